"""Where a particle lies among the 27 nodes it exchanges with: quadratic B-splines."""

from functools import cache
from types import SimpleNamespace

import warp as wp

from plait.solver.materials.rotation import module_name


@cache
def stencil_functions(real: type) -> SimpleNamespace:
    """Device functions `locate` and `spline` for `real` (wp.float32 or wp.float64)."""
    module, vec3 = module_name(real), wp.types.vector(3, real)

    @wp.func(module=module)
    def locate(position: wp.vec3d, cells: wp.float64):
        """The first node of a particle's stencil, and how far [cells], 0.5 to 1.5, the particle is after it.

        position [m]; cells: to a metre.
        """
        half = wp.float64(0.5)
        place = position * cells
        x = wp.floor(place[0] - half)
        y = wp.floor(place[1] - half)
        z = wp.floor(place[2] - half)
        base = wp.vec3i(wp.int32(x), wp.int32(y), wp.int32(z))
        return base, vec3(real(place[0] - x), real(place[1] - y), real(place[2] - z))

    @wp.func(module=module)
    def spline(offset: real):
        """The weights of a stencil's three nodes along an axis, `offset` after the first."""
        before = real(1.5) - offset
        after = offset - real(0.5)
        middle = offset - real(1.0)
        return vec3(real(0.5) * before * before, real(0.75) - middle * middle, real(0.5) * after * after)

    return SimpleNamespace(locate=locate, spline=spline)
