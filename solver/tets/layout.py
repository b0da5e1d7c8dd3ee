"""All elastic bodies of a scene in one set of arrays: nodes, tets, and the skins they carry."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plait.solver.diagnostics import Refused
from plait.solver.scene import Scene, TetBody


@dataclass(frozen=True)
class TetLayout:
    """Body b owns nodes first_node[b]:first_node[b + 1] and tets first_tet[b]:first_tet[b + 1].

    first_node, first_tet: (body_count + 1,) int32.
    rest: (node_count, 3) float64 [m], each body in its own rest space.
    tets: (tet_count, 4) int32, into all nodes.  volume: (tet_count,) float64 [m3], at rest.
    mass: (node_count,) float64 [kg], a quarter of each tet's.
    pinned: (node_count,) bool.
    edge: (body_count,) float64 [m], mean edge of the tets.
    """

    bodies: tuple[TetBody, ...]
    first_node: np.ndarray
    first_tet: np.ndarray
    rest: np.ndarray
    tets: np.ndarray
    volume: np.ndarray
    mass: np.ndarray
    pinned: np.ndarray
    edge: np.ndarray

    @property
    def body_count(self) -> int:
        return len(self.bodies)

    @property
    def node_count(self) -> int:
        return len(self.rest)

    def nodes(self, body: int) -> slice:
        return slice(int(self.first_node[body]), int(self.first_node[body + 1]))

    def slopes(self, body: int) -> np.ndarray:
        """(tet_count, 4, 3) [1/m]: the shape gradients of the corners of the body's tets, at rest."""
        corners = self.rest[self.tets[self.first_tet[body] : self.first_tet[body + 1]]]
        inverse = np.linalg.inv((corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1))
        return np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1)

    def skin_nodes(self, body: int) -> np.ndarray:
        """(point_count, 4) int32, into all nodes: the corners of the tet that each point of the skin lies in."""
        first = int(self.first_tet[body])
        return self.tets[first + np.asarray(self.bodies[body].embedding.tet)]

    def where(self, node: int) -> str:
        """The node in words, for a message."""
        body = int(np.searchsorted(self.first_node, node, side="right")) - 1
        return f"{self.bodies[body].name}, node {node - int(self.first_node[body])} of its tets"


def build_layout(scene: Scene) -> TetLayout:
    """Raises `Refused` for a body whose tets are none, not of its nodes, or not of positive volume."""
    bodies = scene.bodies
    for body in bodies:
        _check(body)
    first_node = np.concatenate([[0], np.cumsum([len(b.nodes) for b in bodies])]).astype(np.int32)
    first_tet = np.concatenate([[0], np.cumsum([len(b.tets) for b in bodies])]).astype(np.int32)
    rest = np.concatenate([np.asarray(b.nodes, dtype=np.float64) for b in bodies])
    tets = np.concatenate([np.asarray(b.tets) + first_node[i] for i, b in enumerate(bodies)]).astype(np.int32)
    volume = volumes(rest, tets)
    density = np.concatenate([np.broadcast_to(b.density, len(b.tets)) for b in bodies])
    mass = np.bincount(tets.ravel(), np.repeat(0.25 * volume * density, 4), minlength=len(rest))
    return TetLayout(
        bodies,
        first_node,
        first_tet,
        rest,
        tets,
        volume,
        mass,
        np.concatenate([np.asarray(b.pinned, dtype=bool) for b in bodies]),
        np.array([mean_edge(b.nodes, b.tets) for b in bodies]),
    )


def volumes(nodes: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """(tet_count,) [m3], negative for tets of the wrong orientation."""
    x = nodes[tets]
    edges = x[:, 1:] - x[:, :1]
    return np.einsum("ni,ni->n", edges[:, 0], np.cross(edges[:, 1], edges[:, 2])) / 6.0


def mean_edge(nodes: np.ndarray, tets: np.ndarray) -> float:
    """[m]"""
    pairs = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])
    ends = nodes[tets[:, pairs]]
    return float(np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2).mean())


def _check(body: TetBody) -> None:
    tets = np.asarray(body.tets)
    if not len(tets):
        raise Refused(f"{body.name}: has no tets")
    if tets.min() < 0 or tets.max() >= len(body.nodes):
        raise Refused(f"{body.name}: a tet names node {tets.max()} of {len(body.nodes)}")
    flat = ~(volumes(np.asarray(body.nodes, dtype=np.float64), tets) > 0.0)
    if flat.any():
        raise Refused(f"{body.name}: tet {int(np.argmax(flat))} has no positive volume at rest")
