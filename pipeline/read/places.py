"""Conventions by which a groom names the places its strands grow at."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from pxr import UsdGeom

from plait.pipeline.read import values
from plait.pipeline.read.closest import closest_on_each, closest_on_triangles, groups_of
from plait.pipeline.read.curves import Curves, Polylines
from plait.pipeline.read.source import Source
from plait.pipeline.read.surfaces import Body

# triangle (strand_count,), barycentric (strand_count, 3), which strands are named (strand_count,), in words
Places = tuple[np.ndarray, np.ndarray, np.ndarray, str]
# (skin, drawn roots [m], the skin's points in the same coordinates) -> ways to read the convention
Convention = Callable[[Body, np.ndarray, np.ndarray], Iterator[Places]]


def skinprim(source: Source, curves: Curves, lines: Polylines) -> Convention | None:
    """Houdini's: `skinprim` is the face, `skinprimuv` the place on it.

    On a quad corners 0, 1, 2, 3 have (u, v) = (0, 0), (0, 1), (1, 1), (1, 0); on a triangle u and v weigh corners
    1 and 2; on a larger polygon u runs around the edge and v from there to the middle. Read with u and v swapped
    too, as tools that number quads the other way have it.
    """
    faces = _per_strand(source, curves, lines, ("skinprim",), 1)
    places = _per_strand(source, curves, lines, ("skinprimuv",), 2)
    if faces is None or places is None:
        return None
    faces = np.rint(faces[:, 0]).astype(np.int64)

    def ask(body: Body, roots: np.ndarray, points: np.ndarray) -> Iterator[Places]:
        count = len(body.corner_offsets) - 1
        inside = (faces >= 0) & (faces < count)
        known = np.where(inside, faces, 0)
        named = inside & (body.first_triangle[known + 1] > body.first_triangle[known])
        if not named.any():
            return
        for uv, detail in ((places[:, :2], ""), (places[:, 1::-1], "u and v swapped")):
            spots = _spots(body, known, uv, points)
            triangle, barycentric = _within_faces(body, known, spots, points)
            yield triangle, barycentric, named, detail

    return ask


def rest_place(source: Source, curves: Curves, lines: Polylines) -> Convention | None:
    """`restroot` or `rest`: where the root lies on the skin at rest, in the skin's own coordinates.

    The skin at rest is its own `rest` (a value a point) where it has one, else its points as authored.
    """
    rest = _per_strand(source, curves, lines, ("restroot", "rest"), 3)
    if rest is None:
        return None

    def ask(body: Body, roots: np.ndarray, points: np.ndarray) -> Iterator[Places]:
        shape, detail = _rest_shape(source, body)
        places = rest @ body.own_to_rest[:3, :3].T + body.own_to_rest[:3, 3]
        triangle, barycentric, _ = closest_on_triangles(places, shape, body.surface.triangles)
        yield triangle, barycentric, np.ones(len(rest), dtype=bool), detail

    return ask


def texture_place(source: Source, curves: Curves, lines: Polylines) -> Convention | None:
    """`groom_root_uv`, `st` or `uv`: the root's texture coordinates on the skin.

    Where charts overlap, the place that lies closest to the drawn root is meant.
    """
    wanted = _per_strand(source, curves, lines, ("groom_root_uv", "st", "uv"), 2)
    if wanted is None:
        return None

    def ask(body: Body, roots: np.ndarray, points: np.ndarray) -> Iterator[Places]:
        charts = _charts(source, body)
        if charts is None:
            return
        yield *_in_charts(body, charts, wanted, roots, points), ""

    return ask


CONVENTIONS = (
    ("skinprim and skinprimuv", skinprim),
    ("rest", rest_place),
    ("texture coordinates", texture_place),
)


def _per_strand(
    source: Source, curves: Curves, lines: Polylines, names: tuple[str, ...], width: int
) -> np.ndarray | None:
    """The first of these primvars that has a value for every curve (or every point: its root's), (strand_count, k)
    with k >= width; None if there is none. Raises InputError for a count that fits neither."""
    for name in names:
        primvar = UsdGeom.PrimvarsAPI(curves.prim).GetPrimvar(name)
        if not primvar or not primvar.HasAuthoredValue():
            continue
        data = primvar.ComputeFlattened(source.start)
        if data is None:
            raise source.error(
                "its indices do not fit its values", curves.prim, primvar.GetName(), "author one a curve"
            )
        data = values.checked(source, curves.prim, primvar.GetName(), data)
        data = data.reshape(len(data), -1)
        if data.shape[1] < width:
            continue
        if len(data) == len(curves.counts):
            return data[lines.curves]
        if len(data) == len(curves.points):
            return data[lines.roots]
        raise source.error(
            f"has {len(data)} values for {len(curves.counts)} curves",
            curves.prim,
            primvar.GetName(),
            "author one a curve, interpolation uniform",
        )
    return None


def _rest_shape(source: Source, body: Body) -> tuple[np.ndarray, str]:
    """The points of the skin's surface at rest, and by what they are known."""
    primvar = UsdGeom.PrimvarsAPI(body.prim).GetPrimvar("rest")
    if primvar and primvar.HasAuthoredValue() and primvar.GetInterpolation() == UsdGeom.Tokens.vertex:
        given = values.checked(source, body.prim, primvar.GetName(), primvar.ComputeFlattened(source.start))
        if given.ndim == 2 and given.shape[1] == 3 and body.authored_points.max() < len(given):
            shape = np.zeros_like(body.surface.points)
            shape[body.surface.triangles] = given[body.authored_points] @ body.own_to_rest[:3, :3].T
            return shape, "on the skin's own rest"
    return body.surface.points, ""


def _spots(body: Body, faces: np.ndarray, uv: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(n, 3) the point that (u, v) of each face names."""
    u, v = uv[:, :1], uv[:, 1:2]
    first = body.corner_offsets[faces]
    counts = body.corner_offsets[faces + 1] - first
    last = len(body.corner_points) - 1

    def corner(k: np.ndarray) -> np.ndarray:
        return points[body.corner_points[np.minimum(first + k, last)]]

    c0, c1, c2, c3 = (corner(np.full(len(faces), k)) for k in range(4))
    triangle = (1.0 - u - v) * c0 + u * c1 + v * c2
    quad = (1.0 - u) * (1.0 - v) * c0 + (1.0 - u) * v * c1 + u * v * c2 + u * (1.0 - v) * c3
    result = np.where((counts == 3)[:, None], triangle, quad)
    for row in np.nonzero(counts > 4)[0]:
        polygon = points[body.corner_points[first[row] : first[row] + counts[row]]]
        along = uv[row, 0] * counts[row]
        start = int(np.floor(along)) % counts[row]
        edge = polygon[start] + (along - np.floor(along)) * (polygon[(start + 1) % counts[row]] - polygon[start])
        result[row] = edge + uv[row, 1] * (polygon.mean(axis=0) - edge)
    return result


def _within_faces(
    body: Body, faces: np.ndarray, spots: np.ndarray, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The closest place to each spot among the triangles of its face."""
    first, after = body.first_triangle[faces], body.first_triangle[faces + 1]
    last = len(body.surface.triangles) - 1
    triangle = np.minimum(first, last)
    barycentric = np.tile([1.0, 0.0, 0.0], (len(faces), 1))
    best = np.full(len(faces), np.inf)
    for k in range(int((after - first).max(initial=0))):
        there = first + k < after
        candidate = np.minimum(first + k, last)
        place, squared = closest_on_each(spots, points[body.surface.triangles[candidate]])
        closer = there & (squared < best)
        triangle = np.where(closer, candidate, triangle)
        barycentric = np.where(closer[:, None], place, barycentric)
        best = np.where(closer, squared, best)
    return triangle, barycentric


def _charts(source: Source, body: Body) -> np.ndarray | None:
    """(triangle_count, 3, 2) the skin's texture coordinates at its triangles' corners."""
    if not body.prim.IsA(UsdGeom.Mesh):
        return None
    for name in ("st", "uv"):
        primvar = UsdGeom.PrimvarsAPI(body.prim).GetPrimvar(name)
        if not primvar or not primvar.HasAuthoredValue():
            continue
        data = primvar.ComputeFlattened(source.start)
        if data is None:
            continue
        data = values.checked(source, body.prim, primvar.GetName(), data).reshape(len(data), -1)[:, :2]
        return _chart_corners(body, primvar.GetInterpolation(), data)
    return None


def _chart_corners(body: Body, interpolation: str, data: np.ndarray) -> np.ndarray | None:
    if interpolation == UsdGeom.Tokens.faceVarying and body.authored_corners.max(initial=-1) < len(data):
        return data[body.authored_corners]
    if interpolation in (UsdGeom.Tokens.vertex, UsdGeom.Tokens.varying):
        if body.authored_points.max(initial=-1) < len(data):
            return data[body.authored_points]
    return None


def _in_charts(
    body: Body, charts: np.ndarray, wanted: np.ndarray, roots: np.ndarray, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    flat = np.concatenate([charts, np.zeros((*charts.shape[:2], 1))], axis=2)
    queries = np.column_stack([wanted[:, :2], np.zeros(len(wanted))])
    low, high = charts.min(axis=1), charts.max(axis=1)
    corners = points[body.surface.triangles]
    triangle = np.zeros(len(wanted), dtype=np.int64)
    barycentric = np.tile([1.0, 0.0, 0.0], (len(wanted), 1))
    named = np.zeros(len(wanted), dtype=bool)
    # A place on the seam between charts may miss both by rounding.
    margin = 1e-5 * max(float(np.ptp(charts)), 1e-12)
    for group in groups_of(queries):
        near = np.nonzero(
            np.all(low <= wanted[group, :2].max(axis=0) + margin, axis=1)
            & np.all(high >= wanted[group, :2].min(axis=0) - margin, axis=1)
        )[0]
        if not len(near):
            continue
        place, squared = closest_on_each(queries[group][:, None], flat[None, near])
        spots = np.einsum("qnk,nkd->qnd", place, corners[near])
        away = np.linalg.norm(spots - roots[group][:, None], axis=2)
        away[squared > margin**2] = np.inf
        best = np.argmin(away, axis=1)
        rows = np.arange(len(group))
        hit = np.isfinite(away[rows, best])
        named[group] = hit
        triangle[group[hit]] = near[best[hit]]
        barycentric[group[hit]] = place[rows, best][hit]
    return triangle, barycentric, named
