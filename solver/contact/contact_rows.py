"""Rows of contacts, built anew in each substep, and the sweeps over them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from plait.solver.contact.row_kernels import (
    Rows,
    RowState,
    add_impulses,
    begin_rows,
    claim_nodes,
    part_rows,
    spread_impulses,
    sweep_rows,
    weigh_rows,
)
from plait.solver.launch import Launcher

# Cost of a row, and of a node, in units of `Launcher.launch`.
ROW_WORK, NODE_WORK = 8, 8


@dataclass(frozen=True)
class Contacts:
    """What may touch, as numpy arrays of `count` rows.

    nodes: (count, n) int32, weights, common_weights: (count, n) float64, see `row_kernels`; where both weights are
    zero a node is no part of the row.
    normal: (count, 3).  target: (count,) [m].  friction, restitution: (count,).  share: (count,) [kg].
    """

    nodes: np.ndarray
    weights: np.ndarray
    common_weights: np.ndarray
    normal: np.ndarray
    target: np.ndarray
    friction: np.ndarray
    restitution: np.ndarray
    share: np.ndarray


class ContactRows:
    """Contacts that share the nodes of elastic bodies.

    mobile: (node_count,) bool, the nodes that contact can move.
    """

    def __init__(self, mobile: np.ndarray, launcher: Launcher) -> None:
        self._launcher, self._mobile = launcher, mobile
        self._claim = wp.zeros(len(mobile), dtype=wp.float64, device=launcher.device)
        self.count = 0

    def build(self, contacts: Contacts) -> None:
        """Takes up the contacts of a substep."""
        device = self._launcher.device
        taking_part = (contacts.weights != 0.0) | (contacts.common_weights != 0.0)
        row, slot = np.nonzero(taking_part)
        node = contacts.nodes[row, slot]
        weight, common_weight = contacts.weights[row, slot], contacts.common_weights[row, slot]
        self.count = len(contacts.nodes)

        def hold(values: np.ndarray, dtype: type) -> wp.array:
            return wp.array(values, dtype=dtype, device=device)

        rows = Rows()
        rows.offsets = hold(_offsets(taking_part.sum(axis=1)), wp.int32)
        rows.node = hold(node, wp.int32)
        rows.weight, rows.common_weight = hold(weight, wp.float64), hold(common_weight, wp.float64)
        rows.normal = hold(contacts.normal, wp.vec3d)
        for name in ("target", "friction", "restitution", "share"):
            setattr(rows, name, hold(getattr(contacts, name), wp.float64))
        mobile = np.flatnonzero(self._mobile[node])
        order = mobile[np.argsort(node[mobile], kind="stable")]
        touched, counts = np.unique(node[order], return_counts=True)
        rows.nodes, rows.node_offsets = hold(touched, wp.int32), hold(_offsets(counts), wp.int32)
        rows.node_row, rows.node_weight = hold(row[order], wp.int32), hold(common_weight[order], wp.float64)
        self._rows, self._touched = rows, len(touched)
        self._state = self._allocate()
        self._first_pass = True

    def _allocate(self) -> RowState:
        state, device = RowState(), self._launcher.device
        for name in ("compliance", "gap", "velocity", "approach"):
            setattr(state, name, wp.zeros(self.count, dtype=wp.float64, device=device))
        for name in ("impulse", "change"):
            setattr(state, name, wp.zeros(self.count, dtype=wp.vec3d, device=device))
        return state

    @property
    def gap(self) -> wp.array:
        """(count,) float64 [m], where the pass began, or where `part` found the rows."""
        return self._state.gap

    def begin_pass(self, position: wp.array, velocity: wp.array, inverse_mass: wp.array) -> None:
        """Notes where an elastic solve took the nodes.

        inverse_mass: (node_count,) float64 [1/kg], how the nodes answer to impulses in this pass.
        """
        self._rows.inverse_mass = inverse_mass
        rows, launch = self._rows, self._launcher.launch
        launch(claim_nodes, self._touched, [rows], [self._claim], work_per_item=NODE_WORK)
        launch(weigh_rows, self.count, [rows, self._claim], [self._state], work_per_item=ROW_WORK)
        inputs = [int(self._first_pass), rows, position, velocity]
        launch(begin_rows, self.count, inputs, [self._state], work_per_item=ROW_WORK)
        self._first_pass = False

    def sweep(self, velocity: wp.array, displacement_per_velocity: float) -> None:
        """One projected Jacobi sweep: changes velocities [m/s] of the nodes in place."""
        inputs = [self._rows, velocity, wp.float64(displacement_per_velocity)]
        self._launcher.launch(sweep_rows, self.count, inputs, [self._state], work_per_item=ROW_WORK)
        self._spread(velocity)

    def impulses(self) -> tuple[np.ndarray, np.ndarray]:
        """(count,) [kg m/s] each: the impulses in this substep so far, along the normals and across them."""
        impulse, normal = self._state.impulse.numpy(), self._rows.normal.numpy()
        along = np.einsum("cd,cd->c", impulse, normal)
        return along, np.linalg.norm(impulse - along[:, None] * normal, axis=1)

    def add_impulses(self, on_nodes: wp.array) -> None:
        """Adds what the impulses in this substep so far are on nodes, (node_count,) vec3d [kg m/s]."""
        inputs = [self._rows, self._state]
        self._launcher.launch(add_impulses, self._touched, inputs, [on_nodes], work_per_item=NODE_WORK)

    def part(self, position: wp.array, wanted: wp.array, factor: float) -> None:
        """Moves nodes, in place, such that gaps below `wanted` (count,) [m] grow by `factor` of what they lack."""
        inputs = [self._rows, wanted, wp.float64(factor), position]
        self._launcher.launch(part_rows, self.count, inputs, [self._state], work_per_item=ROW_WORK)
        self._spread(position)

    def _spread(self, of_nodes: wp.array) -> None:
        inputs = [self._rows, self._state]
        self._launcher.launch(spread_impulses, self._touched, inputs, [of_nodes], work_per_item=NODE_WORK)


def _offsets(counts: np.ndarray) -> np.ndarray:
    return np.concatenate([[0], np.cumsum(counts)])
