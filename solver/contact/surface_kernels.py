"""Strand nodes against moving triangle surfaces: the planes in force, and the last guard."""

from __future__ import annotations

import warp as wp

from plait.solver.contact.geometry_kernels import ZERO
from plait.solver.contact.meeting_kernels import (
    HALF,
    PRESCRIBED,
    Bodies,
    ContactNodes,
    meet,
    strand_box,
)
from plait.solver.contact.plane_slots import find_slot
from plait.solver.contact.planes import PLANES_A_NODE, ContactPlanes
from plait.solver.contact.search_kernels import Contact, Memory, node_contact

wp.set_module_options({"enable_backward": False})

# A plane broken by less than this part of radius and thickness, or of the way out that a substep allows, needs no
# further solve.
TOLERANCE = wp.constant(wp.float64(0.1))
# Planes that face each other within this (cosine) share the room between them.
OPPOSED = wp.constant(wp.float64(-0.9))
GUARD_ROUNDS = wp.constant(8)
# No node of a stem is deeper than this part of the stem's arc.
OF_STEM = wp.constant(wp.float64(1.5))


@wp.func
def add_plane(
    planes: ContactPlanes,
    plane_body: wp.array(dtype=wp.int32),
    node: int,
    body: int,
    contact: Contact,
    start: wp.vec3d,
    end: wp.vec3d,
    friction: wp.float64,
    tolerance: wp.float64,
) -> bool:
    """Puts a contact in force; whether the node, as it is, breaks it.

    A contact that is kept already is only noted where the node has no plane of that surface yet.
    """
    offset = wp.dot(contact.normal, contact.point) + contact.target
    broken = offset - wp.dot(contact.normal, end)
    found = find_slot(
        node * PLANES_A_NODE, PLANES_A_NODE, plane_body, planes.normal, planes.offset, body, contact.normal, end
    )
    if broken <= tolerance and found.known:
        return False
    slot = found.at
    planes.normal[slot] = contact.normal
    planes.offset[slot] = offset
    planes.anchor[slot] = contact.anchor
    planes.drift[slot] = contact.anchor - start
    planes.friction[slot] = friction
    plane_body[slot] = body
    return broken > tolerance


@wp.func
def share_room(planes: ContactPlanes, plane_body: wp.array(dtype=wp.int32), node: int):
    """Two planes that face each other with less room than both ask for give way equally."""
    a = node * PLANES_A_NODE
    b = a + 1
    if plane_body[a] >= 0 and plane_body[b] >= 0:
        if wp.dot(planes.normal[a], planes.normal[b]) < OPPOSED:
            excess = planes.offset[a] + planes.offset[b]
            if excess > ZERO:
                planes.offset[a] = planes.offset[a] - HALF * excess
                planes.offset[b] = planes.offset[b] - HALF * excess


@wp.kernel
def find_planes(
    first: int,
    bodies: Bodies,
    nodes: ContactNodes,
    start: wp.array(dtype=wp.vec3d),
    end: wp.array(dtype=wp.vec3d),
    depth: wp.array(dtype=wp.float64),
    exit_distance: wp.float64,
    memory: Memory,
    planes: ContactPlanes,
    plane_body: wp.array(dtype=wp.int32),
    flags: wp.array(dtype=wp.int32),
    depth_out: wp.array(dtype=wp.float64),
):
    """Contacts of the strands flagged; a flag stays where a plane is broken. One strand an item."""
    strand = first + wp.tid()
    if flags[strand] == 0:
        return
    flags[strand] = 0
    deepest = ZERO
    root = nodes.first_node[strand] + PRESCRIBED - 1
    box = strand_box(nodes, strand, start, end)
    for body in range(bodies.count):
        near = meet(bodies, body, nodes, strand, box, end[root], depth[strand])
        if near.meets:
            deepest = wp.max(deepest, OF_STEM * near.stem)
            arc = ZERO
            friction = bodies.friction[body]
            if friction < ZERO:
                friction = nodes.friction[strand]
            for i in range(root + 1 - nodes.free[strand], nodes.first_node[strand + 1]):
                arc += wp.length(end[i] - end[i - 1])
                if nodes.clearance[i] >= ZERO and arc > near.stem:
                    contact = node_contact(
                        bodies, body, near, nodes, memory, strand, i, start[i], end[i], depth[strand],
                        exit_distance,
                    )  # fmt: skip
                    if contact.found:
                        deepest = wp.max(deepest, contact.depth)
                        asked = nodes.radius[i] + bodies.thickness[body]
                        tolerance = TOLERANCE * wp.min(asked, exit_distance)
                        if add_plane(planes, plane_body, i, body, contact, start[i], end[i], friction, tolerance):
                            flags[strand] = 1
                        share_room(planes, plane_body, i)
    depth_out[strand] = deepest


@wp.kernel
def project_out(
    first: int,
    bodies: Bodies,
    nodes: ContactNodes,
    start: wp.array(dtype=wp.vec3d),
    depth: wp.array(dtype=wp.float64),
    exit_distance: wp.float64,
    flags: wp.array(dtype=wp.int32),
    memory: Memory,
    end: wp.array(dtype=wp.vec3d),
    moved_out: wp.array(dtype=wp.int32),
    depth_out: wp.array(dtype=wp.float64),
):
    """Puts what is still under a surface just above it, in the strands flagged. One strand an item.

    Only a node whose centre is under the surface, or deeper than it may be while it is led out, is moved; bodies
    that overlap can still leave it inside one of them.
    """
    strand = first + wp.tid()
    if flags[strand] == 0:
        return
    deepest = ZERO
    root = nodes.first_node[strand] + PRESCRIBED - 1
    for _ in range(GUARD_ROUNDS):
        changed = wp.bool(False)
        deepest = ZERO
        box = strand_box(nodes, strand, start, end)
        for body in range(bodies.count):
            near = meet(bodies, body, nodes, strand, box, end[root], depth[strand])
            if near.meets:
                deepest = wp.max(deepest, OF_STEM * near.stem)
                arc = ZERO
                for i in range(root + 1 - nodes.free[strand], nodes.first_node[strand + 1]):
                    arc += wp.length(end[i] - end[i - 1])
                    if nodes.clearance[i] >= ZERO and arc > near.stem:
                        contact = node_contact(
                            bodies, body, near, nodes, memory, strand, i, start[i], end[i], depth[strand],
                            exit_distance,
                        )  # fmt: skip
                        if contact.found:
                            deepest = wp.max(deepest, contact.depth)
                            height = wp.dot(contact.normal, end[i] - contact.point)
                            if height < wp.min(contact.target, ZERO):
                                asked = nodes.radius[i] + bodies.thickness[body]
                                goal = wp.min(contact.target, TOLERANCE * asked)
                                end[i] = end[i] + (goal - height) * contact.normal
                                moved_out[strand] = moved_out[strand] + 1
                                changed = True
        if not changed:
            break
    depth_out[strand] = deepest
