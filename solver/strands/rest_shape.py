"""Rest shapes of all strands: stress-free as drawn, or in stable equilibrium under gravity as drawn."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from plait.solver.contact.planes import allocate_planes
from plait.solver.diagnostics import Refused
from plait.solver.launch import Launcher
from plait.solver.strands import rest
from plait.solver.strands.layout import Layout
from plait.solver.strands.scratch import allocate_scratch, count_chunks
from plait.solver.strands.types import rod_types

# A shape must be stable under this much more than its weight, so that it is not on the verge of giving way.
STABILITY_MARGIN = 1.2
# Bending and twisting stiffness of a strand that is not stable grow by this, again and again.
STIFFENING = 1.25
MOST_STIFFENING = 1.0e12


@dataclass
class RestShape:
    """What the drawn shapes give; node arrays in `Layout`'s order, rest space.

    director: (node_count, 3).  curvature: (node_count, 2) [1] integrated over the vertex.
    twist: (node_count,) [rad].  tension: (node_count,) [N] of the drawn shape.
    stiffening: (strand_count,) by which bending and twisting stiffness are multiplied, 1 for most.
    """

    director: np.ndarray
    curvature: np.ndarray
    twist: np.ndarray
    tension: np.ndarray
    stiffening: np.ndarray


def fit_rest_shapes(layout: Layout, launcher: Launcher) -> RestShape:
    """Rest shapes of every strand, as `Strands.rest_shape` asks.

    A 'sagfree' shape must also be one the strand stays in: where the drawn shape under gravity is not a minimum of
    the energy for any rest shape (a soft hair drawn upright buckles), the strand's bending and twisting stiffness
    are raised in steps of a quarter until it is; raises `Refused` where nothing helps.
    """
    return _Fit(layout, launcher).run()


class _Fit:
    """The rest shapes while they are sought; device arrays are float64 whatever the solve's precision."""

    def __init__(self, layout: Layout, launcher: Launcher) -> None:
        self.layout, self.launcher = layout, launcher
        self.device = launcher.device
        count = layout.node_count
        self.first_node = self._hold(layout.first_node, wp.int32)
        self.position = self._hold(layout.position, wp.vec3d)
        force = np.einsum("nij,ni->nj", layout.rest_rotation[layout.node_strand], layout.force)
        force[~layout.sagfree[layout.node_strand]] = 0.0
        self.force = self._hold(force, wp.vec3d)
        self.director = wp.zeros(count, dtype=wp.vec3d, device=self.device)
        self.curvature = wp.zeros(count, dtype=rest.vec2, device=self.device)
        self.twist = wp.zeros(count, dtype=wp.float64, device=self.device)
        self.tension = wp.zeros(count, dtype=wp.float64, device=self.device)
        self.stiffening = np.ones(layout.strand_count)

    def run(self) -> RestShape:
        strands = self.layout.strand_count
        drawn = [self.first_node, self.position]
        self.launcher.launch(rest.transport_frames, strands, drawn, [self.director])
        every = np.arange(strands, dtype=np.int32)
        self._balance(every, self._stiffness(1.0), [self.curvature, self.twist, self.tension])
        left = np.flatnonzero(self.layout.sagfree).astype(np.int32)
        left = left[~self._stable(left)]
        while len(left):
            self.stiffening[left] *= STIFFENING
            hopeless = left[self.stiffening[left] > MOST_STIFFENING]
            if len(hopeless):
                where = self.layout.where(int(hopeless[0]))
                raise Refused(f"{where}: no stiffness keeps it as drawn; give it restShape 'authored', or more EA")
            self._balance(left, self._stiffness(1.0), [self.curvature, self.twist, self.tension])
            left = left[~self._stable(left)]
        arrays = (self.director, self.curvature, self.twist, self.tension)
        return RestShape(*(array.numpy() for array in arrays), self.stiffening)

    def _hold(self, values: np.ndarray, dtype: Any = wp.float64) -> wp.array:
        return wp.array(values, dtype=dtype, device=self.device)

    def _stiffness(self, factor: float) -> list[wp.array]:
        """`factor` times bending and twisting stiffness over the vertices' Voronoi lengths [N m]."""
        return [self._hold(values) for values in self.layout.vertex_stiffness(factor * self.stiffening)]

    def _balance(self, strands: np.ndarray, stiffness: list[wp.array], outputs: list[wp.array]) -> None:
        """Rest curvature, rest twist and tension (outputs) of `strands` at a stiffness."""
        inputs = [self._hold(strands, wp.int32), self.first_node, self.position, self.director, self.force]
        self.launcher.launch(rest.balance, len(strands), [*inputs, *stiffness], outputs)

    def _stable(self, strands: np.ndarray) -> np.ndarray:
        """(len(strands),) bool: whether the drawn shape is stable, with a margin."""
        if not len(strands):
            return np.ones(0, dtype=bool)
        layout = self.layout
        # The stiffness divided by the margin at the same weight: the same as the weight times the margin.
        stiffness = self._stiffness(1.0 / STABILITY_MARGIN)
        curvature, twist, tension = (wp.clone(a) for a in (self.curvature, self.twist, self.tension))
        self._balance(strands, stiffness, [curvature, twist, tension])
        rods = rod_types(wp.float64).Rods()
        rods.first_node = self.first_node
        rods.mass = self._hold(layout.mass)
        rods.force = self.force
        rest_length = layout.rest_length(tension.numpy(), layout.stretch)
        rods.rest_length, rods.inverse_rest_length = self._hold(rest_length), self._hold(1.0 / rest_length)
        rods.stretch = self._hold(layout.stretch)
        rods.stretch_beyond = self._hold(np.zeros(layout.strand_count))
        rods.bend, rods.twist = stiffness
        rods.rest_curvature, rods.rest_twist = curvature, twist
        rods.segment = self._hold(layout.mean_segment)
        rods.free = wp.zeros(layout.strand_count, dtype=wp.int32, device=self.device)
        chunks = count_chunks(len(strands), self.launcher)
        scratch = allocate_scratch(wp.float64, layout, chunks, self.device)
        stable = wp.zeros(len(strands), dtype=wp.int32, device=self.device)
        inputs = [self._hold(strands, wp.int32), chunks, rods, allocate_planes(0, self.device), scratch]
        self.launcher.launch(
            rest.find_stable,
            chunks,
            [*inputs, self.position, self.director, tension],
            [stable],
            work_per_item=max(1, layout.node_count // layout.strand_count),
        )
        return stable.numpy().astype(bool)
