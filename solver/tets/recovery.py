"""Undoes tangles that elastic forces cannot: tets wrapped twice around an edge, none of them inside out.

No motion short of turning tets inside out again leads out of such a state: the energy has a minimum there. It is
known by its dihedral angles: around an edge they add up to 2 pi at most, in a tangle to 4 pi. (A star of tets
wrapped twice around a node is a branched cover of the sphere, so it has such edges.) A tangle that stays for long
is let go: the strained tets around it, with a margin, are filled anew by the harmonic extension of displacements
from the animated pose around them, and elasticity does the rest.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
import warp as wp

from plait.solver.launch import Launcher
from plait.solver.linear.block_rows import BlockRows
from plait.solver.linear.conjugate_gradients import ConjugateGradients
from plait.solver.tets.elements import PAIRS, element_types
from plait.solver.tets.layout import TetLayout
from plait.solver.tets.targets import Targets

# A tet is strained that has less than this part of its volume, or an edge that differs by more than that.
SQUEEZED, STRAINED = 0.3, 0.3
# [rad] no edge is surrounded by more, or less, in a state that could be: midway to what tangled ones are.
FULL, EMPTY = 3.0 * np.pi, -np.pi
# [s] A tangle that lasts so long is let go. Twice as long again if it is back, with twice the margin of RINGS
# tets; in a body that a skeleton moves and may hold so, with the same, and not before it has moved.
PATIENCE, RINGS = 0.25, 2
# A body tangled all over is put back to its rest shape, if it is alone, after so many times longer.
ALL_OVER = 4.0
TOLERANCE, MAX_ITERATIONS = 1e-5, 2000
EDGES = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])
OPPOSITE = np.array([[2, 3], [3, 1], [1, 2], [0, 3], [2, 0], [0, 1]])  # so that the two with these are positive


class Recovery:
    """Watches over one body.

    memory: (3,) float64, part of the state: whether a tet has been inside out since the body was last found sound,
        since when it has been tangled [s], how often it has been let go.
    """

    def __init__(
        self, layout: TetLayout, body: int, targets: Targets, memory: wp.array, launcher: Launcher, real: type
    ) -> None:
        nodes = layout.nodes(body)
        self._rest, self._mass = layout.rest[nodes], layout.mass[nodes]
        self._tets = layout.tets[layout.first_tet[body] : layout.first_tet[body + 1]] - nodes.start
        self._volume = layout.volume[layout.first_tet[body] : layout.first_tet[body + 1]]
        self._pinned = layout.pinned[nodes]
        self._targets, self._memory, self._launcher, self._real = targets, memory, launcher, real

    def watch(self, least_volume: float) -> None:
        """Takes note of the least J of the body's tets."""
        if least_volume <= 0.0:
            memory = self._memory.numpy().copy()
            if memory[0] == 0.0:
                self._memory.assign([1.0, np.inf, 0.0])

    @property
    def suspects(self) -> bool:
        """Whether there may be a tangle."""
        return bool(self._memory.numpy()[0])

    def let_go(
        self, time: float, position: wp.array, velocity: wp.array, alone: bool
    ) -> tuple[np.ndarray, ...] | None:
        """Where a tangle has lasted: nodes (n,), and their new positions and velocities, (n, 3); or None.

        position, velocity: (node_count,) vec3d of the body at `time` [s].  alone: nothing else is near it.
        """
        _, since, attempts = self._memory.numpy()
        position = position.numpy()
        strained = self._strained(position)
        tangled = self._tangled(position, strained)
        if not tangled.any():
            self._memory.assign([float(strained.any()), np.inf, attempts if strained.any() else 0.0])
            return None
        since = min(since, time)
        self._memory.assign([1.0, since, attempts])
        lasted, patience = time - since, PATIENCE * 2.0**attempts
        if lasted < patience or (attempts and self._held(since, time)):
            return None
        rings = RINGS if len(self._targets.driven) else RINGS * 2 ** int(attempts)
        nodes = self._region(tangled, strained, rings)
        if len(nodes) == len(self._rest) and (lasted < ALL_OVER * patience or not alone):
            return None
        self._memory.assign([1.0, time, attempts + 1.0])
        return nodes, *self._fill(
            nodes, np.concatenate([position, velocity.numpy()], axis=1), self._targets.all_nodes(time)
        )

    def _held(self, since: float, time: float) -> bool:
        return len(self._targets.driven) > 0 and not self._targets.moves(since, time)

    # -- what is tangled -------------------------------------------------------------------------------------

    @cached_property
    def _rest_lengths(self) -> np.ndarray:
        return self._lengths(self._rest)

    def _lengths(self, position: np.ndarray) -> np.ndarray:
        ends = position[self._tets[:, EDGES]]
        return np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2)

    def _strained(self, position: np.ndarray) -> np.ndarray:
        """(tet_count,) bool"""
        corners = position[self._tets]
        edges = corners[:, 1:] - corners[:, :1]
        volume = np.einsum("ni,ni->n", edges[:, 0], np.cross(edges[:, 1], edges[:, 2])) / 6.0
        stretch = self._lengths(position) / self._rest_lengths
        return (volume < SQUEEZED * self._volume) | (np.abs(stretch - 1.0) > STRAINED).any(axis=1)

    @cached_property
    def _edges(self) -> tuple[np.ndarray, np.ndarray]:
        """(edge_count, 2) nodes; (tet_count, 6) which of them are the edges of each tet."""
        ends = np.sort(self._tets[:, EDGES].reshape(-1, 2), axis=1)
        edges, index = np.unique(ends, axis=0, return_inverse=True)
        return edges, index.reshape(-1, len(EDGES))

    def _tangled(self, position: np.ndarray, strained: np.ndarray) -> np.ndarray:
        """(node_count,) bool: the ends of edges that tets are wrapped around, but for pinned ones."""
        edges, index = self._edges
        near = self._touching(strained)
        angle = np.bincount(index[near].ravel(), _dihedral_angles(position[self._tets[near]]).ravel(), len(edges))
        # Edges of a strained tet have all of their tets among those.
        whole = np.zeros(len(edges), dtype=bool)
        whole[index[strained]] = True
        tangled = np.zeros(len(position), dtype=bool)
        tangled[edges[whole & ((angle > FULL) | (angle < EMPTY))]] = True
        return tangled & ~self._pinned

    def _region(self, tangled: np.ndarray, strained: np.ndarray, rings: int) -> np.ndarray:
        """Nodes to fill anew: all that only tets of the tangles' strained surroundings and `rings` more have."""
        inside = tangled[self._tets].any(axis=1)
        count = 0
        while count < inside.sum():
            count = inside.sum()
            inside |= strained & self._touching(inside)
        for _ in range(rings):
            inside = self._touching(inside)
        free = ~self._pinned
        free[self._tets[~inside]] = False
        return np.flatnonzero(free)

    def _touching(self, inside: np.ndarray) -> np.ndarray:
        """(tet_count,) bool: tets that share a node with those of `inside`."""
        reached = np.zeros(len(self._rest), dtype=bool)
        reached[self._tets[inside]] = True
        return reached[self._tets].any(axis=1)

    # -- filling anew ----------------------------------------------------------------------------------------

    def _fill(self, nodes: np.ndarray, motion: np.ndarray, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities (n, 3) of `nodes` from `motion`, (node_count, 6), of all others."""
        if len(nodes) == len(self._rest):
            return self._rigid(motion)
        displacement = motion.copy()
        displacement[:, :3] -= pose
        mean = np.delete(displacement, nodes, axis=0).mean(axis=0)
        filled = self._harmonic(nodes, displacement - mean) + mean
        return pose[nodes] + filled[:, :3], filled[:, 3:]

    def _rigid(self, motion: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The rest shape, placed and moving as the body does on the whole."""
        weight = self._mass[:, None] / self._mass.sum()
        centre, drift = np.split((weight * motion).sum(axis=0), 2)
        arm, about = motion[:, :3] - centre, self._rest - (weight * self._rest).sum(axis=0)
        u, _, vt = np.linalg.svd((weight * arm).T @ about)
        turned = about @ (u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt).T
        momentum = np.cross(weight * arm, motion[:, 3:] - drift).sum(axis=0)
        inertia = np.eye(3) * (weight * turned**2).sum() - (weight * turned).T @ turned
        spin = np.linalg.solve(inertia, momentum)
        return centre + turned, drift + np.cross(spin, turned)

    def _harmonic(self, nodes: np.ndarray, values: np.ndarray) -> np.ndarray:
        """(n, 6): values (node_count, 6) given outside of `nodes`, extended with the Laplacian of linear tets."""
        device, types = self._launcher.device, element_types(self._real)
        unknown = np.full(len(self._rest), -1)
        unknown[nodes] = np.arange(len(nodes))
        reached = (unknown[self._tets] >= 0).any(axis=1)
        tets, volume = self._tets[reached], self._volume[reached]
        corners = np.concatenate([np.ones((len(tets), 1, 4)), self._rest[tets].transpose(0, 2, 1)], axis=1)
        slopes = np.linalg.inv(corners)[:, :, 1:]
        stiffness = np.einsum("t,tai,tbi->tab", volume, slopes, slopes)
        rows = BlockRows(unknown[tets], len(nodes), self._launcher, self._real)
        entries = stiffness[:, *np.array(PAIRS).T].ravel()
        blocks = wp.array(entries[:, None, None] * np.eye(3), dtype=types.mat33, device=device)
        rows.assemble(blocks, wp.zeros(len(nodes), dtype=self._real, device=device))
        given = values.copy()
        given[nodes] = 0.0
        pull = np.zeros_like(values)
        np.add.at(pull, tets, -stiffness @ given[tets])
        solver = ConjugateGradients(rows, self._launcher, self._real)
        out = np.empty((len(nodes), 6))
        for part in (slice(0, 3), slice(3, 6)):
            solver.krylov.residual.assign(pull[nodes, part])
            solver.solve(TOLERANCE, MAX_ITERATIONS)
            out[:, part] = solver.krylov.solution.numpy()
        return out


def _dihedral_angles(corners: np.ndarray) -> np.ndarray:
    """(n, 6) [rad] at the edges of tets with corners (n, 4, 3), negative in tets inside out."""
    start = corners[:, EDGES[:, 0]]
    along = corners[:, EDGES[:, 1]] - start
    one, other = corners[:, OPPOSITE[:, 0]] - start, corners[:, OPPOSITE[:, 1]] - start
    normal, beside = np.cross(along, one), np.cross(along, other)
    volume = np.einsum("nei,nei->ne", along, np.cross(one, other))
    return np.arctan2(volume * np.linalg.norm(along, axis=2), np.einsum("nei,nei->ne", normal, beside))
