"""The same with everything as traditional MPM: bunny and sand are particles that share a grid."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from plait.solver.build import build
from plait.solver.granular.filling import fill_surface
from plait.solver.launch import Launcher
from plait.solver.scene import Emitter, Granular, Scene, Surface
from plait.solver.settings import Settings

SHOT = runpy.run_path(str(Path(__file__).parent / "bunnies.py"))


def share_left(frames: int, spacing: float, poured: float) -> float:
    """The part of the sand that lies over the bunny in the end; as `Bunny.held`, with grains for its skin."""
    points, triangles = SHOT["bunny"]()
    launcher = Launcher("cpu", 1)
    places, volume = fill_surface(
        points + np.array([0.0, SHOT["CLEAR"], 0.0]), triangles, 2.0 * spacing, 8, launcher
    )
    launcher.close()
    simulation = build(
        Scene((_floor(),), granular=(_bunny(places, volume), _sand(points, spacing, poured))), Settings()
    )
    for frame in range(frames):
        simulation.advance_frame((frame + 1) / SHOT["RATE"])
    stage = simulation.model.parts["granular"]
    flesh, sand = stage.grains(0).positions, stage.grains(1).positions
    simulation.close()
    apart, below = cKDTree(flesh[:, [0, 2]]).query(sand[:, [0, 2]], k=8)
    over = (apart < 2.0 * spacing) & (flesh[below, 1] < sand[:, None, 1])
    return float(over.any(axis=1).mean())


def _floor() -> Surface:
    points = np.array([[-1.0, 0.0, -1.0], [-1.0, 0.0, 1.0], [1.0, 0.0, 1.0], [1.0, 0.0, -1.0]])
    return Surface("floor", points, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32), friction=0.9)


def _bunny(places: np.ndarray, volume: float) -> Granular:
    count, modulus = len(places), SHOT["YOUNGS_MODULUS"]
    of_each = (np.zeros((count, 3)), np.full(count, volume), np.full(count, volume ** (1 / 3)), np.arange(count))
    return Granular(
        "bunny", "elastic", places, *of_each, density=1000.0, youngs_modulus=modulus, poissons_ratio=0.4
    )


def _sand(points: np.ndarray, spacing: float, poured: float) -> Granular:
    half, speed = np.array(SHOT["SPOUT"]), SHOT["SPEED"]
    middle = np.array([SHOT["ASIDE"], points[:, 1].max() + SHOT["FALL"], 0.0])
    rate = 4.0 * half[0] * half[2] * speed / spacing**3
    emitter = Emitter(
        rate=rate,
        limit=int(np.ceil(rate * poured)),
        lower=middle - half,
        upper=middle + half,
        velocity=np.array([0.0, -speed, 0.0]),
        volume=spacing**3,
        width=spacing,
    )
    none, empty = np.zeros((0, 3)), np.zeros(0)
    ids = np.zeros(0, dtype=np.int64)
    return Granular(
        "sand", "sand", none, none, empty, empty, ids, friction_angle=np.radians(30.0), emitter=emitter
    )
