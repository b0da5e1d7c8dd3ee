"""Particles that fill a closed surface."""

from __future__ import annotations

import numpy as np
import warp as wp

from plait.solver.granular.filling_kernels import find_inside
from plait.solver.launch import Launcher

# Winding numbers of so many places are taken at once, so that a large box needs little memory.
CHUNK = 1 << 20
# Cost of a winding number in units of `Launcher.launch`.
QUERY_WORK = 100


def fill_surface(
    points: np.ndarray,
    triangles: np.ndarray,
    cell_size: float,
    per_cell: int,
    launcher: Launcher,
    *,
    jitter: float = 0.5,
    seed: int = 0,
) -> tuple[np.ndarray, float]:
    """(particle_count, 3) float64 [m] places inside a closed surface, and the volume [m3] that each stands for.

    A regular lattice of `per_cell` places to a cell of `cell_size` [m], each moved at random by up to `jitter` of
    half its spacing: 0 leaves the lattice, 1 spreads it evenly. The same surface gives the same places; a surface
    that is moved by whole spacings gives them moved with it. Inside is where the winding number is above a half
    (Jacobson et al. 2013), so that gaps and overlaps do no harm.

    points: (point_count, 3) [m].  triangles: (triangle_count, 3) int, counter-clockwise seen from outside.
    """
    spacing = cell_size / per_cell ** (1.0 / 3.0)
    centre = points.mean(axis=0)  # float32 trees: about the middle they keep their digits
    lower = np.floor(points.min(axis=0) / spacing).astype(np.int64)
    upper = np.floor(points.max(axis=0) / spacing).astype(np.int64) + 1
    mesh = wp.Mesh(
        wp.array(points - centre, dtype=wp.vec3f, device=launcher.device),
        wp.array(np.ascontiguousarray(triangles, dtype=np.int32).ravel(), dtype=wp.int32, device=launcher.device),
        support_winding_number=True,
    )
    random = np.random.default_rng(seed)
    layers = max(1, CHUNK // int(np.prod((upper - lower)[1:])))
    kept = []
    for x in range(lower[0], upper[0], layers):
        corner = np.array([x, *lower[1:]])
        shape = np.array([min(x + layers, upper[0]), *upper[1:]]) - corner
        places = np.indices(shape).reshape(3, -1).T + corner + 0.5
        places = spacing * (places + 0.5 * jitter * random.uniform(-1.0, 1.0, places.shape))
        kept.append(places[_inside(mesh, places - centre, launcher)])
    return np.concatenate(kept), spacing**3


def _inside(mesh: wp.Mesh, places: np.ndarray, launcher: Launcher) -> np.ndarray:
    asked = wp.array(places, dtype=wp.vec3f, device=launcher.device)
    inside = wp.zeros(len(places), dtype=wp.int32, device=launcher.device)
    launcher.launch(find_inside, len(places), [mesh.id, asked], [inside], work_per_item=QUERY_WORK)
    return inside.numpy() == 1
