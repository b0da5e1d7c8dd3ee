"""What the kernels of rigid bodies share: surfaces that touch, contacts, a substep."""

from __future__ import annotations

import warp as wp

from plait.solver.rigid.motion_kernels import Motion

wp.set_module_options({"enable_backward": False})


@wp.struct
class Geoms:
    """Surfaces that touch, those of rigid bodies first; in the axes of rest space about the centre of mass."""

    count: int
    carried_count: int
    body: wp.array(dtype=wp.int32)  # -1: moved by the animation
    kind: wp.array(dtype=wp.int32)
    size: wp.array(dtype=wp.vec3d)  # [m] see `Shape`
    offset: wp.array(dtype=wp.vec3d)  # [m] of the shape's own space
    turn: wp.array(dtype=wp.quatd)
    center: wp.array(dtype=wp.vec3d)  # [m] of the bounding box, and half its edges
    half: wp.array(dtype=wp.vec3d)
    reach: wp.array(dtype=wp.float64)  # [m] no part is further from the centre of mass
    margin: wp.array(dtype=wp.float64)  # [m] contacts are followed from here on
    solid: wp.array(dtype=wp.int32)  # 1: closed and facing out
    friction: wp.array(dtype=wp.float64)  # negative: not told
    thickness: wp.array(dtype=wp.float64)  # [m]
    restitution: wp.array(dtype=wp.float64)
    mesh: wp.array(dtype=wp.uint64)  # of triangles in the body's axes
    first_triangle: wp.array(dtype=wp.int32)
    first_point: wp.array(dtype=wp.int32)  # (count + 1,)
    first_edge: wp.array(dtype=wp.int32)
    first_slot: wp.array(dtype=wp.int32)
    filter_offsets: wp.array(dtype=wp.int32)  # (count + 1,)
    filtered: wp.array(dtype=wp.int32)  # geoms that a geom does not touch
    points: wp.array(dtype=wp.vec3d)  # [m]
    inward: wp.array(dtype=wp.vec3d)  # unit, from the point into its body; zero where it is round
    fans: wp.array(dtype=wp.vec4i)  # of animated surfaces, triangles about the point; -1: none
    point_index: wp.array(dtype=wp.int32)  # of animated surfaces, into their points
    radius: wp.array(dtype=wp.float64)  # [m]
    axis: wp.array(dtype=wp.vec3d)  # unit: the point is a rim about it; else zero
    edges: wp.array(dtype=wp.vec4i)  # both ends, what the faces lie towards; into `vertices`, or animated points
    edge_radius: wp.array(dtype=wp.float64)
    vertices: wp.array(dtype=wp.vec3d)  # [m]
    triangles: wp.array(dtype=wp.vec3i)  # into `vertices`


@wp.struct
class Animated:
    """Surfaces that the animation moves, in this substep; entry a - carried_count of geom a."""

    active: wp.array(dtype=wp.int32)
    mesh: wp.array(dtype=wp.uint64)  # at the start
    points: wp.array(dtype=wp.vec2i)  # of each surface, first and past the last
    points_start: wp.array(dtype=wp.vec3d)  # [m]
    points_end: wp.array(dtype=wp.vec3d)
    triangles: wp.array(dtype=wp.vec3i)


@wp.struct
class Boxes:
    """Where geoms may be in the substep."""

    lower: wp.array(dtype=wp.vec3d)  # [m]
    upper: wp.array(dtype=wp.vec3d)
    travel: wp.array(dtype=wp.float64)  # [m] no part goes further
    order: wp.array(dtype=wp.int32)  # (carried_count,) geoms of bodies, by where their boxes begin along an axis
    rank: wp.array(dtype=wp.int32)  # (carried_count,) their places in it
    axis: wp.array(dtype=wp.int32)  # (1,)
    widest: wp.array(dtype=wp.float64)  # (1,) [m] along it
    still: wp.array(dtype=wp.int32)  # 1: where it was in the substep before, and without any way in either


@wp.struct
class Contacts:
    """A point of geom a against a surface b; those of geom a from first_slot[a] on, count[a] of them.

    The point's place is that of its core, which moves with its body, and a constant offset, the arm, that turns
    with the velocity alone: so that what is round rolls. The same on the other side.
    """

    count: wp.array(dtype=wp.int32)  # (geom_count,)
    geom: wp.array(dtype=wp.int32)  # b
    feature: wp.array(dtype=wp.int32)  # which point or pair of edges
    body: wp.array(dtype=wp.vec2i)  # of a and b; -1: animated
    core_a: wp.array(
        dtype=wp.vec3d
    )  # [m] in the body's axes; of an animated surface its way in the substep, world
    core_b: wp.array(dtype=wp.vec3d)
    arm_a: wp.array(dtype=wp.vec3d)  # [m] world
    arm_b: wp.array(dtype=wp.vec3d)
    lever_a: wp.array(dtype=wp.vec3d)  # [m] from the centre of mass to where the impulse acts, world
    lever_b: wp.array(dtype=wp.vec3d)
    normal: wp.array(dtype=wp.vec3d)  # unit, from b to a
    gap: wp.array(dtype=wp.float64)  # [m] at the substep's start
    friction: wp.array(dtype=wp.float64)
    restitution: wp.array(dtype=wp.float64)
    impulse: wp.array(dtype=wp.vec3d)  # [kg m/s] on a, world


@wp.struct
class Kept:
    """What the next substep needs to know of contacts."""

    count: wp.array(dtype=wp.int32)
    geom: wp.array(dtype=wp.int32)
    feature: wp.array(dtype=wp.int32)
    normal: wp.array(dtype=wp.vec3d)
    impulse: wp.array(dtype=wp.vec3d)


@wp.struct
class Start:
    """Of each body at the substep's start."""

    inertia_inverse: wp.array(dtype=wp.mat33d)  # world
    velocity: wp.array(dtype=wp.vec3d)  # [m/s] before the substep's forces
    spin: wp.array(dtype=wp.vec3d)  # [1/s] before the substep's forces


@wp.struct
class Step:
    length: wp.float64  # [s]
    gravity: wp.vec3d  # [m/s2]
    friction: wp.float64  # where neither side tells


@wp.struct
class Finder:
    """What contacts are looked for among, and where they are noted."""

    step: wp.array(dtype=Step)  # (1,)
    geoms: Geoms
    animated: Animated
    motion: Motion
    boxes: Boxes
    kept: Kept
    contacts: Contacts
