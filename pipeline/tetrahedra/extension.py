"""Values known at the skin, carried into the tets: smooth inside, as given at the skin."""

from __future__ import annotations

import numpy as np

from plait.pipeline.tetrahedra.bcc import EDGES
from plait.pipeline.tetrahedra.mesh import FACES, Lattice, volumes
from plait.solver.scene import Embedding

TOLERANCE = 1e-7
MAX_ITERATIONS = 2000
# A skin flatter than this part of its size says nothing about what lies across it.
FLAT = 1e-4
# Weight of the skin's values in each tet against smoothness, in units of the Laplacian's mean diagonal. Much more
# would tilt the tets at the skin, which reach beyond it, and overshoot inside; much less would miss the values.
HOLD = 5e1


def extend(lattice: Lattice, embedding: Embedding, values: np.ndarray) -> np.ndarray:
    """Values at the nodes, (node_count, k) float64, whose embedding gives `values` (point_count, k) at the skin.

    An affine function is split off first and carried exactly. The rest minimises the Dirichlet energy of linear
    tets plus the squared error at the skin (Jacobson 2011's harmonic weights, with the skin between the nodes).
    """
    values = np.asarray(values, dtype=np.float64).reshape(len(embedding.tet), -1)
    at_skin = np.einsum("nk,nkd->nd", embedding.barycentric, lattice.nodes[lattice.tets[embedding.tet]])
    affine = _affine_fit(at_skin, values)
    rest = values - _apply(affine, at_skin)
    return _apply(affine, lattice.nodes) + _smooth(lattice, embedding, rest)


def influences(weights: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The `count` largest joint weights of each node: (n, count) int32 joints, (n, count) float64, rows sum to 1.

    weights: (n, joint_count), of any sign; negative ones are none.
    """
    weights = np.maximum(weights, 0.0)
    count = min(count, weights.shape[1])
    joints = np.argsort(-weights, axis=1, kind="stable")[:, :count]
    kept = np.take_along_axis(weights, joints, axis=1)
    total = kept.sum(axis=1, keepdims=True)
    kept = np.where(total > 0.0, kept, np.eye(1, count))
    return joints.astype(np.int32), kept / np.where(total > 0.0, total, 1.0)


def laplacian(lattice: Lattice) -> tuple[np.ndarray, np.ndarray]:
    """Edges (n, 2) and their weights (n,), minus the off-diagonal entries of the stiffness of linear tets."""
    x = lattice.nodes[lattice.tets]
    # Gradients of the hat functions: inward normals of the opposite faces over three times the volume.
    face = x[:, FACES]
    area = 0.5 * np.cross(face[:, :, 1] - face[:, :, 0], face[:, :, 2] - face[:, :, 0])
    volume = volumes(lattice)
    entry = np.einsum("tia,tja->tij", area, area) / (9.0 * volume[:, None, None])
    pairs = np.sort(lattice.tets[:, EDGES].reshape(-1, 2), axis=1).astype(np.int64)
    key, inverse = np.unique(pairs[:, 0] * len(lattice.nodes) + pairs[:, 1], return_inverse=True)
    weight = np.bincount(inverse, -entry[:, EDGES[:, 0], EDGES[:, 1]].ravel())
    return np.stack(np.divmod(key, len(lattice.nodes)), axis=1), weight


def _affine_fit(places: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(offset (3,) and matrix (4, k)): values ≈ [1, x - offset] matrix, least squares; none across a flat skin."""
    middle = places.mean(axis=0)
    rows = np.column_stack([np.ones(len(places)), places - middle])
    scale = np.array([1.0, *[np.abs(rows[:, 1:]).max() or 1.0] * 3])
    matrix = np.linalg.lstsq(rows / scale, values, rcond=FLAT)[0] / scale[:, None]
    return middle, matrix


def _apply(affine: tuple[np.ndarray, np.ndarray], places: np.ndarray) -> np.ndarray:
    middle, matrix = affine
    return matrix[0] + (places - middle) @ matrix[1:]


def _smooth(lattice: Lattice, embedding: Embedding, values: np.ndarray) -> np.ndarray:
    edges, weight = laplacian(lattice)
    count = len(lattice.nodes)
    diagonal = np.bincount(edges.ravel(), np.repeat(weight, 2), count)
    nodes = lattice.tets[embedding.tet]
    together = np.bincount(embedding.tet, minlength=len(lattice.tets))[embedding.tet]
    hold = (HOLD * diagonal.mean() / together)[:, None, None]
    b = embedding.barycentric
    # The matrix as entries by row: the Laplacian's, and B^T B of the points in each tet.
    pair = np.arange(4)
    rows = [edges[:, 0], edges[:, 1], np.arange(count), nodes[:, np.repeat(pair, 4)].ravel()]
    columns = [edges[:, 1], edges[:, 0], np.arange(count), nodes[:, np.tile(pair, 4)].ravel()]
    entries = [-weight, -weight, diagonal, (hold * b[:, :, None] * b[:, None, :]).ravel()]
    matrix = Rows(count, np.concatenate(rows), np.concatenate(columns), np.concatenate(entries))
    right = np.zeros((count, values.shape[1]))
    np.add.at(right, nodes, hold * b[:, :, None] * values[:, None, :])
    return conjugate_gradient(matrix, right)


class Rows:
    """A sparse matrix with its rows padded to one length, for products with many columns at once."""

    def __init__(self, count: int, rows: np.ndarray, columns: np.ndarray, entries: np.ndarray) -> None:
        key, inverse = np.unique(rows.astype(np.int64) * count + columns, return_inverse=True)
        row, column = np.divmod(key, count)
        entry = np.bincount(inverse, entries)
        length = np.bincount(row, minlength=count)
        slot = np.arange(len(row)) - np.repeat(np.cumsum(length) - length, length)
        self.columns = np.zeros((int(length.max()), count), dtype=np.int64)
        self.entries = np.zeros((int(length.max()), count))
        self.columns[slot, row] = column
        self.entries[slot, row] = entry
        self.diagonal = np.zeros(count)
        self.diagonal[row[row == column]] = entry[row == column]

    def times(self, x: np.ndarray) -> np.ndarray:
        result = np.zeros_like(x)
        for column, entry in zip(self.columns, self.entries, strict=True):
            result += entry[:, None] * x[column]
        return result


def conjugate_gradient(matrix: Rows, right: np.ndarray) -> np.ndarray:
    """Solves matrix x = right for each column of `right` (n, k), to TOLERANCE, preconditioned by the diagonal."""
    inverse = 1.0 / np.where(matrix.diagonal > 0.0, matrix.diagonal, 1.0)[:, None]
    x = np.zeros_like(right)
    residual = right.copy()
    direction = inverse * residual
    rho = np.einsum("nk,nk->k", residual, direction)
    goal = TOLERANCE**2 * rho
    for _ in range(MAX_ITERATIONS):
        if np.all(rho <= goal):
            break
        product = matrix.times(direction)
        curvature = np.einsum("nk,nk->k", direction, product)
        step = np.where(rho > goal, rho / np.where(curvature > 0.0, curvature, 1.0), 0.0)
        x += step * direction
        residual -= step * product
        scaled = inverse * residual
        new = np.einsum("nk,nk->k", residual, scaled)
        direction = scaled + np.where(rho > 0.0, new / np.where(rho > 0.0, rho, 1.0), 0.0) * direction
        rho = new
    return x
