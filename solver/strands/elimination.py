"""One Newton iteration of a strand: assembly, factorisation and solve in two passes over its segments.

Unknowns of segment k (edge k, 1 <= k <= node_count - 2): the turn of its director and the displacement of its end
node k + 1. Root and ghost nodes and the first director are prescribed. Node k + 1 sees edges k - 1 to k + 2, so
the matrix is block pentadiagonal; it is assembled a block row at a time, factored at once and never stored.

A free strand's root moves too, as the end of a segment 0 whose edge, the ghost's, only goes along: the joint at
its root has no stiffness. Nothing holds such a strand against turning about itself where it is straight, so that
the edges' own moments of inertia, which are left out otherwise, are what keeps the matrix definite: the limit of a
strand free at both ends, whose end carries no twisting moment.
"""

from functools import cache

import warp as wp

from plait.solver.contact.planes import ContactPlanes
from plait.solver.strands.blocks import block_functions
from plait.solver.strands.contact import contact_functions
from plait.solver.strands.energy import joint_functions
from plait.solver.strands.stretch import stretch_functions
from plait.solver.strands.substitution import substitution
from plait.solver.strands.types import coupled_module_name, rod_types


@cache
def elimination(real: type, coupled: bool = False) -> wp.Function:
    """Device function `eliminate` for `real`; coupled: with what strands that meet add to each other's matrix.

    Two functions in modules of their own, so that strands that meet nothing are computed as if there were none.
    """
    types = rod_types(real)
    joints = joint_functions(real)
    blocks = block_functions(real)
    contact = contact_functions(real)
    vec3, vec4, mat33 = types.vec3, types.vec4, types.mat33
    mat43, mat44 = types.mat43, types.mat44
    module = coupled_module_name(real) if coupled else types.module
    Rods, Scratch = types.Rods, types.Scratch
    Joint, joint = joints.Joint, joints.joint
    push, contact_stiffness = contact.push, contact.contact_stiffness
    tension = stretch_functions(real).tension
    turned = joints.turned
    factorise, divide, divide_end = blocks.factorise, blocks.divide, blocks.divide_end
    subtract_square, subtract_square_end = blocks.subtract_square, blocks.subtract_square_end
    subtract_product, forward = blocks.subtract_product, blocks.forward
    again = substitution(real)
    invert, divide_unit, divide_unit_end = again.invert, again.divide_unit, again.divide_unit_end

    @wp.func(module=module)
    def eliminate(
        rods: Rods,
        scratch: Scratch,
        planes: ContactPlanes,
        constrained: bool,
        origin: wp.vec3d,
        ahead: wp.float64,
        strand: int,
        base: int,
        stride: int,
        inertia: real,
        beta: real,
    ):
        """Assembles and factors the strand's matrix, with the right-hand side taken along, or kept if coupled.

        constrained: whether `planes` hold, where they are with the part `ahead` of the substep still to come;
        origin: where positions in `scratch` are zero [m], world.
        inertia: [1/s2] times mass is the inertial stiffness.  beta: see `joint`.
        Returns whether every pivot was positive; the factor and the half-solved step are in `scratch`, if coupled
        the right-hand side and the factor as `substitution.py` has it.
        """
        first = rods.first_node[strand]
        count = rods.first_node[strand + 1] - first
        ea = rods.stretch[strand]
        ea_beyond = rods.stretch_beyond[strand]
        free = rods.free[strand]
        zero = real(0.0)
        one = real(1.0)
        identity = wp.identity(n=3, dtype=real)
        stiffness_of_contact = contact_stiffness(rods, strand, inertia)

        inverse = scratch.inverse_length[base]
        t = scratch.tangent[base]
        m = scratch.director[base]
        # What concerns one edge alone: (e e), (e turn), (turn turn) blocks and gradients. First of edge k, then of
        # the edge whose second joint is yet to come. And what couples the edges of joints k and k + 1.
        block = mat33()
        block_turn = vec3()
        turn_block = zero
        gradient = vec3()
        turn_gradient = zero
        half_block = mat33()
        half_block_turn = vec3()
        half_turn_block = zero
        half_gradient = vec3()
        half_turn_gradient = zero
        eb_ea0 = mat33()
        eb_ta0 = vec3()
        ea_tb0 = vec3()
        tb_ta0 = zero
        eb_ea1 = mat33()
        eb_ta1 = vec3()
        ea_tb1 = vec3()
        tb_ta1 = zero
        factor2 = wp.identity(n=4, dtype=real)
        factor1 = wp.identity(n=4, dtype=real)
        undivided1_before = mat44()
        y2 = vec4()
        y1 = vec4()
        definite = wp.bool(True)
        for vertex in range(1, count + 1):
            here = Joint()
            next_force = vec3()
            next_block = mat33()
            if vertex < count - 1:
                length = scratch.length[base + vertex * stride]
                inverse_next = scratch.inverse_length[base + vertex * stride]
                t_next = scratch.tangent[base + vertex * stride]
                m_next = scratch.director[base + vertex * stride]
                bend = rods.bend[first + vertex]
                twist = rods.twist[first + vertex]
                if vertex <= free:
                    bend = zero
                    twist = zero
                here = joint(
                    t, inverse, t_next, inverse_next, m, m_next, scratch.twist[base + vertex * stride],
                    bend, twist, rods.rest_curvature[first + vertex], rods.rest_twist[first + vertex], beta,
                )  # fmt: skip
                # Primal-dual stretch: the geometric part follows the dual tension, the force the true strain.
                inverse_rest = rods.inverse_rest_length[first + vertex]
                pull, slope = tension(length * inverse_rest - one, ea, ea_beyond)
                stiffness = slope * inverse_rest
                dual = scratch.tension[base + vertex * stride]
                across = (wp.max(dual, zero) + beta * wp.min(dual, zero)) * inverse_next
                next_force = pull * t_next
                next_block = across * identity + (stiffness - across) * wp.outer(t_next, t_next)
                inverse = inverse_next
                t = t_next
                m = m_next
            # Edge vertex - 1 is complete now, and with it the row of segment k = vertex - 2.
            block_after = half_block + here.ea_ea
            gradient_after = half_gradient + here.gradient_ea
            k = vertex - 2
            if k >= 1 - free:
                node = first + k + 1
                if free != 0:
                    turn_inertia = rods.turn_inertia[first + k] * inertia
                    turn_block += turn_inertia
                    if k > 0:
                        gone = turned(scratch, base + k * stride, stride)
                        turn_gradient += turn_inertia * (gone - scratch.turn_target[base + k * stride])
                mass = rods.mass[node] * inertia
                x_end = scratch.position[base + (k + 1) * stride]
                offset = x_end - scratch.target[base + (k + 1) * stride]
                g = mass * offset - rods.force[node] + gradient - gradient_after
                tx = block_turn - eb_ta1
                d = mass * identity + block + block_after - eb_ea1 - wp.transpose(eb_ea1)
                if constrained:
                    slot_end = base + (k + 1) * stride
                    contact_block, pushed = push(
                        planes,
                        scratch,
                        node,
                        slot_end,
                        x_end,
                        origin,
                        ahead,
                        stiffness_of_contact,
                        rods.slip[strand],
                    )
                    d += contact_block
                    g += pushed
                b = eb_ea0 + eb_ea1 - block
                if wp.static(coupled):
                    d += scratch.meeting_block[base + (k + 1) * stride]
                    b += scratch.meeting_lower[base + (k + 1) * stride]
                    g += scratch.meeting_gradient[base + (k + 1) * stride]
                ty = ea_tb0 - block_turn
                diagonal = mat44(
                    turn_block, tx[0], tx[1], tx[2],
                    tx[0], d[0, 0], d[0, 1], d[0, 2],
                    tx[1], d[1, 0], d[1, 1], d[1, 2],
                    tx[2], d[2, 0], d[2, 1], d[2, 2],
                )  # fmt: skip
                lower1 = mat44()
                lower2 = mat43()
                if k >= 2 - free:
                    lower1 = mat44(
                        tb_ta0, ty[0], ty[1], ty[2],
                        eb_ta0[0], b[0, 0], b[0, 1], b[0, 2],
                        eb_ta0[1], b[1, 0], b[1, 1], b[1, 2],
                        eb_ta0[2], b[2, 0], b[2, 1], b[2, 2],
                    )  # fmt: skip
                if k >= 3 - free:
                    lower2 = mat43(
                        -ea_tb0[0], -ea_tb0[1], -ea_tb0[2],
                        -eb_ea0[0, 0], -eb_ea0[0, 1], -eb_ea0[0, 2],
                        -eb_ea0[1, 0], -eb_ea0[1, 1], -eb_ea0[1, 2],
                        -eb_ea0[2, 0], -eb_ea0[2, 1], -eb_ea0[2, 2],
                    )  # fmt: skip
                    undivided2, lower2 = divide_end(lower2, factor2)
                    lower1 = subtract_product(lower1, lower2, undivided1_before)
                    diagonal = subtract_square_end(diagonal, lower2, undivided2)
                if k >= 2 - free:
                    undivided1, lower1 = divide(lower1, factor1)
                    diagonal = subtract_square(diagonal, lower1, undivided1)
                    undivided1_before = undivided1
                factor, positive = factorise(diagonal)
                if not positive:
                    definite = wp.bool(False)
                    break
                right = vec4(-turn_gradient, -g[0], -g[1], -g[2])
                slot = base + k * stride
                if wp.static(coupled):
                    scratch.right[slot] = right
                    scratch.inverse[slot] = invert(factor)
                    scratch.left1[slot] = divide_unit(lower1, factor1)
                    scratch.left2[slot] = divide_unit_end(lower2, factor2)
                else:
                    y = forward(factor, right - lower1 * y1 - lower2 * vec3(y2[1], y2[2], y2[3]))
                    scratch.factor[slot] = factor
                    scratch.lower1[slot] = lower1
                    scratch.lower2[slot] = lower2
                    scratch.solution[slot] = y
                    y2 = y1
                    y1 = y
                factor2 = factor1
                factor1 = factor
            block = block_after
            block_turn = half_block_turn + here.ea_ta
            turn_block = half_turn_block + here.ta_ta
            gradient = gradient_after
            turn_gradient = half_turn_gradient + here.gradient_ta
            half_block = next_block + here.eb_eb
            half_block_turn = here.eb_tb
            half_turn_block = here.tb_tb
            half_gradient = next_force + here.gradient_eb
            half_turn_gradient = here.gradient_tb
            eb_ea0 = eb_ea1
            eb_ta0 = eb_ta1
            ea_tb0 = ea_tb1
            tb_ta0 = tb_ta1
            eb_ea1 = here.eb_ea
            eb_ta1 = here.eb_ta
            ea_tb1 = here.ea_tb
            tb_ta1 = here.tb_ta
        return definite

    return eliminate
