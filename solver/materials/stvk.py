"""St. Venant-Kirchhoff elasticity (e.g. Sifakis and Barbic 2012, section 3.3).

psi = mu E:E + lambda/2 (tr E)^2 with Green's strain E = (F^T F - I) / 2,  P = F (2 mu E + lambda tr E I). It does
not tell a mirrored element from one at rest, and gives way under strong compression.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from plait.solver.materials.principal import principal_functions
from plait.solver.materials.rotation import module_name, rotation_functions


@cache
def stvk(real: type) -> SimpleNamespace:
    """The law for `real`; see `laws.py` for the interface."""
    rotations = rotation_functions(real)
    mat33, vec3 = rotations.mat33, rotations.vec3
    PrincipalHessian = principal_functions(real).PrincipalHessian
    module = module_name(real)

    @wp.func(module=module)
    def green_strain(F: mat33):
        return real(0.5) * (wp.transpose(F) * F - wp.identity(n=3, dtype=real))

    @wp.func(module=module)
    def stvk_energy(F: mat33, mu: real, lam: real):
        E = green_strain(F)
        dilation = wp.trace(E)
        return mu * wp.ddot(E, E) + real(0.5) * lam * dilation * dilation

    @wp.func(module=module)
    def stvk_stress(F: mat33, mu: real, lam: real):
        E = green_strain(F)
        return F * (real(2.0) * mu * E + lam * wp.trace(E) * wp.identity(n=3, dtype=real))

    @wp.func(module=module)
    def stvk_hessian(s: vec3, mu: real, lam: real):
        out = PrincipalHessian()
        pressure = real(0.5) * lam * (wp.dot(s, s) - real(3.0))
        out.normal = lam * wp.outer(s, s)
        for k in range(3):
            i = (k + 1) % 3
            j = (k + 2) % 3
            squares = s[i] * s[i] + s[j] * s[j] - real(1.0)
            out.normal[k, k] = out.normal[k, k] + mu * (real(3.0) * s[k] * s[k] - real(1.0)) + pressure
            out.symmetric[k] = mu * (squares + s[i] * s[j]) + pressure
            out.twist[k] = mu * (squares - s[i] * s[j]) + pressure
        return out

    return SimpleNamespace(
        energy_density=stvk_energy,
        first_piola=stvk_stress,
        principal_hessian=stvk_hessian,
        semi_definite=None,
    )
