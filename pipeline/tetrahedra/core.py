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
# Painted depths this close to all flesh or all bone are that.
EXTREME = 0.05
# A joint's own part: nodes that it moves at least this much.
MAIN = 0.5
# A joint moves the flesh at all if some of it has this weight.
MOVES = 0.1
# Of a joint's bone, what must be left when the surroundings of bending joints are taken off; else less is.
ENOUGH = 0.25
SHORTENINGS = (1.0, 0.8, 0.65, 0.5, 0.35, 0.2, 0.0)


@dataclass(frozen=True)
class Core:
    """What holds the flesh.

    pinned: (node_count,) bool, bone.
    attached: (node_count,) bool, flesh of joints and of pieces without bone, to be held to the animated pose by
        springs.
    notes: what a user should know, in words.
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
    weights: (node_count, joint_count), joint weights of the nodes, rows sum to one.
    joints: (joint_count, 3), at rest, in the space of the points.
    parents: (joint_count,) int, each below the joint's own number, -1 for roots.
    depth: of the way from the bone (0: all flesh) to the skin (1: all bone); a number, or one a point.

    A bone goes from a joint to each of its children and belongs to the joint. Within one limb radius of a joint
    that bends (one with flesh on both sides of it) nothing is pinned, so that the flesh there has room to fold.
    That distance is shortened for joints that it would leave with less than a quarter of their bone, as in a trunk
    or a forearm of several twist joints. Joints without a bone in the flesh (heads, hands), and the only joint of
    what is rigid, pin what lies deepest.
    """
    skin = prepare(points, triangles)
    inside = Inside.of(skin)
    depths = _depths(lattice, embedding, depth)
    nodes = lattice.nodes
    below = _finite(-inside.query(nodes)[0])
    owner = np.argmax(weights, axis=1)
    owner = np.where(weights[np.arange(len(nodes)), owner] >= MAIN, owner, -1)
    owners = np.unique(owner[owner >= 0])
    bone = _bone(nodes, owner, below, depths, joints, parents, owners)
    clearance = _clearance(nodes, inside, weights, joints, parents)
    pinned = np.zeros(len(nodes), dtype=bool)
    for joint in owners:
        own = bone & (owner == joint)
        for shortening in SHORTENINGS:
            kept = own & (clearance >= shortening)
            if kept.sum() >= ENOUGH * own.sum():
                break
        pinned |= kept
    pinned |= depths >= 1.0
    boned = np.isin(np.arange(len(parents)), owner[pinned])
    boneless = [
        joint
        for joint in owners
        if (depths[owner == joint] > 0.0).any() and not (boned & _subtree(joint, parents)).any()
    ]
    return _hold_the_rest(lattice, pinned, np.isin(owner, boneless), len(boneless))


def _bone(
    nodes: np.ndarray,
    owner: np.ndarray,
    below: np.ndarray,
    depths: np.ndarray,
    joints: np.ndarray,
    parents: np.ndarray,
    owners: np.ndarray,
) -> np.ndarray:
    """(node_count,) bool: deep enough to be bone. below: how far under the skin."""
    away = _from_bones(nodes, owner, joints, parents)
    if len(owners) == 1:
        away[:] = np.inf
    boned = np.isfinite(away) & (below > 0.0)
    share = np.full(len(nodes), np.inf)
    share[boned] = away[boned] / (away + below)[boned]
    bone = share < depths
    for joint in owners:
        own = owner == joint
        if not bone[own].any():
            deep = below > (1.0 - depths) * below[own].max()
            bone |= own & deep & (depths > 0.0)
    return bone


def _depths(lattice: Lattice, embedding: Embedding, depth: np.ndarray | float) -> np.ndarray:
    values = np.asarray(depth, dtype=np.float64)
    if values.ndim == 0 or len(np.unique(values)) == 1:
        return np.full(len(lattice.nodes), float(values.flat[0]))
    result = np.clip(extend(lattice, embedding, values)[:, 0], values.min(), values.max())
    # Painted extremes are meant to the letter; in the tets they are reached only far from other paint.
    return np.where(result > 1.0 - EXTREME, 1.0, np.where(result < EXTREME, 0.0, result))


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


def _clearance(
    nodes: np.ndarray, inside: Inside, weights: np.ndarray, joints: np.ndarray, parents: np.ndarray
) -> np.ndarray:
    """(node_count,) distance to the closest joint that bends, in radii of the limb there."""
    radius = _finite(-inside.query(joints)[0])
    moving = weights.max(axis=0) > MOVES
    beyond = moving.copy()  # joints with flesh of their own or of joints below them
    for joint in range(len(parents) - 1, -1, -1):  # parents come first
        if parents[joint] >= 0:
            beyond[parents[joint]] |= beyond[joint]
    result = np.full(len(nodes), np.inf)
    for joint in np.flatnonzero((radius > 0.0) & beyond & (np.asarray(parents) >= 0)):
        if (moving & ~_subtree(joint, parents)).any():
            result = np.minimum(result, np.linalg.norm(nodes - joints[joint], axis=1) / radius[joint])
    return result


def _subtree(joint: int, parents: np.ndarray) -> np.ndarray:
    """(joint_count,) bool: the joint and all below it."""
    result = np.zeros(len(parents), dtype=bool)
    result[joint] = True
    for other in range(joint + 1, len(parents)):
        result[other] = parents[other] >= 0 and result[parents[other]]
    return result


def _finite(depth: np.ndarray) -> np.ndarray:
    """How far under the skin; nothing is under a skin without an inside."""
    return np.where(np.isfinite(depth), np.maximum(depth, 0.0), 0.0)


def _hold_the_rest(lattice: Lattice, pinned: np.ndarray, hanging: np.ndarray, joint_count: int) -> Core:
    """Flesh that would fall off its skeleton is attached: connected pieces without bone, and what is `hanging`,
    that of `joint_count` joints at the skeleton's ends.
    """
    tets = lattice.tets
    piece = components(len(lattice.nodes), np.concatenate([tets[:, [0, k]] for k in (1, 2, 3)]))
    held = np.bincount(piece, pinned) > 0
    attached = (~held[piece] | hanging) & ~pinned
    notes = []
    if not pinned.any():
        notes.append("no bone lies within the flesh: all of it is attached to the animated pose by springs")
    elif not held.all():
        notes.append(
            f"{int((~held).sum())} of {len(held)} pieces of flesh have no bone within: they are attached to the "
            "animated pose by springs"
        )
    elif joint_count:
        notes.append(
            f"{joint_count} joints have no bone within their flesh, which is attached to the animated pose by "
            "springs: finer tets would hold some"
        )
    return Core(pinned, attached, tuple(notes))
