"""Bodies brought into states that no motion leads to, or bent and popped by a skeleton; and how far from rest."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from plait.assets.jelly import off_shape
from plait.pipeline.flesh import fill
from plait.solver.build import build
from plait.solver.scene import Pose, Scene, Skinning, Surface, TetBody
from plait.solver.settings import FleshSettings, Settings
from plait.solver.step import Simulation

from ..contact.soft_scenes import solid_box
from .lattices import box_body, box_lattice, keyed, placed, tet_body

FRAME = 1.0 / 24.0
KINDS = ("flat", "point", "scrambled", "mirrored")
# What must hold: the largest deviation from the rest shape, by its diagonal; and speeds [m/s] after a jump.
PROMISE, POP_SPEED = 1e-6, 2.0
COARSE_ELBOW = {"core": 0.55, "across": 3}
ELBOW = {"core": 0.55}
KNEE = {"core": 0.7, "radii": (0.07, 0.045), "length": 0.7}


def bunny(budget: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and tets over Warp's own bunny, 30 cm long."""
    from pxr import Usd, UsdGeom

    stage = Usd.Stage.Open(str(Path(wp.__file__).parent / "examples/assets/bunny.usd"))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/root/bunny"))
    points = np.array(mesh.GetPointsAttr().Get(), dtype=float)
    triangles = np.array(mesh.GetFaceVertexIndicesAttr().Get(), dtype=np.int32).reshape(-1, 3)
    lattice = fill(0.3 * points / np.ptp(points, axis=0).max(), triangles, budget=budget)
    return lattice.nodes, lattice.tets


def broken(nodes: np.ndarray, kind: str, seed: int) -> np.ndarray:
    """`nodes` flattened onto a plane, drawn together in a point but for a millionth, scrambled, or mirrored."""
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=3)
    normal /= np.linalg.norm(normal)
    size = np.ptp(nodes, axis=0)
    if kind == "flat":
        return nodes - np.outer(nodes @ normal, normal)
    if kind == "point":
        return rng.normal(size=nodes.shape) * 1e-6 * size.max()
    if kind == "scrambled":
        return nodes.min(axis=0) + rng.uniform(size=nodes.shape) * size
    assert kind == "mirrored"
    return nodes - 2.0 * np.outer(nodes @ normal, normal)


def simulate(
    body: TetBody, *surfaces: Surface, substeps: int = 1, integrator: str = "bdf2", **scene: Any
) -> Simulation:
    scene = {"gravity": np.zeros(3)} | scene
    settings = Settings(substeps=substeps, flesh=FleshSettings(integrator=integrator))
    return build(Scene(surfaces=surfaces, bodies=(body,), **scene), settings)


def put(simulation: Simulation, position: np.ndarray) -> None:
    """The nodes at `position`, at rest."""
    arrays = simulation.state.arrays
    for name in ("position", "position_before"):
        arrays[f"tets/{name}"].assign(position)


def diagonal(rest: np.ndarray) -> float:
    return float(np.linalg.norm(np.ptp(rest, axis=0)))


def recover(
    nodes: np.ndarray,
    tets: np.ndarray,
    kind: str,
    seed: int,
    *,
    touching: bool = True,
    frames: int = 240,
    goal: float = 0.5 * PROMISE,
) -> tuple[float, dict[str, Any]]:
    """Deviation after at most `frames`, less once it is below `goal`; and the metrics, tangles added up.

    Backward Euler and a drag of 2 / s, so that what swings comes to rest within seconds.
    touching: with contact of the skin with itself, which takes its time where all of it is in one place.
    """
    body, skin = tet_body(nodes, tets, mass_damping=2.0, youngs_modulus=5e4)
    simulation = simulate(body, skin, integrator="backward-euler")
    put(simulation, broken(nodes, kind, seed))
    stage, tangles = simulation.model.parts["tets"], 0
    if not touching:
        stage._contact = None
    for frame in range(frames):
        metrics = simulation.advance_frame((frame + 1) * FRAME)["tets"]
        tangles += metrics["tangles"]
        left = off_shape(nodes, stage.nodes(0))
        if left < goal:
            break
    simulation.close()
    return left, metrics | {"tangles": tangles}


class Bent:
    """Two bones along x that meet in the origin.

    angle(time): [rad] of the second about z.  shift(time): [m] of both along y.
    """

    animated = True

    def __init__(
        self, angle: Callable[[float], float], shift: Callable[[float], float] = lambda time: 0.0
    ) -> None:
        self._angle, self._shift = angle, shift

    def pose(self, time: float) -> Pose:
        transforms = np.stack([np.eye(4)] * 2)
        c, s = np.cos(self._angle(time)), np.sin(self._angle(time))
        transforms[1, :2, :2] = [[c, -s], [s, c]]
        transforms[:, 1, 3] += self._shift(time)
        return Pose(transforms)


def limb(
    motion: Bent, *, radii: tuple[float, float] = (0.04, 0.04), length: float = 0.5, across: int = 4, core: float
) -> tuple[TetBody, Surface]:
    """A tapered capsule about two bones, `across` cells thick.

    Nodes within `core` of the local radius of a bone are pinned, none within one radius of the joint.
    """
    cell = 2.0 * max(radii) / across
    along = 2 * round(0.5 * length / cell)
    nodes, tets = box_lattice((along * cell, across * cell, across * cell), (along, across, across))

    def radius(x: np.ndarray) -> np.ndarray:
        return np.interp(x, [-0.5 * length, 0.5 * length], radii)

    middle = nodes[tets].mean(axis=1)
    beyond = np.maximum(np.abs(middle[:, 0]) - 0.5 * length + radii[0], 0.0)
    inside = np.linalg.norm(np.c_[beyond, middle[:, 1:]], axis=1) < radius(middle[:, 0])
    used, tets = np.unique(tets[inside], return_inverse=True)
    nodes, tets = nodes[used], tets.reshape(-1, 4).astype(np.int32)
    x, local = nodes[:, 0], radius(nodes[:, 0])
    pinned = (np.hypot(nodes[:, 1], nodes[:, 2]) < core * local) & (np.abs(x) >= local)
    blend = np.clip(x / local, -1.0, 1.0)
    weight = 0.5 + 0.75 * blend - 0.25 * blend**3
    joints = np.tile(np.arange(2, dtype=np.int32), (len(nodes), 1))
    skinning = Skinning(joints, np.column_stack([1.0 - weight, weight]))
    return tet_body(
        nodes, tets, pinned=pinned, skinning=skinning, motion=motion, youngs_modulus=3e4, poissons_ratio=0.45,
        mass_damping=10.0,
    )  # fmt: skip


def smooth_step(t: float) -> float:
    t = min(max(t, 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


def unbend(shape: dict[str, Any]) -> tuple[float, float]:
    """A limb bent to 120 degrees within half a second, and back.

    The furthest that a node was from rest, and in the end, both by the diagonal.
    """

    def angle(time: float) -> float:
        return np.radians(120.0) * smooth_step(2.0 * time) * (1.0 - smooth_step(2.0 * (time - 0.6)))

    body, skin = limb(Bent(angle), **shape)
    simulation = simulate(body, skin, substeps=4)
    stage, furthest = simulation.model.parts["tets"], 0.0
    for frame in range(96):
        simulation.advance_frame((frame + 1) * FRAME)
        left = np.linalg.norm(stage.nodes(0) - body.nodes, axis=1).max() / diagonal(body.nodes)
        furthest = max(furthest, left)
    simulation.close()
    return furthest, left


def jump(shape: dict[str, Any], degrees: float, shift: float, lasts: float) -> tuple[int, float]:
    """A joint turned and moved [m] at once, or within `lasts` [s].

    The pops noticed, and the highest speed [m/s] that a frame ends with: not a number if one is.
    """

    def part(time: float) -> float:
        since = time - 2.0 * FRAME
        return float(since > 0.0) if lasts == 0.0 else min(max(since / lasts, 0.0), 1.0)

    body, skin = limb(Bent(lambda t: np.radians(degrees) * part(t), lambda t: shift * part(t)), **shape)
    simulation = simulate(body, skin, substeps=8)
    stage, pops, highest = simulation.model.parts["tets"], 0, 0.0
    for frame in range(24):
        pops += simulation.advance_frame((frame + 1) * FRAME)["tets"]["pops"]
        if frame >= 2:
            highest = np.maximum(highest, np.linalg.norm(stage.node_velocities(0), axis=1).max())
    simulation.close()
    return pops, float(highest)


def crush(cells: int) -> tuple[float, float]:
    """A box pressed to a tenth of its height between two plates, and let go: height left, deviation after."""
    size, half = 0.2, 0.1
    body, skin = box_body((size, size, size), cells, mass_damping=20.0, youngs_modulus=2e4)

    def plate(side: int) -> Surface:
        ways = [0.0, 0.0, 0.9 * half, 0.9 * half, -size, -size]
        motion = keyed([0.0, 0.05, 0.45, 0.55, 0.7, 10.0], [placed((0.0, -side * way, 0.0)) for way in ways])
        return solid_box(f"plate {side}", (1.0, size, 1.0), (0.0, side * (half + 0.5 * size), 0.0), motion=motion)

    simulation = simulate(body, skin, plate(1), plate(-1), substeps=8)
    stage, height = simulation.model.parts["tets"], size
    for frame in range(72):
        simulation.advance_frame((frame + 1) * FRAME)
        nodes = stage.nodes(0)
        height = min(height, np.ptp(nodes[:, 1]))
        left = off_shape(body.nodes, nodes)
        if frame > 24 and left < 0.5 * PROMISE:
            break
    simulation.close()
    return height / size, left
