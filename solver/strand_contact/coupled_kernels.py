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
from plait.solver.strand_contact.meeting_kernels import Meetings
from plait.solver.strands.blocks import block_functions
from plait.solver.strands.contact import contact_functions
from plait.solver.strands.elimination import elimination
from plait.solver.strands.kernels import LARGEST_TURN, strand_kernels
from plait.solver.strands.types import coupled_module_name, rod_types


@cache
def coupled_kernels(real: type) -> SimpleNamespace:
    """Kernels `begin`, `gather`, `linearise`, `search`, `answer`, `image`, `descend`, `advance`, `finish`."""
    types = rod_types(real)
    strands_own = strand_kernels(real)
    load, carry, aim, load_guess = strands_own.load, strands_own.carry, strands_own.aim, strands_own.load_guess
    measure_edges, substitute = strands_own.newton.measure_edges, strands_own.newton.substitute
    measure_spin = strands_own.measure_spin
    advance_strand = strands_own.newton.advance
    eliminate = elimination(real, coupled=True)
    release = contact_functions(real).release
    forward = block_functions(real).forward
    vec3, vec4, mat33 = types.vec3, types.vec4, types.mat33
    Rods, RodState, Roots, Method, Scratch = types.Rods, types.RodState, types.Roots, types.Method, types.Scratch
    module = coupled_module_name(real)
    kernel = partial(wp.kernel, module=module, enable_backward=False)
    structure = partial(wp.struct, module=module)

    @structure
    class Krylov:
        """Of a linear solve, entry k of a strand its segment k: (turn, displacement of node k + 1)."""

        direction: wp.array(dtype=vec4)
        own: wp.array(dtype=vec4)  # the direction's image under the strand's own matrix
        image: wp.array(dtype=vec4)  # and under that of all
        step: wp.array(dtype=vec4)

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
        count = rods.first_node[strand + 1] - base
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
        product = wp.float64(0.0)
        free = rods.free[strand]
        left_out[strand] = wp.float64(0.0)
        if definite:
            furthest, turn = substitute(rods, scratch, strand, base, 1)
            left_out[strand] = wp.float64(furthest / rods.segment[strand])
            for k in range(1 - free, count - 1):
                r = scratch.right[base + k]
                z = scratch.solution[base + k]
                krylov.direction[base + k] = z
                krylov.own[base + k] = r
                krylov.step[base + k] = vec4()
                product += wp.float64(wp.dot(r, z))
        else:
            for k in range(1 - free, count - 1):
                scratch.right[base + k] = vec4()
                krylov.direction[base + k] = vec4()
                krylov.own[base + k] = vec4()
                krylov.step[base + k] = vec4()
        product_out[item] = product

    @wp.func(module=module)
    def displacement(direction: wp.array(dtype=vec4), edge: int, place: wp.float64):
        """Of a point of an edge, whose nodes are the ends of segments edge - 1 and edge."""
        d = direction[edge - 1]
        e = direction[edge]
        u = wp.float64(1.0) - place
        return u * wp.vec3d(vec3(d[1], d[2], d[3])) + place * wp.vec3d(vec3(e[1], e[2], e[3]))

    @kernel
    def answer(first: int, acting: wp.array(dtype=wp.int32), meetings: Meetings, krylov: Krylov):
        """What the edges of a pair that acts do to each other along the direction."""
        pair = acting[first + wp.tid()]
        edges = meetings.edges[pair]
        place = meetings.place[pair]
        block = meetings.block[pair]
        meetings.answer[pair] = block * displacement(krylov.direction, edges[1], place[1])
        meetings.answer_back[pair] = block * displacement(krylov.direction, edges[0], place[0])

    @kernel
    def image(
        first: int,
        strands: wp.array(dtype=wp.int32),
        rods: Rods,
        acting_first: wp.array(dtype=wp.int32),
        acting: wp.array(dtype=wp.int32),
        meetings: Meetings,
        krylov: Krylov,
        product_out: wp.array(dtype=wp.float64),
    ):
        """The direction's image under the matrix of all strands, and their product, one entry an item."""
        item = first + wp.tid()
        strand = strands[item]
        base = rods.first_node[strand]
        product = wp.float64(0.0)
        pull = wp.vec3d()  # on the node at which the edge begins
        for edge in range(base + 1, rods.first_node[strand + 1]):
            pull_next = wp.vec3d()
            for at in range(acting_first[edge], acting_first[edge + 1]):
                pair = acting[at] / 2
                side = acting[at] % 2
                w = meetings.place[pair][side]
                answer = wp.where(side == 0, meetings.answer[pair], meetings.answer_back[pair])
                pull += (wp.float64(1.0) - w) * answer
                pull_next += w * answer
            if edge > base + 1 - rods.free[strand]:
                slot = edge - 1
                image = krylov.own[slot] - vec4(real(0.0), real(pull[0]), real(pull[1]), real(pull[2]))
                krylov.image[slot] = image
                product += wp.float64(wp.dot(krylov.direction[slot], image))
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
        """Steps along the direction; what is left, r, and M^-1 r; their product, one entry an item."""
        item = first + wp.tid()
        strand = strands[item]
        base = rods.first_node[strand]
        count = rods.first_node[strand + 1] - base
        a = real(alpha[0])
        free = rods.free[strand]
        y1 = vec4()
        y2 = vec4()
        for k in range(1 - free, count - 1):
            slot = base + k
            krylov.step[slot] = krylov.step[slot] + a * krylov.direction[slot]
            r = scratch.right[slot] - a * krylov.image[slot]
            scratch.right[slot] = r
            known = vec4()
            if k >= 2 - free:
                known = scratch.lower1[slot] * y1
            if k >= 3 - free:
                known += scratch.lower2[slot] * vec3(y2[1], y2[2], y2[3])
            y = forward(scratch.factor[slot], r - known)
            scratch.solution[slot] = y
            y2 = y1
            y1 = y
        substitute(rods, scratch, strand, base, 1)
        product = wp.float64(0.0)
        for k in range(1 - free, count - 1):
            product += wp.float64(wp.dot(scratch.right[base + k], scratch.solution[base + k]))
        product_out[item] = product

    @kernel
    def search(
        first: int,
        strands: wp.array(dtype=wp.int32),
        beta: wp.array(dtype=wp.float64),
        rods: Rods,
        scratch: Scratch,
        krylov: Krylov,
    ):
        """The next direction."""
        strand = strands[first + wp.tid()]
        base = rods.first_node[strand]
        b = real(beta[0])
        for slot in range(base + 1 - rods.free[strand], rods.first_node[strand + 1] - 1):
            krylov.direction[slot] = scratch.solution[slot] + b * krylov.direction[slot]
            krylov.own[slot] = scratch.right[slot] + b * krylov.own[slot]

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
        position_out: wp.array(dtype=wp.vec3d),
        furthest_out: wp.array(dtype=wp.float64),
        stray_out: wp.array(dtype=wp.float64),
    ):
        """Takes the step, or `relaxation` of it, or so much that no edge turns too far at once.

        furthest_out: (strand_count,) longest displacement asked for, over the strand's segments.
        stray_out: (strand_count,) [m] the furthest that a node now is from `expected`, for which pairs were found.
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
            position_out[node] = x
            stray = wp.max(stray, wp.length(x - expected[node]))
        stray_out[strand] = stray
        furthest_out[strand] = wp.float64(wp.sqrt(furthest) / rods.segment[strand])

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
        answer=answer,
        image=image,
        descend=descend,
        search=search,
        advance=advance,
        hold_back=hold_back,
        finish=finish,
        Krylov=Krylov,
    )
