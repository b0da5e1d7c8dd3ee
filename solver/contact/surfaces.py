"""Strands against the surfaces of the scene: host side."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from plait.solver.contact.bodies import BodyTable
from plait.solver.contact.inside_kernels import find_inside, measure_roots, note_drawn
from plait.solver.contact.meeting_kernels import UNBOUNDED, Bodies, ContactNodes
from plait.solver.contact.planes import PLANES_A_NODE, ContactPlanes, allocate_planes
from plait.solver.contact.search_kernels import Memory
from plait.solver.contact.surface_kernels import find_planes, project_out
from plait.solver.kinematics.colliders import Collider
from plait.solver.model import Interval, Model
from plait.solver.state import State

# Cost of a node in units of `Launcher.launch`.
NODE_WORK = 20


class SurfaceContact:
    """Contact of strand nodes with moving triangle surfaces, for one set of strands.

    A strand's nodes lie in a run of the node arrays, ghost and root first; these two are prescribed and never in
    contact, but a free strand's root. In each substep:

        contact.begin_substep(length)
        contact.examine(start, guess, flags)      planes near a first guess, all flags set before
        ...solve the strands...                   with `planes`
        contact.examine(start, end, flags)        looks at strands flagged; leaves flags where a plane is broken
        ...solve those again, and so on...
        contact.guard(start, end, flags)          puts right what the strands last solved still break
        contact.end_substep()                     if the substep stands

    Distances are float64. Triangles are found by float32 trees: a node that is equally near to two triangles but
    for the rounding of its coordinates (1e-7 of its distance from the scene's origin) may meet either.

    planes: those in force.  plane_body: (plane_count,) int32, the surface of each, an entry of `bodies`; -1: none.
    State array 'contact/depth': (strand_count,) how deep [m] the strand's deepest node
    still is inside a surface that keeps out.
    """

    def __init__(
        self,
        model: Model,
        state: State,
        *,
        first_node: np.ndarray,
        position: wp.array,
        radius: np.ndarray,
        friction: np.ndarray,
        free: np.ndarray | None = None,
    ) -> None:
        """Looks at how the groom was drawn, at `model.start_time`.

        first_node: (strand_count + 1,).  position: (node_count,) vec3d [m], world, at the start time.
        radius: (node_count,) [m].  friction: (strand_count,) Coulomb coefficient.
        free: (strand_count,) bool, strands whose root is a node like others, grown on nothing; None: none.
        """
        self._launcher = launcher = model.launcher
        self._kinematics = model.parts["kinematics"]
        self._exit_speed = model.settings.contact.exit_speed
        self.count, node_count = len(first_node) - 1, len(radius)
        device = launcher.device
        free = np.zeros(self.count, dtype=bool) if free is None else free
        grown_on = [np.full(strands.strand_count, strands.roots.surface) for strands in model.scene.strands]
        nodes = ContactNodes()
        nodes.first_node = wp.array(first_node, dtype=wp.int32, device=device)
        nodes.radius = wp.array(radius, dtype=wp.float64, device=device)
        nodes.clearance = wp.full(node_count, UNBOUNDED, dtype=wp.float64, device=device)
        nodes.friction = wp.array(friction, dtype=wp.float64, device=device)
        nodes.surface = wp.array(np.where(free, -1, np.concatenate(grown_on)), dtype=wp.int32, device=device)
        nodes.free = wp.array(free, dtype=wp.int32, device=device)
        nodes.length = wp.array(_lengths(position.numpy(), first_node), dtype=wp.float64, device=device)
        self._nodes = nodes
        self._work = NODE_WORK * max(1, node_count // self.count)
        self.planes: ContactPlanes = allocate_planes(node_count, device)
        self.plane_body = wp.full(node_count * PLANES_A_NODE, -1, dtype=wp.int32, device=device)
        self._memory = Memory()
        self._memory.body = wp.full(node_count, -1, dtype=wp.int32, device=device)
        self._memory.triangle = wp.zeros(node_count, dtype=wp.int32, device=device)
        self._memory.inside = wp.zeros(node_count, dtype=wp.int32, device=device)
        self._depth = wp.zeros(self.count, dtype=wp.float64, device=device)
        self._depth_next = wp.zeros(self.count, dtype=wp.float64, device=device)
        self._moved = wp.zeros(self.count, dtype=wp.int32, device=device)
        self._inside = wp.zeros(self.count, dtype=wp.int32, device=device)
        self._deepest = wp.zeros(self.count, dtype=wp.float64, device=device)
        state.arrays["contact/depth"] = self._depth
        self._exit_distance = 0.0
        self._table = BodyTable(self._kinematics, launcher)
        start = Interval(model.start_time, model.start_time)
        self._kinematics.begin_frame(state, start)
        self._table.begin_frame()
        self._note_drawn(position, first_node)
        self._drawn_clearance = nodes.clearance.numpy().copy()
        self._left_out = np.zeros(node_count, dtype=bool)

    @property
    def active(self) -> bool:
        """Whether any surface is in reach in this frame; if not, nothing need be called."""
        return self._table.bodies.count > 0

    @property
    def bodies(self) -> Bodies:
        """The surfaces in reach in this frame, in the order of the kinematics stage's `in_reach`."""
        return self._table.bodies

    def begin_frame(self) -> None:
        """Takes up the surfaces in reach; after the kinematics stage's own."""
        self._table.begin_frame()
        self._moved.zero_()
        self._clear()

    def leave_out(self, nodes: np.ndarray) -> None:
        """Gives nodes, (node_count,) bool, no contact from now on: what holds them says where they are."""
        if np.array_equal(nodes, self._left_out):
            return
        self._left_out = nodes
        self._nodes.clearance.assign(np.where(nodes, -1.0, self._drawn_clearance))

    def begin_substep(self, length: float) -> None:
        """Forgets the planes; `length` of the substep [s]. After the kinematics stage has stepped."""
        if not self.active:
            return
        self._exit_distance = self._exit_speed * length
        self._table.begin_substep()
        self._clear()
        wp.copy(self._depth_next, self._depth)

    def examine(self, start: wp.array, end: wp.array, flags: wp.array) -> int:
        """Finds the planes of the strands flagged; how many strands break one, by their flags after.

        start: (node_count,) vec3d [m] at the substep's start.  end: the same, where the nodes would go.
        flags: (strand_count,) int32, in: strands that have moved; out: strands that must be solved again.
        """
        if not self.active:
            flags.zero_()
            return 0
        self._launcher.launch(
            find_planes,
            self.count,
            [self._table.bodies, self._nodes, start, end, self._depth, self._exit_distance],
            [self._memory, self.planes, self.plane_body, flags, self._depth_next],
            work_per_item=self._work,
        )
        return int(flags.numpy().sum())

    def guard(self, start: wp.array, end: wp.array, flags: wp.array) -> None:
        """Moves what is still under a surface out of it, in `end`, for the strands flagged."""
        if not self.active:
            return
        self._launcher.launch(
            project_out,
            self.count,
            [self._table.bodies, self._nodes, start, self._depth, self._exit_distance, flags],
            [self._memory, end, self._moved, self._depth_next],
            work_per_item=self._work,
        )

    def end_substep(self) -> None:
        """Keeps how deep each strand is now."""
        if self.active:
            wp.copy(self._depth, self._depth_next)

    def penetrating(self, position: wp.array) -> tuple[int, float]:
        """How many nodes are deeper inside a surface than their radius, and the deepest node's depth [m].

        At the end pose of the last substep; prescribed nodes and stems (`note_drawn`) apart.
        """
        if not self.active:
            return 0, 0.0
        self._launcher.launch(
            find_inside,
            self.count,
            [self._table.bodies, self._nodes, position],
            [self._inside, self._deepest],
            work_per_item=self._work,
        )
        return int(self._inside.numpy().sum()), float(self._deepest.numpy().max())

    def end_frame(self, position: wp.array) -> dict[str, Any]:
        """Metrics: planes in the last substep, moves of the guard, nodes inside and the deepest of them [m]."""
        inside, deepest = self.penetrating(position)
        return {
            "contacts": int((self.plane_body.numpy() >= 0).sum()) if self.active else 0,
            "guarded": int(self._moved.numpy().sum()),
            "penetrating": inside,
            "deepest": deepest,
        }

    def _clear(self) -> None:
        self.planes.normal.zero_()
        self.plane_body.fill_(-1)
        self._memory.body.fill_(-1)

    def _note_drawn(self, position: wp.array, first_node: np.ndarray) -> None:
        """Fills clearances and depths against every surface in reach that has an inside."""
        x = position.numpy()
        lower, upper = (f.reduceat(x, first_node[:-1]) for f in (np.minimum, np.maximum))
        length = self._nodes.length.numpy()
        grown_on = self._nodes.surface.numpy()
        device = self._launcher.device
        for body, (collider, box) in enumerate(
            zip(self._kinematics.in_reach, self._kinematics.boxes, strict=True)
        ):
            solid = self._table.solid[collider.index]
            meets = np.all((lower <= box[1]) & (upper >= box[0]), axis=1)
            asked = np.flatnonzero(meets if solid else meets & (grown_on == collider.index))
            tree = self._winding_tree(collider) if solid and len(asked) else None
            height = wp.full(self.count, UNBOUNDED, dtype=wp.float64, device=device)
            strands = wp.array(asked, dtype=wp.int32, device=device)
            args = [strands, self._table.bodies, body, tree.id if tree else 0, self._nodes, position]
            self._launcher.launch(measure_roots, len(asked), args, [height])
            held = height.numpy()
            encloses = np.all(held < 0.0) and np.any(-held > length) and not np.any(grown_on == collider.index)
            self._table.solid[collider.index] = solid and not encloses
            if not encloses:
                outputs = [height, self._depth]
                self._launcher.launch(note_drawn, len(asked), args, outputs, work_per_item=self._work)

    def _winding_tree(self, collider: Collider) -> wp.Mesh:
        mesh = collider.meshes[self._kinematics.end]
        return wp.Mesh(wp.clone(mesh.points), mesh.indices, support_winding_number=True)


def _lengths(position: np.ndarray, first_node: np.ndarray) -> np.ndarray:
    """(strand_count,) [m] from root to tip."""
    segments = np.linalg.norm(np.diff(position, axis=0, append=position[-1:]), axis=1)
    segments[first_node[:-1]] = 0.0
    segments[first_node[1:] - 1] = 0.0
    return np.add.reduceat(segments, first_node[:-1])
