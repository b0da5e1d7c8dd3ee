"""Points of strands held to surfaces and to each other: host side."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from plait.solver.diagnostics import Refused
from plait.solver.kinematics.roots import FrameGroup, TriangleFrames
from plait.solver.model import Interval, Model
from plait.solver.scene import Attachment, RootBinding
from plait.solver.state import State
from plait.solver.strand_contact.attachment_kernels import attachment_kernels
from plait.solver.strand_contact.meeting_kernels import Meetings
from plait.solver.strands.layout import Layout

# What is held exactly is off by at most this part of a segment; in float32 by the rounding of positions.
HELD, HELD_FLOAT32 = 3e-7, 1e-4


class Attachments:
    """All attachments of a scene, point by point, as ties of the coupled solve.

    A substep goes by what is on at its start. State arrays: attachments/on (n,) int32, offset (n,) vec3d [m] (to a
    surface in the triangle's frame, else world) and force (n,) vec3d [N] of those on, position and rotation of the
    surfaces' places, one a point that is held to a surface.
    """

    def __init__(self, model: Model, state: State, layout: Layout, real: type) -> None:
        """Raises `Refused` for points, prims or surfaces that are not there."""
        self._launcher, self._kinematics, self._layout = model.launcher, model.parts["kinematics"], layout
        self._kernels, self._real = attachment_kernels(real), real
        scene = model.scene
        self._switches = [attachment.switch for attachment in scene.attachments]
        counts = [len(attachment.point) for attachment in scene.attachments]
        self._group = np.repeat(np.arange(len(counts)), counts)
        self._a = np.concatenate([_nodes(layout, t, t.strands, t.point) for t in scene.attachments])
        self._b = np.concatenate(
            [
                np.full(len(t.point), -1) if t.surface is not None else _nodes(layout, t, t.other, t.other_point)
                for t in scene.attachments
            ]
        )
        self._stiffness = np.repeat([attachment.stiffness for attachment in scene.attachments], counts)
        self._exact = np.isinf(self._stiffness)
        along = (layout.stretch / layout.mean_segment)[layout.node_strand]
        self._along = wp.array(along, dtype=wp.float64, device=model.launcher.device)
        held = [t for t in scene.attachments if t.surface is not None]
        groups = [
            FrameGroup(t.name, "point", RootBinding(t.surface, t.triangle, t.barycentric), None, scene)
            for t in held
        ]
        self._on_surface = np.flatnonzero(self._b < 0)
        self._frames = TriangleFrames(groups, scene, model.launcher) if groups else None
        self._hold_state(state, model.start_time)
        self.near = np.zeros(layout.strand_count, dtype=bool)
        self.held_nodes = np.zeros(layout.node_count, dtype=bool)

    def _hold_state(self, state: State, time: float) -> None:
        count, places, device = len(self._a), len(self._on_surface), self._launcher.device
        arrays = {
            "on": wp.zeros(count, dtype=wp.int32, device=device),
            "offset": wp.zeros(count, dtype=wp.vec3d, device=device),
            "force": wp.zeros(count, dtype=wp.vec3d, device=device),
            "position": wp.zeros(places, dtype=wp.vec3d, device=device),
            "rotation": wp.array(np.tile(np.eye(3), (places, 1, 1)), dtype=wp.mat33d, device=device),
        }
        self._state = arrays
        self._ahead = {name: wp.clone(arrays[name]) for name in ("position", "rotation")}
        self._place(time)
        for name, ahead in self._ahead.items():
            wp.copy(arrays[name], ahead)
        state.arrays |= {f"attachments/{name}": array for name, array in arrays.items()}

    def _place(self, time: float) -> None:
        """The surfaces' places at `time`, in `_ahead`."""
        if self._frames is not None:
            wp.copy(self._ahead["rotation"], self._state["rotation"])
            kinematics = self._kinematics
            outputs = [self._ahead["position"], self._ahead["rotation"]]
            self._frames.place(kinematics.pose_at, time, *outputs, kinematics.skins())

    # -- a substep -----------------------------------------------------------------------------------------

    def begin_substep(self, substep: Interval, position: wp.array) -> None:
        """Notes what is on, and where it is to be. position: (node_count,) vec3d [m] at the start."""
        self._place(substep.end)
        held = {name: array.numpy() for name, array in self._state.items()}
        on = np.array([switch.on(substep.start) for switch in self._switches])[self._group]
        was, x = held["on"] > 0, position.numpy()
        new = on & ~was
        apart = x[self._a] - np.where(self._b[:, None] >= 0, x[self._b], 0.0)
        surface = self._on_surface
        apart[surface] = _turn_back(held["rotation"], apart[surface] - held["position"])
        self._on = on
        self._offset = np.where(new[:, None], apart, held["offset"])
        self._force = np.where((on & was)[:, None], held["force"], 0.0)
        target = self._offset.copy()
        ahead = {name: array.numpy() for name, array in self._ahead.items()}
        target[surface] = ahead["position"] + np.einsum("nij,nj->ni", ahead["rotation"], self._offset[surface])
        self._tie(target)

    def _tie(self, target: np.ndarray) -> None:
        """Ties of what is on."""
        device, ties, ends = self._launcher.device, self._kernels.Ties(), self._kernels.Ends()
        which = self._which = np.flatnonzero(self._on)
        a, b = self._a[which], self._b[which]

        def hold(values: np.ndarray, dtype: Any) -> wp.array:
            return wp.array(values, dtype=dtype, device=device)

        ties.a, ties.b = hold(a, wp.int32), hold(b, wp.int32)
        ties.exact = hold(self._exact[which], wp.int32)
        ties.target, ties.force = hold(target[which], wp.vec3d), hold(self._force[which], wp.vec3d)
        ties.stiffness = hold(np.where(self._exact, 0.0, self._stiffness)[which], wp.float64)
        ties.gap = wp.zeros(len(which), dtype=wp.vec3d, device=device)
        node, tie = np.concatenate([a, b]), np.tile(np.arange(len(which)), 2)
        side = np.repeat([0, 1], len(which))
        moves = (node >= 0) & ~self._layout.prescribed[node]
        order = np.flatnonzero(moves)[np.argsort(node[moves], kind="stable")]
        node, first = np.unique(node[order], return_index=True)
        ends.node, ends.first = hold(node, wp.int32), hold(np.append(first, len(order)), wp.int32)
        ends.tie, ends.side = hold(tie[order], wp.int32), hold(side[order], wp.int32)
        self._ties, self._ends, self.count = ties, ends, len(which)
        self._product = wp.zeros(len(node), dtype=wp.float64, device=device)
        self.near = np.zeros(self._layout.strand_count, dtype=bool)
        self.near[self._layout.node_strand[np.concatenate([a, b[b >= 0]])]] = True
        self.held_nodes = np.zeros(self._layout.node_count, dtype=bool)
        self.held_nodes[a[(b < 0) & self._exact[which]]] = True

    def prepare(
        self, position: wp.array, stiffness: wp.array, scratch: Any, krylov: Any, meetings: Meetings, pairs: int
    ) -> None:
        """For a solve of nodes at `position` [m], of that `stiffness` [N/m]: records what is launched again.

        pairs: how many `meetings` there are.
        """
        launcher, kernels, ties, ends = self._launcher, self._kernels, self._ties, self._ends
        launcher.launch(kernels.stiffen, self.count, [stiffness, self._along], [ties])
        beside = wp.array(self._beside(meetings.edges.numpy()[:pairs]), dtype=wp.int32, device=launcher.device)
        self._exempt = launcher.prepare(kernels.exempt, len(beside), [beside], [meetings])
        self._measure = launcher.prepare(kernels.measure, self.count, [position], [ties])
        self.hold = launcher.prepare(kernels.hold, self.count, [position], [ties])
        count = len(ends.node)
        self.gather = launcher.prepare(kernels.gather, count, [ties, ends], [scratch])
        self._image = launcher.prepare(kernels.image, count, [ties, ends, scratch], [krylov, self._product])

    def measure(self) -> None:
        """How far ties are from what they ask for; takes pairs of edges beside a tie out of contact."""
        self._measure()
        self._exempt()

    def image(self) -> float:
        """Adds to the direction's image under the matrix of all what ties do; its product with the direction."""
        self._image()
        return float(self._product.numpy().sum())

    @property
    def joins_strands(self) -> bool:
        """Whether any tie that is on is between strands."""
        return bool((self._b[self._which] >= 0).any())

    @property
    def hold_exactly(self) -> bool:
        """Whether exact ties are as near as they are to be; after `measure`."""
        exact = self._exact[self._which]
        if not exact.any():
            return True
        segment = self._layout.mean_segment[self._layout.node_strand[self._a[self._which]]]
        part = np.linalg.norm(self._ties.gap.numpy(), axis=1)[exact] / segment[exact]
        return bool(part.max() <= (HELD if self._real == wp.float64 else HELD_FLOAT32))

    def _beside(self, pairs: np.ndarray) -> np.ndarray:
        """Which pairs of edges, (pair_count, 2), lie beside a tie that holds their strands together."""
        a, b = self._a[self._which], self._b[self._which]
        a, b = a[b >= 0], b[b >= 0]
        if not len(a):
            return np.zeros(0, dtype=np.int32)
        lower, upper = np.minimum(a, b), np.maximum(a, b)
        count = self._layout.node_count
        beside = [(lower - i) * count + upper - j for i in (0, 1) for j in (0, 1)]
        keys = pairs[:, 0].astype(np.int64) * count + pairs[:, 1]
        return np.flatnonzero(np.isin(keys, np.concatenate(beside))).astype(np.int32)

    def commit(self) -> None:
        """The substep stands."""
        self._force[self._which] = self._ties.force.numpy()
        for name, values in (("on", self._on), ("offset", self._offset), ("force", self._force)):
            self._state[name].assign(values.astype(np.int32) if name == "on" else values)
        for name, ahead in self._ahead.items():
            wp.copy(self._state[name], ahead)


def _turn_back(rotation: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    return np.einsum("nji,nj->ni", rotation, vectors)


def _nodes(layout: Layout, attachment: Attachment, prim: int, points: np.ndarray) -> np.ndarray:
    """(n,) nodes of a prim's points."""
    points = np.asarray(points)
    first, end = layout.prim_points[prim : prim + 2] if 0 <= prim < len(layout.names) else (0, 0)
    outside = (points < 0) | (points >= end - first)
    if outside.any():
        raise Refused(f"{attachment.name}: point {points[outside][0]} of {end - first} points")
    return layout.point_node[first + points]
