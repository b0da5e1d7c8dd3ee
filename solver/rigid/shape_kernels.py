"""Distances from points to shapes, in float64, each in the shape's own space."""

from __future__ import annotations

import warp as wp

from plait.solver.rigid.motion_kernels import ONE, ZERO

wp.set_module_options({"enable_backward": False})

MESH = wp.constant(0)
SPHERE = wp.constant(1)
CAPSULE = wp.constant(2)
CYLINDER = wp.constant(3)
CONE = wp.constant(4)
BOX = wp.constant(5)


@wp.struct
class Nearest:
    """What of a surface is nearest to a point."""

    found: bool
    distance: wp.float64  # [m] negative inside
    normal: wp.vec3d  # unit, out of the surface, towards the point where that is outside
    foot: wp.vec3d  # [m] on the surface
    core: wp.vec3d  # [m] behind the foot, the centre about which the surface is round; the foot where it is not


@wp.func
def off(x: wp.float64, y: wp.float64, z: wp.float64) -> wp.vec3d:
    """The direction of (x, y, z), or z where there is none."""
    v = wp.vec3d(x, y, z)
    length = wp.length(v)
    if length == ZERO:
        return wp.vec3d(ZERO, ZERO, ONE)
    return v / length


@wp.func
def nearest_on_box(half: wp.vec3d, x: wp.vec3d) -> Nearest:
    near = Nearest()
    near.found = True
    inside = wp.min(wp.max(x, -half), half)
    away = x - inside
    if wp.length_sq(away) > ZERO:
        near.distance = wp.length(away)
        near.normal = away / near.distance
        near.foot = inside
    else:
        axis = wp.int32(0)
        depth = half[0] - wp.abs(x[0])
        for k in range(1, 3):
            if half[k] - wp.abs(x[k]) < depth:
                depth = half[k] - wp.abs(x[k])
                axis = k
        for k in range(3):
            if k == axis:
                near.normal[k] = wp.where(x[k] < ZERO, -ONE, ONE)
        near.distance = -depth
        near.foot = x + depth * near.normal
    near.core = near.foot
    return near


@wp.func
def nearest_on_round(radius: wp.float64, half: wp.float64, x: wp.vec3d) -> Nearest:
    """A sphere, or with `half` > 0 a capsule along z."""
    near = Nearest()
    near.found = True
    near.core = wp.vec3d(ZERO, ZERO, wp.clamp(x[2], -half, half))
    away = x - near.core
    near.normal = off(away[0], away[1], away[2])
    near.distance = wp.length(away) - radius
    near.foot = near.core + radius * near.normal
    return near


@wp.struct
class Profile:
    """The nearest point of a convex outline in the half-plane of (distance from the axis, height)."""

    distance: wp.float64  # [m] negative inside
    foot: wp.vec2d
    normal: wp.vec2d
    outside: bool
    flat: bool  # on a lid: not round


@wp.func
def along_outline(best: Profile, a: wp.vec2d, b: wp.vec2d, x: wp.vec2d, lid: bool) -> Profile:
    """Takes one side of the outline, a to b with the outside on its right, into account."""
    way = b - a
    part = wp.clamp(wp.dot(x - a, way) / wp.dot(way, way), ZERO, ONE)
    foot = a + part * way
    normal = wp.normalize(wp.vec2d(way[1], -way[0]))
    out = best
    if wp.dot(x - a, normal) > ZERO:
        out.outside = True
    apart = wp.length(x - foot)
    if apart < out.distance:
        out.distance = apart
        out.foot = foot
        out.normal = normal
        out.flat = lid
    return out


@wp.func
def nearest_on_turned(kind: int, radius: wp.float64, half: wp.float64, x: wp.vec3d) -> Nearest:
    """A cylinder or a cone about z, the cone's apex at +half."""
    across = wp.sqrt(x[0] * x[0] + x[1] * x[1])
    at = wp.vec2d(across, x[2])
    bottom = wp.vec2d(radius, -half)
    best = Profile()
    best.distance = wp.float64(1e300)
    if kind == CYLINDER:
        top = wp.vec2d(radius, half)
        best = along_outline(best, bottom, top, at, False)
        best = along_outline(best, top, wp.vec2d(ZERO, half), at, True)
    else:
        best = along_outline(best, bottom, wp.vec2d(ZERO, half), at, False)
    best = along_outline(best, wp.vec2d(ZERO, -half), bottom, at, True)
    away = at - best.foot
    normal = best.normal
    if best.outside and best.distance > wp.float64(1e-9) * radius:
        normal = away / best.distance
    radial = wp.vec2d(ONE, ZERO)
    if across > ZERO:
        radial = wp.vec2d(x[0], x[1]) / across
    near = Nearest()
    near.found = True
    near.distance = wp.where(best.outside, best.distance, -best.distance)
    near.normal = wp.vec3d(normal[0] * radial[0], normal[0] * radial[1], normal[1])
    near.foot = wp.vec3d(best.foot[0] * radial[0], best.foot[0] * radial[1], best.foot[1])
    near.core = near.foot
    if not best.flat and normal[0] > ZERO:
        near.core = near.foot - best.foot[0] / normal[0] * near.normal
    return near


@wp.func
def nearest_on_shape(kind: int, size: wp.vec3d, x: wp.vec3d) -> Nearest:
    """See `plait.solver.scene.Shape` for the sizes."""
    if kind == BOX:
        return nearest_on_box(size, x)
    if kind == SPHERE:
        return nearest_on_round(size[0], ZERO, x)
    if kind == CAPSULE:
        return nearest_on_round(size[0], size[1], x)
    return nearest_on_turned(kind, size[0], size[1], x)
