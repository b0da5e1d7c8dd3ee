"""Elastic bodies of tetrahedra: the stage that owns their state and advances it."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from plait.solver.diagnostics import Diverged
from plait.solver.model import Interval, Model
from plait.solver.state import State
from plait.solver.tets.body import BodySolver
from plait.solver.tets.body_kernels import body_kernels
from plait.solver.tets.integrators import SCHEMES, Scheme
from plait.solver.tets.layout import build_layout
from plait.solver.tets.skin import Skin
from plait.solver.tets.stillness import islands

EVOLVING = ("position", "velocity", "position_before", "velocity_before", "external_impulse")
SCRATCH = ("goal", "base", "base_velocity", "predicted", "contact_impulse")

# Solves with obstacles that do not agree with rigid bodies, or with each other, at most.
MAX_ROUNDS, MAX_SWEEPS = 4, 8
# What ends a substep deeper in an obstacle than this part of a cell asks for shorter ones.
DEEPEST = 0.5


def build(model: Model, state: State) -> TetStage | None:
    """The stage of the scene's bodies, at rest at `model.start_time`; None without bodies."""
    return TetStage(model, state) if model.scene.bodies else None


class TetStage:
    """All elastic bodies of a scene, each solved by itself.

    layout: nodes, tets and bodies.
    position, velocity: (node_count,) vec3d [m], [m/s], world.
    external_impulse: (node_count,) vec3d [kg m/s] that others add to; the next substep takes it up.
    warnings: lines for the user about what could not be taken as given.

    State arrays (see `Motion` in `body_kernels.py`): tets/position, velocity, position_before, velocity_before,
    external_impulse; tets/past: (1,) [s], the length of the step before, 0 for none; tets/asleep: (body_count,);
    tets/tangle: (body_count, 3), the memories of `Recovery`; tets/still_place: (node_count,) and tets/still_time:
    (body_count,), those of `Stillness`.
    """

    name = "tets"

    def __init__(self, model: Model, state: State) -> None:
        self._model, self._launcher = model, model.launcher
        self.layout = build_layout(model.scene)
        self.real = wp.float64 if model.settings.precision == "float64" else wp.float32
        self.warnings: tuple[str, ...] = ()
        self._motion = self._lay_out_motion()
        motion, bodies = self._motion, range(self.layout.body_count)
        self.position, self.velocity = motion.position, motion.velocity
        self.external_impulse = motion.external_impulse
        device = self._launcher.device
        self._past = wp.zeros(1, dtype=wp.float64, device=device)
        asleep = wp.zeros(self.layout.body_count, dtype=wp.int32, device=device)
        state.arrays |= {f"tets/{name}": getattr(motion, name) for name in EVOLVING}
        tangle = wp.zeros((self.layout.body_count, 3), dtype=wp.float64, device=device)
        state.arrays |= {"tets/past": self._past, "tets/asleep": asleep, "tets/tangle": tangle}
        place = wp.zeros(self.layout.node_count, dtype=wp.vec3d, device=device)
        time = wp.zeros(self.layout.body_count, dtype=wp.float64, device=device)
        state.arrays |= {"tets/still_place": place, "tets/still_time": time}
        still = [(place[self.layout.nodes(b)], time[b : b + 1]) for b in bodies]
        self._bodies = [
            BodySolver(model, self.layout, b, motion, asleep[b : b + 1], tangle[b], still[b], self.real)
            for b in bodies
        ]
        self._place_at_start()
        self._skins = [Skin(self.layout, b, self._launcher, self.real) for b in bodies]
        self._contact = self._make_contact(state)

    def _lay_out_motion(self) -> Any:
        layout, device = self.layout, self._launcher.device
        motion = body_kernels(self.real).types.Motion()
        for name in (*EVOLVING, *SCRATCH):
            setattr(motion, name, wp.zeros(layout.node_count, dtype=wp.vec3d, device=device))
        attachment = np.concatenate([body.attachment for body in layout.bodies])
        motion.mass = wp.array(layout.mass, dtype=wp.float64, device=device)
        motion.attachment = wp.array(attachment, dtype=wp.float64, device=device)
        motion.pinned = wp.array(layout.pinned, dtype=wp.int32, device=device)
        return motion

    def _place_at_start(self) -> None:
        start = np.concatenate([body.targets.all_nodes(self._model.start_time) for body in self._bodies])
        self._motion.position.assign(start)
        self._motion.position_before.assign(start)

    def _make_contact(self, state: State) -> Any:
        """None where nothing can ever touch."""
        from plait.solver.contact.body_contact import build_contact

        return build_contact(self._model, state, self.layout)

    # -- stepping ------------------------------------------------------------------------------------------

    def begin_frame(self, state: State, frame: Interval) -> None:
        """Lets go what is tangled for good; what a body can skip, it finds out step by step."""
        for b, body in enumerate(self._bodies):
            body.begin_frame()
            if body.tangled:
                body.recover(frame.start, float(self._past.numpy()[0]), self._alone(b))

    def _alone(self, b: int) -> bool:
        """Whether a body can touch nothing but itself."""
        if self._contact is None:
            return True
        position, margin = self.position.numpy(), self._contact.cell_size
        lower, upper = position[self.layout.nodes(b)].min(axis=0), position[self.layout.nodes(b)].max(axis=0)
        others = [position[self.layout.nodes(k)] for k in range(self.layout.body_count) if k != b]
        near = any(((x.max(axis=0) > lower - margin) & (x.min(axis=0) < upper + margin)).all() for x in others)
        return not near and self._bodies[b].newton.obstacles is None

    def step(self, state: State, substep: Interval, last_resort: bool = False) -> bool:
        """Moves every body to the substep's end: elasticity, then contact, in turns while anything is near.

        Does not stand where a body's elastic solve did not converge.
        """
        self._kept_past = float(self._past.numpy()[0])
        scheme = SCHEMES[self._model.settings.flesh.integrator](substep.length, self._kept_past)
        self._past.fill_(substep.length)
        for b, body in enumerate(self._bodies):
            body.begin(substep, scheme, body.lies and self._disturbed(b, substep))
        stands = self._solve()
        if (stands or last_resort) and self._contact is not None:
            stands = self._meet(substep, scheme, last_resort)
            if (stands or last_resort) and self._contact.holds_still:
                self._lay_down(substep)
        return stands or last_resort

    def _disturbed(self, b: int, substep: Interval) -> bool:
        """Whether an obstacle moves that a body lies on, or that reaches it."""
        obstacles = self._contact.obstacles
        return obstacles is not None and obstacles.disturb(b, substep, self.position)

    def _lay_down(self, substep: Interval) -> None:
        """Bodies that have lain still, with all that they touch, sleep from here on."""
        bodies, obstacles = self._bodies, self._contact.obstacles
        pairs = self._contact.pairs
        for b, body in enumerate(bodies):
            if not body.stays:
                disturbed = obstacles is not None and obstacles.bodies[b].meets(obstacles.moving)
                body.watch(substep.length, bool((pairs == b).any()), disturbed)
        for island in islands(len(bodies), pairs):
            members = [bodies[b] for b in island]
            if all(body.still for body in members) and any(not body.asleep for body in members):
                for body in members:
                    body.lie_down()

    def retract(self, state: State, substep: Interval) -> None:
        self._past.fill_(self._kept_past)
        for body in self._bodies:
            body.retract()
        if self._contact is not None:
            self._contact.retract(substep)
            if self._contact.obstacles is not None:
                self._contact.obstacles.retract(substep)

    def _take_contact_impulses(self, impulse: wp.array, substep: Interval, scheme: Scheme) -> list[BodySolver]:
        """Returns the bodies that this woke."""
        wp.copy(self._motion.contact_impulse, impulse)
        return [body for body in self._bodies if body.wake(substep, scheme)]

    def _solve(self) -> bool:
        return all([body.solve() for body in self._bodies])

    def _meet(self, substep: Interval, scheme: Scheme, last_resort: bool) -> bool:
        """Contact: with obstacles in another elastic solve, then with each other, in turns with elastic solves.

        Does not stand where a solve did not converge, or something is left too deep in an obstacle.
        """
        contact, motion = self._contact, self._motion
        obstacles, start, stands = contact.obstacles, motion.position_before, True
        in_reach = obstacles is not None and obstacles.begin_substep(substep, start, motion.position, self._lying)
        if in_reach:
            stands = self._meet_obstacles(substep, scheme)
        touches = False
        if stands or last_resort:
            touches, woken_stand = self._touch(substep, scheme, in_reach)
            stands = stands and woken_stand
        if touches:
            if contact.too_fast and not last_resort:
                return False
            for _ in range(contact.passes - 1):
                contact.resolve(start, motion.position, motion.velocity, scheme.reach, forecast=True)
                self._take_contact_impulses(contact.impulse, substep, scheme)
                stands = self._solve() and stands
            contact.resolve(start, motion.position, motion.velocity, scheme.reach)
            self._spare_skins(*contact.changes(motion.velocity), scheme.reach)
            contact.separate(motion.position)
            # A body that only the last pass has touched has not felt it yet.
            woken = self._take_contact_impulses(contact.impulse, substep, scheme)
            stands = all([body.solve() for body in woken]) and stands
            in_contact = self._bodies
        else:
            in_contact = [body for body in self._bodies if body.struck]
        for body in in_contact:
            body.finish()
        if obstacles is not None:
            obstacles.finish(motion.base)
        if in_reach and obstacles.leave(motion.position) > DEEPEST * contact.cell_size:
            stands = False
        return stands

    def _meet_obstacles(self, substep: Interval, scheme: Scheme) -> bool:
        """Solves the bodies with obstacles, again while rigid ones do not go where they were taken to go."""
        obstacles, motion = self._contact.obstacles, self._motion
        for round in range(MAX_ROUNDS):
            if round > 0:
                obstacles.face_again(substep, motion.position_before, motion.position)
            for _ in range(MAX_SWEEPS):
                stands = all(
                    [
                        body.meet(of_body, substep, scheme)
                        for body, of_body in zip(self._bodies, obstacles.bodies, strict=True)
                    ]
                )
                if obstacles.lasts(motion.base):
                    break
            if obstacles.agree():
                break
        return stands and not (obstacles.carriers is not None and obstacles.carriers.at_odds)

    @property
    def _lying(self) -> np.ndarray:
        """(body_count,) bool, the bodies that go on lying in this step."""
        return np.array([body.stays for body in self._bodies])

    def _touch(self, substep: Interval, scheme: Scheme, in_reach: bool) -> tuple[bool, bool]:
        """Whether bodies may touch each other; what lies against one that is awake has been woken.

        And whether the solves that took converged.  in_reach: some obstacle is.
        """
        contact, motion, stands = self._contact, self._motion, True
        while True:
            lying = self._lying
            places = (motion.position_before, motion.position, motion.base)
            found = contact.begin_substep(substep, *places, lying)
            # No two that lie are a pair.
            woken = np.unique(contact.pairs[lying[contact.pairs]])
            if not len(woken):
                return found, stands
            contact.retract(substep)
            stands = all([self._rouse(b, substep, scheme, in_reach) for b in woken]) and stands

    def _rouse(self, b: int, substep: Interval, scheme: Scheme, in_reach: bool) -> bool:
        """Wakes a body within a substep; whether its solves converged."""
        body, motion = self._bodies[b], self._motion
        body.rouse(substep, scheme)
        stands = body.solve()
        if in_reach:
            of_body = self._contact.obstacles.bodies[b]
            of_body.examine(motion.position_before, motion.position, anew=True)
            stands = body.meet(of_body, substep, scheme) and stands
        return stands

    def _spare_skins(self, change: np.ndarray, in_all: np.ndarray, reach: float) -> None:
        """Of the way that contact's last pass moved skins, takes back what would bend them too much.

        What velocities lose by contact is at least the energy of their change, as with any projection: flesh may
        take up so much energy and no more. Stiff flesh would take up far more. Where its skin then overlaps
        another, they part in the position pass. Only what is quadratic in the way counts: what is linear is
        balanced by inertia, where the elastic solve ended.

        change: (node_count, 3) [m/s] in that pass, which moved nodes by `reach` [s] times as much.
        in_all: (node_count, 3) [m/s] in the whole substep.
        """
        for b, body in enumerate(self._bodies):
            nodes = self.layout.nodes(b)
            if body.newton is None or not change[nodes].any():
                continue
            position, there = self._motion.position[nodes], self._motion.position[nodes].numpy().copy()
            way, kinetic = (
                reach * change[nodes],
                0.5 * self.layout.mass[nodes] @ np.square(in_all[nodes]).sum(axis=1),
            )
            energies = []
            for k in range(3):
                position.assign(there - k * way)
                energies.append(body.newton.elastic_energy())
            taken_up = 0.5 * (energies[0] - 2.0 * energies[1] + energies[2])
            part = np.sqrt(kinetic / taken_up) if taken_up > kinetic else 1.0
            position.assign(there - (1.0 - part) * way)

    def end_frame(self, state: State, frame: Interval) -> dict[str, Any]:
        """Iterations and energies of the frame; raises `Diverged` for a node that is not finite."""
        finite = np.isfinite(self.position.numpy()).all(axis=1)
        if not finite.all():
            raise Diverged("position", self.layout.where(int(np.argmin(finite))), frame.end)
        tallies, reports = [body.tally for body in self._bodies], [body.report() for body in self._bodies]
        contact = self._contact.end_frame() if self._contact is not None else {}
        return contact | {
            "newton_iterations": sum(tally.newton_iterations for tally in tallies),
            "linear_iterations": sum(tally.linear_iterations for tally in tallies),
            "unconverged": sum(tally.unconverged for tally in tallies),
            "pops": sum(tally.pops for tally in tallies),
            "tangles": sum(tally.tangles for tally in tallies),
            "asleep": sum(body.asleep for body in self._bodies),
            "kinetic_energy": sum(report.kinetic_energy for report in reports),
            "elastic_energy": sum(report.elastic_energy for report in reports),
            "potential_energy": sum(report.potential_energy for report in reports),
            "least_volume": min(report.least_volume for report in reports),
            "inverted": sum(report.inverted for report in reports),
        }

    # -- results -------------------------------------------------------------------------------------------

    def solver(self, body: int) -> BodySolver:
        """What advances the body: for those who measure."""
        return self._bodies[body]

    def nodes(self, body: int) -> np.ndarray:
        """(node_count, 3) float64 [m]: the body's nodes, scene world."""
        return self.position.numpy()[self.layout.nodes(body)]

    def node_velocities(self, body: int) -> np.ndarray:
        """(node_count, 3) float64 [m/s] at the same nodes."""
        return self.velocity.numpy()[self.layout.nodes(body)]

    def points(self, body: int) -> np.ndarray:
        """(point_count, 3) float64 [m]: the points of the body's skin, scene world."""
        return self._on_skin(body, self.position)

    def velocities(self, body: int) -> np.ndarray:
        """(point_count, 3) float64 [m/s] at the same points."""
        return self._on_skin(body, self.velocity)

    def place_skin(self, body: int, points_out: wp.array, query_points_out: wp.array) -> None:
        """Writes the points of the body's skin: (point_count,) vec3d, and rounded to vec3f if given room."""
        self._skins[body].place(self.position, points_out, query_points_out)

    def _on_skin(self, body: int, values: wp.array) -> np.ndarray:
        out = wp.empty(self._skins[body].count, dtype=wp.vec3d, device=self._launcher.device)
        self._skins[body].place(values, out)
        return out.numpy()
