"""Emitters: prims that pour grains out of the box about them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pxr import Sdf, Usd

from plait.pipeline.read.attachments import EnabledSwitch
from plait.pipeline.read.gravity import read_gravity
from plait.pipeline.read.motions import Anchor, Placement, RigidMotion, transform
from plait.pipeline.read.parameters import Given
from plait.pipeline.read.polygons import read_polygons
from plait.pipeline.read.source import Source
from plait.pipeline.read.turns import nearest_axes
from plait.solver.scene import AlwaysOn, Emitter, Switch

EMIT = "plait:emit"
# So much more than passes its box at rest density is too much to pour.
CROWDED = 1.5


@dataclass(frozen=True)
class Nozzle:
    """What an emitter pours from.

    lower, upper: (3,) [m], corners of its box, along its own axes.  motion: from there to the scene's world.
    velocity: (3,) [m/s] along its own axes.  stream: [m3/s] that passes its box at the first frame.
    box: (2, 3) [m], the world's axes, about it at the first frame.
    """

    prim: Usd.Prim
    lower: np.ndarray
    upper: np.ndarray
    motion: RigidMotion
    velocity: np.ndarray
    stream: float
    switch: Switch
    box: np.ndarray

    def spacing(self, source: Source, rate: float) -> float:
        """[m] of grains that make the stream as dense as what lies still."""
        if not self.stream > 0.0:
            mend = "author it, or give the emitter an opening across its velocity"
            raise source.error("cannot be told where nothing passes", self.prim, "plait:spacing", mend)
        return float((self.stream / rate) ** (1.0 / 3.0))

    def emitter(self, source: Source, given: Given, limit: int, spacing: float, width: float) -> Emitter:
        """As the scene has it; warns where more is poured than can get away."""
        rate = given["rate"]
        if rate * spacing**3 > CROWDED * self.stream:
            source.warn(
                f"{rate:g} grains a second, {spacing:.3g} m apart, are more than pass its box; "
                f"{self.stream / spacing**3:.3g} are as dense as at rest",
                self.prim,
                "plait:rate",
            )
        return Emitter(
            rate=rate,
            limit=limit,
            lower=self.lower,
            upper=self.upper,
            velocity=self.velocity,
            volume=spacing**3,
            width=width,
            seed=int(given["seed"]),
            switch=self.switch,
            motion=self.motion,
        )


def read_nozzle(source: Source, prim: Usd.Prim, given: Given) -> Nozzle:
    """Raises InputError for a prim without points, or whose values are not finite."""
    points = read_polygons(source, prim).points * source.units.meters_per_unit
    if not len(points):
        raise source.error("has no points to pour from", prim, "points", "give it some, or use a Cube")
    placement = Placement(source, prim)
    motion = RigidMotion(source, placement, Anchor(np.eye(3), source.units.meters_per_unit))
    lower, upper = points.min(axis=0), points.max(axis=0)
    corners = lower + np.indices((2, 2, 2)).reshape(3, -1).T * (upper - lower)
    corners = transform(placement.metric(source.start), corners)
    velocity = given["velocity"] if "velocity" in given else np.zeros(3)
    linear = placement.at_start[:3, :3]
    return Nozzle(
        prim,
        lower,
        upper,
        motion,
        velocity,
        _stream(linear * (upper - lower), nearest_axes(linear) @ velocity, read_gravity(source)),
        _switch(source, prim),
        np.array([corners.min(axis=0), corners.max(axis=0)]),
    )


def _stream(edges: np.ndarray, velocity: np.ndarray, gravity: np.ndarray) -> float:
    """[m3/s] through a box of these edges (columns, [m]): across the velocity, or what gravity makes of none."""
    fall = np.sqrt(np.linalg.norm(gravity) * np.linalg.norm(edges, axis=0).max(initial=0.0))
    speed = np.linalg.norm(velocity)
    direction = velocity / speed if speed > 0.0 else gravity / max(np.linalg.norm(gravity), 1e-300)
    x, y, z = edges.T
    across = sum(abs(float(direction @ np.cross(a, b))) for a, b in ((x, y), (y, z), (z, x)))
    return across * float(max(speed, fall))


def _switch(source: Source, prim: Usd.Prim) -> Switch:
    attribute = prim.GetAttribute(EMIT)
    if not attribute or not attribute.HasAuthoredValue():
        return AlwaysOn()
    if attribute.GetTypeName() != Sdf.ValueTypeNames.Bool:
        raise source.error(f"is {attribute.GetTypeName()}, not a bool", prim, EMIT, "author true or false")
    return EnabledSwitch(source, attribute)
