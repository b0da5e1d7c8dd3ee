"""Contacts as they are found: which are noted, and where."""

from __future__ import annotations

import warp as wp

from plait.solver.contact.geometry_kernels import get_triangle, unit_normal
from plait.solver.rigid.motion_kernels import HALF, ZERO, Motion
from plait.solver.rigid.nearest_kernels import Side
from plait.solver.rigid.types import Contacts, Finder, Geoms, Kept

wp.set_module_options({"enable_backward": False})


@wp.struct
class Place:
    """A point of a geom at the substep's start, world."""

    x: wp.vec3d  # [m] of its core
    way: wp.vec3d  # [m] in the substep, of an animated surface
    radius: wp.float64  # [m]
    axis: wp.vec3d
    inward: wp.vec3d  # unit, or zero


@wp.func
def place_of(finder: Finder, a: int, p: int) -> Place:
    out = Place()
    body = finder.geoms.body[a]
    if body < 0:
        i = finder.geoms.point_index[p]
        out.x = finder.animated.points_start[i]
        out.way = finder.animated.points_end[i] - out.x
        fan = finder.geoms.fans[p]
        for k in range(4):
            if fan[k] >= 0:
                out.inward -= unit_normal(
                    get_triangle(finder.animated.triangles, finder.animated.points_start, fan[k])
                )
        out.inward = wp.normalize(out.inward)
        return out
    out.x = finder.motion.position[body] + wp.quat_rotate(finder.motion.orientation[body], finder.geoms.points[p])
    out.radius = finder.geoms.radius[p]
    out.axis = wp.quat_rotate(finder.motion.orientation[body], finder.geoms.axis[p])
    out.inward = wp.quat_rotate(finder.motion.orientation[body], finder.geoms.inward[p])
    return out


@wp.func
def kept_at(kept: Kept, first: int, count: int, geom: int, feature: int) -> int:
    for k in range(first, first + count):
        if kept.geom[k] == geom and kept.feature[k] == feature:
            return k
    return -1


@wp.func
def find_slot(contacts: Contacts, geoms: Geoms, a: int, gap: wp.float64) -> int:
    """Place for one more contact of geom a; where none are left that of the widest gap, if it is wider; or -1."""
    first = geoms.first_slot[a]
    count = contacts.count[a]
    if first + count < geoms.first_slot[a + 1]:
        contacts.count[a] = count + 1
        return first + count
    widest = wp.int32(first)
    for k in range(first + 1, first + count):
        if contacts.gap[k] > contacts.gap[widest]:
            widest = k
    if contacts.gap[widest] > gap:
        return widest
    return -1


@wp.func
def least_margin(geoms: Geoms, a: int, b: int) -> wp.float64:
    """[m] of the smaller of two bodies, or of the one body."""
    if geoms.body[a] < 0 or (geoms.body[b] >= 0 and geoms.margin[b] < geoms.margin[a]):
        return geoms.margin[b]
    return geoms.margin[a]


@wp.func
def mean_friction(a: wp.float64, b: wp.float64, otherwise: wp.float64) -> wp.float64:
    """The mean of the two; where one is not told, the other's."""
    if a < ZERO and b < ZERO:
        return otherwise
    if a < ZERO:
        return b
    if b < ZERO:
        return a
    return HALF * (a + b)


@wp.func
def core_of(motion: Motion, b: int, x: wp.vec3d, way: wp.vec3d) -> wp.vec3d:
    """[m] a place in its body's axes; of an animated surface its way."""
    if b < 0:
        return way
    return wp.quat_rotate_inv(motion.orientation[b], x - motion.position[b])


@wp.func
def lever_of(motion: Motion, b: int, x: wp.vec3d) -> wp.vec3d:
    if b < 0:
        return wp.vec3d()
    return x - motion.position[b]


@wp.func
def put_contact(
    finder: Finder,
    a: int,
    b: int,
    feature: int,
    place: Place,
    arm: wp.vec3d,
    surface: Side,
):
    """Notes a contact of a point, its core at place.x and itself at place.x + arm, if it may touch in time."""
    geoms = finder.geoms
    contacts = finder.contacts
    # Impacts turn bodies about: whatever may come near in the substep, however it moves now, is looked at.
    if surface.gap > least_margin(geoms, a, b) + finder.boxes.travel[a] + finder.boxes.travel[b]:
        return
    slot = find_slot(contacts, geoms, a, surface.gap)
    if slot < 0:
        return
    body_a = geoms.body[a]
    body_b = geoms.body[b]
    contacts.geom[slot] = b
    contacts.feature[slot] = feature
    contacts.body[slot] = wp.vec2i(body_a, body_b)
    contacts.core_a[slot] = core_of(finder.motion, body_a, place.x, place.way)
    contacts.core_b[slot] = core_of(finder.motion, body_b, surface.core, surface.way)
    contacts.arm_a[slot] = arm
    contacts.arm_b[slot] = surface.foot - surface.core
    contacts.lever_a[slot] = lever_of(finder.motion, body_a, place.x + arm)
    contacts.lever_b[slot] = lever_of(finder.motion, body_b, place.x + arm)
    contacts.normal[slot] = surface.normal
    contacts.gap[slot] = surface.gap
    contacts.friction[slot] = mean_friction(geoms.friction[a], geoms.friction[b], finder.step[0].friction)
    contacts.restitution[slot] = wp.max(geoms.restitution[a], geoms.restitution[b])
    contacts.impulse[slot] = wp.vec3d()
    before = kept_at(finder.kept, geoms.first_slot[a], finder.kept.count[a], b, feature)
    if before >= 0:
        contacts.impulse[slot] = finder.kept.impulse[before]
