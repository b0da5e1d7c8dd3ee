"""Kernels over the nodes and unknowns of a body: what a step aims at, residuals, steps of Newton's method."""

from functools import cache, partial
from types import SimpleNamespace

import warp as wp

from plait.solver.linear.block_kernels import block_kernels
from plait.solver.tets.elements import element_types


@cache
def body_kernels(real: type) -> SimpleNamespace:
    """Kernels with forces in `real` (wp.float32 or wp.float64); positions and sums are float64."""
    module = f"plait_tets_body_{real.__name__}"
    structure = partial(wp.struct, module=module)
    kernel = partial(wp.kernel, module=module, enable_backward=False)
    Incidence = block_kernels(real).types.Incidence
    vec3 = element_types(real).vec3

    @structure
    class Motion:
        """All nodes of the scene; world."""

        position: wp.array(dtype=wp.vec3d)  # [m]
        velocity: wp.array(dtype=wp.vec3d)  # [m/s]
        position_before: wp.array(dtype=wp.vec3d)  # one step earlier; within a step, at its start
        velocity_before: wp.array(dtype=wp.vec3d)
        external_impulse: wp.array(dtype=wp.vec3d)  # [kg m/s] taken up at the step's start
        goal: wp.array(dtype=wp.vec3d)  # [m] where the animation wants driven nodes at the step's end
        base: wp.array(dtype=wp.vec3d)  # [m] position = base + reach velocity, at the step's end
        base_velocity: wp.array(dtype=wp.vec3d)  # [m/s] velocity = base_velocity + reach acceleration
        predicted: wp.array(dtype=wp.vec3d)  # [m] at the step's end, were acceleration constant
        contact_impulse: wp.array(dtype=wp.vec3d)  # [kg m/s] of this step so far
        mass: wp.array(dtype=wp.float64)  # [kg]
        attachment: wp.array(dtype=wp.float64)  # [N/m]
        pinned: wp.array(dtype=wp.int32)

    @structure
    class Unknowns:
        """The free nodes of a body; a step minimises the sum of weight |x - target|^2 / 2 and elastic energy."""

        node: wp.array(dtype=wp.int32)  # (count,) into all nodes
        weight: wp.array(dtype=real)  # (count,) [N/m]
        target: wp.array(dtype=wp.vec3d)  # (count,) [m]
        residual: wp.array(dtype=vec3)  # (count,) [N] the force that is left

    @structure
    class Step:
        """A step of an implicit scheme; see `integrators.py`."""

        first_node: wp.int32
        start: wp.float64
        before: wp.float64
        reach: wp.float64  # [s]
        length: wp.float64  # [s]
        length_before: wp.float64  # [s]
        mass_damping: wp.float64  # [1/s]
        gravity: wp.vec3d  # [m/s2]

    @kernel
    def drive(first: int, driven: wp.array(dtype=wp.int32), place: wp.array(dtype=wp.vec3d), first_node: int,
              goal_out: wp.array(dtype=wp.vec3d)):  # fmt: skip
        i = first + wp.tid()
        goal_out[first_node + driven[i]] = place[i]

    @kernel
    def boost(first: int, step: Step, motion_out: Motion):
        """Takes up external impulses: the past becomes one in which the node had that velocity already.

        A multistep method then sees no jump, and the impulse changes the momentum by itself exactly.
        """
        i = step.first_node + first + wp.tid()
        if motion_out.pinned[i] == 0:
            change = motion_out.external_impulse[i] / motion_out.mass[i]
            motion_out.velocity[i] = motion_out.velocity[i] + change
            motion_out.velocity_before[i] = motion_out.velocity_before[i] + change
            motion_out.position_before[i] = motion_out.position_before[i] - step.length_before * change
        motion_out.external_impulse[i] = wp.vec3d()

    @kernel
    def begin(first: int, step: Step, motion_out: Motion):
        """What the step's end is reckoned from; the present becomes the past; pinned nodes go to their goal."""
        i = step.first_node + first + wp.tid()
        x = motion_out.position[i]
        v = motion_out.velocity[i]
        base_velocity = step.start * v - step.before * motion_out.velocity_before[i]
        motion_out.base[i] = step.start * x - step.before * motion_out.position_before[i]
        motion_out.base_velocity[i] = base_velocity
        acceleration = step.gravity
        if step.before > wp.float64(0.0):
            acceleration = (v - motion_out.velocity_before[i]) / step.length_before
        motion_out.predicted[i] = x + step.length * (v + wp.float64(0.5) * step.length * acceleration)
        motion_out.position_before[i] = x
        motion_out.velocity_before[i] = v
        motion_out.contact_impulse[i] = wp.vec3d()
        if motion_out.pinned[i] != 0:
            motion_out.position[i] = motion_out.goal[i]

    @kernel
    def restart(first: int, step: Step, motion_out: Motion):
        """What the step's end is reckoned from, by backward Euler: without the past."""
        i = step.first_node + first + wp.tid()
        motion_out.base[i] = motion_out.position_before[i]
        motion_out.base_velocity[i] = motion_out.velocity_before[i]

    @kernel
    def forget(first: int, step: Step, motion_out: Motion):
        """The past becomes one in which the node had its present velocity."""
        i = step.first_node + first + wp.tid()
        motion_out.velocity_before[i] = motion_out.velocity[i]
        motion_out.position_before[i] = motion_out.position[i] - step.length * motion_out.velocity[i]

    @kernel
    def aim(first: int, step: Step, motion: Motion, unknowns_out: Unknowns):
        """Inertia with gravity and contact, mass damping and soft attachment, as one quadratic a node."""
        u = first + wp.tid()
        i = unknowns_out.node[u]
        m = motion.mass[i]
        base = motion.base[i]
        v = motion.base_velocity[i] + motion.contact_impulse[i] / m + step.reach * step.gravity
        inertia = m / (step.reach * step.reach)
        spring = motion.attachment[i]
        weight = inertia + step.mass_damping * m / step.reach + spring
        # Written as a way from the base, which keeps the digits of a free node's way.
        way = (inertia / weight) * (step.reach * v)
        if spring > wp.float64(0.0):
            way += (spring / weight) * (motion.goal[i] - base)
        unknowns_out.weight[u] = real(weight)
        unknowns_out.target[u] = base + way

    @kernel
    def residual(first: int, chunk: int, incidence: Incidence, force: wp.array(dtype=vec3),
                 position: wp.array(dtype=wp.vec3d), direction: wp.array(dtype=vec3), unknowns_out: Unknowns,
                 sums_out: wp.array2d(dtype=wp.float64)):  # fmt: skip
        """The force left on each unknown; per chunk: its square, the quadratic, its work along `direction`.

        And the sum of the squares of the tets' forces, of which the residual is what does not cancel.
        """
        c = first + wp.tid()
        square = wp.float64(0.0)
        energy = wp.float64(0.0)
        work = wp.float64(0.0)
        size = wp.float64(0.0)
        for u in range(c * chunk, wp.min((c + 1) * chunk, unknowns_out.node.shape[0])):
            r = vec3()
            squares = real(0.0)
            for k in range(incidence.first[u], incidence.first[u + 1]):
                f = force[incidence.corner[k]]
                r += f
                squares += wp.dot(f, f)
            size += wp.float64(squares)
            away = unknowns_out.target[u] - position[unknowns_out.node[u]]
            weight = unknowns_out.weight[u]
            r += weight * vec3(away)
            unknowns_out.residual[u] = r
            square += wp.float64(wp.dot(r, r))
            energy += wp.float64(0.5) * wp.float64(weight) * wp.dot(away, away)
            work += wp.float64(wp.dot(r, direction[u]))
        sums_out[c, 0] = square
        sums_out[c, 1] = energy
        sums_out[c, 2] = work
        sums_out[c, 3] = size

    @kernel
    def weigh_forces(first: int, chunk: int, step: Step, motion: Motion, unknowns: Unknowns,
                     sums_out: wp.array(dtype=wp.float64)):  # fmt: skip
        """Per chunk: the square of the residual less what only takes the nodes where their velocities lead."""
        c = first + wp.tid()
        square = wp.float64(0.0)
        for u in range(c * chunk, wp.min((c + 1) * chunk, unknowns.node.shape[0])):
            i = unknowns.node[u]
            way = motion.base[i] + step.reach * motion.base_velocity[i] - motion.position[i]
            force = wp.vec3d(unknowns.residual[u]) - (motion.mass[i] / (step.reach * step.reach)) * way
            square += wp.dot(force, force)
        sums_out[c] = square

    @kernel
    def examine_direction(first: int, chunk: int, unknowns: Unknowns, direction: wp.array(dtype=vec3),
                          sums_out: wp.array2d(dtype=wp.float64)):  # fmt: skip
        """Per chunk: the square of the longest displacement, and the work along `direction`."""
        c = first + wp.tid()
        longest = real(0.0)
        work = wp.float64(0.0)
        for u in range(c * chunk, wp.min((c + 1) * chunk, unknowns.node.shape[0])):
            d = direction[u]
            longest = wp.max(longest, wp.dot(d, d))
            work += wp.float64(wp.dot(unknowns.residual[u], d))
        sums_out[c, 0] = wp.float64(longest)
        sums_out[c, 1] = work

    @kernel
    def advance(first: int, unknowns: Unknowns, start: wp.array(dtype=wp.vec3d), direction: wp.array(dtype=vec3),
                fraction: wp.float64, position_out: wp.array(dtype=wp.vec3d)):  # fmt: skip
        u = first + wp.tid()
        x = start[u]
        if fraction != wp.float64(0.0):
            x += fraction * wp.vec3d(direction[u])
        position_out[unknowns.node[u]] = x

    @kernel
    def take(first: int, unknowns: Unknowns, values: wp.array(dtype=wp.vec3d),
             values_out: wp.array(dtype=wp.vec3d)):  # fmt: skip
        """The unknowns' part of `values`, (node_count,)."""
        u = first + wp.tid()
        values_out[u] = values[unknowns.node[u]]

    @kernel
    def put(first: int, unknowns: Unknowns, values: wp.array(dtype=wp.vec3d),
            values_out: wp.array(dtype=wp.vec3d)):  # fmt: skip
        """The unknowns' part of `values`, (node_count,), into `values_out`, (node_count,)."""
        i = unknowns.node[first + wp.tid()]
        values_out[i] = values[i]

    @kernel
    def least(first: int, chunk: int, values: wp.array(dtype=real), least_out: wp.array(dtype=real)):
        c = first + wp.tid()
        value = values[c * chunk]
        for k in range(c * chunk, wp.min((c + 1) * chunk, values.shape[0])):
            value = wp.min(value, values[k])
        least_out[c] = value

    @kernel
    def total(first: int, chunk: int, values: wp.array(dtype=wp.float64), total_out: wp.array(dtype=wp.float64)):
        c = first + wp.tid()
        value = wp.float64(0.0)
        for k in range(c * chunk, wp.min((c + 1) * chunk, values.shape[0])):
            value += values[k]
        total_out[c] = value

    @kernel
    def find_velocity(first: int, step: Step, motion_out: Motion):
        i = step.first_node + first + wp.tid()
        motion_out.velocity[i] = (motion_out.position[i] - motion_out.base[i]) / step.reach

    @kernel
    def absorb_contact(first: int, step: Step, motion_out: Motion):
        """The past becomes one in which the node had the velocity that contact gave it already; see `boost`.

        Positions stay: what rests under the same impulses in every step is then at rest.
        """
        i = step.first_node + first + wp.tid()
        if motion_out.pinned[i] == 0:
            change = motion_out.contact_impulse[i] / motion_out.mass[i]
            motion_out.velocity_before[i] = motion_out.velocity_before[i] + change

    types = SimpleNamespace(vec3=vec3, Motion=Motion, Unknowns=Unknowns, Step=Step)
    return SimpleNamespace(
        drive=drive,
        boost=boost,
        begin=begin,
        restart=restart,
        forget=forget,
        aim=aim,
        residual=residual,
        weigh_forces=weigh_forces,
        examine_direction=examine_direction,
        advance=advance,
        take=take,
        put=put,
        least=least,
        total=total,
        find_velocity=find_velocity,
        absorb_contact=absorb_contact,
        types=types,
    )
