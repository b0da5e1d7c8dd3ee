"""The laws of granular matter there are, behind one interface.

A law is isotropic and keeps of the elastic deformation gradient F only Hencky's strain e = ln(F F^T)/2, a
symmetric matrix as in `materials/symmetric.py`; how F turned does not matter. It may keep one number more, its
memory, which starts at zero. A law is a factory of device functions for wp.float32 or wp.float64:

energy_density(e, memory, material) -> psi [J/m3] of the volume at rest.
kirchhoff(e, memory, material) -> tau = (d psi / dF) F^T [Pa], symmetric.
return_map(e, memory, material) -> e and memory after what flows has flowed.
wave_modulus(memory, material) -> [Pa] lambda + 2 mu as it is now: how fast sound goes, which bounds the step.

and a function `parameters(granular)` that gives the numbers it finds in `material.own`.
"""

from collections.abc import Callable
from functools import cache
from types import SimpleNamespace
from typing import NamedTuple

import warp as wp

from plait.solver.granular import elastic, sand, snow
from plait.solver.granular.material import material_type
from plait.solver.materials.symmetric import symmetric_functions
from plait.solver.scene import Granular, GranularLaw


class Law(NamedTuple):
    """cohesive: whether it hangs together under tension."""

    functions: Callable[[type], SimpleNamespace]
    parameters: Callable[[Granular], tuple[float, ...]]
    cohesive: bool


LAWS: dict[GranularLaw, Law] = {
    "sand": Law(sand.sand, sand.parameters, False),
    "snow": Law(snow.snow, snow.parameters, True),
    "elastic": Law(elastic.elastic, elastic.parameters, True),
}


@cache
def law_functions(laws: tuple[GranularLaw, ...], real: type) -> SimpleNamespace:
    """The interface over several laws, of which `material.law` is a place in `laws`; those alone are compiled."""
    functions = LAWS[laws[-1]].functions(real)
    for k in reversed(range(len(laws) - 1)):
        functions = _either(k, LAWS[laws[k]].functions(real), functions, "_".join(laws), real)
    return functions


def _either(k: int, this: SimpleNamespace, other: SimpleNamespace, name: str, real: type) -> SimpleNamespace:
    module = f"plait_granular_laws_{name}_{real.__name__}"
    sym, Material = symmetric_functions(real).sym, material_type(real).Material
    this_energy, other_energy = this.energy_density, other.energy_density
    this_stress, other_stress = this.kirchhoff, other.kirchhoff
    this_return, other_return = this.return_map, other.return_map
    this_modulus, other_modulus = this.wave_modulus, other.wave_modulus

    @wp.func(module=module)
    def energy_density(strain: sym, memory: real, m: Material):
        if m.law == k:
            return this_energy(strain, memory, m)
        return other_energy(strain, memory, m)

    @wp.func(module=module)
    def kirchhoff(strain: sym, memory: real, m: Material):
        if m.law == k:
            return this_stress(strain, memory, m)
        return other_stress(strain, memory, m)

    @wp.func(module=module)
    def return_map(strain: sym, memory: real, m: Material):
        if m.law == k:
            e, more = this_return(strain, memory, m)
            return e, more
        e, more = other_return(strain, memory, m)
        return e, more

    @wp.func(module=module)
    def wave_modulus(memory: real, m: Material):
        if m.law == k:
            return this_modulus(memory, m)
        return other_modulus(memory, m)

    return SimpleNamespace(
        energy_density=energy_density, kirchhoff=kirchhoff, return_map=return_map, wave_modulus=wave_modulus
    )
