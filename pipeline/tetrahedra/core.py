"""Which nodes are bone: deep within the limbs, and away from the joints that bend."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plait.pipeline.tetrahedra.extension import extend
from plait.pipeline.tetrahedra.graphs import components
from plait.pipeline.tetrahedra.mesh import Lattice
from plait.pipeline.tetrahedra.skin import Inside, prepare
from plait.solver.scene import Embedding

DEPTH = 0.5
# A joint's own part: nodes that it moves at least this much.
MAIN = 0.5


@dataclass(frozen=True)
class Core:
    """pinned: (node_count,) bool, bone.  attached: (node_count,) bool, flesh of pieces that no bone goes through,
    to
    be held to the animated pose by springs.  notes: what a user should know, in words.
    """

    pinned: np.ndarray
    attached: np.ndarray
    notes: tuple[str, ...]


def core(
    lattice: Lattice,
    embedding: Embedding,
    points: np.ndarray,
    triangles: np.ndarray,
    weights: np.ndarray,
    joints: np.ndarray,
    parents: np.ndarray,
    depth: np.ndarray | float = DEPTH,
) -> Core:
    """Pins the nodes within `depth` of the way from a bone to the skin.

    points (point_count, 3), triangles (triangle_count, 3): the skin, which `embedding` places in the lattice.
    weights: (node_count, joint_count), joint weights of the nodes.  joints: (joint_count, 3), at rest, in the
    space of the points.  parents: (joint_count,) int, -1 for roots. depth: of the way from the bone (0: all flesh)
    to the skin (1: all bone); a number, or one a point.

    A bone goes from a joint to each of its children and belongs to the joint. Within one limb radius of a joint
    that bends (one with flesh of its own and of its parent's beside it) nothing is pinned, so that the flesh there
    has room to fold. Joints with no bone within the skin (helmets, rigid parts) pin what lies deepest.
    """
    skin = prepare(points, triangles)
    inside = Inside(skin.points, skin.triangles)
    depths = _depths(lattice, embedding, depth)
    below = np.maximum(-inside.query(lattice.nodes)[0], 0.0)
    owner = np.argmax(weights, axis=1)
    owned = np.take_along_axis(weights, owner[:, None], axis=1)[:, 0] >= MAIN
    away = _from_bones(lattice.nodes, owner, joints, parents)
    boned = np.isfinite(away)
    share = np.full(len(away), np.inf)
    share[boned] = away[boned] / np.maximum((away + below)[boned], 1e-300)
    pinned = owned & (below > 0.0) & (share < depths)
    folding = _near_bending_joints(lattice.nodes, inside, owner, joints, parents)
    pinned &= ~folding
    for joint in np.unique(owner[owned]):
        mine = owned & (owner == joint)
        if not pinned[mine].any():
            deepest = below[mine].max()
            pinned |= mine & ~folding & (below > 0.0) & (below >= (1.0 - depths) * deepest) & (depths > 0.0)
    pinned |= depths >= 1.0
    return _hold_the_rest(lattice, pinned, depths)


def _depths(lattice: Lattice, embedding: Embedding, depth: np.ndarray | float) -> np.ndarray:
    values = np.asarray(depth, dtype=np.float64)
    if values.ndim == 0 or len(np.unique(values)) == 1:
        return np.full(len(lattice.nodes), float(values.flat[0]))
    result = np.clip(extend(lattice, embedding, values)[:, 0], values.min(), values.max())
    # Painted extremes are meant to the letter: their neighbourhoods of an iteration's error too.
    return np.where(result > 1.0 - 1e-3, 1.0, np.where(result < 1e-3, 0.0, result))


def _from_bones(nodes: np.ndarray, owner: np.ndarray, joints: np.ndarray, parents: np.ndarray) -> np.ndarray:
    """(node_count,) distance to the closest bone of the joint that owns each node; infinite without one."""
    distance = np.full(len(nodes), np.inf)
    for child, parent in enumerate(parents):
        if parent < 0:
            continue
        mine = np.flatnonzero(owner == parent)
        distance[mine] = np.minimum(distance[mine], _to_segment(nodes[mine], joints[parent], joints[child]))
    return distance


def _to_segment(places: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    along = end - start
    length = along @ along
    s = np.clip((places - start) @ along / length, 0.0, 1.0) if length > 0.0 else np.zeros(len(places))
    return np.linalg.norm(places - start - s[:, None] * along, axis=1)


def _near_bending_joints(
    nodes: np.ndarray, inside: Inside, owner: np.ndarray, joints: np.ndarray, parents: np.ndarray
) -> np.ndarray:
    """(node_count,) bool: within one limb radius of a joint between two parts of the flesh."""
    radius = np.maximum(-inside.query(joints)[0], 0.0)
    result = np.zeros(len(nodes), dtype=bool)
    for joint in np.flatnonzero((radius > 0.0) & (np.asarray(parents) >= 0)):
        near = np.linalg.norm(nodes - joints[joint], axis=1) < radius[joint]
        if len(np.unique(owner[near])) > 1:
            result |= near
    return result


def _hold_the_rest(lattice: Lattice, pinned: np.ndarray, depths: np.ndarray) -> Core:
    """Every connected piece is held by something: one without bone is attached whole."""
    tets = lattice.tets
    piece = components(len(lattice.nodes), np.concatenate([tets[:, [0, k]] for k in (1, 2, 3)]))
    held = np.bincount(piece, pinned) > 0
    attached = ~held[piece]
    notes = []
    if not pinned.any():
        notes.append("no bone lies within the flesh: all of it is attached to the animated pose by springs")
    elif attached.any():
        notes.append(
            f"{int((~held).sum())} of {len(held)} pieces of flesh have no bone within: they are attached to the "
            "animated pose by springs"
        )
    return Core(pinned, attached, tuple(notes))
