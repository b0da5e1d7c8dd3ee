"""A twisted ring buckles at the angle that Michell (1889) found."""

from __future__ import annotations

import numpy as np

from .joint_probe import derivatives

NODES = 100
RADIUS = 1.0
BEND = 1.0
TWIST = 0.75  # GJ: another value than EI, so that the two cannot be confused
STRETCH = 1e6
CRITICAL = 2.0 * np.pi * np.sqrt(3.0) * BEND / TWIST


def ring_hessian(angle: float) -> np.ndarray:
    """(4 N, 4 N) energy Hessian of a closed, naturally straight ring, twisted evenly by `angle` in all.

    Unknowns: N node places, N turns of the edges times the radius. The turn of the seam is imposed.
    """
    phi = 2.0 * np.pi * np.arange(NODES) / NODES
    nodes = RADIUS * np.stack([np.cos(phi), np.sin(phi), np.zeros(NODES)], axis=1)
    edges = np.roll(nodes, -1, axis=0) - nodes
    length = np.linalg.norm(edges[0])
    tangents = edges / length
    axis = np.tile([0.0, 0.0, 1.0], (NODES, 1))
    # The plane ring carries its axis parallel; a director that turns with the edge count is twisted evenly.
    turn = angle / NODES * np.arange(NODES)[:, None]
    directors = np.cos(turn) * axis + np.sin(turn) * np.cross(tangents, axis)
    twist = np.full(NODES, angle / NODES)
    before = np.roll(np.arange(NODES), 1)
    pairs = np.stack([edges[before], edges], axis=1), np.stack([directors[before], directors], axis=1)
    gradient, hessian = derivatives(*pairs, twist, BEND / length, TWIST / length, np.zeros(2), 0.0)

    # Joint i has the variables (edge i - 1, edge i, turn i - 1, turn i); edges are differences of nodes.
    full = np.zeros((4 * NODES, 4 * NODES))
    force = np.zeros((NODES, 3))
    for i in range(NODES):
        h, n = (i - 1) % NODES, (i + 1) % NODES
        to_edges = np.zeros((8, 4 * NODES))
        for c in range(3):
            to_edges[c, 3 * h + c], to_edges[c, 3 * i + c] = -1.0, 1.0
            to_edges[3 + c, 3 * i + c], to_edges[3 + c, 3 * n + c] = -1.0, 1.0
        to_edges[6, 3 * NODES + h] = to_edges[7, 3 * NODES + i] = 1.0 / RADIUS
        full += to_edges.T @ hessian[i] @ to_edges
        node = to_edges[:, : 3 * NODES].T @ gradient[i]
        force -= node.reshape(NODES, 3)
    # The tension that holds the ring: it balances the radial force of bending at every node.
    outward = nodes / RADIUS
    pull = (tangents - tangents[before])[0] @ outward[0]
    tension = -(force[0] @ outward[0]) / pull
    balance = force + tension * (tangents - tangents[before])
    assert np.abs(balance).max() < 1e-9 * BEND / RADIUS**2, "the ring is not in equilibrium"
    for i in range(NODES):
        t, n = tangents[i], (i + 1) % NODES
        block = STRETCH / length * np.outer(t, t) + tension / length * (np.eye(3) - np.outer(t, t))
        a, b = slice(3 * i, 3 * i + 3), slice(3 * n, 3 * n + 3)
        full[a, a] += block
        full[b, b] += block
        full[a, b] -= block
        full[b, a] -= block
    return full


def negative_modes(angle: float) -> int:
    """Eigenvalues below zero beyond the seven free motions: six rigid ones and the roll of all edges together."""
    eigenvalues = np.linalg.eigvalsh(ring_hessian(angle))
    return int(np.sum(eigenvalues < -1e-6))


def test_ring_buckles_at_michells_angle() -> None:
    """Stable just below 2 pi sqrt 3 EI / GJ and unstable just above, to 0.3 % with 100 nodes."""
    assert negative_modes(0.997 * CRITICAL) == 0
    assert negative_modes(1.003 * CRITICAL) > 0
