"""Bodies that lie within one another as they are drawn: an arm's end in a sleeve, a hand in a glove."""

from __future__ import annotations

import itertools
from functools import cache

import numpy as np
import warp as wp

from plait.solver.contact.collision_particles import CollisionParticles
from plait.solver.contact.drawn_together_kernels import find_depths
from plait.solver.launch import Launcher

# [cells] What is less deep only touches.
TOUCHING = 0.05
# Distances looked at in one go.
AT_ONCE = 1 << 22


def drawn_together(
    particles: CollisionParticles, start: np.ndarray, beside: float, launcher: Launcher
) -> tuple[np.ndarray, np.ndarray]:
    """Which particles are not to touch which bodies: those within `beside` [m] of where two overlap at the start.

    They belong together there, like parts of one body that are near each other at rest; pushed apart they could
    never lie as drawn.

    start: (count, 3) float64 [m], the particles where the shot starts.
    Returns offsets (count + 1,) int32 and bodies' indices, ascending for each particle.
    """
    pairs = []
    bodies = range(len(particles.first) - 1)
    own = [slice(int(particles.first[b]), int(particles.first[b + 1])) for b in bodies]
    boxes = [np.stack([start[o].min(axis=0), start[o].max(axis=0)]) for o in own]
    mesh = cache(lambda body: _mesh(particles, start, body, launcher))
    for a, b in itertools.combinations(bodies, 2):
        if np.any(boxes[a][0] > boxes[b][1]) or np.any(boxes[b][0] > boxes[a][1]):
            continue
        within = [
            start[own[i]][_inside(mesh(j), start[own[i]], boxes[j], TOUCHING * particles.spacing, launcher)]
            for i, j in ((a, b), (b, a))
        ]
        overlap = np.concatenate(within)
        for i, j in ((a, b), (b, a)):
            near = own[i].start + _near(start[own[i]], overlap, beside)
            pairs.append(np.stack([near, np.full_like(near, j)], axis=1))
    found = np.concatenate(pairs) if pairs else np.zeros((0, 2), dtype=np.int64)
    found = found[np.lexsort((found[:, 1], found[:, 0]))]
    offsets = np.searchsorted(found[:, 0], np.arange(particles.count + 1))
    return offsets.astype(np.int32), found[:, 1].astype(np.int32)


def _mesh(particles: CollisionParticles, start: np.ndarray, body: int, launcher: Launcher) -> wp.Mesh | None:
    triangles = particles.triangles[particles.triangle_body == body]
    if not len(triangles):
        return None
    used, local = np.unique(triangles, return_inverse=True)
    points = wp.array(start[used], dtype=wp.vec3f, device=launcher.device)
    indices = wp.array(local.ravel(), dtype=wp.int32, device=launcher.device)
    return wp.Mesh(points, indices, support_winding_number=True)


def _inside(
    mesh: wp.Mesh | None, points: np.ndarray, box: np.ndarray, tolerance: float, launcher: Launcher
) -> np.ndarray:
    """(n,) indices of the points deeper than `tolerance` [m] in the mesh, whose box is `box`."""
    asked = np.flatnonzero(np.all((points >= box[0]) & (points <= box[1]), axis=1))
    if mesh is None or not len(asked):
        return asked[:0]
    held = wp.array(points[asked], dtype=wp.vec3f, device=launcher.device)
    depth = wp.zeros(len(asked), dtype=wp.float32, device=launcher.device)
    launcher.launch(find_depths, len(asked), [wp.uint64(mesh.id), held], [depth], work_per_item=100)
    return asked[depth.numpy() > tolerance]


def _near(points: np.ndarray, others: np.ndarray, distance: float) -> np.ndarray:
    """(n,) indices of the points within `distance` [m] of any of `others`."""
    if not len(others):
        return np.zeros(0, dtype=np.int64)
    box = np.stack([others.min(axis=0) - distance, others.max(axis=0) + distance])
    asked = np.flatnonzero(np.all((points >= box[0]) & (points <= box[1]), axis=1))
    near = np.zeros(len(asked), dtype=bool)
    size = max(1, AT_ONCE // len(others))
    for first in range(0, len(asked), size):
        apart = points[asked[first : first + size], None] - others
        near[first : first + size] = (np.einsum("abi,abi->ab", apart, apart) <= distance**2).any(axis=1)
    return asked[near]
