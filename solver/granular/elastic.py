"""Matter that does not flow: elastic particles on the grid of the others, as traditional MPM has them.

The Kirchhoff stress is tau = 2 mu e + lambda tr e of Hencky's strain e = ln(F F^T)/2. For comparison: it sticks to
all that shares its grid.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from plait.solver.granular.material import material_type
from plait.solver.materials.rotation import module_name
from plait.solver.materials.symmetric import symmetric_functions
from plait.solver.scene import Granular


def parameters(granular: Granular) -> tuple[float, ...]:
    """None beside the elastic ones."""
    return ()


@cache
def elastic(real: type) -> SimpleNamespace:
    """The law for `real`; see `laws.py` for the interface. memory: none."""
    module = module_name(real)
    functions = symmetric_functions(real)
    sym, Material = functions.sym, material_type(real).Material
    trace_of, size_squared, plus_isotropic = functions.trace_of, functions.size_squared, functions.plus_isotropic

    @wp.func(module=module)
    def elastic_energy(strain: sym, memory: real, m: Material):
        dilation = trace_of(strain)
        return m.mu * size_squared(strain) + real(0.5) * m.lam * dilation * dilation

    @wp.func(module=module)
    def elastic_stress(strain: sym, memory: real, m: Material):
        return plus_isotropic(real(2.0) * m.mu * strain, m.lam * trace_of(strain))

    @wp.func(module=module)
    def elastic_return(strain: sym, memory: real, m: Material):
        return strain, memory

    @wp.func(module=module)
    def elastic_modulus(memory: real, m: Material):
        return m.lam + real(2.0) * m.mu

    return SimpleNamespace(
        energy_density=elastic_energy,
        kirchhoff=elastic_stress,
        return_map=elastic_return,
        wave_modulus=elastic_modulus,
    )
