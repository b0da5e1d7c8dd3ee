"""Rigid bodies: the stage that owns their state and advances it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import warp as wp

from plait.solver.diagnostics import Diverged, Refused
from plait.solver.model import Interval, Model
from plait.solver.rigid.begin_kernels import begin_bodies
from plait.solver.rigid.contact import RigidContact
from plait.solver.rigid.joints import JointTable
from plait.solver.rigid.motion_kernels import Masses, Motion
from plait.solver.rigid.place_kernels import place_points
from plait.solver.rigid.quaternions import quaternion, rotation_matrix, turned_by
from plait.solver.rigid.row_kernels import Work
from plait.solver.rigid.solve_kernels import advance_bodies
from plait.solver.rigid.types import Start, Step
from plait.solver.scene import RigidBody
from plait.solver.state import State

MOTION = {
    "position": wp.vec3d,
    "orientation": wp.quatd,
    "velocity": wp.vec3d,
    "angular_momentum": wp.vec3d,
    "impulse": wp.vec3d,
    "angular_impulse": wp.vec3d,
    "still_position": wp.vec3d,
    "still_orientation": wp.quatd,
    "still_time": wp.float64,
    "asleep": wp.int32,
}
# How far a pose's rotation may be from one.
RIGID = 1e-6
# Cost of a body's free motion in units of work; see `Launcher.launch`.
MOTION_WORK = 60


def build(model: Model, state: State) -> RigidStage | None:
    """The stage of the scene's rigid bodies, at `model.start_time`; None without any.

    Raises `Refused` for bodies without mass, and for poses that are not rigid.
    """
    if not model.scene.rigid_bodies:
        return None
    if model.settings.rigid.method == "paper":
        # Here, so that nothing of it is loaded otherwise.
        from plait.solver.rigid.paper import PaperStage

        return PaperStage(model, state)
    return RigidStage(model, state)


class RigidStage:
    """All rigid bodies of a scene; until `Scene.rigid_start` they are where their motions take them.

    position: (body_count,) vec3d [m] of the centres of mass, world.
    orientation: (body_count,) quatd, unit, from the axes of rest space to world.
    velocity: (body_count,) vec3d [m/s].
    angular_momentum: (body_count,) vec3d [kg m2/s] about the centre of mass, world.
    impulse: (body_count,) vec3d [kg m/s], and angular_impulse: (body_count,) vec3d [kg m2/s] about the centre of
        mass, that others add to; the next substep takes them up.
    before: where they were when the substep last stepped began.
    held: whether that was before the bodies' release.

    State arrays: rigid/ and those names; rigid/still_position, still_orientation, still_time and asleep, see
    `Motion`; rigid/contact_count, contact_geom, contact_feature, contact_normal and
    contact_impulse, what is kept of contacts from a substep to the next; rigid/joint_impulse.
    """

    name = "rigid"

    def __init__(self, model: Model, state: State) -> None:
        self._model, self._launcher = model, model.launcher
        self.bodies, device = model.scene.rigid_bodies, model.launcher.device
        self._count = len(self.bodies)
        self.motion, self.before = Motion(), Motion()
        for motion in (self.motion, self.before):
            for name, dtype in MOTION.items():
                setattr(motion, name, wp.zeros(self._count, dtype=dtype, device=device))
        self.held = model.start_time < model.scene.rigid_start
        self._place(model.start_time)
        state.arrays |= {f"rigid/{name}": getattr(self.motion, name) for name in MOTION}
        self.position, self.orientation = self.motion.position, self.motion.orientation
        self.velocity, self.angular_momentum = self.motion.velocity, self.motion.angular_momentum
        self.impulse, self.angular_impulse = self.motion.impulse, self.motion.angular_impulse
        self._masses = self._lay_out_masses()
        self._start = Start()
        self._start.inertia_inverse = wp.zeros(self._count, dtype=wp.mat33d, device=device)
        self._start.velocity = wp.zeros(self._count, dtype=wp.vec3d, device=device)
        self._start.spin = wp.zeros(self._count, dtype=wp.vec3d, device=device)
        self._work = self._lay_out_work()
        self._step = self._lay_out_step()
        self.joints = JointTable(model, state, [body.center_of_mass for body in self.bodies])
        self.contact = self._lay_out_contact(state)
        self._points = self._hold_points()
        launch = self._launcher.prepare
        self._begin = launch(
            begin_bodies, self._count, [self._step, self._masses, self.motion, self._start], work_per_item=4
        )
        self._advance = launch(
            advance_bodies,
            self._count,
            [self._step, self._masses, self.motion, self._work],
            work_per_item=MOTION_WORK,
        )

    # -- set-up --------------------------------------------------------------------------------------------

    def _place(self, time: float) -> None:
        """Where the motions have the bodies at `time` [s], with the velocities that they start with."""
        places, turns, momenta = [], [], []
        for body in self.bodies:
            transform = body.motion.pose(time).joint_transforms[0]
            rotation = rigid_rotation(body, transform)
            places.append(rotation @ body.center_of_mass + transform[:3, 3])
            turns.append(quaternion(rotation))
            momenta.append(rotation @ body.inertia @ rotation.T @ body.angular_velocity)
        self.motion.position.assign(np.array(places))
        self.motion.orientation.assign(np.array(turns))
        self.motion.velocity.assign(np.array([body.velocity for body in self.bodies], dtype=np.float64))
        self.motion.angular_momentum.assign(np.array(momenta))

    def _lay_out_masses(self) -> Masses:
        for body in self.bodies:
            if not (body.mass > 0.0 and np.linalg.eigvalsh(body.inertia)[0] > 0.0):
                raise Refused(f"{body.name}: a rigid body needs a mass and an inertia above 0")
        masses, device = Masses(), self._launcher.device
        inertia = np.array([body.inertia for body in self.bodies], dtype=np.float64)
        masses.mass = wp.array([body.mass for body in self.bodies], dtype=wp.float64, device=device)
        masses.inertia = wp.array(inertia, dtype=wp.mat33d, device=device)
        masses.inertia_inverse = wp.array(np.linalg.inv(inertia), dtype=wp.mat33d, device=device)
        return masses

    def _lay_out_work(self) -> Work:
        work, device = Work(), self._launcher.device
        for name in ("velocity", "angular_momentum", "spin", "push", "push_turn"):
            setattr(work, name, wp.zeros(self._count, dtype=wp.vec3d, device=device))
        work.turned = wp.zeros(self._count, dtype=wp.quatd, device=device)
        work.sweeps = wp.zeros(self._count, dtype=wp.int32, device=device)
        work.lack = wp.zeros(self._count, dtype=wp.float64, device=device)
        return work

    def _lay_out_contact(self, state: State) -> RigidContact:
        return RigidContact(self._model, state, self)

    def _lay_out_step(self) -> wp.array:
        step = Step()
        step.gravity = wp.vec3d(*self._model.scene.gravity)
        step.friction = self._model.settings.rigid.friction
        return wp.array([step], dtype=Step, device=self._launcher.device)

    def _hold_points(self) -> dict[int, wp.array]:
        held = {}
        for index, surface in enumerate(self._model.scene.surfaces):
            if surface.rigid is not None:
                points = np.asarray(surface.points) - self.bodies[surface.rigid].center_of_mass
                held[index] = wp.array(points, dtype=wp.vec3d, device=self._launcher.device)
        return held

    # -- stepping ------------------------------------------------------------------------------------------

    def begin_frame(self, state: State, frame: Interval) -> None:
        """Nothing that lasts a frame."""
        self.contact.begin_frame()

    def step(self, state: State, substep: Interval, last_resort: bool = False) -> bool:
        """Moves every body to the substep's end.

        False where it must be shorter, as what hit a body may have taken it through what was not in its way.
        """
        for name in MOTION:
            wp.copy(getattr(self.before, name), getattr(self.motion, name))
        self._tell_length(substep.length)
        self._move(substep)
        return last_resort or self.held or not self.contact.passed(substep)

    def _tell_length(self, length: float) -> None:
        """Of the step to be taken [s]."""
        held = self._step.numpy().copy()
        held["length"] = length
        self._step.assign(held)

    def redo(self, substep: Interval, impulses: np.ndarray, moments: np.ndarray) -> None:
        """Takes the substep last stepped again, with other impulses.

        impulses, moments: (body_count, 3) [kg m/s], [kg m2/s] about where the centres of mass were, beside those
        that the bodies had to take up.
        """
        state, before = self.motion, self.before
        for name in MOTION:
            wp.copy(getattr(state, name), getattr(before, name))
        state.impulse.assign(before.impulse.numpy() + impulses)
        state.angular_impulse.assign(before.angular_impulse.numpy() + moments)
        self.joints.retract()
        self.contact.retract()
        self._move(substep)

    def _move(self, substep: Interval) -> None:
        self.held = 0.5 * (substep.start + substep.end) < self._model.scene.rigid_start
        if self.held:
            self._place(substep.end)
            self.motion.impulse.zero_()
            self.motion.angular_impulse.zero_()
            return
        self.joints.begin_substep(substep)
        self._go(substep)

    def _go(self, substep: Interval) -> None:
        """Bodies that are free to."""
        self._begin()
        self.contact.solve(substep)
        self._advance()

    def retract(self, state: State, substep: Interval) -> None:
        for name in MOTION:
            wp.copy(getattr(self.motion, name), getattr(self.before, name))
        self.joints.retract()
        self.contact.retract()

    def place_surface(
        self, surface: int, points: wp.array, query_points: wp.array, *, at_end: bool = True
    ) -> None:
        """Writes the points of a surface that a body carries: (n,) vec3d [m], world, and the same as vec3f.

        at_end: of the substep last stepped; or at its start.
        """
        body = self._model.scene.surfaces[surface].rigid
        motion = self.motion if at_end else self.before
        inputs = [self._points[surface], motion.position, motion.orientation, body]
        self._launcher.launch(place_points, len(points), inputs, [points, query_points])

    def bounds(self, body: int) -> np.ndarray:
        """(2, 3) [m] a box that holds a body in the substep last stepped."""
        reach = self.contact.reach[body]
        ends = [motion.position.numpy()[body] for motion in (self.before, self.motion)]
        return np.stack([np.minimum(*ends) - reach, np.maximum(*ends) + reach])

    def speeds(self) -> np.ndarray:
        """(body_count, 6) velocity [m/s] and spin [1/s], world."""
        rotation = np.array([rotation_matrix(q) for q in self.orientation.numpy()])
        inverse = rotation @ self._masses.inertia_inverse.numpy() @ rotation.transpose(0, 2, 1)
        spin = np.einsum("nij,nj->ni", inverse, self.angular_momentum.numpy())
        return np.concatenate([self.velocity.numpy(), spin], axis=1)

    @property
    def start_position(self) -> np.ndarray:
        """(body_count, 3) [m] the centres of mass where the substep last stepped began."""
        return self.before.position.numpy()

    def push(self, bodies: np.ndarray, places: np.ndarray, impulses: np.ndarray) -> None:
        """Adds impulses of others, (n, 3) [kg m/s] at places (n, 3) [m], world; `bodies` (n,) take them up."""
        moments = np.cross(places - self.position.numpy()[bodies], impulses)
        for array, given in ((self.impulse, impulses), (self.angular_impulse, moments)):
            held = array.numpy()
            np.add.at(held, bodies, given)
            array.assign(held)

    def skins(self) -> dict[int, Callable[[wp.array, wp.array], None]]:
        """What places the points of each surface that a rigid body carries."""
        return {index: partial(self.place_surface, index) for index in self._points}

    def pose(self, body: int, ahead: float = 0.0) -> np.ndarray:
        """(4, 4) from the body's rest space to world, now, or so much later [s] were it to fly on evenly."""
        out, position = np.eye(4), self.position.numpy()[body]
        out[:3, :3] = rotation_matrix(self.orientation.numpy()[body])
        if ahead:
            position = position + ahead * self.velocity.numpy()[body]
            spin = np.linalg.solve(self.bodies[body].inertia, out[:3, :3].T @ self.angular_momentum.numpy()[body])
            out[:3, :3] = out[:3, :3] @ turned_by(ahead * spin)
        out[:3, 3] = position - out[:3, :3] @ self.bodies[body].center_of_mass
        return out

    def end_frame(self, state: State, frame: Interval) -> dict[str, Any]:
        """Contacts and energies at the frame's end; raises `Diverged` for a body that is not finite."""
        arrays = [getattr(self.motion, name).numpy() for name in ("position", "velocity", "angular_momentum")]
        finite = np.isfinite(np.concatenate(arrays, axis=1)).all(axis=1)
        if not finite.all():
            raise Diverged("position", self.bodies[int(np.argmin(finite))].name, frame.end)
        position, velocity, angular_momentum = arrays
        mass = self._masses.mass.numpy()
        rotation = np.array([rotation_matrix(q) for q in self.orientation.numpy()])
        local = np.einsum("nji,nj->ni", rotation, angular_momentum)
        turning = np.einsum("ni,nij,nj->", local, self._masses.inertia_inverse.numpy(), local)
        return self.contact.end_frame() | {
            "kinetic_energy": 0.5 * float(mass @ np.square(velocity).sum(axis=1) + turning),
            "potential_energy": -float(mass @ (position @ self._model.scene.gravity)),
            "asleep": int(self.motion.asleep.numpy().sum()),
            "sweeps_max": int(self._work.sweeps.numpy().max()),
            "unconverged": self.contact.unconverged,
        }

    @property
    def parts(self) -> tuple[Masses, Start, Work, wp.array]:
        """For contact."""
        return self._masses, self._start, self._work, self._step


def rigid_rotation(body: RigidBody, transform: np.ndarray) -> np.ndarray:
    """The (3, 3) rotation of a pose; raises `Refused` where it also scales or mirrors."""
    matrix = np.asarray(transform, dtype=np.float64)[:3, :3]
    u, _, vt = np.linalg.svd(matrix)
    rotation = u @ vt
    if np.abs(rotation - matrix).max() > RIGID or np.linalg.det(rotation) < 0.0:
        raise Refused(f"{body.name}: the pose of a rigid body must neither scale nor mirror")
    return rotation
