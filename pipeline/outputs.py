"""From simulated nodes back to a prim's own points: its order, its space, its units."""

from __future__ import annotations

import numpy as np

from plait.pipeline.shot import CurveFrame, CurveOutput

# Half the span of the central difference that gives a moving prim's own velocity [s].
_DIFFERENCE = 1e-3


def curve_frame(output: CurveOutput, points: np.ndarray, velocities: np.ndarray, time: float) -> CurveFrame:
    """One prim's result at `time` [s] from its strands' points and velocities, (n, 3) float64, scene world, SI.

    With x_local = M(t) x, the local velocity is M v + dM/dt x: what a renderer adds to points before applying the
    prim's own transform.
    """
    transform = output.world_to_local(time)
    later, earlier = output.world_to_local(time + _DIFFERENCE), output.world_to_local(time - _DIFFERENCE)
    change = (later - earlier) / (2.0 * _DIFFERENCE)
    world, moving = points[output.point_map], velocities[output.point_map]
    local = world @ transform[:3, :3].T + transform[:3, 3]
    local_velocity = moving @ transform[:3, :3].T + world @ change[:3, :3].T + change[:3, 3]
    return CurveFrame(
        output.prim_path,
        local.astype(np.float32),
        local_velocity.astype(np.float32),
        extent(local.astype(np.float32), output.widths),
    )


def extent(points: np.ndarray, widths: np.ndarray) -> np.ndarray:
    """(2, 3) float32 box of `points` (n, 3) widened by half the `widths` (n,), as UsdGeomCurves defines it."""
    if len(points) == 0:
        return np.zeros((2, 3), np.float32)
    half = np.float32(0.5) * np.float32(np.max(widths, initial=0.0))
    return np.stack([points.min(axis=0) - half, points.max(axis=0) + half]).astype(np.float32)
