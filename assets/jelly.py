"""Soft props for scenes made by hand: a jelly bear, a ball, and elastic bodies of such skins. Metres, Y up."""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh

from plait.assets.implicit import blend, ellipsoid, polygonise, relax, round_cone, simplify
from plait.pipeline.flesh import embed, fill, fractions
from plait.solver.scene import StaticMotion, Surface, TetBody


def bear(triangles: int = 2400) -> tuple[np.ndarray, np.ndarray]:
    """A sitting bear, 0.2 m high: points (n, 3) about its middle, and about that many triangles (m, 3), closed."""
    points, faces = polygonise(bear_distance, (-0.09, -0.12, -0.08), (0.09, 0.12, 0.10), 0.004)
    points, faces = simplify(points, faces, triangles)
    return relax(bear_distance, points, faces, 4), faces


def bear_distance(points: np.ndarray) -> np.ndarray:
    """(n,) signed distance [m] to the bear, which is its own mirror image."""
    p = np.column_stack([np.abs(points[:, 0]), points[:, 1:]])
    d = ellipsoid(p, (0.0, -0.040, 0.0), (0.052, 0.060, 0.045))
    d = blend(d, ellipsoid(p, (0.0, -0.082, -0.040), (0.022, 0.018, 0.022)), 0.010)
    d = blend(d, ellipsoid(p, (0.0, 0.050, 0.004), (0.042, 0.038, 0.038)), 0.015)
    d = blend(d, ellipsoid(p, (0.0, 0.040, 0.040), (0.018, 0.015, 0.016)), 0.010)
    d = blend(d, ellipsoid(p, (0.034, 0.083, 0.0), (0.016, 0.016, 0.011)), 0.006)
    d = blend(d, round_cone(p, (0.040, 0.0, 0.015), (0.066, -0.025, 0.045), 0.019, 0.017), 0.008)
    return blend(d, round_cone(p, (0.034, -0.078, 0.010), (0.050, -0.080, 0.070), 0.022, 0.020), 0.008)


def ball(radius: float, subdivisions: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) about the middle and triangles (m, 3)."""
    sphere = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return np.array(sphere.vertices, dtype=np.float64), np.array(sphere.faces, dtype=np.int32)


def fitted(points: np.ndarray, onto: np.ndarray) -> np.ndarray:
    """`points` moved and turned to where they fit `onto` best in the mean square (Kabsch 1976); (n, 3) each."""
    middle, other = points.mean(axis=0), onto.mean(axis=0)
    u, _, vt = np.linalg.svd((points - middle).T @ (onto - other))
    keep = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    return (points - middle) @ (u @ keep @ vt) + other


def off_shape(rest: np.ndarray, points: np.ndarray) -> float:
    """Largest distance from the rest shape, put where it fits best, over the diagonal of its bounding box."""
    away = np.linalg.norm(fitted(rest, points) - points, axis=1)
    return float(away.max() / np.linalg.norm(np.ptp(rest, axis=0)))


def soft_body(
    points: np.ndarray,
    triangles: np.ndarray,
    edge: float,
    *,
    index: int = 0,
    surface: int = 0,
    name: str = "jelly",
    youngs_modulus: float = 2e4,
    poissons_ratio: float = 0.4,
    density: float = 1000.0,
    friction: float | None = None,
    place: tuple[float, float, float] = (0.0, 0.0, 0.0),
    **body: Any,
) -> tuple[TetBody, Surface]:
    """A free elastic body filled with tets of mean edge `edge` [m], and its skin.

    index, surface: where the two will stand in `Scene.bodies` and `Scene.surfaces`.  place: [m] where its middle
    starts.  body: any other field of `TetBody`.
    """
    lattice = fill(points, triangles, edge=edge)
    embedding, _ = embed(points, lattice)
    part = fractions(lattice, points, triangles)
    transform = np.eye(4)
    transform[:3, 3] = place
    motion = StaticMotion(transform)
    flesh = TetBody(
        name,
        lattice.nodes,
        lattice.tets,
        surface,
        embedding,
        part * density,
        part * youngs_modulus,
        np.full(len(part), poissons_ratio),
        np.zeros(len(lattice.nodes), dtype=bool),
        np.zeros(len(lattice.nodes)),
        motion=motion,
        **body,
    )
    skin = Surface(
        f"{name} skin", points, triangles.astype(np.int32), motion=motion, friction=friction, body=index
    )
    return flesh, skin
