"""Where rigid bodies touch each other and the surfaces that the animation moves."""

from __future__ import annotations

import warp as wp

from plait.solver.rigid.edge_kernels import meet_edges
from plait.solver.rigid.motion_kernels import ZERO, Motion
from plait.solver.rigid.point_kernels import meet_points
from plait.solver.rigid.shape_kernels import SPHERE
from plait.solver.rigid.types import Animated, Boxes, Contacts, Geoms, Kept, Step

wp.set_module_options({"enable_backward": False})


@wp.func
def touches(geoms: Geoms, boxes: Boxes, a: int, b: int) -> bool:
    """Whether geoms may touch."""
    if geoms.body[a] == geoms.body[b]:
        return False
    apart = wp.max(boxes.lower[a] - boxes.upper[b], boxes.lower[b] - boxes.upper[a])
    if wp.max(apart) > ZERO:
        return False
    for k in range(geoms.filter_offsets[a], geoms.filter_offsets[a + 1]):
        if geoms.filtered[k] == b:
            return False
    return True


@wp.kernel
def find_contacts(
    first: int,
    step: wp.array(dtype=Step),
    geoms: Geoms,
    animated: Animated,
    motion: Motion,
    boxes: Boxes,
    kept: Kept,
    contacts: Contacts,
):
    """Contacts of geoms' points and edges, one geom an item."""
    a = first + wp.tid()
    contacts.count[a] = 0
    others = geoms.count
    if geoms.body[a] < 0:
        others = geoms.carried_count
    for b in range(others):
        if touches(geoms, boxes, a, b):
            # Of two balls one side tells all.
            if a < b or geoms.kind[a] != SPHERE or geoms.kind[b] != SPHERE:
                meet_points(geoms, animated, motion, boxes, kept, contacts, step[0], a, b)
            if a < b:
                meet_edges(geoms, animated, motion, boxes, kept, contacts, step[0], a, b)


@wp.kernel
def keep_contacts(first: int, geoms: Geoms, contacts: Contacts, kept: Kept):
    """Keeps a substep's contacts for the next, one geom an item."""
    a = first + wp.tid()
    kept.count[a] = contacts.count[a]
    begin = geoms.first_slot[a]
    for k in range(begin, begin + contacts.count[a]):
        kept.geom[k] = contacts.geom[k]
        kept.feature[k] = contacts.feature[k]
        kept.normal[k] = contacts.normal[k]
        kept.impulse[k] = contacts.impulse[k]
