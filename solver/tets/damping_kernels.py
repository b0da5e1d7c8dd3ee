"""Kernels of `damping.py`."""

from functools import cache, partial
from types import SimpleNamespace

import warp as wp

from plait.solver.linear.block_kernels import block_kernels
from plait.solver.materials.rotation import rotation_functions
from plait.solver.tets.elements import element_types


@cache
def damping_kernels(real: type) -> SimpleNamespace:
    """Kernels over tets in `real` (wp.float32 or wp.float64)."""
    module = f"plait_tets_damping_{real.__name__}"
    kernel = partial(wp.kernel, module=module, enable_backward=False)
    rotations, types = rotation_functions(real), element_types(real)
    vec3, mat33, Elements = types.vec3, types.mat33, types.Elements
    rotation = rotations.rotation
    pair = block_kernels(real).pair
    mat43 = wp.types.matrix((4, 3), real)

    @partial(wp.struct, module=module)
    class Damping:
        rotation: wp.array(dtype=mat33)  # (tet_count,) R
        base: wp.array(dtype=wp.mat33d)  # (tet_count,) F(base)
        rate: wp.float64  # beta / (gamma h)

    @wp.func(module=module)
    def gradient(elements: Elements, x: wp.array(dtype=wp.vec3d), t: int):
        nodes = elements.nodes[t]
        x0 = x[nodes[0]]
        edges = wp.matrix_from_cols(x[nodes[1]] - x0, x[nodes[2]] - x0, x[nodes[3]] - x0)
        return edges * elements.inverse_rest[t]

    @wp.func(module=module)
    def strain(elements: Elements, damping: Damping, position: wp.array(dtype=wp.vec3d), t: int):
        """E."""
        change = mat33(gradient(elements, position, t) - damping.base[t])
        turned = wp.transpose(damping.rotation[t]) * change
        return real(0.5) * (turned + wp.transpose(turned))

    @kernel
    def lay(first: int, elements: Elements, start: wp.array(dtype=wp.vec3d), predicted: wp.array(dtype=wp.vec3d),
            base: wp.array(dtype=wp.vec3d), share: wp.float64, damping_out: Damping):  # fmt: skip
        t = first + wp.tid()
        between = (wp.float64(1.0) - share) * gradient(elements, start, t)
        between += share * gradient(elements, predicted, t)
        damping_out.rotation[t] = rotation(mat33(between))
        damping_out.base[t] = gradient(elements, base, t)

    @kernel
    def energy(first: int, elements: Elements, damping: Damping, position: wp.array(dtype=wp.vec3d),
               energy_out: wp.array(dtype=wp.float64)):  # fmt: skip
        t = first + wp.tid()
        E = strain(elements, damping, position, t)
        spread = wp.trace(E)
        density = elements.mu[t] * wp.ddot(E, E) + real(0.5) * elements.lam[t] * spread * spread
        energy_out[t] = energy_out[t] + damping.rate * wp.float64(elements.volume[t] * density)

    @kernel
    def force(first: int, elements: Elements, damping: Damping, position: wp.array(dtype=wp.vec3d),
              force_out: wp.array(dtype=vec3)):  # fmt: skip
        t = first + wp.tid()
        E = strain(elements, damping, position, t)
        size = real(damping.rate) * elements.volume[t]
        inner = (size * real(2.0) * elements.mu[t]) * E
        inner += (size * elements.lam[t] * wp.trace(E)) * wp.identity(n=3, dtype=real)
        forces = mat33(elements.inverse_rest[t]) * wp.transpose(damping.rotation[t] * inner)
        force_out[4 * t] = force_out[4 * t] + (forces[0] + forces[1] + forces[2])
        for a in range(3):
            force_out[4 * t + 1 + a] = force_out[4 * t + 1 + a] - forces[a]

    @kernel
    def stiffness(first: int, elements: Elements, damping: Damping, block_out: wp.array(dtype=mat33)):
        t = first + wp.tid()
        size = wp.sqrt(real(damping.rate) * elements.volume[t])
        turned = size * mat33(elements.inverse_rest[t]) * wp.transpose(damping.rotation[t])
        g = mat43()
        g[0] = -(turned[0] + turned[1] + turned[2])
        for a in range(3):
            g[a + 1] = turned[a]
        for a in range(4):
            ga = g[a]
            for b in range(a, 4):
                gb = g[b]
                block = elements.mu[t] * (wp.dot(ga, gb) * wp.identity(n=3, dtype=real) + wp.outer(gb, ga))
                block += elements.lam[t] * wp.outer(ga, gb)
                k = 10 * t + pair(a, b)
                block_out[k] = block_out[k] + block

    return SimpleNamespace(
        lay=lay, energy=energy, force=force, stiffness=stiffness, types=SimpleNamespace(Damping=Damping)
    )
