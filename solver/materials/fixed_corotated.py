"""Fixed corotated elasticity (Stomakhin et al. 2012; Han et al. 2019 eq. 3, with P the derivative of its energy).

psi = mu |F - R|^2 + lambda/2 (J - 1)^2,  P = 2 mu (F - R) + lambda (J - 1) cof F.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from plait.solver.materials.principal import principal_functions
from plait.solver.materials.rotation import module_name, rotation_functions

LEAST_SUM = 1.0e-12  # of two principal stretches, beside one: there the nearest rotation is not unique


@cache
def fixed_corotated(real: type) -> SimpleNamespace:
    """The law for `real`; see `laws.py` for the interface."""
    rotations = rotation_functions(real)
    mat33, vec3 = rotations.mat33, rotations.vec3
    rotation, cofactor = rotations.rotation, rotations.cofactor
    PrincipalHessian = principal_functions(real).PrincipalHessian
    module = module_name(real)

    @wp.func(module=module)
    def fixed_corotated_energy(F: mat33, mu: real, lam: real):
        strain = F - rotation(F)
        dilation = wp.determinant(F) - real(1.0)
        return mu * wp.ddot(strain, strain) + real(0.5) * lam * dilation * dilation

    @wp.func(module=module)
    def fixed_corotated_stress(F: mat33, mu: real, lam: real):
        dilation = wp.determinant(F) - real(1.0)
        return real(2.0) * mu * (F - rotation(F)) + lam * dilation * cofactor(F)

    @wp.func(module=module)
    def fixed_corotated_hessian(s: vec3, mu: real, lam: real):
        out = PrincipalHessian()
        J = s[0] * s[1] * s[2]
        pressure = lam * (J - real(1.0))
        others = vec3(s[1] * s[2], s[2] * s[0], s[0] * s[1])
        out.normal = lam * wp.outer(others, others)
        for k in range(3):
            i = (k + 1) % 3
            j = (k + 2) % 3
            out.normal[k, k] = out.normal[k, k] + real(2.0) * mu
            out.normal[i, j] = out.normal[i, j] + pressure * s[k]
            out.normal[j, i] = out.normal[i, j]
            out.symmetric[k] = real(2.0) * mu - pressure * s[k]
            apart = real(4.0) * mu / wp.max(s[i] + s[j], real(LEAST_SUM))
            out.twist[k] = real(2.0) * mu - apart + pressure * s[k]
        return out

    @wp.func(module=module)
    def corotated(F: mat33, mu: real, lam: real):
        """Q, W of mu |sym(R^T dF)|^2 + lambda/2 (cof F : dF)^2, what remains when R and J turn no further."""
        return wp.sqrt(mu) * rotation(F), wp.sqrt(lam) * cofactor(F)

    return SimpleNamespace(
        energy_density=fixed_corotated_energy,
        first_piola=fixed_corotated_stress,
        principal_hessian=fixed_corotated_hessian,
        semi_definite=corotated,
    )
