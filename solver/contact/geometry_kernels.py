"""Points against moving triangles, in float64: closest points, triangle frames, motion bounds."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

ZERO = wp.constant(wp.float64(0.0))
ONE = wp.constant(wp.float64(1.0))
# Twice a triangle's area relative to its squared edges, below which it has no normal to speak of.
FLAT = wp.constant(wp.float64(1e-10))
# Features of a triangle that a closest point may lie on: inside, edge opposite corner k, corner k.
INSIDE = wp.constant(0)
EDGE = wp.constant(1)  # 1, 2, 3
CORNER = wp.constant(4)  # 4, 5, 6


@wp.struct
class Triangle:
    """A triangle's corners [m]."""

    a: wp.vec3d
    b: wp.vec3d
    c: wp.vec3d


@wp.struct
class Closest:
    """The point of a triangle nearest to another: barycentric weights, and the feature it lies on."""

    weights: wp.vec3d
    feature: int


@wp.func
def get_triangle(triangles: wp.array(dtype=wp.vec3i), points: wp.array(dtype=wp.vec3d), index: int) -> Triangle:
    corners = triangles[index]
    triangle = Triangle()
    triangle.a = points[corners[0]]
    triangle.b = points[corners[1]]
    triangle.c = points[corners[2]]
    return triangle


@wp.func
def interpolate(triangle: Triangle, weights: wp.vec3d) -> wp.vec3d:
    return triangle.a + weights[1] * (triangle.b - triangle.a) + weights[2] * (triangle.c - triangle.a)


@wp.func
def unit_normal(triangle: Triangle) -> wp.vec3d:
    """Zero for a triangle without area."""
    edge1 = triangle.b - triangle.a
    edge2 = triangle.c - triangle.a
    normal = wp.cross(edge1, edge2)
    area = wp.length(normal)
    if area <= FLAT * (wp.length_sq(edge1) + wp.length_sq(edge2)):
        return wp.vec3d()
    return normal / area


@wp.func
def triangle_frame(triangle: Triangle, normal: wp.vec3d) -> wp.mat33d:
    """Columns: the first edge's direction, normal x it, normal."""
    tangent = wp.normalize(triangle.b - triangle.a)
    return wp.matrix_from_cols(tangent, wp.cross(normal, tangent), normal)


@wp.func
def closest_point(triangle: Triangle, x: wp.vec3d) -> Closest:
    """By Voronoi regions (Ericson 2005, section 5.1.5); a triangle without area falls to its edges and corners."""
    found = Closest()
    ab = triangle.b - triangle.a
    ac = triangle.c - triangle.a
    ax = x - triangle.a
    d1 = wp.dot(ab, ax)
    d2 = wp.dot(ac, ax)
    if d1 <= ZERO and d2 <= ZERO:
        found.weights = wp.vec3d(ONE, ZERO, ZERO)
        found.feature = CORNER
        return found
    bx = x - triangle.b
    d3 = wp.dot(ab, bx)
    d4 = wp.dot(ac, bx)
    if d3 >= ZERO and d4 <= d3:
        found.weights = wp.vec3d(ZERO, ONE, ZERO)
        found.feature = CORNER + 1
        return found
    vc = d1 * d4 - d3 * d2
    if vc <= ZERO and d1 >= ZERO and d3 <= ZERO and d1 > d3:
        v = d1 / (d1 - d3)
        found.weights = wp.vec3d(ONE - v, v, ZERO)
        found.feature = EDGE + 2
        return found
    cx = x - triangle.c
    d5 = wp.dot(ab, cx)
    d6 = wp.dot(ac, cx)
    if d6 >= ZERO and d5 <= d6:
        found.weights = wp.vec3d(ZERO, ZERO, ONE)
        found.feature = CORNER + 2
        return found
    vb = d5 * d2 - d1 * d6
    if vb <= ZERO and d2 >= ZERO and d6 <= ZERO and d2 > d6:
        w = d2 / (d2 - d6)
        found.weights = wp.vec3d(ONE - w, ZERO, w)
        found.feature = EDGE + 1
        return found
    va = d3 * d6 - d5 * d4
    along = (d4 - d3) + (d5 - d6)
    if va <= ZERO and d4 >= d3 and d5 >= d6 and along > ZERO:
        w = (d4 - d3) / along
        found.weights = wp.vec3d(ZERO, ONE - w, w)
        found.feature = EDGE
        return found
    total = va + vb + vc
    found.weights = wp.vec3d(va / total, vb / total, vc / total)
    found.feature = INSIDE
    return found


@wp.struct
class Groups:
    """Triangles near each other, and how they move over a substep; group g has one entry.

    The motion is x' = rotation (x - centre) + centre + shift, up to `deformation`.
    """

    vertex_offsets: wp.array(dtype=wp.int32)  # (group_count + 1,)
    vertices: wp.array(dtype=wp.int32)  # of each group, once each
    lower: wp.array(dtype=wp.vec3d)  # [m] box of the start and end positions
    upper: wp.array(dtype=wp.vec3d)
    centre: wp.array(dtype=wp.vec3d)  # [m] mean start position
    shift: wp.array(dtype=wp.vec3d)  # [m] mean displacement
    rotation: wp.array(dtype=wp.mat33d)
    deformation: wp.array(dtype=wp.float64)  # [m] largest distance of a vertex from where the motion takes it


@wp.kernel
def bound_groups(
    first: int,
    active: wp.array(dtype=wp.int32),
    points_start: wp.array(dtype=wp.vec3d),
    points_end: wp.array(dtype=wp.vec3d),
    groups: Groups,
):
    """Fills boxes and motions of the groups listed in `active`, one group an item.

    The rotation is the best in the sense of least squares (Kabsch 1976).
    """
    g = active[first + wp.tid()]
    begin = groups.vertex_offsets[g]
    end = groups.vertex_offsets[g + 1]
    lower = points_start[groups.vertices[begin]]
    upper = lower
    centre = wp.vec3d()
    centre_end = wp.vec3d()
    for k in range(begin, end):
        v = groups.vertices[k]
        lower = wp.min(lower, wp.min(points_start[v], points_end[v]))
        upper = wp.max(upper, wp.max(points_start[v], points_end[v]))
        centre += points_start[v]
        centre_end += points_end[v]
    centre = centre / wp.float64(end - begin)
    centre_end = centre_end / wp.float64(end - begin)
    covariance = wp.mat33d()
    for k in range(begin, end):
        v = groups.vertices[k]
        covariance += wp.outer(points_end[v] - centre_end, points_start[v] - centre)
    u, _sigma, v_matrix = wp.svd3(covariance)
    handed = wp.determinant(u) * wp.determinant(v_matrix)
    rotation = u * wp.diag(wp.vec3d(ONE, ONE, handed)) * wp.transpose(v_matrix)
    deformation = ZERO
    for k in range(begin, end):
        v = groups.vertices[k]
        off = rotation * (points_start[v] - centre) + centre_end - points_end[v]
        deformation = wp.max(deformation, wp.length(off))
    groups.lower[g] = lower
    groups.upper[g] = upper
    groups.centre[g] = centre
    groups.shift[g] = centre_end - centre
    groups.rotation[g] = rotation
    groups.deformation[g] = deformation
