"""Kernels of `explicit.py`."""

from functools import cache, partial
from types import SimpleNamespace

import warp as wp

from plait.solver.linear.block_kernels import block_kernels
from plait.solver.tets.body_kernels import body_kernels
from plait.solver.tets.elements import element_types


@cache
def explicit_kernels(real: type) -> SimpleNamespace:
    """Kernels over the nodes of a body, with forces in `real` (wp.float32 or wp.float64)."""
    kernel = partial(wp.kernel, module=f"plait_tets_explicit_{real.__name__}", enable_backward=False)
    Step, Motion = body_kernels(real).types.Step, body_kernels(real).types.Motion
    Incidence, vec3 = block_kernels(real).types.Incidence, element_types(real).vec3

    @kernel
    def begin(first: int, step: Step, motion_out: Motion):
        """Back to the step's start, with the velocity that contact has given so far."""
        i = step.first_node + first + wp.tid()
        motion_out.position[i] = motion_out.position_before[i]
        velocity = motion_out.velocity_before[i]
        if motion_out.pinned[i] != 0:
            velocity = (motion_out.goal[i] - motion_out.position_before[i]) / step.length
        else:
            velocity += motion_out.contact_impulse[i] / motion_out.mass[i]
        motion_out.velocity[i] = velocity

    @kernel
    def retrace(first: int, step: Step, count: int, motion: Motion, previous_out: wp.array(dtype=wp.vec3d)):
        """Where the nodes' velocities say they were one part of the step ago."""
        i = step.first_node + first + wp.tid()
        previous_out[i] = motion.position[i] - (step.length / wp.float64(count)) * motion.velocity[i]

    @kernel
    def kick(first: int, step: Step, count: int, k: int, incidence: Incidence,
                unknown: wp.array(dtype=wp.int32), force: wp.array(dtype=vec3), motion_out: Motion):  # fmt: skip
        """Part k of `count` of the step: the free nodes' velocities, and where pinned nodes go."""
        node = first + wp.tid()
        i = step.first_node + node
        u = unknown[node]
        dt = step.length / wp.float64(count)
        if u < 0:
            share = wp.float64(k + 1) / wp.float64(count)
            start = motion_out.position_before[i]
            motion_out.position[i] = start + share * (motion_out.goal[i] - start)
        else:
            f = wp.vec3d()
            for e in range(incidence.first[u], incidence.first[u + 1]):
                f += wp.vec3d(force[incidence.corner[e]])
            x = motion_out.position[i]
            spring = motion_out.attachment[i]
            if spring > wp.float64(0.0):
                f += spring * (motion_out.goal[i] - x)
            v = motion_out.velocity[i] + dt * (f / motion_out.mass[i] + step.gravity)
            motion_out.velocity[i] = v / (wp.float64(1.0) + step.mass_damping * dt)

    @kernel
    def drift(first: int, step: Step, count: int, motion_out: Motion):
        i = step.first_node + first + wp.tid()
        if motion_out.pinned[i] == 0:
            way = (step.length / wp.float64(count)) * motion_out.velocity[i]
            motion_out.position[i] = motion_out.position[i] + way

    return SimpleNamespace(begin=begin, retrace=retrace, kick=kick, drift=drift)
