"""Contacts of rigid bodies as rows of a problem: what they bound, and one step of its solution."""

from __future__ import annotations

import warp as wp

from plait.solver.rigid.impulse_kernels import place_velocity, push_body
from plait.solver.rigid.motion_kernels import HALF, ONE, ZERO, Masses, Motion
from plait.solver.rigid.types import Contacts, Start, Step

wp.set_module_options({"enable_backward": False})


@wp.struct
class Rows:
    """Contacts' rows along the normal and two tangents; entries as those of `Contacts`."""

    axes: wp.array(dtype=wp.mat33d)  # rows: normal, tangents
    response: wp.array(dtype=wp.vec4d)  # [1/kg] of the normal; of the tangents xx, xy, yy
    bias: wp.array(dtype=wp.vec3d)  # [m/s] what turning adds, and animated surfaces; world
    impulse: wp.array(dtype=wp.vec3d)  # [kg m/s] along the rows
    held: wp.array(dtype=wp.vec3d)  # the same before the last sweep, and how it goes on
    ahead: wp.array(dtype=wp.vec3d)
    least: wp.array(dtype=wp.float64)  # [m/s] bound of the normal speed
    struck: wp.array(dtype=wp.float64)  # [m/s] normal speed before the substep
    push: wp.array(dtype=wp.float64)  # [kg m] of the position pass


@wp.struct
class Work:
    """Of bodies in a substep."""

    velocity: wp.array(dtype=wp.vec3d)  # [m/s] before contacts and joints
    angular_momentum: wp.array(dtype=wp.vec3d)  # [kg m2/s] likewise
    spin: wp.array(dtype=wp.vec3d)  # [1/s] with the inertia of the start
    turned: wp.array(dtype=wp.quatd)  # the orientation at the end
    push: wp.array(dtype=wp.vec3d)  # [m] by which overlaps part
    push_turn: wp.array(dtype=wp.vec3d)  # [rad]
    sweeps: wp.array(dtype=wp.int32)  # of the island, by root
    lack: wp.array(dtype=wp.float64)  # [m/s] by which the last sweep still changed a speed, over what was asked


@wp.func
def angular_response(start: Start, b: int, lever: wp.vec3d, way: wp.vec3d) -> wp.vec3d:
    return wp.cross(start.inertia_inverse[b] * wp.cross(lever, way), lever)


@wp.func
def respond(contacts: Contacts, masses: Masses, start: Start, c: int, way: wp.vec3d) -> wp.vec3d:
    """[1/kg] the relative velocity that a unit impulse gives."""
    pair = contacts.body[c]
    out = wp.vec3d()
    if pair[0] >= 0:
        out += way / masses.mass[pair[0]] + angular_response(start, pair[0], contacts.lever_a[c], way)
    if pair[1] >= 0:
        out += way / masses.mass[pair[1]] + angular_response(start, pair[1], contacts.lever_b[c], way)
    return out


@wp.func
def relative_velocity(
    contacts: Contacts, c: int, velocity: wp.array(dtype=wp.vec3d), spin: wp.array(dtype=wp.vec3d)
) -> wp.vec3d:
    """Of the bodies' places where the impulse acts, a against b."""
    pair = contacts.body[c]
    u = place_velocity(velocity, spin, pair[0], contacts.lever_a[c])
    return u - place_velocity(velocity, spin, pair[1], contacts.lever_b[c])


@wp.func
def carried_by(contacts: Contacts, c: int, length: wp.float64) -> wp.vec3d:
    """[m/s] what the animation adds to that."""
    pair = contacts.body[c]
    u = wp.vec3d()
    if pair[0] < 0:
        u += contacts.core_a[c] / length
    if pair[1] < 0:
        u -= contacts.core_b[c] / length
    return u


@wp.func
def way_of(b: int, core: wp.vec3d, arm: wp.vec3d, motion: Motion, work: Work, length: wp.float64) -> wp.vec3d:
    """[m] that one side's place goes in the substep."""
    if b < 0:
        return core
    turned = wp.quat_rotate(work.turned[b], core) - wp.quat_rotate(motion.orientation[b], core)
    return length * (motion.velocity[b] + wp.cross(work.spin[b], arm)) + turned


@wp.func
def give(contacts: Contacts, masses: Masses, motion: Motion, start: Start, work: Work, c: int, impulse: wp.vec3d):
    """An impulse on a, its opposite on b."""
    pair = contacts.body[c]
    push_body(masses, motion, start, work.spin, pair[0], impulse, wp.cross(contacts.lever_a[c], impulse))
    push_body(masses, motion, start, work.spin, pair[1], -impulse, -wp.cross(contacts.lever_b[c], impulse))


@wp.func
def begin_contact(
    contacts: Contacts, rows: Rows, masses: Masses, motion: Motion, start: Start, work: Work, c: int, step: Step
):
    """Axes, response and bounds; the impulse of the substep before is given again."""
    n = contacts.normal[c]
    other = wp.vec3d(ONE, ZERO, ZERO)
    if wp.abs(n[0]) > wp.float64(0.7):
        other = wp.vec3d(ZERO, ONE, ZERO)
    s = wp.normalize(wp.cross(n, other))
    t = wp.cross(n, s)
    axes = wp.matrix_from_rows(n, s, t)
    rows.axes[c] = axes
    of_n = respond(contacts, masses, start, c, n)
    of_s = respond(contacts, masses, start, c, s)
    of_t = respond(contacts, masses, start, c, t)
    rows.response[c] = wp.vec4d(wp.dot(n, of_n), wp.dot(s, of_s), wp.dot(s, of_t), wp.dot(t, of_t))
    gap = contacts.gap[c]
    rows.least[c] = wp.min(-gap / step.length, ZERO)
    carried = carried_by(contacts, c, step.length)
    rows.struck[c] = wp.dot(n, relative_velocity(contacts, c, start.velocity, start.spin) + carried)
    impulse = axes * contacts.impulse[c]
    impulse = wp.vec3d(wp.max(impulse[0], ZERO), impulse[1], impulse[2])
    rows.impulse[c] = impulse
    rows.bias[c] = wp.vec3d()
    give(contacts, masses, motion, start, work, c, wp.transpose(axes) * impulse)


@wp.func
def look_at_contact(
    contacts: Contacts, rows: Rows, motion: Motion, work: Work, c: int, length: wp.float64
) -> wp.float64:
    """Takes what turning adds anew; by how much that has changed [m/s], where the contact acts."""
    pair = contacts.body[c]
    way = way_of(pair[0], contacts.core_a[c], contacts.arm_a[c], motion, work, length)
    way -= way_of(pair[1], contacts.core_b[c], contacts.arm_b[c], motion, work, length)
    bias = way / length - relative_velocity(contacts, c, motion.velocity, work.spin)
    change = wp.length(bias - rows.bias[c])
    rows.bias[c] = bias
    if rows.impulse[c][0] == ZERO and wp.dot(contacts.normal[c], way) / length >= rows.least[c]:
        return ZERO
    return change


@wp.func
def within(cone: wp.float64, x: wp.float64, y: wp.float64) -> wp.vec2d:
    size = wp.sqrt(x * x + y * y)
    if size <= cone:
        return wp.vec2d(x, y)
    return (cone / size) * wp.vec2d(x, y)


@wp.func
def solve_contact(
    contacts: Contacts,
    rows: Rows,
    masses: Masses,
    motion: Motion,
    start: Start,
    work: Work,
    c: int,
    friction: wp.float64,
) -> wp.float64:
    """One contact of a sweep; the largest change of a speed [m/s]."""
    axes = rows.axes[c]
    k = rows.response[c]
    held = rows.impulse[c]
    u = axes * (relative_velocity(contacts, c, motion.velocity, work.spin) + rows.bias[c])
    normal = wp.max(held[0] - (u[0] - rows.least[c]) / k[0], ZERO)
    if normal == ZERO and held[0] == ZERO:
        return ZERO
    change_n = normal - held[0]
    # Friction sees the normal impulse as it now is, and what that does across.
    if change_n != ZERO:
        give(contacts, masses, motion, start, work, c, change_n * contacts.normal[c])
        u = axes * (relative_velocity(contacts, c, motion.velocity, work.spin) + rows.bias[c])
    cone = friction * normal
    det = k[1] * k[3] - k[2] * k[2]
    x = held[1] - (k[3] * u[1] - k[2] * u[2]) / det
    y = held[2] - (k[1] * u[2] - k[2] * u[1]) / det
    across = wp.vec2d(x, y)
    if x * x + y * y > cone * cone:
        # Towards the cone by a step that all directions take alike: where it ends, friction opposes slip exactly.
        half = HALF * (k[1] - k[3])
        most = HALF * (k[1] + k[3]) + wp.sqrt(half * half + k[2] * k[2])
        across = within(cone, held[1] - u[1] / most, held[2] - u[2] / most)
    change = wp.vec3d(ZERO, across[0] - held[1], across[1] - held[2])
    rows.impulse[c] = wp.vec3d(normal, across[0], across[1])
    give(contacts, masses, motion, start, work, c, wp.transpose(axes) * change)
    return wp.max(wp.abs(change_n) * k[0], wp.length(change) * wp.max(k[1], k[3]))


@wp.func
def contact_change(rows: Rows, c: int) -> wp.float64:
    """[J] a measure of what a sweep has changed: the impulse's change squared, by its response."""
    change = rows.impulse[c] - rows.held[c]
    k = rows.response[c]
    return change[0] * change[0] * k[0] + change[1] * change[1] * k[1] + change[2] * change[2] * k[3]
