"""A surface as it is drawn: smooth but for its creases, a colour a point."""

from __future__ import annotations

import numpy as np

from plait.pipeline.pictures.colours import to_bytes
from plait.pipeline.pictures.drawables import Shell

CREASE = 50.0  # degrees between faces at which a surface is no longer shaded as smooth


class Creased:
    """A shell's topology for drawing: its points parted at creases and where colours change."""

    def __init__(self, shell: Shell, points: np.ndarray, code: float) -> None:
        triangles = shell.triangles
        crease = 180.0 if shell.body.subdivided else CREASE
        self._corners, self._origin = _parted(points, triangles, crease)
        colours = to_bytes(shell.corner_colours(code).reshape(-1, 3)).astype(np.int64)
        keys = self._corners.ravel() << 24 | (colours @ [1 << 16, 1 << 8, 1])
        _, first, drawn = np.unique(keys, return_index=True, return_inverse=True)
        self._parted = self._corners.ravel()[first]  # of each drawn point
        self.triangles = drawn.reshape(-1, 3)
        self.colours = colours[first].astype(np.uint8)

    def placed(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n, 3) points and normals to draw; a corner weighs in a normal by its triangle's area."""
        parted = points[self._origin]
        a, b, c = (parted[self._corners[:, k]] for k in range(3))
        area = np.repeat(np.cross(b - a, c - a), 3, axis=0)
        normal = np.stack(
            [np.bincount(self._corners.ravel(), area[:, k], minlength=len(parted)) for k in range(3)], axis=1
        )
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
        return parted[self._parted], normal[self._parted]


def _parted(points: np.ndarray, triangles: np.ndarray, crease: float) -> tuple[np.ndarray, np.ndarray]:
    """Triangles (m, 3) into points that are parted where faces meet at more than `crease` degrees, and which of
    `points` each of those is, (k,)."""
    normal = np.cross(
        points[triangles[:, 1]] - points[triangles[:, 0]], points[triangles[:, 2]] - points[triangles[:, 0]]
    )
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    starts, ends = triangles.ravel(), triangles[:, [1, 2, 0]].ravel()
    low, high = np.minimum(starts, ends), np.maximum(starts, ends)
    order = np.lexsort((high, low))
    same = (low[order][1:] == low[order][:-1]) & (high[order][1:] == high[order][:-1])
    one, other = order[:-1][same], order[1:][same]  # half edges, 3 triangle + corner, that are one edge
    smooth = np.sum(normal[one // 3] * normal[other // 3], axis=1) >= np.cos(np.radians(crease)) - 1e-9
    one, other = one[smooth], other[smooth]
    after = np.array([1, 2, 0])
    along = starts[one] == starts[other]  # neighbours that wind alike run along their edge in opposite directions
    begin, end = other, other // 3 * 3 + after[other % 3]
    pairs = np.concatenate(
        [
            np.stack([one, np.where(along, begin, end)], axis=1),
            np.stack([one // 3 * 3 + after[one % 3], np.where(along, end, begin)], axis=1),
        ]
    )
    label = np.arange(3 * len(triangles))
    while True:  # the least corner of all that are smoothly joined; as many rounds as a fan has triangles
        lowest = label[pairs].min(axis=1)
        if (label[pairs] == lowest[:, None]).all():
            break
        np.minimum.at(label, pairs[:, 0], lowest)
        np.minimum.at(label, pairs[:, 1], lowest)
        label = label[label]
    kept, corners = np.unique(label, return_inverse=True)
    return corners.reshape(-1, 3), triangles.ravel()[kept]
