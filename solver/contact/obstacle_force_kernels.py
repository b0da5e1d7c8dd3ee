"""Contact with planes in an implicit solve: an augmented Lagrangian of Signorini's law and Coulomb friction.

For a point y with plane n, d, anchor a, stiffness k, and forces p and t held so far (Simo and Laursen 1992):

    pressure  p' = max(p - k (n . y - d), 0)
    traction  t' = t - k (1 - n n^T) (y - a), shortened to mu p~ where it is longer

Both are gradients of convex energies once p~, the pressure that bounds friction, is held, so that a Newton solve
can search along a line. Where the held forces are those of the solve before, the plane is kept and sticking is
exact, whatever the stiffness.
"""

from functools import cache, partial
from types import SimpleNamespace

import warp as wp

from plait.solver.contact.geometry_kernels import ZERO
from plait.solver.contact.meeting_kernels import HALF
from plait.solver.contact.obstacle_search_kernels import SLOTS, ObstaclePlanes, SkinPoints, point_at, stretch_at

wp.set_module_options({"enable_backward": False})


# A contact this many times as stiff as what it stops: less and it gives too far, more and the solve takes longer.
STIFFER = wp.constant(wp.float64(20.0))
# A plane left by more than this part of the distance to keep has let go.
LEFT = wp.constant(wp.float64(0.1))
# What hangs on a surface by a tet with an edge this many times as long as at rest is let go: bone has been drawn
# through the surface, or a corner has caught between two points.
TORN = wp.constant(wp.float64(4.0))


@wp.func
def stiffness_of(points: SkinPoints, q: int, inertia: wp.float64) -> wp.float64:
    """[N/m] of a point's contacts, against inertia and elasticity of what is around it."""
    frequency = points.frequency[q]
    return STIFFER * points.mass[q] * (inertia + frequency * frequency)


@wp.struct
class Push:
    """What a plane does to a point."""

    pressure: wp.float64  # [N]
    traction: wp.vec3d  # [N]
    energy: wp.float64  # [J] of the augmented Lagrangian
    stiffness: wp.mat33d  # [N/m] positive semi-definite


@wp.func
def push(planes: ObstaclePlanes, slot: int, k: wp.float64, point: wp.vec3d) -> Push:
    """The contact of a point, [m]."""
    out = Push()
    y = point - planes.shift[slot]
    n = planes.normal[slot]
    held = planes.pressure[slot]
    bound = planes.friction[slot] * held  # [N] of friction
    out.pressure = wp.max(held - k * (wp.dot(n, y) - planes.offset[slot] - planes.rebound[slot]), ZERO)
    out.energy = HALF * (out.pressure * out.pressure - held * held) / k
    nn = wp.outer(n, n)
    if out.pressure > ZERO:
        out.stiffness = k * nn
    if bound > ZERO:
        way = y - planes.anchor[slot]
        across = wp.identity(n=3, dtype=wp.float64) - nn
        traction = across * (planes.traction[slot] - k * way)
        size = wp.length(traction)
        if size <= bound:
            out.traction = traction
            out.energy += HALF * size * size / k
            out.stiffness += k * across
        else:
            along = traction / size
            out.traction = bound * along
            out.energy += bound * (size - HALF * bound) / k
            out.stiffness += (k * bound / size) * (across - wp.outer(along, along))
    return out


@wp.kernel
def evaluate_pushes(
    first: int,
    active: wp.array(dtype=wp.int32),
    points: SkinPoints,
    planes: ObstaclePlanes,
    inertia: wp.float64,
    x: wp.array(dtype=wp.vec3d),
    energy_out: wp.array(dtype=wp.float64),
    force_out: wp.array(dtype=wp.vec3d),
    stiffness_out: wp.array(dtype=wp.mat33d),
):
    """Energy [J], force [N] and stiffness [N/m] of the active points' contacts with the nodes at x; one an item.

    inertia: [1/s2] the inverse square of the time in which a force moves a mass.
    """
    item = first + wp.tid()
    q = active[item]
    y = point_at(points, q, x)
    held = stiffness_of(points, q, inertia)
    energy = ZERO
    force = wp.vec3d()
    total = wp.mat33d()
    for k in range(SLOTS):
        slot = q * SLOTS + k
        if planes.surface[slot] >= 0:
            one = push(planes, slot, held, y)
            energy += one.energy
            force += one.pressure * planes.normal[slot] + one.traction
            total += one.stiffness
    energy_out[item] = energy
    force_out[item] = force
    stiffness_out[item] = total


@wp.kernel
def hold_forces(
    first: int,
    active: wp.array(dtype=wp.int32),
    points: SkinPoints,
    planes: ObstaclePlanes,
    inertia: wp.float64,
    x: wp.array(dtype=wp.vec3d),
    change_out: wp.array(dtype=wp.float64),
    pressure_out: wp.array(dtype=wp.float64),
):
    """Holds the forces that the active points' contacts have with the nodes at x; one an item.

    change_out, pressure_out: by how much they were off, and how large they are, both over the stiffness and as
    part of the distance to keep.
    """
    item = first + wp.tid()
    q = active[item]
    y = point_at(points, q, x)
    held = stiffness_of(points, q, inertia)
    change = ZERO
    pressure = ZERO
    for k in range(SLOTS):
        slot = q * SLOTS + k
        if planes.surface[slot] >= 0:
            one = push(planes, slot, held, y)
            change = wp.max(change, wp.abs(one.pressure - planes.pressure[slot]))
            change = wp.max(change, wp.length(one.traction - planes.traction[slot]))
            pressure = wp.max(pressure, one.pressure)
            planes.pressure[slot] = one.pressure
            planes.traction[slot] = one.traction
    change_out[item] = change / (held * points.reach[q])
    pressure_out[item] = pressure / (held * points.reach[q])


@wp.kernel
def strike(
    first: int,
    active: wp.array(dtype=wp.int32),
    points: SkinPoints,
    restitution: wp.array(dtype=wp.float64),
    x: wp.array(dtype=wp.vec3d),
    approach: wp.float64,
    planes: ObstaclePlanes,
    struck_out: wp.array(dtype=wp.int32),
):
    """1 where the nodes at x take an active point through a plane that held no force; one an item.

    Such a point leaves the surface as fast as it came, times the larger restitution (Newton's law of impact).
    restitution: of the scene's surfaces.
    approach: [m] of the point towards the surface in the substep, below which it does not count.
    """
    item = first + wp.tid()
    q = active[item]
    y = point_at(points, q, x)
    struck = wp.int32(0)
    for k in range(SLOTS):
        slot = q * SLOTS + k
        if planes.surface[slot] >= 0 and planes.pressure[slot] == ZERO:
            height = wp.dot(planes.normal[slot], y - planes.shift[slot])
            nearer = wp.dot(planes.normal[slot], planes.anchor[slot]) - height
            if height < planes.offset[slot] and nearer > approach:
                struck = 1
                e = wp.max(points.restitution[q], restitution[planes.surface[slot]])
                back = wp.dot(planes.normal[slot], planes.anchor[slot]) + e * nearer
                planes.rebound[slot] = wp.max(back - planes.offset[slot], ZERO)
    struck_out[item] = struck


@wp.kernel
def leave_planes(
    first: int,
    active: wp.array(dtype=wp.int32),
    points: SkinPoints,
    x: wp.array(dtype=wp.vec3d),
    planes: ObstaclePlanes,
    deepest_out: wp.array(dtype=wp.float64),
):
    """Notes how the active points leave their planes at a substep's end; what has come off them has let go.

    deepest_out: [m] how deep each is under a surface; one an item.
    """
    item = first + wp.tid()
    q = active[item]
    y = point_at(points, q, x)
    deepest = ZERO
    torn = stretch_at(points, q, x) > TORN
    for k in range(SLOTS):
        slot = q * SLOTS + k
        if planes.surface[slot] >= 0:
            if torn and planes.pressure[slot] > ZERO:
                planes.let_go[q * SLOTS] = 1
            height = wp.dot(planes.normal[slot], y - planes.shift[slot])
            planes.depth[slot] = wp.max(planes.ground[slot] - height, ZERO)
            deepest = wp.max(deepest, planes.depth[slot])
            if height - planes.offset[slot] > LEFT * points.reach[q]:
                planes.pressure[slot] = ZERO
                planes.traction[slot] = wp.vec3d()
    deepest_out[item] = deepest


@cache
def tet_kernels(real: type) -> SimpleNamespace:
    """Kernels `add_forces`, `add_stiffness`: what points feel, onto the tets they lie in, in `real`."""
    kernel = partial(wp.kernel, module=f"plait_obstacles_{real.__name__}", enable_backward=False)
    vec3, mat33 = wp.types.vector(3, real), wp.types.matrix((3, 3), real)

    @kernel
    def add_forces(
        first: int,
        tets: wp.array(dtype=wp.int32),
        first_point: wp.array(dtype=wp.int32),
        weights: wp.array(dtype=wp.vec4d),
        force: wp.array(dtype=wp.vec3d),
        tet_force: wp.array(dtype=vec3),
    ):
        """Onto corner a of tet t, at 4 t + a, the forces b_a f of its points; one of `tets` an item."""
        item = first + wp.tid()
        for a in range(4):
            total = wp.vec3d()
            for i in range(first_point[item], first_point[item + 1]):
                total += weights[i][a] * force[i]
            at = 4 * tets[item] + a
            tet_force[at] = tet_force[at] + vec3(total)

    @kernel
    def add_stiffness(
        first: int,
        tets: wp.array(dtype=wp.int32),
        first_point: wp.array(dtype=wp.int32),
        weights: wp.array(dtype=wp.vec4d),
        stiffness: wp.array(dtype=wp.mat33d),
        tet_block: wp.array(dtype=mat33),
    ):
        """Onto pair k of corners (a, b) of tet t, at 10 t + k, the stiffness b_a b_b K of its points.

        The pairs are (0, 0) to (3, 3), then (0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3).
        """
        item = first + wp.tid()
        for a in range(4):
            for b in range(a, 4):
                total = wp.mat33d()
                for i in range(first_point[item], first_point[item + 1]):
                    total += weights[i][a] * weights[i][b] * stiffness[i]
                k = wp.where(a == b, a, 3 + a + b + wp.where(a > 0, 1, 0))
                at = 10 * tets[item] + k
                tet_block[at] = tet_block[at] + mat33(total)

    return SimpleNamespace(add_forces=add_forces, add_stiffness=add_stiffness)
