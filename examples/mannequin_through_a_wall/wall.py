"""The shot: a wall of soft planks held at their outer ends, and someone who walks through. Centimetres, Y up.

Planks come in pairs, one from the left and one from the right, and meet somewhere near the middle.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from pxr import Gf, Sdf, Usd, UsdGeom, Vt

from plait.assets import generate, mannequin
from plait.assets.stages import author_parameters

FIRST, RATE = 1.0, generate.RATE
SAMPLES_PER_FRAME = 2
STEPS = 4
HALF_WIDTH, THICK, GAP = 88.0, 8.0, 2.5  # [cm] of the wall, of a plank, and between planks
LOW, HIGH, ROWS = 6.0, 186.0, 6  # [cm] where the wall begins and ends, of so many pairs of planks
SEAM = 14.0  # [cm] how far from the middle two planks meet, on one side and the other in turn
FACET = 4.5  # [cm] of the planks' triangles
GRIP = 10.0  # [cm] of a plank that its end is held by
CLAY = ((0.47, 0.17, 0.10), (0.55, 0.24, 0.13), (0.40, 0.15, 0.11))  # linear RGB

# In kilograms, centimetres and seconds. Flesh: 3e4 Pa, held as if it swung freely at 4 Hz.
FLESH_HELD = 4.0  # [Hz]
DENSITY = 1e-3
FLESH = {
    "youngsModulus": 300.0,
    "poissonsRatio": 0.45,
    "density": DENSITY,
    "attachStiffness": DENSITY * (2.0 * np.pi * FLESH_HELD) ** 2,
    "stiffnessDamping": 0.005,
    "friction": 0.3,
}
# Foam: 1e5 Pa at 30 kg/m3; `damping` is what air takes.
FOAM = {
    "youngsModulus": 1000.0,
    "poissonsRatio": 0.3,
    "density": 3e-5,
    "stiffnessDamping": 0.01,
    "damping": 1.0,
    "friction": 0.3,
}
HELD = 3e-5 * (2.0 * np.pi * 100.0) ** 2  # a plank's held end: as good as glued


def write(path: Path, frames: int, flesh: float, foam: float, rows: tuple[int, ...], distance: float) -> None:
    """frames: how long it lasts.  flesh, foam: [cm] mean edges of the tets.  rows: those of the planks that there
    are, from the lowest, 0, up.  distance: [cm] of the wall from where the walk begins."""
    last = FIRST + frames
    codes = np.arange(FIRST, last + 1e-6, 1.0 / SAMPLES_PER_FRAME)

    def author(stage: Usd.Stage) -> None:
        UsdGeom.Xform.Define(stage, generate.WORLD)
        generate.author_ground(stage)
        walk = mannequin.straight_walk(STEPS, stride=75.0, period=0.46)
        place = generate.WORLD.AppendChild("Mannequin")
        skin = mannequin.author(stage, place, mannequin.AVERAGE, codes, walk)
        author_parameters(skin.GetPrim(), {**FLESH, "tetEdge": flesh})
        height = (HIGH - LOW) / ROWS
        for row in rows:
            seam = SEAM if row % 2 else -SEAM
            low = LOW + row * height
            for side, ends in (("Left", (seam, HALF_WIDTH)), ("Right", (-HALF_WIDTH, seam))):
                shape = Box(ends, (low, low + height), (distance, distance + THICK))
                plank = _plank(stage, generate.WORLD.AppendPath(f"Wall/{side}{row}"), shape, CLAY[row % 3])
                author_parameters(plank.GetPrim(), {**FOAM, "tetEdge": foam}, role="flesh")

    generate.write(path, author, frames=(FIRST, last))


Range = tuple[float, float]


class Box:
    """A plank: a box with a gap around it, of evenly sized triangles, and how firmly its points are held."""

    def __init__(self, x: Range, y: Range, z: Range) -> None:
        margin = np.array([0.5 * GAP, 0.5 * GAP, 0.0])
        low, high = np.array([x, y, z]).T
        box = trimesh.creation.box(bounds=[low + margin, high - margin])
        self.points, self.triangles = trimesh.remesh.subdivide_to_size(box.vertices, box.faces, 2.0 * FACET)
        self.points, self.triangles = _welded(self.points, self.triangles)
        self.held = np.where(HALF_WIDTH - np.abs(self.points[:, 0]) < GRIP, HELD, 0.0)


def _welded(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    _, first, index = np.unique(points.round(6), axis=0, return_index=True, return_inverse=True)
    return points[first], index.ravel()[triangles]


def _plank(stage: Usd.Stage, path: Sdf.Path, box: Box, colour: tuple[float, float, float]) -> UsdGeom.Mesh:
    mesh = generate.define_mesh(stage, path, box.points, box.triangles)
    mesh.CreateDisplayColorAttr([Gf.Vec3f(*colour)])
    painted = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(
        "plait:attachStiffness", Sdf.ValueTypeNames.FloatArray, UsdGeom.Tokens.vertex
    )
    painted.Set(Vt.FloatArray.FromNumpy(box.held.astype(np.float32)))
    return mesh
