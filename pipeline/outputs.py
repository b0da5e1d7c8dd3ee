"""From simulated nodes back to a prim's own points: its order, its space, its units."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from plait.pipeline.normals import CarriedNormals
from plait.pipeline.shot import (
    CurveOutput,
    CurvesNow,
    GrainOutput,
    GrainSurfaceOutput,
    MeshOutput,
    PrimFrame,
    PrimOutput,
    Shot,
    TransformFrame,
    TransformOutput,
)
from plait.pipeline.surface_normals import SurfaceNormals

# Half the span of the central difference that gives a moving prim's own velocity [s].
_DIFFERENCE = 1e-3
_NO_WIDTHS = np.zeros(0)


class Outputs:
    """All prims' results, read from the stages that own them."""

    def __init__(self, shot: Shot, parts: Mapping[str, Any]) -> None:
        """parts: `Model.parts`, just built: authored normals of curves belong to the frames of that moment.

        Raises `Refused` for curves that follow guides and grow where they cannot.
        """
        self._on_props = ()
        if shot.on_props:
            # Here, so that a shot without rigid props loads nothing for them.
            from plait.pipeline.on_props import carried

            shot, self._on_props = carried(shot, parts["rigid"])
        self._strands, self._tets = parts.get("strands"), parts.get("tets")
        self._rigid, self._grains = parts.get("rigid"), None
        if shot.grains:
            # Here, so that a shot without grains loads nothing for them.
            from plait.pipeline.grains import GrainFrames

            self._grains = GrainFrames(shot, parts["granular"])
        self._curves, self._meshes, self._props = shot.curves, shot.meshes, shot.props
        self._following = None
        followers = [output.followers for output in shot.curves if output.followers is not None]
        if followers:
            # Here, so that a shot without guides compiles nothing for it.
            from plait.pipeline.following import Following

            turning = any(output.followers and output.normals for output in shot.curves)
            self._following = Following(followers, parts, turning)
        self._normals = self._carried_normals(shot, parts["kinematics"].model.start_time) if shot.curves else {}
        self._normals |= {
            output.prim_path: SurfaceNormals(output.normals)
            for output in shot.meshes
            if output.normals is not None
        }

    def _carried_normals(self, shot: Shot, start: float) -> dict[str, CarriedNormals | SurfaceNormals]:
        result: dict[str, CarriedNormals | SurfaceNormals] = {}
        for output, now in zip(shot.curves, self._now(start), strict=True):
            if output.normals is not None:
                held = output.followers or shot.scene.strands[output.strands]
                result[output.prim_path] = CarriedNormals(
                    output.normals, now.points, now.directors, now.rotations, held.offsets
                )
        return result

    def frames(self, time: float) -> tuple[PrimFrame | TransformFrame, ...]:
        """Every prim's sample, everything simulated being where it is at `time` [s]."""
        for prop in self._on_props:
            prop.take(time)
        shapes = zip(self._curves, self._now(time), strict=True)
        curves = [self._curve_frame(output, now, time) for output, now in shapes]
        meshes = [self._mesh_frame(output, time) for output in self._meshes]
        props = [self._transform_frame(output, time) for output in self._props]
        return (*curves, *meshes, *props, *(self._grains.frames(time) if self._grains is not None else ()))

    def _now(self, time: float) -> list[CurvesNow]:
        """Every curves prim's strands, simulated or following, as they are at `time` [s]."""
        following = iter(self._following.now(time) if self._following is not None else ())
        return [self._together(output, following) for output in self._curves]

    def _together(self, output: CurveOutput, following: Iterator[CurvesNow]) -> CurvesNow:
        followers, stage, prim = output.followers, self._strands, output.strands
        if prim is None:
            return next(following)
        turning = (stage.directors(prim), stage.root_rotations(prim)) if output.normals is not None else ()
        own = CurvesNow(stage.points(prim), stage.velocities(prim), *turning)
        return own if followers is None else followers.among(own, next(following))

    def _curve_frame(self, output: CurveOutput, now: CurvesNow, time: float) -> PrimFrame:
        carried = self._normals.get(output.prim_path)
        normals = None if carried is None else carried.at(now.points, now.directors)
        points, velocities = output.drawn(now.points), output.drawn(now.velocities)
        return prim_frame(output, points, velocities, time, output.widths, normals)

    def _transform_frame(self, output: TransformOutput, time: float) -> TransformFrame:
        return TransformFrame(output.prim_path, output.local(self._rigid.pose(output.body), time).T)

    def _mesh_frame(self, output: MeshOutput, time: float) -> PrimFrame:
        tets, body = self._tets, output.body
        points = output.drawn(tets.points(body), tets.nodes(body))
        velocities = output.drawn(tets.velocities(body), tets.node_velocities(body))
        carried = self._normals.get(output.prim_path)
        normals = None if carried is None else carried.at(points)
        return prim_frame(output, points, velocities, time, normals=normals)


def prim_frame(
    output: PrimOutput | GrainOutput | GrainSurfaceOutput,
    points: np.ndarray,
    velocities: np.ndarray,
    time: float,
    widths: np.ndarray = _NO_WIDTHS,
    normals: np.ndarray | None = None,
) -> PrimFrame:
    """One prim's result at `time` [s] from its points and velocities, (n, 3) float64 as authored, scene world, SI.

    widths: (n,) [stage units], for `extent`.  normals: (m, 3) float64, scene world, if the prim has any.

    With x_local = M(t) x, the local velocity is M v + dM/dt x: what a renderer adds to points before applying the
    prim's own transform.
    """
    transform = output.world_to_local(time)
    later, earlier = output.world_to_local(time + _DIFFERENCE), output.world_to_local(time - _DIFFERENCE)
    change = (later - earlier) / (2.0 * _DIFFERENCE)
    local = points @ transform[:3, :3].T + transform[:3, 3]
    local_velocity = velocities @ transform[:3, :3].T + points @ change[:3, :3].T + change[:3, 3]
    return PrimFrame(
        output.prim_path,
        local.astype(np.float32),
        local_velocity.astype(np.float32),
        extent(local.astype(np.float32), widths),
        None if normals is None else _local_normals(transform, normals),
    )


def _local_normals(transform: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(m, 3) float32, unit: turned by the inverse transpose, so that they stay across what they are normal to."""
    turned = normals @ np.linalg.inv(transform[:3, :3])
    return (turned / np.linalg.norm(turned, axis=1, keepdims=True)).astype(np.float32)


def extent(points: np.ndarray, widths: np.ndarray) -> np.ndarray:
    """(2, 3) float32 box of `points` (n, 3) widened by half the largest width, as UsdGeomCurves defines it."""
    if len(points) == 0:
        return np.zeros((2, 3), np.float32)
    half = np.float32(0.5) * np.float32(np.max(widths, initial=0.0))
    return np.stack([points.min(axis=0) - half, points.max(axis=0) + half]).astype(np.float32)
