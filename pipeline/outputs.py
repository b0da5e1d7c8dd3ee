"""From simulated nodes back to a prim's own points: its order, its space, its units."""

from __future__ import annotations

from typing import Any

import numpy as np

from plait.pipeline.normals import CarriedNormals
from plait.pipeline.shot import CurveFrame, CurveOutput, Shot

# Half the span of the central difference that gives a moving prim's own velocity [s].
_DIFFERENCE = 1e-3


class Outputs:
    """All prims' results, read from the strands' stage."""

    def __init__(self, shot: Shot, stage: Any) -> None:
        """stage: `StrandsStage`, just built: authored normals belong to the frames of that moment."""
        self._outputs, self._stage = shot.curves, stage
        self._normals = {
            output.prim_path: CarriedNormals(
                output.normals,
                stage.points(output.strands),
                stage.directors(output.strands),
                stage.root_rotations(output.strands),
                shot.scene.strands[output.strands].offsets,
            )
            for output in shot.curves
            if output.normals is not None
        }

    def frames(self, time: float) -> tuple[CurveFrame, ...]:
        """Every prim's sample, the strands being where they are at `time` [s]."""
        return tuple(self._frame(output, time) for output in self._outputs)

    def _frame(self, output: CurveOutput, time: float) -> CurveFrame:
        points, velocities = self._stage.points(output.strands), self._stage.velocities(output.strands)
        carried = self._normals.get(output.prim_path)
        normals = None if carried is None else carried.at(points, self._stage.directors(output.strands))
        return curve_frame(output, points, velocities, time, normals)


def curve_frame(
    output: CurveOutput,
    points: np.ndarray,
    velocities: np.ndarray,
    time: float,
    normals: np.ndarray | None = None,
) -> CurveFrame:
    """One prim's result at `time` [s] from its strands' points and velocities, (n, 3) float64, scene world, SI.

    normals: (m, 3) float64, scene world, if the prim has any.

    With x_local = M(t) x, the local velocity is M v + dM/dt x: what a renderer adds to points before applying the
    prim's own transform.
    """
    transform = output.world_to_local(time)
    later, earlier = output.world_to_local(time + _DIFFERENCE), output.world_to_local(time - _DIFFERENCE)
    change = (later - earlier) / (2.0 * _DIFFERENCE)
    world, moving = output.drawn(points), output.drawn(velocities)
    local = world @ transform[:3, :3].T + transform[:3, 3]
    local_velocity = moving @ transform[:3, :3].T + world @ change[:3, :3].T + change[:3, 3]
    return CurveFrame(
        output.prim_path,
        local.astype(np.float32),
        local_velocity.astype(np.float32),
        extent(local.astype(np.float32), output.widths),
        None if normals is None else _local_normals(transform, normals),
    )


def _local_normals(transform: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(m, 3) float32, unit: turned by the inverse transpose, so that they stay across what they are normal to."""
    turned = normals @ np.linalg.inv(transform[:3, :3])
    return (turned / np.linalg.norm(turned, axis=1, keepdims=True)).astype(np.float32)


def extent(points: np.ndarray, widths: np.ndarray) -> np.ndarray:
    """(2, 3) float32 box of `points` (n, 3) widened by half the `widths` (n,), as UsdGeomCurves defines it."""
    if len(points) == 0:
        return np.zeros((2, 3), np.float32)
    half = np.float32(0.5) * np.float32(np.max(widths, initial=0.0))
    return np.stack([points.min(axis=0) - half, points.max(axis=0) + half]).astype(np.float32)
