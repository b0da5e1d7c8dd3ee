"""Prims beneath rigid props: their own space goes where the prop is simulated to, not where the shot has it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from plait.pipeline.shot import Shot, TransformOutput
from plait.solver.rigid.stage import RigidStage


class Whereabouts:
    """Where a prop is, at the time of `take` and close to it."""

    def __init__(self, prop: TransformOutput, stage: RigidStage) -> None:
        self._prop, self._stage, self._time = prop, stage, 0.0

    def take(self, time: float) -> None:
        """time: [s] to which the stage has come."""
        self._time = time

    def back(self, time: float) -> np.ndarray:
        """(4, 4), scene world to scene world: from where the prop is to where the shot has it."""
        pose = self._stage.pose(self._prop.body, time - self._time)
        return self._prop.in_shot(time) @ np.linalg.inv(pose)


@dataclass(frozen=True)
class OnProp:
    """`PrimOutput.world_to_local` of a prim beneath a prop; in_shot: were the prop where the shot has it."""

    in_shot: Callable[[float], np.ndarray]
    prop: Whereabouts

    def __call__(self, time: float) -> np.ndarray:
        return self.in_shot(time) @ self.prop.back(time)


def carried(shot: Shot, stage: RigidStage) -> tuple[Shot, tuple[Whereabouts, ...]]:
    """The shot, its outputs beneath props going back to spaces that these carry; and the props that do."""
    props = {index: Whereabouts(shot.props[index], stage) for index in sorted(set(shot.on_props.values()))}

    def place(outputs: tuple) -> tuple:
        return tuple(
            replace(output, world_to_local=OnProp(output.world_to_local, props[shot.on_props[output.prim_path]]))
            if output.prim_path in shot.on_props
            else output
            for output in outputs
        )

    placed = replace(shot, curves=place(shot.curves), meshes=place(shot.meshes), grains=place(shot.grains))
    return placed, tuple(props.values())
