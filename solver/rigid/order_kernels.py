"""Which geoms may touch: sort and sweep (Baraff 1992) over what rigid bodies carry."""

from __future__ import annotations

import warp as wp

from plait.solver.rigid.motion_kernels import ZERO
from plait.solver.rigid.types import Boxes, Geoms

wp.set_module_options({"enable_backward": False})


@wp.func
def comes_before(boxes: Boxes, axis: int, a: int, b: int) -> bool:
    """By where boxes begin along an axis; the order depends on nothing else but the geoms' numbers."""
    x = boxes.lower[a][axis]
    y = boxes.lower[b][axis]
    return x < y or (x == y and a < b)


@wp.kernel
def order_geoms(first: int, geoms: Geoms, boxes: Boxes):
    """One item in all: sorts what bodies carry along the axis that it is spread out on most.

    By insertion into the order of the substep before, of which little has changed.
    """
    count = geoms.carried_count
    if first + wp.tid() > 0 or count == 0:
        return
    lower = boxes.lower[0]
    upper = boxes.lower[0]
    widest = wp.vec3d()
    for a in range(count):
        lower = wp.min(lower, boxes.lower[a])
        upper = wp.max(upper, boxes.lower[a])
        widest = wp.max(widest, boxes.upper[a] - boxes.lower[a])
    spread = upper - lower
    axis = wp.int32(0)
    for k in range(1, 3):
        if spread[k] > spread[axis]:
            axis = k
    for i in range(1, count):
        a = boxes.order[i]
        j = wp.int32(i)
        while j > 0 and comes_before(boxes, axis, a, boxes.order[j - 1]):
            boxes.order[j] = boxes.order[j - 1]
            j = j - 1
        boxes.order[j] = a
    for i in range(count):
        boxes.rank[boxes.order[i]] = i
    boxes.axis[0] = axis
    boxes.widest[0] = widest[axis]


@wp.func
def first_near(boxes: Boxes, a: int) -> int:
    """The first place in the order of what may reach geom a, which a body carries."""
    axis = boxes.axis[0]
    i = wp.int32(boxes.rank[a])
    while i > 0 and boxes.lower[boxes.order[i - 1]][axis] + boxes.widest[0] >= boxes.lower[a][axis]:
        i = i - 1
    return i


@wp.func
def boxes_meet(boxes: Boxes, a: int, b: int) -> bool:
    apart = wp.max(boxes.lower[a] - boxes.upper[b], boxes.lower[b] - boxes.upper[a])
    return wp.max(apart) <= ZERO


@wp.func
def next_near(geoms: Geoms, boxes: Boxes, a: int, i: int) -> int:
    """From place i on, that of the next geom whose box meets that of geom a; -1 for none.

    Of what no body carries, the place is the geom's number.
    """
    k = wp.int32(i)
    axis = boxes.axis[0]
    while k < geoms.carried_count:
        b = boxes.order[k]
        if geoms.body[a] >= 0 and boxes.lower[b][axis] > boxes.upper[a][axis]:
            k = geoms.carried_count
        elif boxes_meet(boxes, a, b):
            return k
        else:
            k = k + 1
    if geoms.body[a] < 0:
        return -1
    while k < geoms.count:
        if boxes_meet(boxes, a, k):
            return k
        k = k + 1
    return -1


@wp.func
def geom_at(geoms: Geoms, boxes: Boxes, i: int) -> int:
    if i < geoms.carried_count:
        return boxes.order[i]
    return i
