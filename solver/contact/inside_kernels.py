"""What is inside a surface: how a groom was drawn, and a check apart from the finding of contacts."""

from __future__ import annotations

import warp as wp

from plait.solver.contact.geometry_kernels import ONE, ZERO, closest_point, get_triangle, interpolate
from plait.solver.contact.meeting_kernels import (
    PRESCRIBED,
    TWO,
    Bodies,
    ContactNodes,
    box_gap,
    is_rim,
    stem_inside,
    strand_box,
    to_float,
)

wp.set_module_options({"enable_backward": False})

FAR = wp.constant(1.0e10)


@wp.func
def height_above(bodies: Bodies, body: int, query: wp.MeshQueryPoint, x: wp.vec3d, sign: float) -> wp.float64:
    """[m] signed distance to a query's nearest triangle, end pose; beside an open border nothing is inside."""
    index = bodies.first_triangle[body] + query.face
    triangle = get_triangle(bodies.triangles, bodies.points_end, index)
    near = closest_point(triangle, x)
    distance = wp.length(x - interpolate(triangle, near.weights))
    if sign < 0.0 and not is_rim(bodies, index, near.feature):
        return -distance
    return distance


@wp.func
def drawn_height(
    bodies: Bodies, body: int, winding_mesh: wp.uint64, x: wp.vec3d, reach: float, otherwise: wp.float64
) -> wp.float64:
    """[m] signed distance: by the winding number of a solid, by normals where there is no such tree."""
    height = otherwise
    if winding_mesh != wp.uint64(0):
        query = wp.mesh_query_point_sign_winding_number(winding_mesh, to_float(x), reach)
        if query.result:
            height = height_above(bodies, body, query, x, query.sign)
    else:
        query = wp.mesh_query_point_sign_normal(bodies.mesh_end[body], to_float(x), reach)
        if query.result:
            height = height_above(bodies, body, query, x, query.sign)
    return height


@wp.kernel
def measure_roots(
    first: int,
    strands: wp.array(dtype=wp.int32),
    bodies: Bodies,
    body: int,
    winding_mesh: wp.uint64,
    nodes: ContactNodes,
    position: wp.array(dtype=wp.vec3d),
    height_out: wp.array(dtype=wp.float64),
):
    """[m] signed distance of the roots of `strands` to a surface; one of these strands an item."""
    strand = strands[first + wp.tid()]
    x = position[nodes.first_node[strand] + PRESCRIBED - 1]
    height_out[strand] = drawn_height(bodies, body, winding_mesh, x, FAR, ZERO)


@wp.kernel
def note_drawn(
    first: int,
    strands: wp.array(dtype=wp.int32),
    bodies: Bodies,
    body: int,
    winding_mesh: wp.uint64,
    nodes: ContactNodes,
    position: wp.array(dtype=wp.vec3d),
    root_height: wp.array(dtype=wp.float64),
    depth_out: wp.array(dtype=wp.float64),
):
    """How a groom was drawn: lowers `nodes.clearance`, raises `depth_out`; one of `strands` an item.

    A node drawn nearer than radius and thickness is asked for no more than that distance. A node drawn inside is
    asked to come out, unless it belongs to the strand's stem: the run of nodes inside that starts at the root,
    over no more arc than twice the root's depth. A stem cannot come out, its root holds it: it has no contacts.
    """
    strand = strands[first + wp.tid()]
    root = nodes.first_node[strand] + PRESCRIBED - 1
    root_depth = wp.max(-root_height[strand], ZERO)
    known = wp.abs(root_height[strand])
    outside = root_height[strand] > ZERO
    in_stem = nodes.free[strand] == 0
    since = ZERO
    arc = ZERO
    for i in range(root + 1 - nodes.free[strand], nodes.first_node[strand + 1]):
        step = wp.length(position[i] - position[i - 1])
        arc += step
        since += step
        asked = nodes.radius[i] + bodies.thickness[body]
        # Distance changes no faster than arc length: it is taken where it may matter, and bounded in the search.
        if not outside or known - since < asked:
            reach = float(known + since) * 1.001 + 1.0e-5
            height = drawn_height(bodies, body, winding_mesh, position[i], reach, known)
            outside = height >= ZERO
            known = wp.abs(height)
            since = ZERO
            if outside:
                in_stem = False
                if height < asked and nodes.clearance[i] >= ZERO:
                    nodes.clearance[i] = wp.min(nodes.clearance[i], height)
            elif in_stem and arc <= TWO * root_depth:
                nodes.clearance[i] = -ONE
            else:
                in_stem = False
                depth_out[strand] = wp.max(depth_out[strand], -height)


@wp.func
def ray_parity(mesh: wp.uint64, x: wp.vec3f) -> float:
    """-1 inside, 1 outside; where the first ray says inside, the majority of three decides."""
    if wp.mesh_query_ray_count_intersections(mesh, x, wp.vec3f(0.48, 0.64, 0.6)) % 2 == 0:
        return 1.0
    second = wp.mesh_query_ray_count_intersections(mesh, x, wp.vec3f(-0.6, 0.31, -0.7375)) % 2
    third = wp.mesh_query_ray_count_intersections(mesh, x, wp.vec3f(0.13, -0.89, 0.437)) % 2
    if second + third == 0:
        return 1.0
    return -1.0


@wp.func
def crosses(mesh: wp.uint64, a: wp.vec3d, b: wp.vec3d) -> bool:
    way = b - a
    length = wp.length(way)
    if length <= ZERO:
        return False
    return wp.mesh_query_ray_anyhit(mesh, to_float(a), to_float(way / length), float(length))


@wp.kernel
def find_inside(
    first: int,
    bodies: Bodies,
    nodes: ContactNodes,
    position: wp.array(dtype=wp.vec3d),
    count_out: wp.array(dtype=wp.int32),
    deepest_out: wp.array(dtype=wp.float64),
):
    """Nodes further inside a surface than their radius, and the deepest node [m]; one strand an item.

    For solids by ray parity, taken again wherever an edge of the strand meets the surface; for an open surface
    grown on by normals. Prescribed nodes and stems are left out.
    """
    strand = first + wp.tid()
    root = nodes.first_node[strand] + PRESCRIBED - 1
    box = strand_box(nodes, strand, position, position)
    count = wp.int32(0)
    deepest = ZERO
    for body in range(bodies.count):
        solid = bodies.solid[body] == 1
        keeps_out = solid or bodies.surface[body] == nodes.surface[strand]
        stem = -ONE
        if keeps_out and box_gap(box.lower, box.upper, bodies.lower[body], bodies.upper[body]) <= ZERO:
            full = box.radius + bodies.thickness[body]
            stem = stem_inside(bodies, body, keeps_out, nodes, strand, position[root], full)
        if stem >= ZERO:
            mesh = bodies.mesh_end[body]
            arc = ZERO
            sign = wp.float32(1.0)
            known = wp.bool(False)
            for i in range(root + 1 - nodes.free[strand], nodes.first_node[strand + 1]):
                x = position[i]
                arc += wp.length(x - position[i - 1])
                if nodes.clearance[i] >= ZERO and arc > stem:
                    if solid and (not known or crosses(mesh, position[i - 1], x)):
                        sign = ray_parity(mesh, to_float(x))
                        known = True
                    if not solid or sign < 0.0:
                        query = wp.mesh_query_point_sign_normal(mesh, to_float(x), FAR)
                        if query.result:
                            height = height_above(bodies, body, query, x, wp.where(solid, sign, query.sign))
                            deepest = wp.max(deepest, -height)
                            if height < -nodes.radius[i]:
                                count += 1
    count_out[strand] = count
    deepest_out[strand] = deepest
