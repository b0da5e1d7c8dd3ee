"""Which of the few planes that a point can have a contact takes."""

from __future__ import annotations

import warp as wp

from plait.solver.contact.meeting_kernels import UNBOUNDED

wp.set_module_options({"enable_backward": False})

# Planes of one surface whose normals differ less (cosine) are the same contact, refined.
SAME = wp.constant(wp.float64(0.9995))


@wp.struct
class Slot:
    """The place for a contact: of the plane it refines, else a free one, else of the plane with most room."""

    at: wp.int32
    refines: wp.bool  # it is that of a plane of the same surface and direction
    known: wp.bool  # the point has a plane of that surface already


@wp.func
def find_slot(
    first: int,
    count: int,
    surfaces: wp.array(dtype=wp.int32),
    normals: wp.array(dtype=wp.vec3d),
    offsets: wp.array(dtype=wp.float64),
    surface: int,
    normal: wp.vec3d,
    place: wp.vec3d,
) -> Slot:
    """The place for a contact with `surface` along `normal`, of a point at `place`.

    The point's planes are those from `first` on, `count` of them: surfaces (-1: free), normals, offsets.
    """
    slot = Slot()
    slot.at = wp.int32(-1)
    free = wp.int32(-1)
    loosest = first
    most_room = -UNBOUNDED
    for k in range(count):
        at = first + k
        if surfaces[at] < 0:
            if free < 0:
                free = at
        else:
            if surfaces[at] == surface:
                slot.known = True
                if wp.dot(normals[at], normal) > SAME:
                    slot.at = at
                    slot.refines = True
            room = wp.dot(normals[at], place) - offsets[at]
            if room > most_room:
                most_room = room
                loosest = at
    if not slot.refines:
        slot.at = wp.where(free >= 0, free, loosest)
    return slot
