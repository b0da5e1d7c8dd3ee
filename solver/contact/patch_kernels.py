"""Patches of skins: where they are, how they move, which come near another. The bounds test before all contact."""

from __future__ import annotations

import warp as wp

from plait.solver.contact.geometry_kernels import ONE, ZERO

wp.set_module_options({"enable_backward": False})

FAR_AWAY = wp.constant(wp.float64(1.0e300))


@wp.struct
class Patches:
    """Triangles of one skin near each other; body b owns patches first[b]:first[b + 1]."""

    first: wp.array(dtype=wp.int32)  # (body_count + 1,)
    body: wp.array(dtype=wp.int32)  # (patch_count,)
    offsets: wp.array(dtype=wp.int32)  # (patch_count + 1,) into triangles
    triangles: wp.array(dtype=wp.int32)
    rest_lower: wp.array(dtype=wp.vec3d)  # [m] box in the body's rest space
    rest_upper: wp.array(dtype=wp.vec3d)
    lower: wp.array(dtype=wp.vec3d)  # [m] box at the substep's start
    upper: wp.array(dtype=wp.vec3d)
    shift: wp.array(dtype=wp.vec3d)  # [m] mean displacement in the substep
    spread: wp.array(dtype=wp.float64)  # [m] no corner's displacement differs more from the mean
    axis: wp.array(dtype=wp.vec3d)  # mean normal at the start
    cone: wp.array(dtype=wp.float64)  # [rad] no triangle's normal is further from it
    body_lower: wp.array(dtype=wp.vec3d)  # (body_count,) [m] as `lower`, of whole bodies
    body_upper: wp.array(dtype=wp.vec3d)
    body_travel: wp.array(dtype=wp.float64)  # [m] no corner of the body moves further


@wp.func
def box_distance(lower_a: wp.vec3d, upper_a: wp.vec3d, lower_b: wp.vec3d, upper_b: wp.vec3d) -> wp.float64:
    apart = wp.max(wp.max(lower_a - upper_b, lower_b - upper_a), wp.vec3d())
    return wp.length(apart)


@wp.kernel
def bound_patches(
    first: int,
    triangles: wp.array(dtype=wp.vec3i),
    start: wp.array(dtype=wp.vec3d),
    end: wp.array(dtype=wp.vec3d),
    patches: Patches,
):
    """Box, motion and normals of a patch, from its corners' positions; one patch an item."""
    g = first + wp.tid()
    begin = patches.offsets[g]
    stop = patches.offsets[g + 1]
    lower = wp.vec3d(FAR_AWAY, FAR_AWAY, FAR_AWAY)
    upper = -lower
    shift = wp.vec3d()
    axis = wp.vec3d()
    for k in range(begin, stop):
        corner = triangles[patches.triangles[k]]
        for i in range(3):
            x = start[corner[i]]
            lower = wp.min(lower, x)
            upper = wp.max(upper, x)
            shift += end[corner[i]] - x
        a = start[corner[0]]
        axis += wp.cross(start[corner[1]] - a, start[corner[2]] - a)
    shift = shift / wp.float64(3 * (stop - begin))
    axis = wp.normalize(axis)
    spread = ZERO
    least = ONE
    for k in range(begin, stop):
        corner = triangles[patches.triangles[k]]
        for i in range(3):
            spread = wp.max(spread, wp.length(end[corner[i]] - start[corner[i]] - shift))
        a = start[corner[0]]
        normal = wp.normalize(wp.cross(start[corner[1]] - a, start[corner[2]] - a))
        if wp.length_sq(normal) > ZERO:
            least = wp.min(least, wp.dot(normal, axis))
    patches.lower[g] = lower
    patches.upper[g] = upper
    patches.shift[g] = shift
    patches.spread[g] = spread
    patches.axis[g] = axis
    patches.cone[g] = wp.acos(wp.clamp(least, -ONE, ONE))


@wp.kernel
def bound_bodies(first: int, patches: Patches):
    """Boxes of whole bodies, from those of their patches; one body an item."""
    b = first + wp.tid()
    lower = wp.vec3d(FAR_AWAY, FAR_AWAY, FAR_AWAY)
    upper = -lower
    travel = ZERO
    for g in range(patches.first[b], patches.first[b + 1]):
        lower = wp.min(lower, patches.lower[g])
        upper = wp.max(upper, patches.upper[g])
        travel = wp.max(travel, wp.length(patches.shift[g]) + patches.spread[g])
    patches.body_lower[b] = lower
    patches.body_upper[b] = upper
    patches.body_travel[b] = travel


@wp.kernel
def find_near_patches(
    first: int,
    body_count: int,
    patches: Patches,
    margin: wp.float64,
    apart_at_rest: wp.float64,
    opposed: wp.float64,
    reach_out: wp.array(dtype=wp.float64),
):
    """How far [m] a patch and some other it may meet in this substep move against each other; -1: meets none.

    Patches of one body that lie within `apart_at_rest` [m] of each other at rest meet only where normals may
    differ by more than `opposed` [rad]: a surface that is nearly flat does not touch itself. One patch an item.
    """
    g = first + wp.tid()
    own = patches.body[g]
    lower = patches.lower[g]
    upper = patches.upper[g]
    travel = wp.length(patches.shift[g]) + patches.spread[g]
    reach = -ONE
    for b in range(body_count):
        apart = box_distance(lower, upper, patches.body_lower[b], patches.body_upper[b])
        if apart <= travel + patches.body_travel[b] + margin:
            for h in range(patches.first[b], patches.first[b + 1]):
                between = wp.length(patches.shift[g] - patches.shift[h]) + patches.spread[g] + patches.spread[h]
                if box_distance(lower, upper, patches.lower[h], patches.upper[h]) <= between + margin:
                    may_meet = wp.bool(True)
                    if b == own:
                        near = patches.rest_lower[h]
                        far = patches.rest_upper[h]
                        if box_distance(patches.rest_lower[g], patches.rest_upper[g], near, far) <= apart_at_rest:
                            turn = wp.acos(wp.clamp(wp.dot(patches.axis[g], patches.axis[h]), -ONE, ONE))
                            may_meet = turn + patches.cone[g] + patches.cone[h] >= opposed
                    if may_meet:
                        reach = wp.max(reach, between)
    reach_out[g] = reach
