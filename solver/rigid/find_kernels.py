"""Where rigid bodies touch each other and the surfaces that the animation moves."""

from __future__ import annotations

import warp as wp

from plait.solver.rigid.edge_kernels import meet_edges
from plait.solver.rigid.order_kernels import first_near, geom_at, next_near
from plait.solver.rigid.point_kernels import meet_points
from plait.solver.rigid.shape_kernels import SPHERE
from plait.solver.rigid.types import Contacts, Finder, Geoms, Kept

# Unrolled, the search would take three times as long to compile for CUDA, and be no faster.
wp.set_module_options({"enable_backward": False, "max_unroll": 1})


@wp.func
def touches(geoms: Geoms, a: int, b: int) -> bool:
    """Whether geoms whose boxes meet may touch."""
    if geoms.body[a] == geoms.body[b]:
        return False
    for k in range(geoms.filter_offsets[a], geoms.filter_offsets[a + 1]):
        if geoms.filtered[k] == b:
            return False
    return True


@wp.func
def rests(finder: Finder, a: int, begin: int) -> bool:
    """Whether a geom's contacts are those of the substep before: neither it nor what is near has moved since."""
    if finder.boxes.still[a] == 0:
        return False
    for k in range(finder.geoms.first_slot[a], finder.geoms.first_slot[a] + finder.contacts.count[a]):
        if finder.boxes.still[finder.contacts.geom[k]] == 0:
            return False
    i = next_near(finder.geoms, finder.boxes, a, begin)
    while i >= 0:
        if finder.boxes.still[geom_at(finder.geoms, finder.boxes, i)] == 0:
            return False
        i = next_near(finder.geoms, finder.boxes, a, i + 1)
    return True


@wp.kernel
def find_contacts(
    first: int,
    finder: Finder,
):
    """Contacts of geoms' points and edges, one geom an item."""
    a = first + wp.tid()
    begin = wp.int32(0)
    if finder.geoms.body[a] >= 0:
        begin = first_near(finder.boxes, a)
    if rests(finder, a, begin):
        return
    finder.contacts.count[a] = 0
    i = next_near(finder.geoms, finder.boxes, a, begin)
    while i >= 0:
        b = geom_at(finder.geoms, finder.boxes, i)
        if touches(finder.geoms, a, b):
            # Of two balls one side tells all.
            if a < b or finder.geoms.kind[a] != SPHERE or finder.geoms.kind[b] != SPHERE:
                meet_points(finder, a, b)
            if a < b:
                meet_edges(finder, a, b)
        i = next_near(finder.geoms, finder.boxes, a, i + 1)


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
