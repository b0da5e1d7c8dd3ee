"""The sample's groom: layered, slightly wavy hair to the shoulders, parted, lying outside the skin as modelled."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from plait.assets.character import HEAD_MIDDLE, azimuth, body_distance, scalp
from plait.assets.implicit import gradient

STEP = 0.2  # [cm] strands are grown by
FIRST = 0.8  # [cm] of the first segment, which leaves along the normal
SEED = 7


@dataclass(frozen=True)
class Style:
    """strands; points: of each.  length [cm]: of the lowest, and what the highest have more.
    clearance: [cm] least distance of a strand's points from the modelled surface.
    layers: [cm] by which the highest strands lie over the lowest.  wave: [cm] its size at the tips.
    distance: (n, 3) points [cm] to (n,) signed distance [cm] from the modelled surface.
    """

    strands: int = 640
    points: int = 22
    length: tuple[float, float] = (20.6, 8.2)
    clearance: float = 0.35
    layers: float = 1.1
    wave: float = 0.42
    distance: Callable[[np.ndarray], np.ndarray] = body_distance


SAMPLE = Style()


@dataclass(frozen=True)
class Groom:
    """points (strands, points, 3) [cm]; roots: face (strands,), uv (strands, 2), weights of corners 1 and 2."""

    points: np.ndarray
    face: np.ndarray
    uv: np.ndarray


def build(points: np.ndarray, triangles: np.ndarray, style: Style = SAMPLE) -> Groom:
    """The groom on a skin of points (n, 3) [cm] and triangles (m, 3)."""
    random = np.random.Generator(np.random.PCG64(SEED))
    face, uv = scatter(points, triangles, random, style.strands)
    corners = points[triangles[face]]
    weights = np.column_stack([1.0 - uv.sum(axis=1), uv])
    roots = np.einsum("sk,skd->sd", weights, corners)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    return Groom(grow(roots, normals, random, style), face, uv)


def scatter(
    points: np.ndarray, triangles: np.ndarray, random: np.random.Generator, strands: int
) -> tuple[np.ndarray, np.ndarray]:
    """Faces and places on them, evenly apart: of many random places always the one farthest from those chosen."""
    corners = points[triangles]
    on_scalp = np.nonzero(scalp(corners.mean(axis=1)) < 0.0)[0]
    edges = corners[on_scalp, 1:] - corners[on_scalp, :1]
    area = 0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    count = 16 * strands
    face = on_scalp[np.searchsorted(np.cumsum(area) / area.sum(), random.random(count))]
    uv = random.random((count, 2))
    uv = np.where(uv.sum(axis=1, keepdims=True) > 1.0, 1.0 - uv, uv)
    uv = 0.02 + 0.94 * uv  # not on an edge
    places = np.einsum("sk,skd->sd", np.column_stack([1.0 - uv.sum(axis=1), uv]), corners[face])
    allowed = scalp(places) < 0.0
    face, uv, places = face[allowed], uv[allowed], places[allowed]
    chosen = [int(np.argmax(places[:, 1]))]
    far = np.linalg.norm(places - places[chosen[0]], axis=1)
    while len(chosen) < strands:
        chosen.append(int(np.argmax(far)))
        far = np.minimum(far, np.linalg.norm(places - places[chosen[-1]], axis=1))
    order = np.array(sorted(chosen, key=lambda k: (places[k, 1], k)))
    return face[order], uv[order]


def part_line(z: np.ndarray) -> np.ndarray:
    """x of the parting, a little on the left, that runs back from the brow and ends at the crown."""
    return 1.6 * np.clip((z + 5.0) / 6.0, 0.0, 1.0)


def grow(roots: np.ndarray, normals: np.ndarray, random: np.random.Generator, style: Style) -> np.ndarray:
    """(strands, points, 3): from the root over the head towards its own place at ear height, then down."""
    count = len(roots)
    height = np.clip((roots[:, 1] - 156.0) / 18.0, 0.0, 1.0)
    length = style.length[0] + style.length[1] * height + random.uniform(-0.5, 0.9, count)
    lift = style.clearance + 0.15 + style.layers * height**1.5 + random.uniform(0.0, 0.35, count)
    side = np.where(roots[:, 0] > part_line(roots[:, 2]), 1.0, -1.0)
    target = hanging_places(roots, side)
    paths = [roots, roots + FIRST * normals]
    direction = normals.copy()
    for _ in range(int(np.ceil((length.max() - FIRST) / STEP)) + 8):
        place = paths[-1]
        wanted = towards(place, target)
        direction = direction + 0.16 * wanted
        direction /= np.linalg.norm(direction, axis=1)[:, None]
        moved = outside(place + STEP * direction, lift, style.distance)
        direction = (moved - place) / np.linalg.norm(moved - place, axis=1)[:, None]
        paths.append(moved)
    grown = np.stack(paths, axis=1)
    points = resample(grown, length, style.points)
    return settle(wave(points, roots, style.wave), points, style)


def hanging_places(roots: np.ndarray, side: np.ndarray) -> np.ndarray:
    """(n, 3) where each strand comes down: front hair beside the cheeks, the rest spread evenly to the nape."""
    around = azimuth(roots)
    rank = np.empty(len(roots))
    for sign in (-1.0, 1.0):
        own = np.nonzero(side == sign)[0]
        rank[own[np.argsort(around[own], kind="stable")]] = np.linspace(0.0, 1.0, len(own))
    angle = np.radians(84.0 + 94.0 * rank)
    return HEAD_MIDDLE + np.column_stack(
        [side * 10.4 * np.sin(angle), np.full(len(roots), -5.0), 2.0 + 12.5 * np.cos(angle)]
    )


def towards(places: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Unit vectors: to the target above its height, turning straight down near it."""
    offset = target - places
    above = np.clip(-offset[:, 1] / 6.0, 0.0, 1.0)[:, None]
    sideways = offset * (1.0, 0.0, 1.0)
    wanted = above * sideways / np.maximum(np.linalg.norm(sideways, axis=1), 3.0)[:, None]
    wanted[:, 1] -= 0.75
    return wanted / np.linalg.norm(wanted, axis=1)[:, None]


def outside(points: np.ndarray, level: np.ndarray, distance: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Points nearer to the body than `level` moved out along the distance's gradient."""
    moved = points.copy()
    for _ in range(2):
        short = level - distance(moved)
        inside = np.nonzero(short > 0.0)[0]
        if not len(inside):
            break
        slope = gradient(distance, moved[inside])
        slope /= np.linalg.norm(slope, axis=1)[:, None]
        moved[inside] += slope * short[inside, None]
    return moved


def resample(grown: np.ndarray, length: np.ndarray, count: int) -> np.ndarray:
    """(n, count, 3): the first segment, then equal ones, to each strand's length."""
    step = np.linalg.norm(np.diff(grown, axis=1), axis=2)
    along = np.concatenate([np.zeros((len(grown), 1)), np.cumsum(step, axis=1)], axis=1)
    result = np.empty((len(grown), count, 3))
    for k in range(len(grown)):
        wanted = np.concatenate([[0.0], np.linspace(FIRST, length[k], count - 1)])
        for axis in range(3):
            result[k, :, axis] = np.interp(wanted, along[k], grown[k, :, axis])
    return result


def wave(points: np.ndarray, roots: np.ndarray, largest: float) -> np.ndarray:
    """A wave that grows towards the tip; neighbours share its phase, so that locks form."""
    tangent = np.gradient(points, axis=1)
    tangent /= np.linalg.norm(tangent, axis=2, keepdims=True)
    away = points - (HEAD_MIDDLE - (0.0, 4.0, 0.0))
    away[..., 1] = 0.0
    across = np.cross(tangent, away)
    across /= np.linalg.norm(across, axis=2, keepdims=True)
    phase = 2.2 * np.sin(0.55 * roots[:, 0] + 1.0) + 2.2 * np.sin(0.5 * roots[:, 2]) + 0.5 * roots[:, 1]
    along = np.linspace(0.0, 1.0, points.shape[1])[None]
    size = largest * np.clip((along - 0.2) / 0.5, 0.0, 1.0) ** 1.5
    return points + across * (size * np.sin(2.0 * np.pi * 3.3 * along + phase[:, None]))[..., None]


def settle(waved: np.ndarray, straight: np.ndarray, style: Style) -> np.ndarray:
    """Where the wave would lead a strand too near the body, it is moved out again; the first segment is kept."""
    free = waved[:, 2:].reshape(-1, 3)
    result = waved.copy()
    level = np.full(len(free), style.clearance)
    result[:, 2:] = outside(free, level, style.distance).reshape(len(waved), -1, 3)
    result[:, :2] = straight[:, :2]
    return result
