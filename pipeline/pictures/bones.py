"""What of flesh is bone, to be drawn within it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plait.pipeline import layers
from plait.pipeline.config import Config
from plait.pipeline.pictures.drawables import Dots
from plait.pipeline.read import read_shot
from plait.pipeline.read.placing import place_points
from plait.pipeline.read.source import Source
from plait.pipeline.read.surfaces import NO_TRIANGLES
from plait.solver.scene import Surface, TetBody
from plait.solver.tets.layout import mean_edge

BONE = (0.02, 0.10, 0.55)
SIZE = 0.4  # of the mean edge of the tets


@dataclass(frozen=True)
class Bones(Dots):
    """The pinned nodes of one prim's flesh, where the animation takes them."""

    size: float

    def point_colours(self, code: float) -> np.ndarray:
        return np.broadcast_to(BONE, (len(self.points(code)), 3))

    def width(self, code: float) -> float:
        return self.size


def bones(source: Source, config: Config) -> list[Bones]:
    """Of every prim of flesh of a shot, or of the shot that a result was made of. Raises as `read_shot` does."""
    shot = read_shot(layers.source_path(source.stage.GetRootLayer()) or source.path, config)
    if not shot.scene.bodies:
        raise source.error("has no flesh", mend="leave --core out, or give the shot that the result was made of")
    return [_bones(source, body, shot.scene.origin) for body in shot.scene.bodies]


def _bones(source: Source, body: TetBody, origin: np.ndarray) -> Bones:
    nodes = Surface(body.name, body.nodes, NO_TRIANGLES, body.motion, body.skinning, body.blend_shapes)
    pinned, rate = np.flatnonzero(body.pinned), source.units.time_codes_per_second

    def points(code: float) -> np.ndarray:
        return place_points(nodes, body.motion.pose(code / rate), pinned) + origin

    prim = source.stage.GetPrimAtPath(body.name)
    return Bones(source, prim, points, body.motion.animated, SIZE * mean_edge(body.nodes, body.tets))
