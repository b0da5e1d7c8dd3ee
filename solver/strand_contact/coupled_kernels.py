"""Strands that meet, solved together: each strand's own matrix preconditions conjugate gradients over all.

A Newton step of all strands solves H d = r, where H is the strands' own matrices M (each with what its contacts
add to it alone) and the coupling O of contacts between strands. M is factored strand by strand
(`elimination.py`), so that M^-1 costs a forward and a backward substitution; and as the search directions are
combinations of M^-1 r, their images under M are the same combinations of r, and need no matrix at all.
"""

from functools import cache, partial
from types import SimpleNamespace

import warp as wp

from plait.solver.contact.planes import ContactPlanes
from plait.solver.strand_contact.meeting_kernels import Meetings, Ways
from plait.solver.strands.contact import contact_functions
from plait.solver.strands.elimination import elimination
from plait.solver.strands.kernels import LARGEST_TURN, strand_kernels
from plait.solver.strands.substitution import substitution
from plait.solver.strands.types import coupled_module_name, rod_types


@cache
def coupled_kernels(real: type) -> SimpleNamespace:
    """Kernels `begin`, `gather`, `linearise`, `image`, `descend`, `advance`, `hold_back`, `finish`."""
    types = rod_types(real)
    strands_own = strand_kernels(real)
    load, carry, aim, load_guess = strands_own.load, strands_own.carry, strands_own.aim, strands_own.load_guess
    measure_edges = strands_own.newton.measure_edges
    measure_spin = strands_own.measure_spin
    advance_strand = strands_own.newton.advance
    eliminate = elimination(real, coupled=True)
    release = contact_functions(real).release
    solve, Krylov = substitution(real).solve, substitution(real).Krylov
    vec2, vec3, vec4, mat33, mat44 = types.vec2, types.vec3, types.vec4, types.mat33, types.mat44
    Rods, RodState, Roots, Method, Scratch = types.Rods, types.RodState, types.Roots, types.Method, types.Scratch
    module = coupled_module_name(real)
    kernel = partial(wp.kernel, module=module, enable_backward=False)

    @partial(wp.struct, module=module)
    class Couplings:
        """Pairs that act, from the side of each of their edges, in the order of `acting`."""

        other: wp.array(dtype=wp.int32)  # the other edge
        place: wp.array(dtype=vec2)  # where on the edge itself and on the other, 0 to 1
        block: wp.array(dtype=mat33)  # [N/m] the force on the edge by the other's displacement

    @kernel
    def begin(
        first: int,
        strands: wp.array(dtype=wp.int32),
        method: Method,
        rods: Rods,
        state: RodState,
        roots: Roots,
        lasting: wp.array(dtype=wp.int32),
        alone: RodState,
        scratch: Scratch,
        position_out: wp.array(dtype=wp.vec3d),
        stiffness_out: wp.array(dtype=wp.float64),
        inertia_out: wp.array(dtype=real),
        ways_out: Ways,
    ):
        """The substep's start carried rigidly with the root; what a node resists a contact by [N/m]."""
        strand = strands[first + wp.tid()]
        base = rods.first_node[strand]
        count = rods.first_node[strand + 1] - base
        root = roots.position[strand]
        rotation = roots.rotation[strand]
        before = state.root_position[strand] - root
        turn = rotation * wp.transpose(state.root_rotation[strand])
        load(state, scratch, base, count, base, 1, root)
        carry(scratch, count, base, 1, turn, before, -before)
        if lasting[strand] == 0:
            load_guess(alone, scratch, base, count, base, 1, root)
        if rods.free[strand] == 0:
            # The clamp itself, exactly.
            scratch.position[base] = vec3(rotation * rods.ghost[strand])
            scratch.position[base + 1] = vec3()
            scratch.director[base] = vec3(rotation * rods.clamp_director[strand])
        step = real(method.step)
        inertia = aim(
            rods, scratch, strand, base, 1, step, real(0.0), types.mat33(turn), vec3(before), vec3(-before), step
        )
        inertia_out[strand] = inertia
        length = rods.segment[strand]
        # The root's Voronoi length is half a segment.
        bending = wp.float64(real(0.5) * length * rods.bend[base + 1])
        measure_edges(scratch, count, base, 1)
        release(scratch, count, base, 1)
        for k in range(count):
            node = base + k
            position_out[node] = root + wp.vec3d(scratch.position[node])
            ways_out.travel[node] = wp.float64(0.0)
            # A beam, and a string, on an elastic foundation, its inertia, under a point load (Hetenyi 1946).
            inertial = wp.float64(rods.mass[node] * inertia)
            foundation = inertial / wp.float64(length)
            pull = wp.max(wp.float64(scratch.tension[node]), wp.float64(0.0))
            stiffness_out[node] = (
                inertial
                + wp.float64(2.8284271247461903) * wp.sqrt(wp.sqrt(bending * foundation * foundation * foundation))
                + wp.float64(2.0) * wp.sqrt(pull * foundation)
            )

    @kernel
    def gather(
        first: int,
        strands: wp.array(dtype=wp.int32),
        acting_first: wp.array(dtype=wp.int32),
        acting: wp.array(dtype=wp.int32),
        meetings: Meetings,
        rods: Rods,
        scratch: Scratch,
        couplings_out: Couplings,
    ):
        """What the forces and stiffnesses of its pairs are to a strand's nodes.

        acting_first, acting: the pairs of each edge that act, as those of `EdgePairs`.
        """
        strand = strands[first + wp.tid()]
        base = rods.first_node[strand]
        end = rods.first_node[strand + 1]
        for node in range(base + 1, end):
            scratch.meeting_block[node] = mat33()
            scratch.meeting_lower[node] = mat33()
            scratch.meeting_gradient[node] = vec3()
        for edge in range(base + 1, end - 1):
            block_here = wp.mat33d()
            block_next = wp.mat33d()
            between = wp.mat33d()
            force_here = wp.vec3d()
            force_next = wp.vec3d()
            for at in range(acting_first[edge], acting_first[edge + 1]):
                pair = acting[at] / 2
                side = acting[at] % 2
                w = meetings.place[pair][side]
                u = wp.float64(1.0) - w
                block = meetings.block[pair]
                force = meetings.force[pair]
                if side == 1:
                    force = -force
                block_here += (u * u) * block
                block_next += (w * w) * block
                between += (u * w) * block
                force_here += u * force
                force_next += w * force
                couplings_out.other[at] = meetings.edges[pair][1 - side]
                couplings_out.place[at] = vec2(real(w), real(meetings.place[pair][1 - side]))
                couplings_out.block[at] = mat33(block)
            scratch.meeting_block[edge] = scratch.meeting_block[edge] + mat33(block_here)
            scratch.meeting_gradient[edge] = scratch.meeting_gradient[edge] - vec3(force_here)
            scratch.meeting_block[edge + 1] = mat33(block_next)
            scratch.meeting_lower[edge + 1] = mat33(between)
            scratch.meeting_gradient[edge + 1] = -vec3(force_next)

    @kernel
    def linearise(
        first: int,
        strands: wp.array(dtype=wp.int32),
        rods: Rods,
        planes: ContactPlanes,
        constrained: bool,
        roots: Roots,
        inertia: wp.array(dtype=real),
        scratch: Scratch,
        krylov: Krylov,
        product_out: wp.array(dtype=wp.float64),
        definite_out: wp.array(dtype=wp.int32),
        left_out: wp.array(dtype=wp.float64),
    ):
        """Factors each strand's own matrix; the first direction, M^-1 r, and r . M^-1 r, one entry an item.

        left_out: (strand_count,) longest displacement in M^-1 r, over the strand's segments.
        """
        item = first + wp.tid()
        strand = strands[item]
        base = rods.first_node[strand]
        # The exact Hessian where it is definite, else half, else none of its geometric part.
        definite = wp.bool(False)
        beta = real(1.0)
        while not definite and beta >= real(0.0):
            definite = eliminate(
                rods, scratch, planes, constrained, roots.position[strand], wp.float64(0.0), strand, base, 1,
                inertia[strand], beta,
            )  # fmt: skip
            beta -= real(0.5)
        definite_out[item] = wp.where(definite, 1, 0)
        begin = base + 1 - rods.free[strand]
        end = rods.first_node[strand + 1] - 1
        for slot in range(begin, end):
            krylov.direction[slot] = vec4()
            krylov.image[slot] = vec4()
            krylov.step[slot] = vec4()
            if not definite:
                # It stays where it is.
                scratch.right[slot] = vec4()
                scratch.inverse[slot] = mat44()
                scratch.left1[slot] = mat44()
                scratch.left2[slot] = mat44()
        product_out[item] = solve(rods, scratch, krylov, strand, real(0.0))
        furthest = real(0.0)
        for slot in range(begin, end):
            z = scratch.solution[slot]
            furthest = wp.max(furthest, z[1] * z[1] + z[2] * z[2] + z[3] * z[3])
        left_out[strand] = wp.float64(wp.sqrt(furthest) / rods.segment[strand])

    @kernel
    def image(
        first: int,
        strands: wp.array(dtype=wp.int32),
        rods: Rods,
        acting_first: wp.array(dtype=wp.int32),
        couplings: Couplings,
        scratch: Scratch,
        beta: wp.array(dtype=wp.float64),
        krylov: Krylov,
        product_out: wp.array(dtype=wp.float64),
    ):
        """The next direction, z and `beta` times the last; its image under the matrix of all strands likewise, as
        that of z under the strand's own is r; the product of both, one entry an item."""
        item = first + wp.tid()
        strand = strands[item]
        base = rods.first_node[strand]
        b = real(beta[0])
        product = wp.float64(0.0)
        pull = vec3()  # on the node at which the edge begins
        for edge in range(base + 1, rods.first_node[strand + 1]):
            pull_next = vec3()
            for at in range(acting_first[edge], acting_first[edge + 1]):
                other = couplings.other[at]
                place = couplings.place[at]
                d = scratch.solution[other - 1]
                e = scratch.solution[other]
                moved = d + place[1] * (e - d)
                answer = couplings.block[at] * vec3(moved[1], moved[2], moved[3])
                there = place[0] * answer
                pull += answer - there
                pull_next += there
            if edge > base + 1 - rods.free[strand]:
                slot = edge - 1
                own = scratch.right[slot]
                direction = scratch.solution[slot] + b * krylov.direction[slot]
                image = vec4(own[0], own[1] - pull[0], own[2] - pull[1], own[3] - pull[2]) + b * krylov.image[slot]
                krylov.direction[slot] = direction
                krylov.image[slot] = image
                product += wp.float64(wp.dot(direction, image))
            pull = pull_next
        product_out[item] = product

    @kernel
    def descend(
        first: int,
        strands: wp.array(dtype=wp.int32),
        alpha: wp.array(dtype=wp.float64),
        rods: Rods,
        scratch: Scratch,
        krylov: Krylov,
        product_out: wp.array(dtype=wp.float64),
    ):
        """Steps along the direction; what is left, r, and z = M^-1 r; their product, one entry an item."""
        item = first + wp.tid()
        product_out[item] = solve(rods, scratch, krylov, strands[item], real(alpha[0]))

    @kernel
    def advance(
        first: int,
        strands: wp.array(dtype=wp.int32),
        rods: Rods,
        planes: ContactPlanes,
        constrained: bool,
        roots: Roots,
        inertia: wp.array(dtype=real),
        relaxation: wp.array(dtype=wp.float64),
        krylov: Krylov,
        scratch: Scratch,
        expected: wp.array(dtype=wp.vec3d),
        room: wp.array(dtype=wp.float64),
        least_room: wp.float64,
        position_out: wp.array(dtype=wp.vec3d),
        ways_out: Ways,
    ):
        """Takes the step, or `relaxation` of it, or so much that no edge turns too far at once.

        expected, room, least_room: [m] where pairs were found for, and how far from there.
        """
        strand = strands[first + wp.tid()]
        base = rods.first_node[strand]
        count = rods.first_node[strand + 1] - base
        root = roots.position[strand]
        furthest = real(0.0)
        turn = real(0.0)
        moved = vec3()
        if rods.free[strand] != 0:
            z = krylov.step[base]
            scratch.solution[base] = z
            moved = vec3(z[1], z[2], z[3])
            furthest = wp.dot(moved, moved)
        for k in range(1, count - 1):
            slot = base + k
            z = krylov.step[slot]
            scratch.solution[slot] = z
            d = vec3(z[1], z[2], z[3])
            across = scratch.inverse_length[slot] * wp.cross(scratch.tangent[slot], d - moved)
            furthest = wp.max(furthest, wp.dot(d, d))
            turn = wp.max(turn, wp.max(z[0] * z[0], wp.dot(across, across)))
            moved = d
        turn = wp.sqrt(turn)
        fraction = real(relaxation[0])
        if fraction * turn > real(LARGEST_TURN):
            fraction = real(LARGEST_TURN) / turn
        advance_strand(
            rods, scratch, planes, constrained, root, wp.float64(0.0), strand, base, 1, inertia[strand], fraction
        )
        stray = wp.float64(0.0)
        for node in range(base, base + count):
            x = root + wp.vec3d(scratch.position[node])
            ways_out.travel[node] = ways_out.travel[node] + wp.length(x - position_out[node])
            position_out[node] = x
            stray = wp.max(stray, wp.length(x - expected[node]) / wp.max(least_room, room[node]))
        ways_out.stray[strand] = stray
        ways_out.moved[strand] = wp.float64(wp.sqrt(furthest) / rods.segment[strand])

    @kernel
    def hold_back(
        first: int,
        strands: wp.array(dtype=wp.int32),
        part: wp.array(dtype=wp.float64),
        rods: Rods,
        state: RodState,
        roots: Roots,
        whole: wp.array(dtype=wp.vec3d),
        scratch: Scratch,
        position_out: wp.array(dtype=wp.vec3d),
    ):
        """Lets a strand go only `part` of its way to `whole`, from where its root alone would carry it."""
        item = first + wp.tid()
        strand = strands[item]
        root = roots.position[strand]
        before = state.root_position[strand]
        turn = roots.rotation[strand] * wp.transpose(state.root_rotation[strand])
        base = rods.first_node[strand]
        for node in range(base + 2 - rods.free[strand], rods.first_node[strand + 1]):
            carried = turn * (state.position[node] - before) + root
            x = carried + part[item] * (whole[node] - carried)
            position_out[node] = x
            scratch.position[node] = vec3(x - root)

    @kernel
    def finish(
        first: int,
        strands: wp.array(dtype=wp.int32),
        method: Method,
        rods: Rods,
        roots: Roots,
        scratch: Scratch,
        position: wp.array(dtype=wp.vec3d),
        state_out: RodState,
    ):
        """The strands' state at the substep's end."""
        strand = strands[first + wp.tid()]
        step = real(method.step)
        if rods.free[strand] != 0:
            base = rods.first_node[strand]
            measure_spin(scratch, rods.first_node[strand + 1] - base, base, 1, step)
        for node in range(rods.first_node[strand], rods.first_node[strand + 1]):
            state_out.position[node] = position[node]
            v = (scratch.position[node] - scratch.start_of_stage[node]) / step
            state_out.velocity[node] = wp.vec3d(v)
            state_out.director[node] = wp.vec3d(scratch.director[node])
            state_out.twist[node] = wp.float64(scratch.twist[node])
            state_out.tension[node] = wp.float64(scratch.tension[node])
            if rods.free[strand] != 0:
                state_out.spin[node] = wp.float64(scratch.stage_spin[node])
        state_out.root_position[strand] = roots.position[strand]
        state_out.root_rotation[strand] = roots.rotation[strand]

    return SimpleNamespace(
        begin=begin,
        gather=gather,
        linearise=linearise,
        image=image,
        descend=descend,
        advance=advance,
        hold_back=hold_back,
        finish=finish,
        Couplings=Couplings,
        Krylov=Krylov,
    )
