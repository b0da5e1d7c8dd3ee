"""Faces to triangles, and seams closed for the simulation."""

from __future__ import annotations

import numpy as np


def triangulate(
    points: np.ndarray, counts: np.ndarray, indices: np.ndarray, left_handed: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of polygons, concave ones too: (n, 3) int32, and the face each came from, (n,) int32.

    points: (p, 3).  counts: (f,) vertices a face, three or more.  indices: (sum of counts,).
    A quad is cut along the diagonal that keeps both halves facing the polygon's way (if either does, the shorter);
    larger polygons by ear clipping in their mean plane. Triangles without area are left out.
    """
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(np.int64)
    pieces, faces = [], []
    threes = np.nonzero(counts == 3)[0]
    pieces.append(indices[starts[threes, None] + np.arange(3)].reshape(-1, 3))
    faces.append(threes)
    fours = np.nonzero(counts == 4)[0]
    pieces.append(_cut_quads(points, indices[starts[fours, None] + np.arange(4)].reshape(-1, 4)))
    faces.append(np.repeat(fours, 2))
    for face in np.nonzero(counts > 4)[0]:
        polygon = indices[starts[face] : starts[face] + counts[face]]
        pieces.append(clip_ears(points, polygon))
        faces.append(np.full(len(polygon) - 2, face))
    triangles, face_of = np.concatenate(pieces), np.concatenate(faces)
    if left_handed:
        triangles = triangles[:, [0, 2, 1]]
    order = np.argsort(face_of, kind="stable")
    triangles, face_of = triangles[order], face_of[order]
    kept = has_area(points, triangles)
    return triangles[kept].astype(np.int32), face_of[kept].astype(np.int32)


def has_area(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Which triangles are neither points nor lines, (n,) bool; slivers down to rounding are kept."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    doubled = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    longest = np.maximum(np.maximum(_squared(b - a), _squared(c - b)), _squared(a - c))
    # The points are float32 in the file: what they make of a straight line is no triangle.
    return doubled > 1e-6 * longest


def weld(points: np.ndarray, triangles: np.ndarray, attached: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Merges points at the very same place that move alike, so that a seam is no hole.

    attached: (n, k), what else must be equal (joints and weights, shape offsets).
    Returns which of the points are kept, (m,), and the welded point of each point, (n,).
    """
    # Adding zero turns -0.0 into 0.0, so that bytes are equal where numbers are.
    rows = np.ascontiguousarray(np.column_stack([points, attached]) + 0.0)
    keys = rows.view(np.dtype((np.void, rows.dtype.itemsize * rows.shape[1]))).ravel()
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    # In the order of first appearance, so that a mesh without seams is left as it is.
    order = np.argsort(first, kind="stable")
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return first[order], rank[inverse.ravel()].astype(np.int32)


def clip_ears(points: np.ndarray, polygon: np.ndarray) -> np.ndarray:
    """(len(polygon) - 2, 3) triangles of a simple polygon, by ear clipping (Meisters 1975) in its mean plane."""
    corners = points[polygon]
    normal = _newell(corners)
    axis = np.argmax(np.abs(normal))
    flat = np.delete(corners, axis, axis=1)
    if normal[axis] * (1.0, -1.0, 1.0)[axis] < 0.0:
        flat = flat * np.array([-1.0, 1.0])
    remaining, triangles = list(range(len(polygon))), []
    while len(remaining) > 3:
        ear = _find_ear(flat, remaining)
        count = len(remaining)
        triangles.append([remaining[ear - 1], remaining[ear], remaining[(ear + 1) % count]])
        del remaining[ear]
    triangles.append(remaining)
    return polygon[np.array(triangles)]


def _find_ear(flat: np.ndarray, remaining: list[int]) -> int:
    """A corner that can be cut off; the sharpest convex one where the polygon crosses itself."""
    count = len(remaining)
    best, best_area = 0, -np.inf
    for k in range(count):
        i, j, m = remaining[k - 1], remaining[k], remaining[(k + 1) % count]
        area = _cross(flat[j] - flat[i], flat[m] - flat[j])
        if area > best_area:
            best, best_area = k, area
        if area <= 0.0:
            continue
        others = flat[[r for r in remaining if r not in (i, j, m)]]
        inside = (
            (_cross(flat[j] - flat[i], others - flat[i]) >= 0.0)
            & (_cross(flat[m] - flat[j], others - flat[j]) >= 0.0)
            & (_cross(flat[i] - flat[m], others - flat[m]) >= 0.0)
        )
        if not inside.any():
            return k
    return best


def _cut_quads(points: np.ndarray, quads: np.ndarray) -> np.ndarray:
    """(2 n, 3) triangles of (n, 4) quads, in pairs."""
    p = points[quads]
    normal = np.cross(p[:, 2] - p[:, 0], p[:, 3] - p[:, 1])
    first = _smaller_half(p, normal, (0, 1, 2), (0, 2, 3))
    second = _smaller_half(p, normal, (0, 1, 3), (1, 2, 3))
    shorter = _squared(p[:, 2] - p[:, 0]) <= _squared(p[:, 3] - p[:, 1])
    both_good = (first > 0.0) & (second > 0.0)
    use_first = np.where(both_good, shorter, first >= second)
    along_first = quads[:, [0, 1, 2, 0, 2, 3]]
    along_second = quads[:, [0, 1, 3, 1, 2, 3]]
    return np.where(use_first[:, None], along_first, along_second).reshape(-1, 3)


def _smaller_half(p: np.ndarray, normal: np.ndarray, *halves: tuple[int, int, int]) -> np.ndarray:
    """Signed doubled area (times |normal|) of the smaller of a quad's two triangles."""
    areas = [np.sum(np.cross(p[:, j] - p[:, i], p[:, k] - p[:, i]) * normal, axis=1) for i, j, k in halves]
    return np.minimum(*areas)


def _newell(corners: np.ndarray) -> np.ndarray:
    """Normal of a polygon that need not be flat (Newell)."""
    centred = corners - corners.mean(axis=0)
    return np.cross(centred, np.roll(centred, -1, axis=0)).sum(axis=0)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _squared(vectors: np.ndarray) -> np.ndarray:
    return np.sum(vectors * vectors, axis=-1)
