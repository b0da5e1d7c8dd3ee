"""Han 2019 §6 on the grid: what bodies weigh at nodes, the potential's forces there, impulses, directors.

Each body's velocity is known anywhere, v_b(x) = v_b + w_b x (x - c_b), so no velocity is filtered: a node that
body b's particles give the mass m_ib moves with sum_b m_ib v_b(x_i) / m_i. What a particle of body b sees of that
is the difference from its own body, nothing where the node is its body's alone.
"""

from __future__ import annotations

import warp as wp

from plait.solver.grid.transfer_kernels import (
    BLOCK_NODES,
    STENCIL,
    arm_of,
    gradient_of,
    node_after,
    node_before,
    weight_of,
)
from plait.solver.rigid.motion_kernels import HALF, ONE, ZERO
from plait.solver.rigid.paper_law import returned, traction_of
from plait.solver.rigid.paper_types import Field, View
from plait.solver.rigid.put_kernels import mean_friction

# Unrolled, the loops over nodes would be most of the code, and no faster.
wp.set_module_options({"enable_backward": False, "max_unroll": 1})

# Of two bodies each says one half of the impulse between them.
SAYS = HALF


@wp.kernel
def place_directors(first: int, field: Field):
    """Normals and directors in world; one particle of a body an item."""
    at = first + wp.tid()
    q = field.placed.particle[at]
    orientation = field.motion.orientation[field.skin.body[q]]
    field.placed.normal[at] = wp.quat_rotate(orientation, field.skin.normal[q])
    field.placed.director[at] = wp.quat_rotate(orientation, field.skin.director[q])


@wp.kernel
def gather_layers(first: int, field: Field):
    """m_ib = sum_q w_iq m_q (17), and normals, frictions and velocities likewise; a body at a node an item."""
    entry = first + wp.tid()
    layer = entry / BLOCK_NODES
    placed = field.placed
    grid = field.grid
    body = field.layers.body[layer]
    node = field.layers.block[layer] * BLOCK_NODES + entry % BLOCK_NODES
    mass = ZERO
    momentum = wp.vec3d()
    normal = wp.vec3d()
    friction = ZERO
    telling = ZERO
    for i in range(STENCIL):
        for j in range(STENCIL):
            for k in range(STENCIL):
                base = node_before(grid, node, i, j, k)
                if base >= 0:
                    for n in range(grid.cell_first[base], grid.cell_first[base + 1]):
                        at = grid.particles[n]
                        if placed.body[at] == body:
                            m = weight_of(grid.offset[at], i, j, k) * placed.mass[at]
                            mass += m
                            normal += m * placed.normal[at]
                            if placed.friction[at] >= ZERO:
                                friction += m * placed.friction[at]
                                telling += m
                            if body < 0:
                                momentum += m * placed.velocity[at]
    field.layers.mass[entry] = mass
    field.layers.normal[entry] = normal
    field.layers.friction[entry] = wp.where(telling > ZERO, friction / telling, -ONE)
    field.layers.velocity[entry] = wp.where(mass > ZERO, momentum / mass, wp.vec3d())


@wp.kernel
def gather_forces(first: int, field: Field):
    """f_i = -sum_q V_q dpsi/dd (grad w_iq . d) of one body at one node an item.

    A node's displacement u_i changes a director by u_i (grad w_iq . d), hence the force.
    """
    entry = first + wp.tid()
    layer = entry / BLOCK_NODES
    placed = field.placed
    grid = field.grid
    body = field.layers.body[layer]
    node = field.layers.block[layer] * BLOCK_NODES + entry % BLOCK_NODES
    force = wp.vec3d()
    if body >= 0 and field.layers.mass[entry] > ZERO:
        for i in range(STENCIL):
            for j in range(STENCIL):
                for k in range(STENCIL):
                    base = node_before(grid, node, i, j, k)
                    if base >= 0:
                        for n in range(grid.cell_first[base], grid.cell_first[base + 1]):
                            at = grid.particles[n]
                            if placed.body[at] == body and placed.seen[at] > ZERO:
                                slope = wp.dot(gradient_of(grid.offset[at], i, j, k), placed.director[at])
                                force -= slope / field.cell_size * placed.pull[at]
    field.layers.force[entry] = force


@wp.func
def spin_of(field: Field, body: int) -> wp.vec3d:
    return field.start.inertia_inverse[body] * field.motion.angular_momentum[body]


@wp.func
def view_of(field: Field, at: int, node: int, arm: wp.vec3d) -> View:
    """A node that lies at `arm` [m] from a particle, as its body sees it.

    What is animated weighs as much for its area as the body that looks: held, it does not change its velocity.
    """
    layers = field.layers
    body = field.placed.body[at]
    place = field.motion.position[body] + field.placed.lever[at] + arm
    own = field.motion.velocity[body] + wp.cross(spin_of(field, body), place - field.motion.position[body])
    view = View()
    total = ZERO
    force = wp.vec3d()
    block = node / BLOCK_NODES
    for layer in range(layers.first[block], layers.first[block + 1]):
        entry = layer * BLOCK_NODES + node % BLOCK_NODES
        mass = layers.mass[entry]
        if mass > ZERO:
            other = layers.body[layer]
            force += layers.force[entry]
            velocity = layers.velocity[entry]
            if other < 0:
                mass *= field.skin.density[body]
                view.animated += mass
            elif other != body:
                lever = place - field.motion.position[other]
                velocity = field.motion.velocity[other] + wp.cross(spin_of(field, other), lever)
            if other != body:
                view.part += mass
                view.velocity += mass * (velocity - own)
                weight = wp.where(other < 0, field.skin.density[body], ONE)
                view.normal += weight * layers.normal[entry]
                view.friction += mass * mean_friction(
                    field.placed.friction[at], layers.friction[entry], field.step[0].friction
                )
            total += mass
    # At the very rim of a stencil a particle's weight is 0, and there may be nothing else.
    if total > ZERO:
        view.part /= total
        view.animated /= total
        view.velocity /= total
        view.friction /= total
        view.normal /= total
        view.acceleration = force / total
    return view


@wp.func
def leant(x: wp.vec3d, normal: wp.vec3d, facing: wp.vec3d) -> wp.vec3d:
    """x turned by the least turn that takes `normal` to `facing`, less than a right angle away."""
    axis = wp.cross(normal, facing)
    across = wp.cross(axis, x)
    return x + across + wp.cross(axis, across) / (ONE + wp.dot(normal, facing))


@wp.kernel
def look(first: int, field: Field):
    """What a particle of a body sees of others, which way, and what it pulls with; one particle an item.

    A body that slides on another leans a little on the layer between. With its own normals, inclined to the way it
    goes, the potential would wear off, and its walls would be stopped by a floor that passes below them. So the
    surface of the others says what is normal, taken from the nodes as in (45), and a particle counts by how much
    it faces that; one that does not face it has no part.
    """
    at = first + wp.tid()
    placed = field.placed
    grid = field.grid
    seen = ZERO
    animated = ZERO
    friction = ZERO
    others = wp.vec3d()
    for i in range(STENCIL):
        for j in range(STENCIL):
            for k in range(STENCIL):
                weight = weight_of(grid.offset[at], i, j, k)
                node = node_after(grid, grid.base[at], i, j, k)
                view = view_of(field, at, node, field.cell_size * arm_of(grid.offset[at], i, j, k))
                seen += weight * view.part
                animated += weight * view.animated
                friction += weight * view.friction
                others += weight * view.normal
    normal = placed.normal[at]
    facing = -wp.normalize(others)
    faces = wp.dot(facing, normal)
    if seen > ZERO and faces > ZERO:
        q = placed.particle[at]
        traction = traction_of(placed.director[at], normal, field.skin.stiffness)
        placed.pull[at] = field.skin.volume[q] * faces * leant(traction, normal, facing)
        placed.animated[at] = animated / seen
        placed.met_friction[at] = friction / seen
        placed.facing[at] = facing
        placed.seen[at] = seen


@wp.kernel
def press(first: int, field: Field):
    """The impulse on a particle's body, (37) to (39), one particle of a body an item.

    v_r is what the grid, moved on by the potential's forces, has at the particle less the particle's own velocity;
    the normal points outward, so that the body is pushed where v_r . n < 0. Friction is bounded by mu |I|. A
    particle that sees no other body has no part in it.
    """
    at = first + wp.tid()
    placed = field.placed
    grid = field.grid
    impulse = wp.vec3d()
    if placed.seen[at] > ZERO:
        relative = wp.vec3d()
        for i in range(STENCIL):
            for j in range(STENCIL):
                for k in range(STENCIL):
                    weight = weight_of(grid.offset[at], i, j, k)
                    node = node_after(grid, grid.base[at], i, j, k)
                    view = view_of(field, at, node, field.cell_size * arm_of(grid.offset[at], i, j, k))
                    relative += weight * (view.velocity + field.step[0].length * view.acceleration)
        normal = placed.facing[at]
        along = wp.dot(relative, normal)
        if along < ZERO:
            change = along * normal
            across = relative - along * normal
            size = wp.length(across)
            if size > ZERO:
                change += wp.min(size, -placed.met_friction[at] * along) / size * across
            impulse = wp.dot(normal, placed.normal[at]) * placed.mass[at] * change
    placed.impulse[at] = impulse


@wp.func
def pushed(field: Field, at: int) -> bool:
    return wp.length_sq(field.placed.impulse[at]) > ZERO


@wp.kernel
def share_out(
    first: int,
    field: Field,
    pair_particle: wp.array(dtype=wp.int32),
    pair_body: wp.array(dtype=wp.int32),
    part_out: wp.array(dtype=wp.float64),
):
    """Of what a particle sees, the part that one other body has; one pair of them an item."""
    pair = first + wp.tid()
    at = pair_particle[pair]
    body = pair_body[pair]
    grid = field.grid
    layers = field.layers
    share = ZERO
    if pushed(field, at):
        own = field.placed.body[at]
        for i in range(STENCIL):
            for j in range(STENCIL):
                for k in range(STENCIL):
                    node = node_after(grid, grid.base[at], i, j, k)
                    block = node / BLOCK_NODES
                    total = ZERO
                    of_body = ZERO
                    for layer in range(layers.first[block], layers.first[block + 1]):
                        mass = layers.mass[layer * BLOCK_NODES + node % BLOCK_NODES]
                        if layers.body[layer] < 0:
                            mass *= field.skin.density[own]
                        if layers.body[layer] == body:
                            of_body = mass
                        total += mass
                    if of_body > ZERO:
                        share += weight_of(grid.offset[at], i, j, k) * of_body / total
        share /= field.placed.seen[at]
    part_out[pair] = share


@wp.kernel
def push_bodies(
    first: int,
    field: Field,
    near_body: wp.array(dtype=wp.int32),
    own_first: wp.array(dtype=wp.int32),
    pair_first: wp.array(dtype=wp.int32),
    pair_particle: wp.array(dtype=wp.int32),
    share: wp.array(dtype=wp.float64),
):
    """The sum of impulses on a body over its mass, and of their moments (40), (41); one body an item.

    What two bodies do to each other is said by the particles of both, each for its own skin, and the two would not
    agree: so each says half of it, and the other body gets the opposite at the same place. Both momenta stay. What
    is animated does not give way, and the body's particles say all of it.
    """
    item = first + wp.tid()
    body = near_body[item]
    center = field.motion.position[body]
    placed = field.placed
    impulse = wp.vec3d()
    moment = wp.vec3d()
    for at in range(own_first[item], own_first[item + 1]):
        if pushed(field, at):
            by_animated = placed.animated[at]
            given = (by_animated + SAYS * (ONE - by_animated)) * placed.impulse[at]
            impulse += given
            moment += wp.cross(placed.lever[at], given)
    for pair in range(pair_first[item], pair_first[item + 1]):
        at = pair_particle[pair]
        if share[pair] > ZERO:
            given = -SAYS * share[pair] * placed.impulse[at]
            impulse += given
            moment += wp.cross(field.motion.position[placed.body[at]] + placed.lever[at] - center, given)
    field.motion.velocity[body] = field.motion.velocity[body] + impulse / field.masses.mass[body]
    field.motion.angular_momentum[body] = field.motion.angular_momentum[body] + moment


@wp.kernel
def carry_directors(first: int, field: Field):
    """d <- (1 + dt sum_i v_i grad w_iq) d, and what of it is elastic (35), (36); one particle of a body an item.

    The nodes go as the bodies now do: of the velocities that the forces gave them, bodies take over as little as
    their skins weigh beside them, and directors that follow those would let go of any load.
    The own body's motion turns the director with it.
    """
    at = first + wp.tid()
    placed = field.placed
    if placed.seen[at] > ZERO:
        grid = field.grid
        rate = wp.vec3d()
        for i in range(STENCIL):
            for j in range(STENCIL):
                for k in range(STENCIL):
                    node = node_after(grid, grid.base[at], i, j, k)
                    view = view_of(field, at, node, field.cell_size * arm_of(grid.offset[at], i, j, k))
                    slope = wp.dot(gradient_of(grid.offset[at], i, j, k), placed.director[at])
                    rate += slope / field.cell_size * view.velocity
        rate = leant(rate, placed.facing[at], placed.normal[at])
        director = placed.director[at] + field.step[0].length * rate
        q = placed.particle[at]
        orientation = field.motion.orientation[placed.body[at]]
        field.skin.director[q] = returned(
            wp.quat_rotate_inv(orientation, director), field.skin.normal[q], placed.met_friction[at]
        )
