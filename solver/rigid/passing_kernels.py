"""Whether bodies that were turned aside went through what was not looked for on their way."""

from __future__ import annotations

import warp as wp

from plait.solver.rigid.find_kernels import touches
from plait.solver.rigid.motion_kernels import Motion
from plait.solver.rigid.types import Animated, Geoms

wp.set_module_options({"enable_backward": False})


@wp.func
def middle_of(geoms: Geoms, motion: Motion, geom: int) -> wp.vec3d:
    """[m] of a geom's bounding box, world."""
    b = geoms.body[geom]
    return motion.position[b] + wp.quat_rotate(motion.orientation[b], geoms.center[geom])


@wp.kernel
def find_passed(
    first: int,
    geoms: Geoms,
    animated: Animated,
    before: Motion,
    after: Motion,
    passed_out: wp.array(dtype=wp.int32),
):
    """1 where a geom's middle passes a surface that the animation moves and it may touch, one geom an item.

    A middle starts on the side where its geom belongs, and contact keeps it there, unless it was not looked for.
    """
    a = first + wp.tid()
    start = middle_of(geoms, before, a)
    way = middle_of(geoms, after, a) - start
    length = wp.length(way)
    passed = wp.int32(0)
    # Less far than the least of its halves, a middle may reach no surface that the geom does not meet.
    half = geoms.half[a]
    if length > wp.min(half[0], wp.min(half[1], half[2])):
        ahead = way / length
        for b in range(geoms.carried_count, geoms.count):
            k = b - geoms.carried_count
            if animated.active[k] == 1 and touches(geoms, a, b):
                hit = wp.mesh_query_ray(animated.mesh[k], wp.vec3f(start), wp.vec3f(ahead), wp.float32(length))
                if hit.result:
                    passed = 1
    passed_out[a] = passed
