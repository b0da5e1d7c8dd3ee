"""Contact of rigid bodies with each other and with what the animation moves, and joints: host side."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from plait.solver.model import Interval, Model
from plait.solver.rigid.begin_kernels import bound_geoms
from plait.solver.rigid.find_kernels import find_contacts, keep_contacts
from plait.solver.rigid.geoms import GeomTable
from plait.solver.rigid.island_kernels import Islands, find_islands
from plait.solver.rigid.order_kernels import order_geoms
from plait.solver.rigid.passing_kernels import find_passed
from plait.solver.rigid.problem import Problem
from plait.solver.rigid.row_kernels import Rows
from plait.solver.rigid.solve_kernels import solve_islands
from plait.solver.rigid.types import Animated, Boxes, Contacts, Finder, Kept
from plait.solver.state import State

if TYPE_CHECKING:
    from plait.solver.rigid.stage import RigidStage

CONTACTS = {
    "geom": wp.int32,
    "feature": wp.int32,
    "body": wp.vec2i,
    "core_a": wp.vec3d,
    "core_b": wp.vec3d,
    "arm_a": wp.vec3d,
    "arm_b": wp.vec3d,
    "lever_a": wp.vec3d,
    "lever_b": wp.vec3d,
    "normal": wp.vec3d,
    "gap": wp.float64,
    "friction": wp.float64,
    "restitution": wp.float64,
    "impulse": wp.vec3d,
}
KEPT = ("geom", "feature", "normal", "impulse")
ROWS = {
    "axes": wp.mat33d,
    "response": wp.vec4d,
    "bias": wp.vec3d,
    "impulse": wp.vec3d,
    "held": wp.vec3d,
    "ahead": wp.vec3d,
    "least": wp.float64,
    "struck": wp.float64,
    "push": wp.float64,
}
# Cost of looking for a geom's contacts, and of an island's solve, in units of work; see `Launcher.launch`.
FIND_WORK, SOLVE_WORK = 400, 2000


class RigidContact:
    """Finds contacts, gathers islands and solves them: a few launches a substep, recorded once.

    reach: (body_count,) [m] from a centre of mass to what of the body is furthest, and contact's margin.
    unconverged: islands and substeps of the frame whose last sweep still changed more than was asked.
    """

    def __init__(self, model: Model, state: State, stage: RigidStage) -> None:
        self._model, self._stage, self._launcher = model, stage, model.launcher
        self._kinematics = model.parts["kinematics"]
        self.table = GeomTable(model, [body.center_of_mass for body in stage.bodies])
        self.reach = self._reach_of_bodies()
        device = self._launcher.device
        slots, geoms = int(self.table.first_slot[-1]), len(self.table.surfaces)
        self.contacts, self._kept, self._rows = Contacts(), Kept(), Rows()
        for name, dtype in CONTACTS.items():
            setattr(self.contacts, name, wp.zeros(slots, dtype=dtype, device=device))
        for name in KEPT:
            setattr(self._kept, name, wp.zeros(slots, dtype=CONTACTS[name], device=device))
            state.arrays[f"rigid/contact_{name}"] = getattr(self._kept, name)
        for name, dtype in ROWS.items():
            setattr(self._rows, name, wp.zeros(slots, dtype=dtype, device=device))
        self.contacts.count = wp.zeros(geoms, dtype=wp.int32, device=device)
        self._kept.count = wp.zeros(geoms, dtype=wp.int32, device=device)
        state.arrays["rigid/contact_count"] = self._kept.count
        self._boxes = self._lay_out_boxes(geoms)
        self._islands = self._lay_out_islands(slots)
        self._animated = [self._lay_out_animated(buffer) for buffer in range(2)]
        self._active = np.zeros(len(self.table.colliders), dtype=np.int32)
        self._planted = np.zeros(len(self.table.colliders), dtype=bool)
        self._runs: list[list[Callable[[], None]] | None] = [None, None]
        self._keep = self._launcher.prepare(keep_contacts, geoms, [self.table.geoms, self.contacts, self._kept])
        self._passed = wp.zeros(self.table.carried_count, dtype=wp.int32, device=device)
        self._pass = [self._prepare_to_pass(animated) for animated in self._animated]
        self._thinnest = self._thinnest_of_bodies()
        self._faced = np.zeros((2, 3))
        self._found = False
        self.unconverged = 0

    # -- set-up --------------------------------------------------------------------------------------------

    def _reach_of_bodies(self) -> np.ndarray:
        """(body_count,) [m] from the centre of mass to what is furthest, and contact's margin."""
        geoms = self.table.geoms
        reach = np.zeros(len(self._stage.bodies))
        body = geoms.body.numpy()
        held = body >= 0
        np.maximum.at(
            reach, body[held], (geoms.reach.numpy() + geoms.margin.numpy() + geoms.thickness.numpy())[held]
        )
        return reach

    def _thinnest_of_bodies(self) -> np.ndarray:
        """(body_count,) [m] half of the least size of what of a body is thinnest."""
        thinnest = np.full(len(self._stage.bodies), np.inf)
        count = self.table.carried_count
        body, half = self.table.geoms.body.numpy()[:count], self.table.geoms.half.numpy()[:count]
        np.minimum.at(thinnest, body, half.min(axis=1))
        return thinnest

    def _lay_out_boxes(self, count: int) -> Boxes:
        boxes, device = Boxes(), self._launcher.device
        boxes.lower = wp.zeros(count, dtype=wp.vec3d, device=device)
        boxes.upper = wp.zeros(count, dtype=wp.vec3d, device=device)
        boxes.travel = wp.zeros(count, dtype=wp.float64, device=device)
        carried = np.arange(int(self.table.geoms.carried_count))
        boxes.order = wp.array(carried, dtype=wp.int32, device=device)
        boxes.rank = wp.array(carried, dtype=wp.int32, device=device)
        boxes.axis = wp.zeros(1, dtype=wp.int32, device=device)
        boxes.widest = wp.zeros(1, dtype=wp.float64, device=device)
        boxes.still = wp.zeros(count, dtype=wp.int32, device=device)
        return boxes

    def _lay_out_islands(self, slots: int) -> Islands:
        islands, bodies, device = Islands(), len(self._stage.bodies), self._launcher.device

        def indices(count: int) -> wp.array:
            return wp.zeros(count, dtype=wp.int32, device=device)

        islands.root, islands.body = indices(bodies), indices(bodies)
        islands.body_begin, islands.contact_begin, islands.joint_begin = (indices(bodies + 1) for _ in range(3))
        islands.contact, islands.joint = indices(slots), indices(self._stage.joints.count)
        return islands

    def _lay_out_animated(self, start: int) -> Animated:
        """With the substep's start in that of the two buffers."""
        animated, device, items = Animated(), self._launcher.device, self.table.colliders
        animated.active = wp.zeros(len(items), dtype=wp.int32, device=device)
        animated.mesh = wp.zeros(len(items), dtype=wp.uint64, device=device)
        ranges = np.array([(item.points.start, item.points.stop) for item in items]).reshape(-1, 2)
        animated.points = wp.array(ranges, dtype=wp.vec2i, device=device)
        colliders = self._kinematics.colliders
        if colliders is not None:
            animated.points_start, animated.points_end = colliders.points[start], colliders.points[1 - start]
            animated.triangles = colliders.triangles
        return animated

    def _prepare_to_pass(self, animated: Animated) -> Callable[[], None]:
        ends = [self._stage.before, self._stage.motion]
        inputs = [self.table.geoms, animated, *ends, self._passed]
        return self._launcher.prepare(find_passed, len(self._passed), inputs, work_per_item=20)

    def _record(self, buffer: int) -> list[Callable[[], None]]:
        """The launches of a substep that starts in that buffer."""
        stage, prepare, problem = self._stage, self._launcher.prepare, self._problem()
        geoms, animated, step = problem.geoms, self._animated[buffer], problem.step
        finder = Finder()
        finder.step, finder.geoms, finder.animated, finder.motion = step, geoms, animated, stage.motion
        finder.boxes, finder.kept, finder.contacts = self._boxes, self._kept, self.contacts
        bodies, joints = len(stage.bodies), stage.joints
        to_bound = [step, geoms, animated, stage.motion, problem.start, self._boxes]
        to_gather = [geoms, self.contacts, joints.joints, joints.count, bodies, self._islands]
        return [
            prepare(bound_geoms, geoms.count, to_bound, work_per_item=20),
            prepare(order_geoms, 1, [geoms, self._boxes]),
            prepare(find_contacts, geoms.count, [finder], work_per_item=FIND_WORK),
            prepare(find_islands, 1, to_gather),
            prepare(solve_islands, bodies, [problem], work_per_item=SOLVE_WORK),
        ]

    def _problem(self) -> Problem:
        stage, settings, problem = self._stage, self._model.settings.rigid, Problem()
        problem.masses, problem.start, problem.work, problem.step = stage.parts
        problem.effort.tolerance, problem.effort.exit_speed = settings.tolerance, settings.exit_speed
        problem.effort.sweeps, problem.effort.passes = settings.iterations, settings.passes
        problem.geoms, problem.islands, problem.motion = self.table.geoms, self._islands, stage.motion
        problem.contacts, problem.rows, problem.joints = self.contacts, self._rows, stage.joints.joints
        return problem

    # -- a substep -----------------------------------------------------------------------------------------

    def begin_frame(self) -> None:
        self.unconverged = 0

    def solve(self, substep: Interval) -> None:
        """Gives the bodies the impulses of a substep, whose forces they have taken up."""
        self._keep_found()
        self._face(substep)
        buffer = self._kinematics.start
        if self._runs[buffer] is None:
            self._runs[buffer] = self._record(buffer)
        for run in self._runs[buffer]:
            run()
        self._found = True
        self.unconverged += int((self._stage.parts[2].lack.numpy() > 1.0).sum())

    def passed(self, substep: Interval) -> bool:
        """Whether bodies, turned aside in this substep, may have gone through what was not in their way."""
        before, after = self._stage.before, self._stage.motion
        start, way = before.position.numpy(), after.position.numpy() - before.position.numpy()
        aside = np.linalg.norm(way - substep.length * before.velocity.numpy(), axis=1)
        if not self.table.colliders or (aside <= self._thinnest).all():
            return False
        box = self._box(start, np.abs(way))
        if (box[0] < self._faced[0]).any() or (box[1] > self._faced[1]).any():
            near = {collider.index for collider in self._kinematics.colliders_near(*box, substep)}
            faced = zip(self.table.colliders, self._active, strict=True)
            if near - {item.index for item, active in faced if active}:
                return True
        if not self._active.any():
            return False
        self._pass[self._kinematics.start]()
        return bool(self._passed.numpy().any())

    def _box(self, position: np.ndarray, way: np.ndarray) -> np.ndarray:
        """(2, 3) [m] about bodies at (n, 3) [m] that go no further than (n, 3) [m]."""
        room = self.reach[:, None] + way
        return np.stack([(position - room).min(axis=0), (position + room).max(axis=0)])

    def retract(self) -> None:
        """As before `solve`."""
        self._found = False

    def loaded(self) -> Iterator[tuple[tuple[int, int], tuple[np.ndarray, np.ndarray], np.ndarray]]:
        """Of each contact that bore a load in the last substep bodies (-1: none), levers [m], normal; world."""
        counts, starts = self.contacts.count.numpy(), self.table.first_slot
        held = {name: getattr(self.contacts, name).numpy() for name in ("body", "lever_a", "lever_b", "normal")}
        impulse = self.contacts.impulse.numpy()
        for geom in np.flatnonzero(counts):
            for c in range(starts[geom], starts[geom] + counts[geom]):
                if impulse[c] @ held["normal"][c] > 0.0:
                    pair = tuple(int(b) for b in held["body"][c])
                    yield pair, (held["lever_a"][c], held["lever_b"][c]), held["normal"][c]

    def _keep_found(self) -> None:
        if self._found:
            self._keep()
            self._found = False

    def _face(self, substep: Interval) -> None:
        """Notes which animated surfaces are in reach."""
        if not self.table.colliders:
            return
        stage = self._stage
        position, velocity = stage.position.numpy(), stage.velocity.numpy()
        self._faced = self._box(position, substep.length * np.abs(velocity))
        near = self._kinematics.colliders_near(*self._faced, substep)
        held = {collider.index for collider in near}
        active = np.array([item.index in held for item in self.table.colliders])
        if (active & ~self._planted).any():
            self._planted |= active
            for buffer, animated in enumerate(self._animated):
                ids = [item.meshes[buffer].id if item.meshes else 0 for item in self.table.colliders]
                animated.mesh.assign(np.array(ids, dtype=np.uint64))
        if (active != self._active).any():
            self._active = active.astype(np.int32)
            for animated in self._animated:
                animated.active.assign(self._active)

    def end_frame(self) -> dict[str, Any]:
        """Contacts in the last substep."""
        self._keep_found()
        return {"contacts": int(self._kept.count.numpy().sum())}
