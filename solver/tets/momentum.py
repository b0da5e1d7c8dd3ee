"""Exact momenta of free bodies.

What moves a body as a whole costs no elastic energy, so an iteration that stops at a tolerance leaves an error
there that elasticity never takes back; and multistep methods do not keep the spin of a body that vibrates. Both
momenta are known, however, and the rigid motion that gives them is found by itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from plait.solver.launch import Launcher
from plait.solver.linear.chunks import chunk_size
from plait.solver.tets.momentum_kernels import move, sum_moments

MAX_ITERATIONS = 20


@dataclass(frozen=True)
class Moments:
    """Of two fields a and b over a body's nodes, weighted by w.

    weight: sum of w.  mean_a, mean_b: (3,).  product: (3, 3), sum of w (a - mean_a) (b - mean_b)^T.
    """

    weight: float
    mean_a: np.ndarray
    mean_b: np.ndarray
    product: np.ndarray

    @property
    def inner_cross(self) -> np.ndarray:
        """Sum of w (a - mean_a) x (b - mean_b)."""
        return axial(self.product)

    @property
    def cross(self) -> np.ndarray:
        """Sum of w a x b."""
        return self.inner_cross + self.weight * np.cross(self.mean_a, self.mean_b)


class WholeBody:
    """Sums over all nodes of a body, and moves it rigidly."""

    def __init__(self, nodes: slice, launcher: Launcher) -> None:
        self._nodes, self._launcher = nodes, launcher
        self._count = nodes.stop - nodes.start
        self._chunk = chunk_size(self._count, launcher.device)
        chunks = -(-self._count // self._chunk)
        self._sums = wp.zeros((chunks, 16), dtype=wp.float64, device=launcher.device)

    def moments(self, weight: wp.array, a: wp.array, b: wp.array) -> Moments:
        """weight: float64, a, b: vec3d, all (node_count,) of all nodes."""
        first = self._nodes.start
        inputs = [first, self._count, self._chunk, weight, a, b]
        self._launcher.launch(sum_moments, len(self._sums), inputs, [self._sums], work_per_item=self._chunk)
        sums = self._sums.numpy().sum(axis=0)
        # Summed about the first node, which keeps the digits of bodies far from the origin.
        off_a, off_b = sums[:3] / sums[15], sums[3:6] / sums[15]
        product = sums[6:15].reshape(3, 3) - sums[15] * np.outer(off_a, off_b)
        ends = [field[first : first + 1].numpy()[0] for field in (a, b)]
        return Moments(float(sums[15]), ends[0] + off_a, ends[1] + off_b, product)

    def move(self, position: wp.array, centre: np.ndarray, rotation: np.ndarray, to: np.ndarray) -> None:
        """Turns the body about `centre` and takes that to `to`."""
        turn = wp.mat33d(*(rotation - np.eye(3)).ravel())
        inputs = [self._nodes.start, wp.vec3d(*centre), turn, wp.vec3d(*(to - centre))]
        self._launcher.launch(move, self._count, inputs, [position])


def axial(product: np.ndarray) -> np.ndarray:
    """Sum of a x b, from the sum of a b^T."""
    return np.array([product[1, 2] - product[2, 1], product[2, 0] - product[0, 2], product[0, 1] - product[1, 0]])


def rotation_with_spin(base: np.ndarray, spin: np.ndarray) -> np.ndarray:
    """The rotation Q nearest to none that gives a body turned by it the `spin`, (3,), times gamma h.

    With x = base + gamma h v and B the sum of m (base)(x)^T about the centres, the spin is axial(B Q^T) over
    gamma h. Newton's method; a body so flat that its inertia cannot be inverted turns as little as possible.
    """
    turned, rotation = base, np.eye(3)
    scale = np.abs(base).max()
    for _ in range(MAX_ITERATIONS):
        off = spin - axial(turned)
        if np.abs(off).max() <= 1e-15 * scale:
            break
        inertia = np.trace(turned) * np.eye(3) - turned.T
        step = _exponential(np.linalg.lstsq(inertia, off, rcond=1e-10)[0])
        rotation, turned = step @ rotation, turned @ step.T
    return rotation


def _exponential(turn: np.ndarray) -> np.ndarray:
    """Rodrigues' formula."""
    angle = float(np.linalg.norm(turn))
    cross = np.array([[0.0, -turn[2], turn[1]], [turn[2], 0.0, -turn[0]], [-turn[1], turn[0], 0.0]])
    half = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
    return np.eye(3) + np.sinc(angle / np.pi) * cross + half * cross @ cross
