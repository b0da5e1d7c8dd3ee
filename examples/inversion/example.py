"""A jelly bear that starts flat, inside out or crumpled, on coarse and fine grids, beside plain MPM.

`python example.py [small|default|full]` runs both, prints and checks what is left of the deformation, and leaves
`out/inversion.usdc` with a picture.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from plait.assets import jelly, stages
from plait.pipeline.preview import render
from plait.solver.build import build
from plait.solver.scene import Scene, Surface
from plait.solver.settings import GridSettings, Settings
from plait.solver.tets.layout import TetLayout, build_layout

sys.path.insert(0, str(Path(__file__).parent))
from plain_mpm import recover

FRAMES_PER_SECOND = 24
DAMPING = 10.0  # [1/s] of all motion, in both methods
APART = 0.28  # [m] between bears in the picture
COLOURS = {0.5: (0.62, 0.10, 0.08), 1.0: (0.75, 0.42, 0.05), 2.0: (0.16, 0.36, 0.14)}  # linear RGB, by grid
GREY = (0.35, 0.36, 0.38)


@dataclass(frozen=True)
class Size:
    """edge: [m] of the tets.  starts: which of `starts`.  cells: of the grid, over the edge of the tets.
    seconds, plain_seconds: simulated, by the method and by plain MPM."""

    edge: float
    starts: tuple[str, ...]
    cells: tuple[float, ...]
    seconds: float = 4.0
    plain_seconds: float = 1.0


ALL = ("crumpled", "flat", "inside out")
SIZES = {
    "small": Size(0.03, ("crumpled", "flat"), (0.5, 2.0), plain_seconds=0.4),
    "default": Size(0.03, ALL, (0.5, 1.0, 2.0)),
    "full": Size(0.012, ALL, (0.5, 1.0, 2.0), seconds=6.0),
}


@dataclass(frozen=True)
class Result:
    """Nodes (node_count, 3) [m]: at rest, as they start, and as the method and plain MPM leave them, by start and,
    for these two, by grid cell over the edge of the tets."""

    layout: TetLayout
    skin: Surface
    started: dict[str, np.ndarray]
    hybrid: dict[tuple[str, float], np.ndarray]
    plain: dict[tuple[str, float], np.ndarray]

    def error(self, nodes: np.ndarray) -> float:
        """Largest distance from the rest shape, put where it fits best, over the diagonal of its bounding box."""
        return jelly.off_shape(self.layout.rest, nodes)


def starts(rest: np.ndarray, edge: float) -> dict[str, np.ndarray]:
    """Every one of them with about half of its tets inside out, or with all."""
    random = np.random.default_rng(0)
    return {
        "crumpled": rest + random.uniform(-0.6 * edge, 0.6 * edge, rest.shape),
        # As thin as a thousandth of an edge; exactly flat, no force would lead out of the plane.
        "flat": rest * (1.0, 1.0, 0.0) + 1e-3 * edge * random.normal(size=rest.shape),
        "inside out": rest * (1.0, 1.0, -1.0),
    }


def run(size: Size) -> Result:
    """All starts on all grids, by both methods."""
    body, skin = jelly.soft_body(*jelly.bear(), size.edge, youngs_modulus=2e4, mass_damping=DAMPING)
    scene = Scene(surfaces=(skin,), bodies=(body,), gravity=np.zeros(3))
    layout = build_layout(scene)
    edge = float(layout.edge[0])
    started = {name: nodes for name, nodes in starts(layout.rest, edge).items() if name in size.starts}
    hybrid, plain = {}, {}
    for name, cell in product(size.starts, size.cells):
        hybrid[name, cell] = _hybrid(scene, started[name], cell * edge, size.seconds)
        plain[name, cell] = recover(layout, started[name], cell * edge, size.plain_seconds, DAMPING)
    return Result(layout, skin, started, hybrid, plain)


def _hybrid(scene: Scene, start: np.ndarray, cell: float, seconds: float) -> np.ndarray:
    simulation = build(scene, Settings(substeps=2, grid=GridSettings(cell_size=cell)))
    for name in ("position", "position_before"):
        simulation.state.arrays[f"tets/{name}"].assign(start)
    for frame in range(1, round(seconds * FRAMES_PER_SECOND) + 1):
        simulation.advance_frame(frame / FRAMES_PER_SECOND)
    nodes = simulation.model.parts["tets"].nodes(0)
    simulation.close()
    return nodes


def table(result: Result) -> str:
    """What is left of each start, of the diagonal."""
    lines = ["start         cell / edge        plait    plain MPM"]
    for (name, cell), nodes in result.hybrid.items():
        plain = result.error(result.plain[name, cell])
        lines.append(f"{name:12s}  {cell:11.2g}  {result.error(nodes):11.1e}  {plain:11.1e}")
    return "\n".join(lines)


def check(result: Result) -> None:
    """What must be seen; AssertionError if it is not."""
    for key, nodes in result.hybrid.items():
        assert result.error(nodes) < 1e-6, key
    # The comparison means something: plain MPM is stuck, and by far.
    for key, nodes in result.plain.items():
        assert result.error(nodes) > 0.02, key


def write(result: Result, path: Path) -> None:
    """A USD stage, a row a start: the start in grey, then, by grid, plain MPM, then the method."""
    stage = stages.new_stage(path)
    cells = sorted({cell for _, cell in result.hybrid})
    for row, (name, started) in enumerate(result.started.items()):
        places = [(started, GREY)]
        places += [(result.plain[name, cell], COLOURS[cell]) for cell in cells]
        places += [(result.hybrid[name, cell], COLOURS[cell]) for cell in cells]
        for column, (nodes, colour) in enumerate(places):
            extra = 0.5 * (column > 0) + 0.5 * (column > len(cells))
            offset = np.array([(column + extra) * APART, -row * APART, 0.0])
            points = _skin_points(result, jelly.fitted(nodes, result.layout.rest)) + offset
            mesh = stages.define_mesh(stage, f"/bear_{row}_{column}", points, result.skin.triangles, colour)
            mesh.CreateDoubleSidedAttr(True)
    width, height = (2 * len(cells) + 2) * APART, (len(result.started) - 1) * APART
    stages.add_camera(stage, "/Camera", (0.5 * width - 0.5 * APART, -0.5 * height, 2.6 * width), 0.0)
    stage.Save()


def _skin_points(result: Result, nodes: np.ndarray) -> np.ndarray:
    embedding = result.layout.bodies[0].embedding
    return np.einsum("pk,pkd->pd", embedding.barycentric, nodes[result.layout.skin_nodes(0)])


def main(folder: Path, draw: bool = True, size: str = "default") -> None:
    """Runs, prints, checks, writes, draws."""
    folder.mkdir(parents=True, exist_ok=True)
    result = run(SIZES[size])
    print(table(result))
    check(result)
    path = folder / "inversion.usdc"
    write(result, path)
    if draw:
        render(path, path.with_suffix(".jpg"), frames=None, size="1000x470", camera="/Camera")


if __name__ == "__main__":
    main(Path("out"), size=sys.argv[1] if len(sys.argv) > 1 else "default")
