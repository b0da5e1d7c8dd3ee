"""St. Venant-Kirchhoff elasticity in Hencky's strain (Klar et al. 2016; Han et al. 2019, eq. 8 and 9).

psi = mu tr(e^2) + lambda/2 (tr e)^2 with e = ln s of the principal stretches s, F = U diag(s) V^T,
P = U diag((2 mu e + lambda tr e) / s) V^T; the trace of the second term is missing where (9) is printed. Chosen
for the return mappings of granular matter (`drucker_prager.py`), which are exact in e. It exists for positive
stretches alone, so it is none of the laws that a body of tets can have.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from plait.solver.materials.principal import principal_functions
from plait.solver.materials.rotation import module_name, rotation_functions


@cache
def hencky(real: type) -> SimpleNamespace:
    """`energy_density` and `first_piola` for `real`, as in `laws.py`; NaN where a stretch is not positive."""
    rotations = rotation_functions(real)
    mat33, vec3 = rotations.mat33, rotations.vec3
    decompose = principal_functions(real).decompose
    module = module_name(real)

    @wp.func(module=module)
    def hencky_strain(s: vec3):
        return vec3(wp.log(s[0]), wp.log(s[1]), wp.log(s[2]))

    @wp.func(module=module)
    def hencky_energy(F: mat33, mu: real, lam: real):
        _U, s, _V = decompose(F)
        e = hencky_strain(s)
        dilation = e[0] + e[1] + e[2]
        return mu * wp.dot(e, e) + real(0.5) * lam * dilation * dilation

    @wp.func(module=module)
    def hencky_stress(F: mat33, mu: real, lam: real):
        U, s, V = decompose(F)
        e = hencky_strain(s)
        pressure = lam * (e[0] + e[1] + e[2])
        stress = vec3()
        for k in range(3):
            stress[k] = (real(2.0) * mu * e[k] + pressure) / s[k]
        return U * wp.diag(stress) * wp.transpose(V)

    return SimpleNamespace(energy_density=hencky_energy, first_piola=hencky_stress, strain=hencky_strain)
