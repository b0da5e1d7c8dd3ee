"""Stable neo-Hookean elasticity (Smith, de Goes and Kim 2018, eq. 14).

psi = m/2 (|F|^2 - 3) + l/2 (J - alpha)^2 - m/2 log(|F|^2 + 1) + constant,  alpha = 1 + 3/4 m / l, and m = 4/3 mu,
l = lambda + 5/6 mu to agree with linear elasticity at rest (their section 3.4). The constant makes psi(I) = 0.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from plait.solver.materials.principal import principal_functions
from plait.solver.materials.rotation import module_name, rotation_functions

SHEAR = 4.0 / 3.0
BULK = 5.0 / 6.0


@cache
def neo_hookean(real: type) -> SimpleNamespace:
    """The law for `real`; see `laws.py` for the interface."""
    rotations = rotation_functions(real)
    mat33, vec3, cofactor = rotations.mat33, rotations.vec3, rotations.cofactor
    PrincipalHessian = principal_functions(real).PrincipalHessian
    module = module_name(real)

    @wp.func(module=module)
    def parameters(mu: real, lam: real):
        """m, l, alpha."""
        m = real(SHEAR) * mu
        l = lam + real(BULK) * mu  # noqa: E741
        return m, l, real(1.0) + real(0.75) * m / l

    @wp.func(module=module)
    def neo_hookean_energy(F: mat33, mu: real, lam: real):
        m, l, alpha = parameters(mu, lam)  # noqa: E741
        stretch = wp.ddot(F, F) - real(3.0)
        J = wp.determinant(F)
        # (J - alpha)^2 - (1 - alpha)^2 without cancellation at rest.
        volume = (J - real(1.0)) * (J + real(1.0) - real(2.0) * alpha)
        return real(0.5) * (m * (stretch - wp.log(real(1.0) + real(0.25) * stretch)) + l * volume)

    @wp.func(module=module)
    def neo_hookean_stress(F: mat33, mu: real, lam: real):
        m, l, alpha = parameters(mu, lam)  # noqa: E741
        shear = m * (real(1.0) - real(1.0) / (wp.ddot(F, F) + real(1.0)))
        return shear * F + l * (wp.determinant(F) - alpha) * cofactor(F)

    @wp.func(module=module)
    def neo_hookean_hessian(s: vec3, mu: real, lam: real):
        m, l, alpha = parameters(mu, lam)  # noqa: E741
        out = PrincipalHessian()
        over = real(1.0) / (wp.dot(s, s) + real(1.0))
        shear = m * (real(1.0) - over)
        pressure = l * (s[0] * s[1] * s[2] - alpha)
        others = vec3(s[1] * s[2], s[2] * s[0], s[0] * s[1])
        out.normal = (real(2.0) * m * over * over) * wp.outer(s, s) + l * wp.outer(others, others)
        for k in range(3):
            i = (k + 1) % 3
            j = (k + 2) % 3
            out.normal[k, k] = out.normal[k, k] + shear
            out.normal[i, j] = out.normal[i, j] + pressure * s[k]
            out.normal[j, i] = out.normal[i, j]
            out.symmetric[k] = shear - pressure * s[k]
            out.twist[k] = shear + pressure * s[k]
        return out

    return SimpleNamespace(
        energy_density=neo_hookean_energy,
        first_piola=neo_hookean_stress,
        principal_hessian=neo_hookean_hessian,
        semi_definite=None,
    )
