"""Contacts as sparse rows over nodes, solved by impulses: projected Jacobi sweeps that conserve momentum.

Row c stands for two points that may touch: u_c = sum_k w_ck v_k is how fast they part, x_c = sum_k w_ck x_k where
one lies from the other. Weights of the one sum to 1, of the other to -1, so an impulse J_c on the first and -J_c
on the second never changes the linear momentum of the whole. Both act in the second point, where the first body's
tet, extended, has a place too (weights W_ck; sum_c W_ck J_c on node k): so neither do they change the angular one.
Velocities are taken where impulses act, U_c = sum_k W_ck v_k: what impulses do then is their product with the
velocities they see, and stopping those takes energy away. Seen by w_ck instead, in a flat tet, it could add any.
"""

from __future__ import annotations

import warp as wp

from plait.solver.contact.geometry_kernels import ZERO

wp.set_module_options({"enable_backward": False})


@wp.struct
class Rows:
    """One row a contact, and the same by nodes; node n of the list is nodes[n] of all."""

    offsets: wp.array(dtype=wp.int32)  # (row_count + 1,) into node, weight
    node: wp.array(dtype=wp.int32)
    weight: wp.array(dtype=wp.float64)
    common_weight: wp.array(dtype=wp.float64)  # with the first point moved to where the second lies
    normal: wp.array(dtype=wp.vec3d)  # the direction in which the points part
    target: wp.array(dtype=wp.float64)  # [m] gap to keep
    friction: wp.array(dtype=wp.float64)  # Coulomb coefficient
    restitution: wp.array(dtype=wp.float64)
    share: wp.array(dtype=wp.float64)  # [kg] what each row claims of its nodes' masses, in proportion
    nodes: wp.array(dtype=wp.int32)  # (touched_count,) the nodes that some row acts on
    node_offsets: wp.array(dtype=wp.int32)  # (touched_count + 1,) into node_row, node_weight
    node_row: wp.array(dtype=wp.int32)
    node_weight: wp.array(dtype=wp.float64)  # as common_weight
    inverse_mass: wp.array(dtype=wp.float64)  # (node_count,) [1/kg], how nodes answer to impulses; zero if held


@wp.struct
class RowState:
    """What sweeps change; one entry a row."""

    compliance: wp.array(dtype=wp.float64)  # [1/kg] velocity that a unit impulse gives, with all rows at once
    gap: wp.array(dtype=wp.float64)  # [m] where the pass began
    velocity: wp.array(dtype=wp.float64)  # [m/s] along the normal, where the pass began
    approach: wp.array(dtype=wp.float64)  # [m/s] along the normal, where the first pass began
    impulse: wp.array(dtype=wp.vec3d)  # [kg m/s] in this substep so far
    change: wp.array(dtype=wp.vec3d)  # [kg m/s] of the last sweep


@wp.func
def between(
    rows: Rows, weight: wp.array(dtype=wp.float64), c: int, of_nodes: wp.array(dtype=wp.vec3d)
) -> wp.vec3d:
    """sum_k w_ck y_k, by one of the weights of the rows."""
    total = wp.vec3d()
    for k in range(rows.offsets[c], rows.offsets[c + 1]):
        total += weight[k] * of_nodes[rows.node[k]]
    return total


@wp.func
def sum_on_node(rows: Rows, n: int, of_rows: wp.array(dtype=wp.vec3d)) -> wp.vec3d:
    """sum_c W_cn y_c of a touched node, its rows in fixed order."""
    total = wp.vec3d()
    for k in range(rows.node_offsets[n], rows.node_offsets[n + 1]):
        total += rows.node_weight[k] * of_rows[rows.node_row[k]]
    return total


@wp.kernel
def claim_nodes(first: int, rows: Rows, claim_out: wp.array(dtype=wp.float64)):
    """[kg] sum_c |W_ck| share_c at each touched node; one an item."""
    n = first + wp.tid()
    total = ZERO
    for k in range(rows.node_offsets[n], rows.node_offsets[n + 1]):
        total += wp.abs(rows.node_weight[k]) * rows.share[rows.node_row[k]]
    claim_out[rows.nodes[n]] = total


@wp.kernel
def weigh_rows(
    first: int,
    rows: Rows,
    claim: wp.array(dtype=wp.float64),
    state: RowState,
):
    """The compliance that makes Jacobi sweeps converge whatever touches whatever; one row an item.

    The matrix A_cd = sum_k W_ck W_dk / m_k has no eigenvalue above one after division by
    sum_d |A_cd| s_d / s_c <= sum_k |W_ck| claim_k / (m_k s_c), for any shares s > 0 (Gershgorin's circles).
    """
    c = first + wp.tid()
    total = ZERO
    for k in range(rows.offsets[c], rows.offsets[c + 1]):
        node = rows.node[k]
        total += wp.abs(rows.common_weight[k]) * claim[node] * rows.inverse_mass[node]
    state.compliance[c] = total / rows.share[c]


@wp.kernel
def begin_rows(
    first: int,
    first_pass: int,
    rows: Rows,
    position: wp.array(dtype=wp.vec3d),
    velocity: wp.array(dtype=wp.vec3d),
    state: RowState,
):
    """Gap and velocity of each row where an elastic solve took it; one row an item."""
    c = first + wp.tid()
    n = rows.normal[c]
    u = wp.dot(n, between(rows, rows.common_weight, c, velocity))
    state.gap[c] = wp.dot(n, between(rows, rows.weight, c, position))
    state.velocity[c] = u
    if first_pass == 1:
        state.approach[c] = u


@wp.kernel
def sweep_rows(
    first: int,
    rows: Rows,
    velocity: wp.array(dtype=wp.vec3d),
    displacement_per_velocity: wp.float64,
    state: RowState,
):
    """The impulse that closes a row's gap to its target and not beyond, with Coulomb friction; one row an item.

    The total since the substep's start never pulls, and its tangential part, one vector that acts on both sides
    with opposite signs, is at most friction times the normal part.
    """
    c = first + wp.tid()
    n = rows.normal[c]
    slip = between(rows, rows.common_weight, c, velocity)
    un = wp.dot(n, slip)
    lack = (rows.target[c] - state.gap[c]) / displacement_per_velocity - (un - state.velocity[c])
    if rows.target[c] > state.gap[c] and rows.restitution[c] > ZERO:
        lack = wp.max(lack, -rows.restitution[c] * state.approach[c] - un)
    before = state.impulse[c]
    normal_before = wp.dot(n, before)
    normal_after = wp.max(normal_before + lack / state.compliance[c], ZERO)
    tangential = before - normal_before * n - (slip - wp.dot(n, slip) * n) / state.compliance[c]
    most = rows.friction[c] * normal_after
    length = wp.length(tangential)
    if length > most:
        tangential = tangential * (most / length)
    after = normal_after * n + tangential
    state.impulse[c] = after
    state.change[c] = after - before


@wp.kernel
def spread_impulses(
    first: int,
    rows: Rows,
    state: RowState,
    velocity: wp.array(dtype=wp.vec3d),
):
    """v_k += sum_c W_ck J_c / m_k; one touched node an item."""
    n = first + wp.tid()
    node = rows.nodes[n]
    velocity[node] = velocity[node] + rows.inverse_mass[node] * sum_on_node(rows, n, state.change)


@wp.kernel
def add_impulses(first: int, rows: Rows, state: RowState, on_nodes: wp.array(dtype=wp.vec3d)):
    """J_k += sum_c W_ck J_c; one touched node an item."""
    n = first + wp.tid()
    node = rows.nodes[n]
    on_nodes[node] = on_nodes[node] + sum_on_node(rows, n, state.impulse)


@wp.kernel
def part_rows(
    first: int,
    rows: Rows,
    wanted: wp.array(dtype=wp.float64),
    factor: wp.float64,
    position: wp.array(dtype=wp.vec3d),
    state: RowState,
):
    """What moves a row towards the gap it wants by `factor` of what it lacks, times mass; one row an item."""
    c = first + wp.tid()
    n = rows.normal[c]
    gap = wp.dot(n, between(rows, rows.weight, c, position))
    state.gap[c] = gap
    state.change[c] = wp.max(wanted[c] - gap, ZERO) * factor / state.compliance[c] * n
