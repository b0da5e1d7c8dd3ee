"""A shot that has been read: the scene to simulate, and how results go back to the prims they came from."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from plait.solver.scene import Scene, Strands

# What curves that follow guides are for.
INTERPOLATED = "interpolated"


@dataclass(frozen=True)
class StageInfo:
    """What the result must repeat: the source's own units, axis, rate and range (in time codes)."""

    path: Path
    meters_per_unit: float
    up_axis: str
    time_codes_per_second: float
    frames_per_second: float
    start: float
    end: float


@dataclass(frozen=True)
class Normals:
    """Authored normals of curves, each carried by the segment that it is drawn at.

    values: (n, 3) float64, as many as authored, unit, in the space of `Strands.points`.
    segments: (n,) int64, the simulated point (of the prim's own) at which that segment begins.
    """

    values: np.ndarray
    segments: np.ndarray


@dataclass(frozen=True)
class MeshNormals:
    """Authored normals of a mesh, each carried by the triangles about it that it is drawn with.

    values: (group_count, 3) float64, unit, in the space of `rest`: equal normals at one place are one group.
    group_of: (n,) int64, as many as authored.
    triangles: (m, 3) int32 into the authored points, and rest: (point count, 3) [m], where those lie meanwhile.
    groups, carriers: (k,) pairs of a group and one of the triangles that turn it.
    """

    values: np.ndarray
    group_of: np.ndarray
    triangles: np.ndarray
    rest: np.ndarray
    groups: np.ndarray
    carriers: np.ndarray


@dataclass(frozen=True)
class Stencil:
    """Each authored point as a weighted sum of simulated points.

    points: (authored point count, 4) int32.  weights: (authored point count, 4) float64, rows sum to one.
    """

    points: np.ndarray
    weights: np.ndarray


@dataclass(frozen=True)
class PrimOutput:
    """How a prim gets its simulated points back.

    world_to_local: time [s] -> (4, 4) float64, column vectors, from scene world [m] to the prim's own space
        [stage units].
    point_map: (authored point count,) int32: the simulated point that each authored point takes its place from.
    skinned: the prim has a UsdSkel binding, which the result must switch off.
    normals: authored ones, which are to be refreshed; None for none, or none that can be.
    """

    prim_path: str
    world_to_local: Callable[[float], np.ndarray]
    point_map: np.ndarray = field(kw_only=True)
    skinned: bool = field(default=False, kw_only=True)
    normals: Normals | MeshNormals | None = field(default=None, kw_only=True)

    @property
    def point_count(self) -> int:
        """How many points the prim has as authored."""
        return len(self.point_map)


def as_drawn(strands: Strands) -> np.ndarray:
    """(point_count, 3) scene coordinates, where the artist drew them."""
    return strands.points @ strands.rest_transform[:3, :3].T + strands.rest_transform[:3, 3]


@dataclass(frozen=True)
class CurvesNow:
    """A prim's strands at one instant, scene world.

    points, velocities: (n, 3) float64 [m], [m/s].
    directors: (n, 3), unit, across the segment that begins at each point.  rotations: (strand_count, 3, 3), from
        rest space, of the roots. Both are None where the prim has no normals to turn.
    """

    points: np.ndarray
    velocities: np.ndarray
    directors: np.ndarray | None = None
    rotations: np.ndarray | None = None


@dataclass(frozen=True)
class Followers:
    """Curves of a prim that follow guides instead of being simulated.

    curves: as if they were; only their shape and what they grow on play a part.
    points, strands: which of all the prim's points (n,) and strands (curve_count,) these are.
    offsets: as of `Strands`, for all strands of the prim.
    guides: (curve_count, 3) int32, counted through the strands of all of `Scene.strands`, heaviest first.
    weights: (curve_count, 3) float64, rows sum to one; zero where there are fewer guides.
    """

    curves: Strands
    points: np.ndarray
    strands: np.ndarray
    offsets: np.ndarray
    guides: np.ndarray
    weights: np.ndarray

    def among(self, simulated: CurvesNow, following: CurvesNow) -> CurvesNow:
        """All strands of the prim, in its order."""
        points = np.ones(len(simulated.points) + len(following.points), dtype=bool)
        strands = np.ones(len(self.offsets) - 1, dtype=bool)
        points[self.points], strands[self.strands] = False, False

        def merge(own: np.ndarray | None, others: np.ndarray | None, mine: np.ndarray) -> np.ndarray | None:
            if own is None or others is None:
                return None
            result = np.empty((len(mine), *own.shape[1:]))
            result[mine], result[~mine] = own, others
            return result

        return CurvesNow(
            merge(simulated.points, following.points, points),
            merge(simulated.velocities, following.velocities, points),
            merge(simulated.directors, following.directors, points),
            merge(simulated.rotations, following.rotations, strands),
        )


@dataclass(frozen=True)
class CurveOutput(PrimOutput):
    """How a BasisCurves prim gets its points from the `Strands` of the scene that are simulated for it.

    strands: index into `Scene.strands`; None where all its curves follow guides.
    followers: those of its curves that do, if any; the prim's points are then those of both, curve by curve.
    point_map: authored points that were collapsed (repeated ends) share a simulated one.
    widths: (authored point count,) float64 [stage units] as they apply to points, for `extent`.
    stencil: how authored points follow from several simulated ones, where they are not points of the curve
        (Bezier handles); None where `point_map` says all.
    """

    strands: int | None
    widths: np.ndarray
    stencil: Stencil | None = None
    followers: Followers | None = None
    normals: Normals | None = field(default=None, kw_only=True)

    def drawn(self, simulated: np.ndarray) -> np.ndarray:
        """(authored point count, 3), points or velocities, from those of the prim's simulated points (n, 3)."""
        if self.stencil is None:
            return simulated[self.point_map]
        return np.einsum("ns,nsd->nd", self.stencil.weights, simulated[self.stencil.points])


@dataclass(frozen=True)
class MeshOutput(PrimOutput):
    """How a `TetBody` of the scene goes back to the Mesh that is its skin, or the TetMesh whose nodes it has.

    body: index into `Scene.bodies`.
    point_map: points of the body's skin (`of_nodes`: nodes); -1 for those that `loose` places.
    loose: points of the prim that no face or tet holds, or all of a mesh that is drawn in another's tets, and
        where they lie in these.
    """

    body: int
    of_nodes: bool = False
    loose: Embedded | None = None
    normals: MeshNormals | None = field(default=None, kw_only=True)

    def drawn(self, skin: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        """(authored point count, 3), points or velocities, from those of the body's skin and of its nodes."""
        result = (nodes if self.of_nodes else skin)[self.point_map]
        if self.loose is not None:
            corners = nodes[self.loose.nodes]
            result[self.loose.points] = np.einsum("na,nad->nd", self.loose.barycentric, corners)
        return result


@dataclass(frozen=True)
class TransformOutput:
    """How a `RigidBody` of the scene goes back to the transform of its prim.

    body: index into `Scene.rigid_bodies`.
    rest: (4, 4), the prim's own space [stage units] to the body's rest space [m].
    world_to_parent: time [s] -> (4, 4), from scene world [m] to the space that the prim's transform is in.
    in_shot: time [s] -> (4, 4), from the body's rest space to scene world [m], where the shot has the prim.
    resets: that space is the world, not the parent's.
    """

    prim_path: str
    body: int
    rest: np.ndarray
    world_to_parent: Callable[[float], np.ndarray]
    in_shot: Callable[[float], np.ndarray]
    resets: bool = False
    point_count: int = field(default=0, init=False)

    def local(self, pose: np.ndarray, time: float) -> np.ndarray:
        """(4, 4) float64, column vectors: the prim's transform at `time` [s], its body being at `pose` (4, 4)."""
        return self.world_to_parent(time) @ pose @ self.rest


@dataclass(frozen=True)
class GrainOutput:
    """How a `Granular` of the scene goes to a Points prim: that of the source, or one beside what is filled.

    source_path: the prim of the source that has the role; it is `prim_path` where that is its own Points.
    granular: index into `Scene.granular`.
    world_to_local: as of `PrimOutput`.
    law: 'sand' or 'snow'.
    home: (3,) [m], scene world, near which grains start: where no grains at all have their bounds.
    hidden: a surface about the grains is drawn in their place.
    """

    prim_path: str
    source_path: str
    granular: int
    world_to_local: Callable[[float], np.ndarray]
    law: str
    home: np.ndarray
    hidden: bool = False
    point_count: None = field(default=None, init=False)


@dataclass(frozen=True)
class GrainSurfaceOutput:
    """How a `Granular` of the scene goes to a new Mesh about its grains, beside the prim at `source_path`.

    cell: [m] of the grid that the surface is found on.  volume: [m3] that each grain fills.
    The rest as of `GrainOutput`.
    """

    prim_path: str
    source_path: str
    granular: int
    world_to_local: Callable[[float], np.ndarray]
    law: str
    home: np.ndarray
    cell: float
    volume: float
    point_count: None = field(default=None, init=False)


@dataclass(frozen=True)
class Embedded:
    """Authored points in tets. points: (n,).  nodes: (n, 4) corners.  barycentric: (n, 4), rows sum to one."""

    points: np.ndarray
    nodes: np.ndarray
    barycentric: np.ndarray


# The way back of one prim. What a result adds has no prim of that path in the source.
Output = PrimOutput | TransformOutput | GrainOutput | GrainSurfaceOutput


@dataclass(frozen=True)
class PrimReport:
    """One row of `plait inspect`: what a prim will be, how that was recognised, how large it is.

    role: what it is for, INTERPOLATED for curves that follow guides, or 'skipped'.  recognised: in words.
    reason: why skipped or refused, or ''.
    supported: False for a role whose physics does not exist yet.
    sizes: e.g. {'strands': 500, 'points': 12000}.
    roots, guides, attachments: where its strands grow, what they lead or follow, and what holds their points
        besides, in words.
    """

    path: str
    type_name: str
    role: str
    recognised: str
    sizes: dict[str, int]
    reason: str = ""
    supported: bool = True
    roots: str = ""
    guides: str = ""
    attachments: tuple[str, ...] = ()


@dataclass(frozen=True)
class Shot:
    """Everything the driver and the writer need.

    on_props: by path of an output, the index into `props` of the one whose transform its prim's space is beneath.
    warnings: whole lines for the log.  layers: every file the shot is composed of, sorted; none may be written to.
    """

    info: StageInfo
    scene: Scene
    curves: tuple[CurveOutput, ...]
    prims: tuple[PrimReport, ...]
    warnings: tuple[str, ...] = ()
    layers: tuple[Path, ...] = ()
    meshes: tuple[MeshOutput, ...] = ()
    props: tuple[TransformOutput, ...] = ()
    on_props: Mapping[str, int] = field(default_factory=dict)
    grains: tuple[GrainOutput | GrainSurfaceOutput, ...] = ()

    @property
    def outputs(self) -> tuple[Output, ...]:
        """Every prim that the result overrides or adds."""
        return (*self.curves, *self.meshes, *self.props, *self.grains)


@dataclass(frozen=True)
class PrimFrame:
    """One prim's result at one time sample, in the prim's own space and units.

    points (n, 3) float32; velocities (n, 3) float32, per second; extent (2, 3) float32; normals (m, 3) float32,
    as many as authored, or None.
    others: by attribute name, what only some prims have: ids and widths of grains, faces of their surface.
    """

    prim_path: str
    points: np.ndarray
    velocities: np.ndarray
    extent: np.ndarray
    normals: np.ndarray | None = None
    others: Mapping[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True)
class TransformFrame:
    """One rigid prim's result at one time sample: its transform (4, 4) float64, row vectors, as USD has them."""

    prim_path: str
    transform: np.ndarray
