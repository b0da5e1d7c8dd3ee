"""Energies of granular matter."""

from functools import cache
from types import SimpleNamespace

import warp as wp

from plait.solver.granular.laws import law_functions
from plait.solver.granular.types import granular_types
from plait.solver.scene import GranularLaw


@cache
def energy_kernels(laws: tuple[GranularLaw, ...], real: type) -> SimpleNamespace:
    """Kernels for the laws in use, in `real` (wp.float32 or wp.float64)."""
    types, energy_density = granular_types(real), law_functions(laws, real).energy_density
    Particles, Blocks, Material = types.Particles, types.Blocks, types.Material

    @wp.kernel(module=f"plait_granular_energy_{'_'.join(laws)}_{real.__name__}", enable_backward=False)
    def measure_energies(
        first: int,
        particles: Particles,
        blocks: Blocks,
        materials: wp.array(dtype=Material),
        gravity: wp.vec3d,
        energy_out: wp.array(dtype=wp.vec3d),
    ):
        """[J] of motion, of strain, and in gravity; one block an item."""
        block = first + wp.tid()
        total = wp.vec3d()
        for q in range(blocks.first[block], blocks.first[block + 1]):
            material = materials[particles.material[q]]
            volume = particles.volume[q]
            mass = wp.float64(material.density * volume)
            psi = energy_density(particles.strain[q], particles.memory[q], material)
            speed_squared = wp.float64(wp.length_sq(particles.velocity[q]))
            lifted = -mass * wp.dot(gravity, particles.position[q])
            total += wp.vec3d(wp.float64(0.5) * mass * speed_squared, wp.float64(volume * psi), lifted)
        energy_out[block] = total

    return SimpleNamespace(measure_energies=measure_energies)
