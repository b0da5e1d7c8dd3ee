"""The grid that contact goes through, from a quarter to twice as coarse as the tets: does it matter?

`python example.py [small|default|full]` sets one soft block on another and lets two soft bars meet head on, for
every grid; it prints and checks gaps, overlaps and rebounds, and leaves a picture in `out/`.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh
from pxr import Gf, UsdGeom

from plait.assets import jelly, stages
from plait.pipeline.preview import render
from plait.pipeline.tetrahedra.skin import Inside
from plait.solver.build import build
from plait.solver.scene import Scene, Surface, TetBody
from plait.solver.settings import GridSettings, Settings

YOUNG, DENSITY = 1e5, 1000.0  # [Pa], [kg/m3]
SOUND = (YOUNG / DENSITY) ** 0.5  # [m/s] of long waves in a thin bar
BLOCK = (0.24, 0.16, 0.24)  # [m]
BAR = (0.9, 0.1, 0.1)  # [m]: thin, or waves would run across it too
SPEED = 0.25  # [m/s] of either bar
SETTLING, SETTLING_DAMPING = 2.0, 12.0  # [s], [1/s]
APART = 0.4  # [m] between pairs in the picture
COLOURS = ((0.62, 0.10, 0.08), (0.16, 0.32, 0.50))  # linear RGB


@dataclass(frozen=True)
class Size:
    """edge: [m] of the tets.  cells: of the grid, over that.  meet: whether bars meet, too."""

    edge: float
    cells: tuple[float, ...]
    meet: bool = True


SIZES = {
    "small": Size(0.06, (0.5, 2.0), meet=False),
    "default": Size(0.04, (0.25, 0.5, 1.0, 2.0)),
    "full": Size(0.02, (0.25, 0.5, 1.0, 2.0)),
}


@dataclass(frozen=True)
class Rest:
    """A block that came to rest on another. points: (point_count, 3) [m] of the lower's skin and of the upper's.
    overlap: how deep one is in the other, gap: mean between the faces that met, over the grid cell.
    moving: [m/s], the fastest of these points, over the last frame."""

    points: tuple[np.ndarray, np.ndarray]
    triangles: tuple[np.ndarray, np.ndarray]
    overlap: float
    gap: float
    moving: float


@dataclass(frozen=True)
class Meeting:
    """Two bars that met. rebound: speed apart over speed together.  duration: of the contact over 2 L / c.
    momentum: what their sum is off by, over one's.  energy: after over before."""

    rebound: float
    duration: float
    momentum: float
    energy: float


@dataclass(frozen=True)
class Result:
    """edge: [m] of the tets.  rests, meetings: by grid cell over that."""

    edge: float
    rests: dict[float, Rest]
    meetings: dict[float, Meeting]


def run(size: Size) -> Result:
    rests = {cell: rest(size.edge, cell) for cell in size.cells}
    meetings = {cell: meet(size.edge, cell) for cell in size.cells} if size.meet else {}
    return Result(size.edge, rests, meetings)


def box(extents: tuple[float, float, float], edge: float, index: int, place: tuple[float, float, float], **body):
    """A soft box about `place`, as body and skin `index`."""
    made = trimesh.creation.box(extents=extents)
    points, triangles = trimesh.remesh.subdivide_to_size(made.vertices, made.faces, 1.5 * edge)
    points, first = np.unique(points.round(9), axis=0, return_inverse=True)
    made = first.ravel()[triangles]
    given = {"youngs_modulus": YOUNG, "poissons_ratio": 0.3, "density": DENSITY} | body
    return jelly.soft_body(
        points, made, edge, index=index, surface=index, name=f"box {index}", place=place, **given
    )


def pair(first: tuple[TetBody, Surface], second: tuple[TetBody, Surface], **scene) -> Scene:
    return Scene(surfaces=(first[1], second[1]), bodies=(first[0], second[0]), **scene)


def rest(edge: float, cell: float) -> Rest:
    """A block set down on another, the bottom of which is held."""
    start = BLOCK[1] + 0.25 * edge  # [m] the upper above the lower
    lower, lower_skin = box(BLOCK, edge, 0, (0.0, 0.0, 0.0), mass_damping=SETTLING_DAMPING)
    lower = replace(lower, pinned=lower.nodes[:, 1] < lower.nodes[:, 1].min() + 0.6 * edge)
    upper = box(tuple(0.75 * np.array(BLOCK)), edge, 1, (0.0, start, 0.0), mass_damping=SETTLING_DAMPING)
    simulation = build(pair((lower, lower_skin), upper), _settings(edge, cell))
    stage = simulation.model.parts["tets"]
    for frame in range(1, round(SETTLING * 24) + 1):
        before = stage.points(0), stage.points(1)
        simulation.advance_frame(frame / 24, 4)
    points = stage.points(0), stage.points(1)
    triangles = lower_skin.triangles, upper[1].triangles
    moving = 24.0 * max(float(np.linalg.norm(points[b] - before[b], axis=1).max()) for b in (0, 1))
    simulation.close()
    down, _ = Inside(points[0], triangles[0]).query(points[1])
    up, _ = Inside(points[1], triangles[1]).query(points[0])
    bottom = upper[1].points[:, 1] < upper[1].points[:, 1].min() + 1e-6
    width = cell * edge
    overlap = max(0.0, -float(down.min()), -float(up.min())) / width
    return Rest(points, triangles, overlap, float(down[bottom].mean()) / width, moving)


def meet(edge: float, cell: float) -> Meeting:
    """Two bars that fly at each other, end to end; their waves run along them only, as in theory, with nu = 0."""
    place = 0.5 * BAR[0] + 0.1 * edge
    left, right = (box(BAR, edge, i, (x, 0.0, 0.0), poissons_ratio=0.0) for i, x in ((0, -place), (1, place)))
    simulation = build(pair(left, right, gravity=np.zeros(3)), _settings(edge, cell))
    stage = simulation.model.parts["tets"]
    nodes = [stage.layout.nodes(b) for b in (0, 1)]
    mass = [stage.layout.mass[own] for own in nodes]
    velocity = np.zeros((stage.layout.node_count, 3))
    velocity[nodes[0], 0], velocity[nodes[1], 0] = SPEED, -SPEED
    for name in ("velocity", "velocity_before"):
        simulation.state.arrays[f"tets/{name}"].assign(velocity)
    step = 2.0 * BAR[0] / SOUND / 200.0
    speeds = []
    energies = []
    for frame in range(1, 401):
        metrics = simulation.advance_frame(frame * step, 1)["tets"]
        speeds.append([np.average(stage.node_velocities(b)[:, 0], weights=mass[b]) for b in (0, 1)])
        energies.append(metrics["kinetic_energy"] + metrics["elastic_energy"])
    simulation.close()
    speeds = np.array(speeds)
    # From when a fiftieth of the exchange has happened until as much is to come: .96 of it, at a steady force.
    together = (speeds[0, 0] - speeds[:, 0]) / (speeds[0, 0] - speeds[-1, 0])
    inside = np.flatnonzero((together > 0.02) & (together < 0.98))
    return Meeting(
        rebound=float((speeds[-1, 1] - speeds[-1, 0]) / (2.0 * SPEED)),
        duration=float(inside[-1] - inside[0] + 1) / (0.96 * 200.0),
        momentum=float(abs(speeds[-1].sum()) / SPEED),
        energy=float(max(energies) / energies[0]),
    )


def _settings(edge: float, cell: float) -> Settings:
    return Settings(grid=GridSettings(cell_size=cell * edge))


def table(result: Result) -> str:
    lines = ["cell / edge   gap / cell  overlap / cell   rebound  contact / (2L/c)"]
    for cell, found in result.rests.items():
        line = f"{cell:11.2g}  {found.gap:11.3f}  {found.overlap:14.3f}"
        met = result.meetings.get(cell)
        lines.append(line + (f"  {met.rebound:8.3f}  {met.duration:16.2f}" if met else ""))
    return "\n".join(lines)


def check(result: Result) -> None:
    """What must be seen; AssertionError if it is not."""
    for cell, found in result.rests.items():
        assert found.moving < 1e-2, (cell, found.moving)
        assert found.overlap <= 0.1, (cell, found.overlap)
        assert found.gap <= 0.5, (cell, found.gap)
    for cell, found in result.meetings.items():
        # Equal bars swap their speeds while a wave runs there and back; the rest of the energy rings on in them.
        assert found.rebound >= 0.94, (cell, found.rebound)
        assert abs(found.duration - 1.0) < 0.05, (cell, found.duration)
        assert found.momentum < 1e-4 and found.energy < 1.01, (cell, found)


def write(result: Result, path: Path) -> None:
    """The blocks at rest as a USD stage, from the finest grid to the coarsest, on a cell of each."""
    stage = stages.new_stage(path)
    for column, (cell, found) in enumerate(result.rests.items()):
        x = column * APART
        for half in (0, 1):
            moved = found.points[half] + np.array([x, 0.0, 0.0])
            stages.define_mesh(stage, f"/block_{column}_{half}", moved, found.triangles[half], COLOURS[half])
        cube = UsdGeom.Cube.Define(stage, f"/cell_{column}")
        cube.CreateSizeAttr(cell * result.edge)
        cube.AddTranslateOp().Set(Gf.Vec3d(x, -0.5 * BLOCK[1] - 0.06, 0.5 * BLOCK[2]))
        cube.CreateDisplayColorAttr([Gf.Vec3f(0.35, 0.36, 0.38)])
    middle, away = 0.5 * APART * (len(result.rests) - 1), 2.6 * APART * len(result.rests)
    stages.add_camera(stage, "/Camera", (middle, 0.04 + 0.176 * away, away), 10.0)
    stage.Save()


def main(folder: Path, draw: bool = True, size: str = "default") -> None:
    """Runs, prints, checks, writes, draws."""
    folder.mkdir(parents=True, exist_ok=True)
    result = run(SIZES[size])
    print(table(result))
    check(result)
    path = folder / "grid_and_mesh_size.usdc"
    write(result, path)
    if draw:
        render(path, path.with_suffix(".jpg"), frames=None, size="900x340", camera="/Camera")


if __name__ == "__main__":
    main(Path("out"), size=sys.argv[1] if len(sys.argv) > 1 else "default")
