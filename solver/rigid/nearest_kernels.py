"""The places of surfaces nearest to points."""

from __future__ import annotations

import warp as wp

from plait.solver.contact.geometry_kernels import (
    INSIDE,
    closest_point,
    get_triangle,
    interpolate,
    triangle_frame,
    unit_normal,
)
from plait.solver.rigid.motion_kernels import ZERO, Motion
from plait.solver.rigid.shape_kernels import MESH, nearest_on_shape
from plait.solver.rigid.types import Animated, Geoms

wp.set_module_options({"enable_backward": False})

# Normals are told from offsets longer than this part of a triangle's edges.
NOISE = wp.constant(wp.float64(1e-7))


@wp.struct
class Side:
    """The surface side of a contact, world."""

    found: bool
    gap: wp.float64  # [m] of the point at its start from the surface, along the normal
    distance: wp.float64  # [m] from the surface at the start
    normal: wp.vec3d  # at the substep's end
    foot: wp.vec3d  # [m] at the start
    core: wp.vec3d  # [m] at the start
    way: wp.vec3d  # [m] that an animated surface carries the foot


@wp.struct
class OnMesh:
    """The nearest place of a mesh."""

    found: bool
    triangle: int
    weights: wp.vec3d
    foot: wp.vec3d  # [m]
    normal: wp.vec3d
    distance: wp.float64  # [m] negative inside, or behind


@wp.func
def to_float(x: wp.vec3d) -> wp.vec3f:
    return wp.vec3f(float(x[0]), float(x[1]), float(x[2]))


@wp.func
def nearest_on_mesh(
    mesh: wp.uint64,
    triangles: wp.array(dtype=wp.vec3i),
    points: wp.array(dtype=wp.vec3d),
    first_triangle: int,
    solid: bool,
    x: wp.vec3d,
    search: wp.float64,
    witness: wp.vec3d,
) -> OnMesh:
    """The nearest place of a mesh within `search` [m]; witness: a point on the side of an open one that counts."""
    out = OnMesh()
    query = wp.mesh_query_point_sign_normal(mesh, to_float(x), float(search))
    if not query.result:
        return out
    out.found = True
    out.triangle = first_triangle + query.face
    triangle = get_triangle(triangles, points, out.triangle)
    place = closest_point(triangle, x)
    out.weights = place.weights
    out.foot = interpolate(triangle, place.weights)
    away = x - out.foot
    out.normal = unit_normal(triangle)
    # Where the nearest place is within a triangle its own plane tells the side, without float32's rounding.
    behind = query.sign < 0.0
    if not solid and wp.dot(witness - out.foot, out.normal) < ZERO:
        out.normal = -out.normal
    if not solid or place.feature == INSIDE:
        behind = wp.dot(away, out.normal) < ZERO
    distance = wp.length(away)
    out.distance = wp.where(behind, -distance, distance)
    if distance > NOISE * (wp.length(triangle.b - triangle.a) + wp.length(triangle.c - triangle.a)):
        out.normal = away / out.distance
    return out


@wp.func
def nearest_on_animated(
    geoms: Geoms, animated: Animated, b: int, x: wp.vec3d, search: wp.float64, witness: wp.vec3d
) -> Side:
    """The place nearest to a point at the substep's start, carried along to its end."""
    out = Side()
    near = nearest_on_mesh(
        animated.mesh[b - geoms.carried_count],
        animated.triangles,
        animated.points_start,
        geoms.first_triangle[b],
        geoms.solid[b] == 1,
        x,
        search,
        witness,
    )
    if not near.found:
        return out
    before = get_triangle(animated.triangles, animated.points_start, near.triangle)
    after = get_triangle(animated.triangles, animated.points_end, near.triangle)
    out.found = True
    out.normal = near.normal
    normal_before = unit_normal(before)
    normal_after = unit_normal(after)
    if wp.length_sq(normal_before) > ZERO and wp.length_sq(normal_after) > ZERO:
        carry = triangle_frame(after, normal_after) * wp.transpose(triangle_frame(before, normal_before))
        out.normal = carry * near.normal
    out.foot = near.foot
    out.core = near.foot
    out.way = interpolate(after, near.weights) - near.foot
    out.distance = near.distance
    out.gap = wp.dot(out.normal, x - near.foot) - geoms.thickness[b]
    return out


@wp.func
def nearest_on_geom(
    geoms: Geoms, animated: Animated, motion: Motion, b: int, x: wp.vec3d, search: wp.float64, witness: wp.vec3d
) -> Side:
    """The place of geom b nearest to a point, world; witness: a point on the side of an open one that counts."""
    body = geoms.body[b]
    if body < 0:
        return nearest_on_animated(geoms, animated, b, x, search, witness)
    out = Side()
    orientation = motion.orientation[body]
    origin = motion.position[body]
    local = wp.quat_rotate_inv(orientation, x - origin)
    if geoms.kind[b] == MESH:
        near = nearest_on_mesh(
            geoms.mesh[b],
            geoms.triangles,
            geoms.vertices,
            geoms.first_triangle[b],
            geoms.solid[b] == 1,
            local,
            search,
            wp.quat_rotate_inv(orientation, witness - origin),
        )
        out.found = near.found
        out.distance = near.distance
        out.normal = near.normal
        out.foot = near.foot
        out.core = near.foot
    else:
        turn = geoms.turn[b]
        on_shape = nearest_on_shape(
            geoms.kind[b], geoms.size[b], wp.quat_rotate_inv(turn, local - geoms.offset[b])
        )
        out.found = on_shape.distance <= search
        out.distance = on_shape.distance
        out.normal = wp.quat_rotate(turn, on_shape.normal)
        out.foot = geoms.offset[b] + wp.quat_rotate(turn, on_shape.foot)
        out.core = geoms.offset[b] + wp.quat_rotate(turn, on_shape.core)
    out.gap = out.distance - geoms.thickness[b]
    out.normal = wp.quat_rotate(orientation, out.normal)
    out.foot = origin + wp.quat_rotate(orientation, out.foot)
    out.core = origin + wp.quat_rotate(orientation, out.core)
    out.way = wp.vec3d()
    return out
