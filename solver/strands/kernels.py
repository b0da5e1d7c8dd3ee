"""A strand's whole substep in one kernel item: prediction, Newton, time integration, subdivision."""

from functools import cache
from types import SimpleNamespace

import warp as wp

from plait.solver.contact.planes import PLANES_A_NODE, ContactPlanes
from plait.solver.strands.contact import contact_functions
from plait.solver.strands.energy import joint_functions
from plait.solver.strands.newton import newton_functions
from plait.solver.strands.stretch import stretch_functions
from plait.solver.strands.types import rod_types

SDIRK2_GAMMA = 0.2928932188134524  # 1 - 1 / sqrt 2: L-stable and second order (Alexander 1977)
SAFETY = 3.0  # on the expected next Newton step
LARGEST_TURN = 1.0  # [rad] an edge or a director in one Newton iteration


@cache
def strand_kernels(real: type) -> SimpleNamespace:
    """Kernels `solve`, `measure` for `real`, in one Warp module per precision."""
    types = rod_types(real)
    newton = newton_functions(real)
    joints = joint_functions(real)
    vec3, module = types.vec3, types.module
    Rods, RodState, Roots = types.Rods, types.RodState, types.Roots
    Method, Scratch, Report = types.Method, types.Scratch, types.Report
    eliminate, substitute, advance = newton.eliminate, newton.substitute, newton.advance
    measure_edges = newton.measure_edges
    joint_energy, signed_twist, turned = joints.joint_energy, joints.signed_twist, joints.turned
    stretch_energy = stretch_functions(real).stretch_energy
    contact = contact_functions(real)
    touching, release = contact.touching, contact.release
    plane_force = contact.plane_force

    @wp.func(module=module)
    def part_of_rotation(rotation: wp.mat33d, part: wp.float64):
        """The rotation about the same axis by `part` of the angle."""
        quaternion = wp.quat_from_matrix(rotation)
        axis = wp.vec3d()
        angle = wp.float64(0.0)
        wp.quat_to_axis_angle(quaternion, axis, angle)
        return wp.quat_to_matrix(wp.quat_from_axis_angle(axis, part * angle))

    @wp.func(module=module)
    def rotation_vector(turn: types.mat33):
        """A rotation's axis times its angle [rad]."""
        axis = real(0.5) * vec3(turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1])
        sine = wp.length(axis)
        if sine > real(0.0):
            axis = (wp.atan2(sine, real(0.5) * (wp.trace(turn) - real(1.0))) / sine) * axis
        return axis

    @wp.func(module=module)
    def load(state: RodState, scratch: Scratch, first: int, count: int, base: int, stride: int, origin: wp.vec3d):
        """Start of the substep into `scratch`, positions about `origin`."""
        for k in range(count):
            slot = base + k * stride
            x = vec3(state.position[first + k] - origin)
            scratch.start[slot] = x
            scratch.position[slot] = x
            scratch.start_velocity[slot] = vec3(state.velocity[first + k])
            scratch.director[slot] = vec3(state.director[first + k])
            scratch.twist[slot] = real(state.twist[first + k])
            scratch.tension[slot] = real(state.tension[first + k])
            if state.spin.shape[0] > 0:
                scratch.start_director[slot] = scratch.director[slot]
                scratch.start_spin[slot] = real(state.spin[first + k])

    @wp.func(module=module)
    def load_guess(
        guess: RodState, scratch: Scratch, first: int, count: int, base: int, stride: int, origin: wp.vec3d
    ):
        """Shape, twist and dual tension from which Newton starts."""
        for k in range(count):
            slot = base + k * stride
            scratch.position[slot] = vec3(guess.position[first + k] - origin)
            scratch.director[slot] = vec3(guess.director[first + k])
            scratch.twist[slot] = real(guess.twist[first + k])
            scratch.tension[slot] = real(guess.tension[first + k])

    @wp.func(module=module)
    def carry(
        scratch: Scratch, count: int, base: int, stride: int, turn: wp.mat33d, centre: wp.vec3d, shift: wp.vec3d
    ):
        """Moves the current shape rigidly: x to turn (x - centre) + centre + shift."""
        rotation = types.mat33(turn)
        c = vec3(centre)
        to = vec3(centre + shift)
        for k in range(count):
            slot = base + k * stride
            scratch.position[slot] = rotation * (scratch.position[slot] - c) + to
            scratch.director[slot] = rotation * scratch.director[slot]

    @wp.func(module=module)
    def converge(
        rods: Rods,
        scratch: Scratch,
        method: Method,
        planes: ContactPlanes,
        constrained: bool,
        origin: wp.vec3d,
        ahead: wp.float64,
        strand: int,
        base: int,
        stride: int,
        inertia: real,
    ):
        """Newton's method. Returns iterations and whether what is left is within the tolerance.

        What is left after a full step is bounded by the step itself, and by the next one: Newton contracts at
        least as fast as from the step before to this one, with a factor for safety.
        """
        measure_edges(scratch, rods.first_node[strand + 1] - rods.first_node[strand], base, stride)
        small = method.tolerance * rods.segment[strand]
        iterations = wp.int32(0)
        previous = real(0.0)
        if constrained:
            release(scratch, rods.first_node[strand + 1] - rods.first_node[strand], base, stride)
        converged = wp.bool(False)
        while iterations < method.max_iterations and not converged:
            iterations += 1
            # The exact Hessian where it is definite, else half, else none of its geometric part.
            definite = wp.bool(False)
            beta = real(1.0)
            while not definite and beta >= real(0.0):
                definite = eliminate(
                    rods, scratch, planes, constrained, origin, ahead, strand, base, stride, inertia, beta
                )
                beta -= real(0.5)
            if not definite:
                break
            furthest, turn = substitute(rods, scratch, strand, base, stride)
            fraction = real(1.0)
            if turn > real(LARGEST_TURN):
                fraction = real(LARGEST_TURN) / turn
            under = advance(
                rods, scratch, planes, constrained, origin, ahead, strand, base, stride, inertia, fraction
            )
            expected = furthest
            if fraction == real(1.0) and previous > furthest:
                expected = wp.min(furthest, real(SAFETY) * furthest * (furthest / previous))
            converged = fraction == real(1.0) and expected <= small and not under
            previous = wp.where(fraction == real(1.0), furthest, real(0.0))
        return iterations, converged

    @wp.func(module=module)
    def aim(
        rods: Rods,
        scratch: Scratch,
        strand: int,
        base: int,
        stride: int,
        h: real,
        explicit_step: real,
        turn: types.mat33,
        centre: vec3,
        shift: vec3,
        step: real,
    ):
        """Targets of an implicit stage, x = x0 + h v, v = v0 + h a; returns the inertia [1/s2].

        Damping acts on the velocity relative to the root's rigid motion over the piece (turn, centre, shift in
        time `step`), a free strand's relative to its own.  explicit_step: 0, or (1 - gamma) step, by which
        SDIRK2's first stage enters its second.
        """
        count = rods.first_node[strand + 1] - rods.first_node[strand]
        damping = rods.damping[strand]
        inertia = real(1.0) / (h * h) + damping / h
        for k in range(count):
            slot = base + k * stride
            x = scratch.start[slot]
            v = scratch.start_velocity[slot]
            rigid = (turn * (x - centre) + centre + shift - x) / step
            x = x + explicit_step * scratch.stage_velocity[slot]
            v = v + (explicit_step / h) * (scratch.stage_velocity[slot] - v)
            scratch.start_of_stage[slot] = x
            scratch.target[slot] = x + (v / h + damping * rigid) / inertia
        if rods.free[strand] != 0:
            rate = rotation_vector(turn) / step
            for k in range(count - 1):
                slot = base + k * stride
                edge = wp.normalize(scratch.start[slot + stride] - scratch.start[slot])
                angle = explicit_step * scratch.stage_spin[slot]
                spin = scratch.start_spin[slot] + (explicit_step / h) * (
                    scratch.stage_spin[slot] - scratch.start_spin[slot]
                )
                scratch.turn_of_stage[slot] = angle
                scratch.turn_target[slot] = angle + (spin / h + damping * wp.dot(rate, edge)) / inertia
        return inertia

    @wp.func(module=module)
    def measure_spin(scratch: Scratch, count: int, base: int, stride: int, h: real):
        """Spin of a free strand's edges at the end of a stage."""
        for k in range(1, count - 1):
            slot = base + k * stride
            scratch.stage_spin[slot] = (turned(scratch, slot, stride) - scratch.turn_of_stage[slot]) / h

    @wp.func(module=module)
    def march(
        rods: Rods,
        state: RodState,
        scratch: Scratch,
        method: Method,
        planes: ContactPlanes,
        constrained: bool,
        result: RodState,
        strand: int,
        base: int,
        stride: int,
        root: wp.vec3d,
        rotation: wp.mat33d,
        pieces: int,
        stubborn: bool,
    ):
        """The substep in `pieces` equal parts. Returns iterations and whether all of them converged.

        Gives up at the first part that does not converge unless `stubborn`. A single solve may start from
        `result`, see `Method.warm`.
        """
        first = rods.first_node[strand]
        count = rods.first_node[strand + 1] - first
        root_before = state.root_position[strand] - root
        part = wp.float64(1.0) / wp.float64(pieces)
        turn = rotation * wp.transpose(state.root_rotation[strand])
        if pieces > 1:
            turn = part_of_rotation(turn, part)
        shift = -part * root_before
        step = real(part * method.step)
        gamma = wp.float64(SDIRK2_GAMMA)
        load(state, scratch, first, count, base, stride, root)
        iterations = wp.int32(0)
        converged = wp.bool(True)
        for stage in range(pieces * method.stages):
            if converged or stubborn:
                piece = stage / method.stages
                centre = (wp.float64(1.0) - wp.float64(piece) * part) * root_before
                h = step
                explicit_step = real(0.0)
                ahead = wp.float64(1.0) - wp.float64(piece + 1) * part
                if method.stages == 1:
                    carry(scratch, count, base, stride, turn, centre, shift)
                else:
                    h = real(gamma) * step
                    if stage % 2 == 0:
                        ahead += (wp.float64(1.0) - gamma) * part
                        carry(scratch, count, base, stride, part_of_rotation(turn, gamma), centre, gamma * shift)
                    else:
                        rest = wp.float64(1.0) - gamma
                        explicit_step = real(rest) * step
                        turn_rest = part_of_rotation(turn, rest)
                        carry(scratch, count, base, stride, turn_rest, centre + gamma * shift, rest * shift)
                if method.warm != 0 and pieces * method.stages == 1:
                    load_guess(result, scratch, first, count, base, stride, root)
                if stage + 1 == pieces * method.stages and rods.free[strand] == 0:
                    # The clamp itself, exactly.
                    scratch.position[base] = vec3(rotation * rods.ghost[strand])
                    scratch.position[base + stride] = vec3()
                    scratch.director[base] = vec3(rotation * rods.clamp_director[strand])
                inertia = real(0.0)
                if step > real(0.0):
                    inertia = aim(
                        rods, scratch, strand, base, stride, h, explicit_step, types.mat33(turn), vec3(centre),
                        vec3(shift), step,
                    )  # fmt: skip
                done, within = converge(
                    rods, scratch, method, planes, constrained, root, ahead, strand, base, stride, inertia
                )
                iterations += done
                converged = converged and within
                if step > real(0.0):
                    last_stage = (stage + 1) % method.stages == 0
                    if rods.free[strand] != 0:
                        measure_spin(scratch, count, base, stride, h)
                    for k in range(count):
                        slot = base + k * stride
                        v = (scratch.position[slot] - scratch.start_of_stage[slot]) / h
                        scratch.stage_velocity[slot] = v
                        if last_stage:
                            scratch.start[slot] = scratch.position[slot]
                            scratch.start_velocity[slot] = v
                            if rods.free[strand] != 0:
                                scratch.start_director[slot] = scratch.director[slot]
                                scratch.start_spin[slot] = scratch.stage_spin[slot]
        return iterations, converged

    @wp.kernel(enable_backward=False, module=module)
    def solve(
        first: int,
        chunk_count: int,
        active: wp.array(dtype=wp.int32),  # (strand_count,) 0: leave this strand alone
        constrained: bool,
        planes: ContactPlanes,
        method: Method,
        rods: Rods,
        state: RodState,
        roots: Roots,
        scratch: Scratch,
        state_out: RodState,
        report_out: Report,
    ):
        """Advances the strands chunk, chunk + chunk_count, ... by one substep from `state` to `state_out`.

        A strand that does not converge starts again in 2, 4, ... parts.
        """
        chunk = first + wp.tid()
        base = chunk * scratch.chunk_stride
        stride = scratch.node_stride
        strand_count = rods.first_node.shape[0] - 1
        for strand in range(chunk, strand_count, chunk_count):
            if active[strand] == 0:
                continue
            root = roots.position[strand]
            rotation = roots.rotation[strand]
            pieces = wp.int32(0)
            converged = wp.bool(False)
            iterations = wp.int32(0)
            if method.warm != 0:
                iterations += report_out.iterations[strand]
            while not converged and pieces < method.max_pieces:
                pieces = wp.max(1, 2 * pieces)
                more, within = march(
                    rods, state, scratch, method, planes, constrained, state_out, strand, base, stride, root,
                    rotation, pieces, pieces >= method.max_pieces,
                )  # fmt: skip
                iterations += more
                converged = within
            report_out.iterations[strand] = iterations
            report_out.pieces[strand] = pieces
            report_out.unconverged[strand] = wp.where(converged, 0, 1)
            begin = rods.first_node[strand]
            contacts = wp.int32(0)
            for node in range(begin, rods.first_node[strand + 1]):
                slot = base + (node - begin) * stride
                x = wp.vec3d(scratch.position[slot]) + root
                if constrained and touching(planes, node, x):
                    contacts += 1
                state_out.position[node] = x
                state_out.velocity[node] = wp.vec3d(scratch.stage_velocity[slot])
                state_out.director[node] = wp.vec3d(scratch.director[slot])
                state_out.twist[node] = wp.float64(scratch.twist[slot])
                state_out.tension[node] = wp.float64(scratch.tension[slot])
                if rods.free[strand] != 0:
                    state_out.spin[node] = wp.float64(scratch.stage_spin[slot])
                if report_out.reaction.shape[0] > 0:
                    for i in range(PLANES_A_NODE):
                        plane = node * PLANES_A_NODE + i
                        force = vec3()
                        if constrained:
                            force = plane_force(
                                planes, plane, scratch.pressure[slot * PLANES_A_NODE + i], scratch.position[slot],
                                root, rods.slip[strand],
                            )  # fmt: skip
                        report_out.reaction[plane] = wp.vec3d(force)
            report_out.contacts[strand] = contacts
            state_out.root_position[strand] = root
            state_out.root_rotation[strand] = rotation

    @wp.kernel(enable_backward=False, module=module)
    def realign(
        first: int,
        active: wp.array(dtype=wp.int32),  # (strand_count,) 0: leave this strand alone
        first_node: wp.array(dtype=wp.int32),
        position: wp.array(dtype=wp.vec3d),
        director_out: wp.array(dtype=wp.vec3d),
        twist_out: wp.array(dtype=wp.float64),
    ):
        """Turns directors the least that makes them perpendicular to their edges again; twist follows."""
        strand = first + wp.tid()
        if active[strand] == 0:
            return
        begin = first_node[strand]
        t = vec3(wp.normalize(position[begin + 1] - position[begin]))
        m = vec3(director_out[begin])
        for k in range(begin + 1, first_node[strand + 1] - 1):
            t_next = vec3(wp.normalize(position[k + 1] - position[k]))
            m_next = vec3(director_out[k])
            m_next = wp.normalize(m_next - wp.dot(m_next, t_next) * t_next)
            director_out[k] = wp.vec3d(m_next)
            twist_out[k] = wp.float64(signed_twist(t, t_next, m, m_next, real(twist_out[k])))
            t = t_next
            m = m_next

    @wp.kernel(enable_backward=False, module=module)
    def measure(
        first: int,
        rods: Rods,
        state: RodState,
        measures_out: wp.array2d(dtype=wp.float64),  # (strand_count, 4) largest strain, energies [J]
    ):
        """Largest strain and kinetic, elastic and potential energy of each strand."""
        strand = first + wp.tid()
        begin = rods.first_node[strand]
        end = rods.first_node[strand + 1]
        root = state.position[begin + 1]
        strain = real(0.0)
        kinetic = wp.float64(0.0)
        elastic = wp.float64(0.0)
        potential = wp.float64(0.0)
        if rods.free[strand] != 0:
            v_root = state.velocity[begin + 1]
            kinetic = wp.float64(0.5) * wp.float64(rods.mass[begin + 1]) * wp.dot(v_root, v_root)
            potential = -wp.dot(wp.vec3d(rods.force[begin + 1]), root)
        x = vec3()
        t = -wp.normalize(vec3(state.position[begin] - root))
        for node in range(begin + 2, end):
            x_next = vec3(state.position[node] - root)
            e = x_next - x
            length = wp.length(e)
            t_next = e / length
            rest = rods.rest_length[node - 1]
            stretched = length / rest - real(1.0)
            strain = wp.max(strain, wp.abs(stretched))
            elastic += wp.float64(
                rest * stretch_energy(stretched, rods.stretch[strand], rods.stretch_beyond[strand])
            )
            if node - 1 > begin + rods.free[strand]:
                elastic += wp.float64(
                    joint_energy(
                        t, t_next, vec3(state.director[node - 2]), vec3(state.director[node - 1]),
                        real(state.twist[node - 1]), rods.bend[node - 1], rods.twist[node - 1],
                        rods.rest_curvature[node - 1], rods.rest_twist[node - 1],
                    )
                )  # fmt: skip
            v = state.velocity[node]
            kinetic += wp.float64(0.5) * wp.float64(rods.mass[node]) * wp.dot(v, v)
            potential -= wp.dot(wp.vec3d(rods.force[node]), state.position[node])
            x = x_next
            t = t_next
        measures_out[strand, 0] = wp.float64(strain) + wp.float64(0.0) * (elastic + kinetic)
        measures_out[strand, 1] = kinetic
        measures_out[strand, 2] = elastic
        measures_out[strand, 3] = potential

    return SimpleNamespace(
        solve=solve,
        realign=realign,
        measure=measure,
        types=types,
        newton=newton,
        joint_energy=joint_energy,
        load=load,
        load_guess=load_guess,
        carry=carry,
        aim=aim,
        measure_spin=measure_spin,
    )
