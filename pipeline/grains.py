"""Grains on their way back to USD: as Points, and as a mesh about them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from plait.pipeline.outputs import extent, prim_frame
from plait.pipeline.shot import GrainOutput, GrainSurfaceOutput, PrimFrame, Shot
from plait.pipeline.surfacing import surface_of
from plait.solver.granular.stage import Grains, GranularStage


class GrainFrames:
    """What becomes of all grains of a shot."""

    def __init__(self, shot: Shot, stage: GranularStage) -> None:
        self._outputs, self._stage = shot.grains, stage

    def frames(self, time: float) -> list[PrimFrame]:
        """Every prim's sample at `time` [s], to which the stage has come."""
        held = {output.granular: self._stage.grains(output.granular) for output in self._outputs}
        return [_frame(output, held[output.granular], time) for output in self._outputs]


def _frame(output: GrainOutput | GrainSurfaceOutput, grains: Grains, time: float) -> PrimFrame:
    if isinstance(output, GrainSurfaceOutput):
        return _surface_frame(output, grains, time)
    to_local = output.world_to_local(time)
    widths = grains.widths * np.cbrt(abs(np.linalg.det(to_local[:3, :3])))
    frame = prim_frame(output, grains.positions, grains.velocities, time, widths)
    others = {"ids": grains.ids, "widths": widths.astype(np.float32)}
    return replace(frame, others=others, extent=frame.extent if len(widths) else _nowhere(output, to_local))


def _surface_frame(output: GrainSurfaceOutput, grains: Grains, time: float) -> PrimFrame:
    found = surface_of(grains.positions, grains.velocities, output.volume, output.cell)
    to_local = output.world_to_local(time)
    frame = prim_frame(output, found.points, found.velocities, time, normals=found.normals)
    triangles = found.triangles
    if np.linalg.det(to_local[:3, :3]) < 0.0:  # what mirrors turns faces inside out
        triangles = triangles[:, ::-1]
    others = {
        "faceVertexCounts": np.full(len(triangles), 3, np.int32),
        "faceVertexIndices": np.ascontiguousarray(triangles).ravel().astype(np.int32),
    }
    return replace(frame, others=others, extent=frame.extent if len(triangles) else _nowhere(output, to_local))


def _nowhere(output: GrainOutput | GrainSurfaceOutput, to_local: np.ndarray) -> np.ndarray:
    """(2, 3) float32 bounds of nothing: where grains will be, so that what frames a shot is not led astray."""
    home = to_local[:3, :3] @ output.home + to_local[:3, 3]
    return extent(home.astype(np.float32)[None], np.zeros(0))
