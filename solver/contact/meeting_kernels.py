"""Strands against moving triangle surfaces: which can meet, and how the surface moves where they do."""

from __future__ import annotations

import warp as wp

from plait.solver.contact.geometry_kernels import (
    ONE,
    ZERO,
    Groups,
    closest_point,
    get_triangle,
    interpolate,
)

wp.set_module_options({"enable_backward": False})

HALF = wp.constant(wp.float64(0.5))
TWO = wp.constant(wp.float64(2.0))
# A strand's first nodes, ghost and root, are prescribed and never in contact; a free strand's ghost alone.
PRESCRIBED = wp.constant(2)
# A strand is at most this much longer than drawn.
STRETCHED = wp.constant(wp.float64(1.05))
UNBOUNDED = wp.constant(wp.float64(1e30))


@wp.struct
class Bodies:
    """The surfaces in reach in this frame, one entry each; see `Colliders` for the point buffers."""

    count: int
    mesh_start: wp.array(dtype=wp.uint64)
    mesh_end: wp.array(dtype=wp.uint64)
    surface: wp.array(dtype=wp.int32)  # index into Scene.surfaces
    first_triangle: wp.array(dtype=wp.int32)
    solid: wp.array(dtype=wp.int32)  # 1: closed, with an inside that nothing belongs in
    thickness: wp.array(dtype=wp.float64)  # [m]
    friction: wp.array(dtype=wp.float64)  # Coulomb coefficient; negative leaves it to the strand
    lower: wp.array(dtype=wp.vec3d)  # [m] box over the frame
    upper: wp.array(dtype=wp.vec3d)
    first_group: wp.array(dtype=wp.int32)
    group_count: wp.array(dtype=wp.int32)
    groups: Groups
    triangles: wp.array(dtype=wp.vec3i)
    rim: wp.array(dtype=wp.int32)  # bit f set: feature f of the triangle lies on the surface's open border
    points_start: wp.array(dtype=wp.vec3d)
    points_end: wp.array(dtype=wp.vec3d)


@wp.struct
class ContactNodes:
    """What is constant of the strands."""

    first_node: wp.array(dtype=wp.int32)  # (strand_count + 1,)
    radius: wp.array(dtype=wp.float64)  # (node_count,) [m]
    clearance: wp.array(dtype=wp.float64)  # (node_count,) [m] least distance ever asked; negative: no contact
    friction: wp.array(dtype=wp.float64)  # (strand_count,)
    surface: wp.array(dtype=wp.int32)  # (strand_count,) grown on, index into Scene.surfaces; -1: nothing
    free: wp.array(dtype=wp.int32)  # (strand_count,) 1: nothing holds the root
    length: wp.array(dtype=wp.float64)  # (strand_count,) [m] from the root to the tip


@wp.func
def to_float(x: wp.vec3d) -> wp.vec3f:
    return wp.vec3f(float(x[0]), float(x[1]), float(x[2]))


@wp.func
def is_rim(bodies: Bodies, triangle: int, feature: int) -> bool:
    return (bodies.rim[triangle] >> feature) & 1 == 1


@wp.struct
class StrandBox:
    lower: wp.vec3d
    upper: wp.vec3d
    radius: wp.float64  # [m] largest


@wp.func
def strand_box(
    nodes: ContactNodes, strand: int, start: wp.array(dtype=wp.vec3d), end: wp.array(dtype=wp.vec3d)
) -> StrandBox:
    root = nodes.first_node[strand] + PRESCRIBED - 1
    box = StrandBox()
    box.lower = wp.min(start[root], end[root])
    box.upper = wp.max(start[root], end[root])
    for i in range(root, nodes.first_node[strand + 1]):
        box.lower = wp.min(box.lower, wp.min(start[i], end[i]))
        box.upper = wp.max(box.upper, wp.max(start[i], end[i]))
        box.radius = wp.max(box.radius, nodes.radius[i])
    return box


@wp.struct
class Near:
    """A strand against a surface: whether they can meet, and how the surface moves nearby.

    The motion is x' = rotation (x - centre) + centre + shift; no part of the surface near the strand moves
    otherwise by more than `deviation`.
    """

    meets: bool
    keeps_out: bool  # the surface has an inside for this strand
    stem: wp.float64  # [m] arc from the root over which the strand has no contact with it
    centre: wp.vec3d  # [m]
    shift: wp.vec3d  # [m]
    rotation: wp.mat33d
    deviation: wp.float64  # [m]


@wp.func
def box_gap(lower1: wp.vec3d, upper1: wp.vec3d, lower2: wp.vec3d, upper2: wp.vec3d) -> wp.float64:
    gap = wp.max(wp.max(lower1 - upper2, lower2 - upper1), wp.vec3d())
    return wp.length(gap)


@wp.func
def follow(near: Near, x: wp.vec3d) -> wp.vec3d:
    return near.rotation * (x - near.centre) + near.centre + near.shift


@wp.func
def find_near(bodies: Bodies, body: int, lower: wp.vec3d, upper: wp.vec3d, margin: wp.float64) -> Near:
    """Against the box of a strand's start and end positions, grown by `margin`; the nearest group's motion."""
    near = Near()
    if box_gap(lower, upper, bodies.lower[body], bodies.upper[body]) > margin:
        return near
    groups = bodies.groups
    begin = bodies.first_group[body]
    end = begin + bodies.group_count[body]
    nearest = wp.int32(-1)
    least = margin
    for g in range(begin, end):
        gap = box_gap(lower, upper, groups.lower[g], groups.upper[g])
        if gap < least or (nearest < 0 and gap <= margin):
            least = gap
            nearest = g
    if nearest < 0:
        return near
    near.meets = True
    near.centre = groups.centre[nearest]
    near.shift = groups.shift[nearest]
    near.rotation = groups.rotation[nearest]
    for g in range(begin, end):
        if box_gap(lower, upper, groups.lower[g], groups.upper[g]) <= margin:
            # Two rigid motions differ no more than at one point, and by their turning over the way from there.
            half = HALF * wp.length(groups.upper[g] - groups.lower[g])
            apart = wp.length(groups.centre[g] + groups.shift[g] - follow(near, groups.centre[g]))
            turning = groups.rotation[g] - near.rotation
            turn = wp.sqrt(wp.ddot(turning, turning))
            near.deviation = wp.max(near.deviation, apart + TWO * turn * half + groups.deformation[g])
    return near


@wp.func
def stem_inside(
    bodies: Bodies, body: int, keeps_out: bool, nodes: ContactNodes, strand: int, root: wp.vec3d, full: wp.float64
) -> wp.float64:
    """[m] arc from a root that the animation has put inside a solid: what its root holds there cannot come out.

    Twice the root's depth; negative where the surface is further from the root than the strand is long: the strand
    is then out of its reach, or held inside as a whole.
    """
    if bodies.surface[body] == nodes.surface[strand]:
        return ZERO
    reach = STRETCHED * nodes.length[strand] + TWO * full
    query = wp.mesh_query_point_sign_normal(bodies.mesh_end[body], to_float(root), float(reach))
    if not query.result:
        return -ONE
    if query.sign >= 0.0 or not keeps_out or nodes.free[strand] != 0:
        return ZERO
    index = bodies.first_triangle[body] + query.face
    triangle = get_triangle(bodies.triangles, bodies.points_end, index)
    nearest = closest_point(triangle, root)
    if is_rim(bodies, index, nearest.feature):
        return ZERO
    return TWO * wp.length(root - interpolate(triangle, nearest.weights))


@wp.func
def meet(
    bodies: Bodies,
    body: int,
    nodes: ContactNodes,
    strand: int,
    box: StrandBox,
    root: wp.vec3d,
    depth: wp.float64,
) -> Near:
    """Whether and how a strand meets a surface in this substep."""
    full = box.radius + bodies.thickness[body]
    near = find_near(bodies, body, box.lower, box.upper, TWO * full + depth)
    if near.meets:
        near.keeps_out = bodies.solid[body] == 1 or bodies.surface[body] == nodes.surface[strand]
        near.stem = stem_inside(bodies, body, near.keeps_out, nodes, strand, root, full)
        near.meets = near.stem >= ZERO
    return near
