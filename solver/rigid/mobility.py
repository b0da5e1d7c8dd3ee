"""How rigid bodies give way to impulses of others within a substep, their joints and supports holding them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from plait.solver.rigid.quaternions import rotation_matrix

if TYPE_CHECKING:
    from plait.solver.rigid.stage import RigidStage
    from plait.solver.scene import Joint

# Of larger islands each body is taken with the others at rest: the problem grows with the island's size cubed.
LARGEST_ISLAND = 32
# Rows that are combinations of others but for rounding hold nothing more.
DEPENDENT = 1e-9


class _Row(NamedTuple):
    """One speed that is held at zero: of each body that it concerns the six numbers it is made of."""

    bodies: tuple[int, ...]
    parts: tuple[np.ndarray, ...]


def mobility(stage: RigidStage, bodies: np.ndarray, *, supports: bool = True) -> np.ndarray:
    """(n, 6, 6) of `bodies` (n,), where they are now: velocity [m/s] and spin [1/s] by impulse and moment.

    World, about the centres of mass. With M the mass and J what joints hold, and with `supports` contacts and
    limits that bore a load in the last substep, these as if they could pull:
    M^-1 - M^-1 J^T (J M^-1 J^T)^-1 J M^-1. Friction holds nothing here.
    Zero before the bodies are released.
    """
    if stage.held:
        return np.zeros((len(bodies), 6, 6))
    rows = [*_joint_rows(stage), *(_support_rows(stage) if supports else ())]
    islands = _islands(len(stage.bodies), rows)
    roots = _inverse_mass_roots(stage)
    matrix = np.zeros((len(bodies), 6, 6))
    for k, body in enumerate(bodies):
        members = np.flatnonzero(islands == islands[body])
        if len(members) > LARGEST_ISLAND:
            members = np.array([body])
        own = [row for row in rows if not set(members.tolist()).isdisjoint(row.bodies)]
        matrix[k] = _constrained(roots, members, own, int(body))
    return matrix


def supported(stage: RigidStage, bodies: np.ndarray) -> np.ndarray:
    """(n,) bool: whether contacts or limits bore a load of `bodies` (n,), or of what is joined to them."""
    supports = list(_support_rows(stage))
    islands = _islands(len(stage.bodies), [*_joint_rows(stage), *supports])
    return np.isin(islands[bodies], [islands[row.bodies[0]] for row in supports])


def _constrained(roots: np.ndarray, members: np.ndarray, rows: list[_Row], body: int) -> np.ndarray:
    """(6, 6) of one of an island's bodies. roots: (body_count, 6, 6) L with L L^T = M^-1."""
    at = {int(b): 6 * i for i, b in enumerate(members)}
    held = np.zeros((6 * len(members), len(rows)))
    for column, row in enumerate(rows):
        for b, part in zip(row.bodies, row.parts, strict=True):
            if b in at:
                held[at[b] : at[b] + 6, column] += roots[b].T @ part
    block = slice(at[body], at[body] + 6)
    free = np.eye(6)
    if len(rows):
        basis, size, _ = np.linalg.svd(held, full_matrices=False)
        basis = basis[block, size > DEPENDENT * size[0]] if size[0] > 0.0 else basis[block, :0]
        free = free - basis @ basis.T
    return roots[body] @ free @ roots[body].T


def _inverse_mass_roots(stage: RigidStage) -> np.ndarray:
    rotation = np.array([rotation_matrix(q) for q in stage.orientation.numpy()])
    roots = np.zeros((len(stage.bodies), 6, 6))
    for b, body in enumerate(stage.bodies):
        roots[b, :3, :3] = np.eye(3) / np.sqrt(body.mass)
        roots[b, 3:, 3:] = rotation[b] @ np.linalg.cholesky(np.linalg.inv(body.inertia))
    return roots


def _islands(count: int, rows: list[_Row]) -> np.ndarray:
    """(count,) the least body of each one's island."""
    root = np.arange(count)
    for row in rows:
        joined = root[list(row.bodies)]
        root[np.isin(root, joined)] = joined.min()
    return root


def _row(bodies: tuple[int, int], levers: tuple[np.ndarray, np.ndarray], way: np.ndarray) -> _Row:
    """The speed along `way` of the first body's place against the second's; -1: no body."""
    parts = [
        (b, sign * np.concatenate([way, np.cross(lever, way)]))
        for b, lever, sign in zip(bodies, levers, (1.0, -1.0), strict=True)
        if b >= 0
    ]
    return _Row(tuple(b for b, _ in parts), tuple(part for _, part in parts))


def _turn_row(bodies: tuple[int, int], axis: np.ndarray) -> _Row:
    parts = [
        (b, sign * np.append(np.zeros(3), axis)) for b, sign in zip(bodies, (1.0, -1.0), strict=True) if b >= 0
    ]
    return _Row(tuple(b for b, _ in parts), tuple(part for _, part in parts))


def _joint_rows(stage: RigidStage) -> Iterator[_Row]:
    position = stage.position.numpy()
    rotation = [rotation_matrix(q) for q in stage.orientation.numpy()]
    place, turn = stage.joints.joints.place.numpy(), stage.joints.joints.turn.numpy()
    for j, joint in enumerate(stage.joints.scene_joints):
        a, b = bodies = _bodies_of(joint)
        anchor = place[2 * j + 1] if b < 0 else position[b] + rotation[b] @ place[2 * j + 1]
        levers = tuple(anchor - position[k] if k >= 0 else np.zeros(3) for k in bodies)
        frame = rotation_matrix(turn[2 * j])
        x, y, z = (frame if a < 0 else rotation[a] @ frame).T
        ways = {"prismatic": (x, y), "distance": ()}.get(joint.kind, (x, y, z))
        turns = {"fixed": (x, y, z), "prismatic": (x, y, z), "revolute": (x, y)}.get(joint.kind, ())
        for way in ways:
            yield _row(bodies, levers, way)
        for axis in turns:
            yield _turn_row(bodies, axis)


def _support_rows(stage: RigidStage) -> Iterator[_Row]:
    """What pushes and does not pull, as far as it bore a load in the last substep: contacts, joints' limits."""
    joints = stage.joints.joints
    at_limit, axis = joints.limit_impulse.numpy().any(axis=1), joints.limit_axis.numpy()
    for j in np.flatnonzero(at_limit):
        joint = stage.joints.scene_joints[j]
        bodies = _bodies_of(joint)
        if joint.kind in ("prismatic", "distance"):
            yield _row(bodies, (joints.lever_a.numpy()[j], joints.lever_b.numpy()[j]), axis[j])
        else:
            yield _turn_row(bodies, axis[j])
    for bodies, levers, normal in stage.contact.loaded():
        yield _row(bodies, levers, normal)


def _bodies_of(joint: Joint) -> tuple[int, int]:
    return tuple(-1 if body is None else body for body in joint.bodies)
