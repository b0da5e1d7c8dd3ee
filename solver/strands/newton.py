"""One Newton iteration of a strand, but for its matrix (`elimination.py`): edges, back substitution, the step."""

from functools import cache
from types import SimpleNamespace

import warp as wp

from plait.solver.contact.planes import ContactPlanes
from plait.solver.strands.blocks import block_functions
from plait.solver.strands.contact import contact_functions
from plait.solver.strands.elimination import elimination
from plait.solver.strands.energy import joint_functions
from plait.solver.strands.stretch import stretch_functions
from plait.solver.strands.types import rod_types


@cache
def newton_functions(real: type) -> SimpleNamespace:
    """Device functions `measure_edges`, `eliminate`, `substitute`, `advance` for `real`."""
    types = rod_types(real)
    joints = joint_functions(real)
    contact = contact_functions(real)
    vec3, vec4 = types.vec3, types.vec4
    mat43, mat44, module = types.mat43, types.mat44, types.module
    Rods, Scratch = types.Rods, types.Scratch
    transport, signed_twist = joints.transport, joints.signed_twist
    judge, contact_stiffness = contact.judge, contact.contact_stiffness
    tension = stretch_functions(real).tension
    backward = block_functions(real).backward
    eliminate = elimination(real)

    @wp.func(module=module)
    def measure_edges(scratch: Scratch, count: int, base: int, stride: int):
        """Tangents and lengths of the present shape; `advance` keeps them."""
        x = scratch.position[base]
        for k in range(count - 1):
            slot = base + k * stride
            x_next = scratch.position[slot + stride]
            e = x_next - x
            length = wp.length(e)
            inverse = real(1.0) / length
            scratch.tangent[slot] = inverse * e
            scratch.length[slot] = length
            scratch.inverse_length[slot] = inverse
            x = x_next

    @wp.func(module=module)
    def substitute(rods: Rods, scratch: Scratch, strand: int, base: int, stride: int):
        """Back substitution. Returns the largest displacement [m] and the largest turn of an edge [rad]."""
        count = rods.first_node[strand + 1] - rods.first_node[strand]
        free = rods.free[strand]
        furthest = real(0.0)
        turn = real(0.0)
        z1 = vec4()  # of segment k + 1
        l1 = mat44()
        l2 = mat43()
        l2_after = mat43()
        z2 = vec4()
        for i in range(count - 2 + free):
            k = count - 2 - i
            slot = base + k * stride
            end = wp.transpose(l2_after) * z2
            known = wp.transpose(l1) * z1 + vec4(real(0.0), end[0], end[1], end[2])
            z = backward(scratch.factor[slot], scratch.solution[slot], known)
            scratch.solution[slot] = z
            furthest = wp.max(furthest, z[1] * z[1] + z[2] * z[2] + z[3] * z[3])
            if k > 0:
                turn = wp.max(turn, z[0] * z[0])
            # Edge k + 1 turns by the part of its end nodes' difference that is across it.
            if i > 0:
                d = vec3(z1[1] - z[1], z1[2] - z[2], z1[3] - z[3])
                across = scratch.inverse_length[slot + stride] * wp.cross(scratch.tangent[slot + stride], d)
                turn = wp.max(turn, wp.dot(across, across))
            l2_after = l2
            l1 = scratch.lower1[slot]
            l2 = scratch.lower2[slot]
            z2 = z1
            z1 = z
        if free == 0:
            d = vec3(z1[1], z1[2], z1[3])
            across = scratch.inverse_length[base + stride] * wp.cross(scratch.tangent[base + stride], d)
            turn = wp.max(turn, wp.dot(across, across))
        return wp.sqrt(furthest), wp.sqrt(turn)

    @wp.func(module=module)
    def advance(
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
        fraction: real,
    ):
        """Takes `fraction` of the step: nodes, directors by parallel transport and turn, twist, forces.

        Returns whether nodes have just gone under a plane, so that another step is needed.
        """
        first = rods.first_node[strand]
        count = rods.first_node[strand + 1] - first
        ea = rods.stretch[strand]
        ea_beyond = rods.stretch_beyond[strand]
        half = real(0.5)
        one = real(1.0)
        x_new = scratch.position[base + stride]
        t_before = scratch.tangent[base]
        m_before = scratch.director[base]
        moved = vec3()
        under = wp.bool(False)
        if rods.free[strand] != 0:
            # The ghost goes along with the root, and its edge does not turn.
            z = scratch.solution[base]
            moved = vec3(z[1], z[2], z[3])
            x_old = x_new
            x_new = x_old + fraction * moved
            scratch.position[base] = scratch.position[base] + fraction * moved
            scratch.position[base + stride] = x_new
            if constrained:
                under = judge(
                    planes, scratch, first + 1, base + stride, x_old, x_new, origin, ahead,
                    contact_stiffness(rods, strand, inertia), rods.slip[strand],
                )  # fmt: skip
        for k in range(1, count - 1):
            slot = base + k * stride
            z = scratch.solution[slot]
            step = vec3(z[1], z[2], z[3])
            x_next_old = scratch.position[slot + stride]
            x_next_new = x_next_old + fraction * step
            t = scratch.tangent[slot]
            inverse_rest = rods.inverse_rest_length[first + k]
            pull, slope = tension(scratch.length[slot] * inverse_rest - one, ea, ea_beyond)
            linear = pull + slope * inverse_rest * wp.dot(t, step - moved)
            dual = scratch.tension[slot]
            scratch.tension[slot] = dual + fraction * (linear - dual)
            e = x_next_new - x_new
            length = wp.length(e)
            inverse = one / length
            t_new = inverse * e
            scratch.tangent[slot] = t_new
            scratch.length[slot] = length
            scratch.inverse_length[slot] = inverse
            m = transport(t, t_new, scratch.director[slot])
            # A turn by 2 atan(angle / 2): the angle itself up to third order, and no trigonometry.
            q = half * fraction * z[0]
            n = wp.cross(t_new, m)
            m = (one / (one + q * q)) * ((one - q * q) * m + (real(2.0) * q) * n)
            # Rounding alone takes it from unit length and from the plane across; one Newton step puts it back.
            m = m - wp.dot(m, t_new) * t_new
            m = (real(1.5) - half * wp.dot(m, m)) * m
            scratch.director[slot] = m
            scratch.position[slot + stride] = x_next_new
            scratch.twist[slot] = signed_twist(t_before, t_new, m_before, m, scratch.twist[slot])
            if constrained:
                node = first + k + 1
                sank = judge(
                    planes, scratch, node, slot + stride, x_next_old, x_next_new, origin, ahead,
                    contact_stiffness(rods, strand, inertia), rods.slip[strand],
                )  # fmt: skip
                under = under or sank
            t_before = t_new
            m_before = m
            x_new = x_next_new
            moved = step
        return under

    return SimpleNamespace(
        measure_edges=measure_edges, eliminate=eliminate, substitute=substitute, advance=advance
    )
