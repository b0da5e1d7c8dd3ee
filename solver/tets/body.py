"""One elastic body: its unknowns, and how it takes a step."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from plait.solver.diagnostics import Diverged
from plait.solver.model import Interval, Model
from plait.solver.tets.body_kernels import body_kernels
from plait.solver.tets.explicit import ExplicitSteps
from plait.solver.tets.integrators import Scheme
from plait.solver.tets.layout import TetLayout
from plait.solver.tets.momentum import WholeBody, rotation_with_spin
from plait.solver.tets.newton import Evaluation, Newton
from plait.solver.tets.recovery import Recovery
from plait.solver.tets.report import Report, Tally
from plait.solver.tets.stillness import Stillness
from plait.solver.tets.targets import Targets

if TYPE_CHECKING:
    from plait.solver.contact.obstacle_forces import ObstacleForces

# A body is at rest where, left alone for a time of REST_TIME [s], it would move by this part of a tet's edge.
REST, REST_TIME = {wp.float32: 1e-7, wp.float64: 1e-9}, 1.0 / 24.0
# Rounding keeps a body that rests trembling, with residuals of so many times what it leaves in one evaluation.
TREMBLE = 10.0
# A pinned node has jumped if it is further than this part of an edge, and of the way of an elastic wave, from
# where its velocity would have taken it.
JUMP, JUMP_WAVE = 0.5, 0.5
# Friction shows what is left of the forces: with obstacles they are found to this part of the tolerance.
WITH_OBSTACLES = 0.1
# Of a body that costs nothing: in balance by itself, or lying still on what it touches.
AWAKE, BALANCED, LYING = 0, 1, 2
HELD = ("position", "velocity", "position_before", "velocity_before", "external_impulse")


class BodySolver:
    """Advances body `index` of the layout. Of the stage's arrays, it touches those of its own nodes alone.

    A step is `begin`, `solve` as often as contact wants it, and `finish`; `retract` undoes it.

    struck: whether the body has run into an obstacle in this step, and so forgets its past.
    """

    def __init__(
        self,
        model: Model,
        layout: TetLayout,
        index: int,
        motion: Any,
        asleep: wp.array,
        tangle: wp.array,
        still: tuple[wp.array, wp.array],
        real: type,
    ) -> None:
        """motion: struct `Motion` of `body_kernels`, of all nodes.  asleep: (1,) int32, AWAKE, BALANCED or LYING,
        tangle and still: the memories of `Recovery` and `Stillness`: parts of the state."""
        self._layout, self._nodes = layout, layout.nodes(index)
        self._body, self._settings, self._launcher = layout.bodies[index], model.settings.flesh, model.launcher
        self._motion, self._asleep = motion, asleep
        self._kernels, device = body_kernels(real), model.launcher.device
        self.targets = Targets(self._body, model.launcher)
        self._driven = wp.array(self.targets.driven, dtype=wp.int32, device=device)
        free = np.flatnonzero(~layout.pinned[self._nodes]).astype(np.int32) + self._nodes.start
        self.newton = Newton(layout, index, free, motion.position, model.launcher, real) if len(free) else None
        self._whole: WholeBody | None = None
        if not len(self.targets.driven):
            self._whole = WholeBody(self._nodes, model.launcher)
            self._ones = wp.ones(layout.node_count, dtype=wp.float64, device=device)
        self._explicit: ExplicitSteps | None = None
        if self._settings.integrator == "symplectic-euler" and self.newton is not None:
            self._explicit = ExplicitSteps(
                self.newton, layout, index, self._settings.rpic_damping, model.launcher, real
            )
        self._recovery = Recovery(layout, index, self.targets, tangle, model.launcher, real)
        self._arrays = [getattr(motion, name)[self._nodes] for name in HELD]
        self._kept = [wp.zeros_like(array) for array in self._arrays]
        self._step = self._kernels.types.Step()
        self._step.first_node = self._nodes.start
        self._step.mass_damping = self._body.mass_damping
        self._step.gravity = wp.vec3d(*model.scene.gravity)
        mean_mass = float(layout.mass[free].mean()) if len(free) else 0.0
        edge = float(layout.edge[index])
        self._rest_residual = REST[real] * edge / REST_TIME**2 * mean_mass * np.sqrt(len(free))
        young, density = np.max(self._body.youngs_modulus), np.mean(self._body.density)
        self._edge, self._wave = edge, float(np.sqrt(young / density))
        self._stillness = Stillness(*still, edge)
        self.struck = self._meets = False
        self.tally = Tally()
        self._report: Report | None = None

    @property
    def asleep(self) -> bool:
        return self._sleep != AWAKE

    @property
    def lies(self) -> bool:
        """Whether it sleeps on what it touches."""
        return self._sleep == LYING

    @property
    def stays(self) -> bool:
        """Whether it goes on lying in this step."""
        return self._skipped and self.lies

    @property
    def _sleep(self) -> int:
        return int(self._asleep.numpy()[0])

    # -- a step ----------------------------------------------------------------------------------------------

    def begin(self, substep: Interval, scheme: Scheme, disturbed: bool = False) -> None:
        """Takes the present for the past, and pinned nodes to where the animation wants them.

        disturbed: something moves that the body lies on, or that reaches it.
        """
        self._kept_asleep = self._sleep
        self._skipped = self.asleep and not disturbed and self._undisturbed(substep)
        self.struck = False
        if not self._skipped:
            self._begin(substep, scheme)

    def rouse(self, substep: Interval, scheme: Scheme) -> None:
        """Begins a step after all: what the body lies on, or carries, is awake."""
        self._skipped = False
        self._begin(substep, scheme)

    def _begin(self, substep: Interval, scheme: Scheme) -> None:
        self._stillness.begin()
        if self.lies or (self._stillness.noted and not self._undisturbed(substep)):
            self._stillness.forget()
        for kept, array in zip(self._kept, self._arrays, strict=True):
            wp.copy(kept, array)
        self._asleep.fill_(AWAKE)
        self._time, self._reference = substep.end, None
        if self.newton is not None:
            self.newton.obstacles = None
        self.targets.place(substep.end)
        step = self._step
        step.start, step.before, step.reach = scheme.start, scheme.before, scheme.reach
        step.length, step.length_before = scheme.length, scheme.length_before
        self._over_nodes(self._kernels.boost)
        if self._jumped(substep.length):
            self._carry(substep)
        driven = [self._driven, self.targets.position, self._nodes.start]
        self._launcher.launch(self._kernels.drive, len(self._driven), driven, [self._motion.goal])
        self._over_nodes(self._kernels.begin)
        self.tally.steps += 1

    def solve(self) -> bool:
        """The elastic step with obstacles and the contact impulses so far; whether it converged."""
        if self._skipped or self.newton is None:
            converged = True
        elif self.newton.obstacles is None and self._explicit is not None:
            self._explicit.advance(self._step, self._motion)
            return True
        elif self.newton.obstacles is None:
            converged = self._minimise() if self._whole is None else self._minimise_free()
        else:
            motion = self._motion
            obstacles = self.newton.obstacles
            converged = obstacles.alternate(motion.position_before, motion.position, self._minimise)
            if obstacles.gives_way and self._whole is not None:
                force, moment = obstacles.total(motion.base)
                given = self._whole.moments(self._ones, motion.base, motion.contact_impulse)
                reach = self._step.reach
                self._give_momenta(given.weight * given.mean_b + reach * force, given.cross + reach * moment)
        if not self._skipped:
            self._over_nodes(self._kernels.find_velocity)
        return converged

    def meet(self, obstacles: ObstacleForces, substep: Interval, scheme: Scheme) -> bool:
        """Takes the step again if it led through obstacles; whether it converged.

        By backward Euler where one is struck: the second-order scheme, told by its past of a motion that has
        ended, would take the body off again with half of its speed. And where rigid bodies give way: what the body
        gains in the substep is then what they lose.
        """
        if not self._skipped and self.newton is not None and self.newton.obstacles is obstacles:
            return self.solve()
        if self.newton is None or not obstacles.pushes(self._motion.position, self._step.reach):
            return True
        if self._skipped:
            self._skipped = False
            self._begin(substep, scheme)
        lasts = not obstacles.strikes(self._motion.position)
        if (obstacles.gives_way or not lasts) and self._step.before > 0.0:
            self.struck = True
            step = self._step
            step.start, step.before, step.reach = 1.0, 0.0, step.length
            self._over_nodes(self._kernels.restart)
            obstacles.pushes(self._motion.position, step.reach)
        self.newton.obstacles, self._meets = obstacles, True
        return self.solve()

    def wake(self, substep: Interval, scheme: Scheme) -> bool:
        """Begins a step after all if contact has touched a body that was skipped; whether it must be solved."""
        touched = self._motion.contact_impulse[self._nodes].numpy().any()
        if not (self._skipped and touched):
            return False
        self._skipped = False
        impulse = wp.clone(self._motion.contact_impulse[self._nodes])
        wp.copy(self._motion.position[self._nodes], self._motion.position_before[self._nodes])
        self._motion.velocity[self._nodes].zero_()
        self._begin(substep, scheme)
        wp.copy(self._motion.contact_impulse[self._nodes], impulse)
        return True

    def finish(self) -> None:
        """Makes what contact did part of the past."""
        if self._skipped:
            return
        self._over_nodes(self._kernels.forget if self.struck else self._kernels.absorb_contact)
        pushed_by_obstacles = self.newton is not None and self.newton.obstacles is not None
        if self._whole is not None and not self.struck and not pushed_by_obstacles:
            self._shift_past()

    def _shift_past(self) -> None:
        """Takes back the way that an impulse shifts a free body by in a multistep scheme.

        Its velocity changes at once, but x = base + gamma h v has only gamma h of it: across the way of what it
        met, the rest would be angular momentum out of nothing. What rests has as much from gravity, and keeps it.
        """
        late = self._step.length - self._step.reach
        impulse = self._motion.contact_impulse[self._nodes].numpy()
        if late <= 0.0 or not impulse.any():
            return
        change = impulse.sum(axis=0) / self._layout.mass[self._nodes].sum()
        before = self._motion.position_before[self._nodes]
        before.assign(before.numpy() - late * (change + self._step.length * np.array(self._step.gravity)))

    def retract(self) -> None:
        """All as it was before `begin`, bit for bit."""
        if self._skipped:
            return
        for kept, array in zip(self._kept, self._arrays, strict=True):
            wp.copy(array, kept)
        self._asleep.fill_(self._kept_asleep)
        self._stillness.retract()

    def _over_nodes(self, kernel: wp.Kernel) -> None:
        count = self._nodes.stop - self._nodes.start
        self._launcher.launch(kernel, count, [self._step], [self._motion])

    # -- the elastic solve -----------------------------------------------------------------------------------

    def _minimise(self) -> bool:
        newton, settings, motion, step = self.newton, self._settings, self._motion, self._step
        if newton.damping is not None:
            share = 1.0 if step.before > 0.0 else 0.5
            newton.damping.begin(motion.position_before, motion.predicted, motion.base, share, step.reach)
        inputs = [step, motion]
        self._launcher.launch(self._kernels.aim, newton.rows.count, inputs, [newton.unknowns])
        here = newton.evaluate()
        if self._reference is None:
            self._check_finite(here)
            self._recovery.watch(here.least_volume)
            small = max(self._rest_residual, TREMBLE * here.rounding)
            if here.residual <= small and self._momentum() <= small * step.length:
                self._fall_asleep()
                return True
            self._reference = newton.force_size(step, motion)
            here = newton.start_from(motion.predicted, here)
        elif self._meets:
            # What lay on something lies there still: more likely there than where it would have fallen to.
            self._meets = False
            here = newton.start_from(motion.predicted, here)
        tolerance = settings.tolerance * (1.0 if newton.obstacles is None else WITH_OBSTACLES)
        outcome = newton.minimise(here, self._reference, tolerance, settings.max_iterations, step.reach)
        self.tally.newton_iterations += outcome.iterations
        self.tally.linear_iterations += outcome.linear_iterations
        self.tally.unconverged += not outcome.converged
        return outcome.converged

    def _minimise_free(self) -> bool:
        """Minimises, then gives the body its momenta."""
        motion = self._motion
        contact = self._whole.moments(self._ones, motion.base, motion.contact_impulse)
        converged = self._minimise()
        if not self.asleep:
            self._give_momenta(contact.weight * contact.mean_b, contact.cross)
        return converged

    def _give_momenta(self, impulse: np.ndarray, moment: np.ndarray) -> None:
        """Gives a free body the momenta of its start, but for gravity, damping and what it was given.

        impulse, moment: (3,) [kg m/s], (3,) [kg m2/s] about the origin, acting at `base`.
        """
        whole, motion, step = self._whole, self._motion, self._step
        start = whole.moments(motion.mass, motion.position_before, motion.velocity_before)
        base = whole.moments(motion.mass, motion.base, motion.base_velocity)
        damping = 1.0 / (1.0 + step.mass_damping * step.reach)
        change = damping * impulse / base.weight
        velocity = damping * (base.mean_b + step.reach * np.array(step.gravity)) + change
        centre = base.mean_a + step.reach * velocity
        # Of the impulses' torque, what does not show in the centre's own angular momentum is spin.
        orbital = np.cross(centre, velocity) - np.cross(centre - step.reach * change, velocity - change)
        spin = np.exp(-step.mass_damping * step.length) * start.inner_cross
        spin = spin + moment - base.weight * orbital
        now = whole.moments(motion.mass, motion.base, motion.position)
        rotation = rotation_with_spin(now.product, step.reach * spin)
        whole.move(motion.position, now.mean_b, rotation, centre)

    def _check_finite(self, here: Evaluation) -> None:
        if np.isfinite(here.residual):
            return
        bad = ~np.isfinite(self._motion.position.numpy()[self._nodes]).all(axis=1)
        bad |= ~np.isfinite(self._motion.base.numpy()[self._nodes]).all(axis=1)
        raise Diverged("position", self._layout.where(self._nodes.start + int(np.argmax(bad))), self._time)

    # -- what a frame took -----------------------------------------------------------------------------------

    def begin_frame(self) -> None:
        self.tally = Tally()

    def report(self) -> Report:
        """Of the body as it is; found anew only if it moved in this frame."""
        if self._report is None or self.tally.steps:
            mass = self._layout.mass[self._nodes]
            velocity = self._motion.velocity.numpy()[self._nodes]
            weighted = mass @ self._motion.position.numpy()[self._nodes]
            volumes = np.ones(1) if self.newton is None else self.newton.volumes()
            self._report = Report(
                kinetic_energy=0.5 * float(mass @ np.square(velocity).sum(axis=1)),
                elastic_energy=0.0 if self.newton is None else self.newton.elastic_energy(),
                potential_energy=-float(weighted @ np.array(self._step.gravity)),
                least_volume=float(volumes.min()),
                inverted=int((volumes <= 0.0).sum()),
            )
        return self._report

    # -- tangles ---------------------------------------------------------------------------------------------

    @property
    def tangled(self) -> bool:
        """Whether some of it may be."""
        return self._recovery.suspects

    def recover(self, time: float, past: float, alone: bool) -> None:
        """Between steps, at `time` [s]: lets go what is tangled for good.

        past: [s] length of the step before.  alone: nothing else is near.
        """
        motion, nodes = self._motion, self._nodes
        arrays = [motion.position[nodes], motion.velocity[nodes]]
        found = self._recovery.let_go(time, *arrays, alone)
        if found is None:
            return
        moved, position, velocity = found
        arrays += [motion.position_before[nodes], motion.velocity_before[nodes]]
        for array, values in zip(arrays, (position, velocity, position - past * velocity, velocity), strict=True):
            held = array.numpy().copy()
            held[moved] = values
            array.assign(held)
        self._asleep.fill_(AWAKE)
        self.tally.tangles += 1

    # -- rest ------------------------------------------------------------------------------------------------

    def _momentum(self) -> float:
        """[kg m/s] 2-norm of the nodes' momenta at the start: what swings back would not move now either."""
        velocity = self._motion.velocity_before[self._nodes].numpy()
        return float(np.linalg.norm(self._layout.mass[self._nodes, None] * velocity))

    def _fall_asleep(self) -> None:
        """Nothing would move: nothing does, and nothing is computed until something happens to the body."""
        wp.copy(self._motion.base[self._nodes], self._motion.position[self._nodes])
        self._motion.velocity_before[self._nodes].zero_()
        self._asleep.fill_(BALANCED)

    def watch(self, length: float, touches: bool, disturbed: bool) -> None:
        """Takes note of a step of `length` [s] that the body has taken.

        touches: another body, or itself.  disturbed: something moves that it touches, or that reaches it.
        """
        touches = touches or (self.newton is not None and self.newton.obstacles is not None)
        if touches and not disturbed:
            self._stillness.watch(self._motion.position[self._nodes], length)
        else:
            self._stillness.forget()

    @property
    def still(self) -> bool:
        """Whether it may sleep as far as it alone is concerned."""
        return self.asleep or self._stillness.lasts

    def lie_down(self) -> None:
        """Stays where it is, with the forces that it has from what it touches, until something happens."""
        motion, nodes = self._motion, self._nodes
        for array in (motion.base, motion.position_before):
            wp.copy(array[nodes], motion.position[nodes])
        for array in (motion.velocity, motion.velocity_before):
            array[nodes].zero_()
        self._asleep.fill_(LYING)

    def _undisturbed(self, substep: Interval) -> bool:
        """Whether nothing happens to the body in this step but what has happened all along."""
        if self._motion.external_impulse[self._nodes].numpy().any():
            return False
        return not self.targets.moves(substep.start, substep.end)

    # -- jumps of the animation ------------------------------------------------------------------------------

    def _jumped(self, length: float) -> bool:
        """Whether a pinned node goes further at once than flesh could follow."""
        if not len(self._driven) or not self.targets.animated:
            return False
        nodes = self.targets.driven + self._nodes.start
        expected = self._motion.position.numpy()[nodes] + length * self._motion.velocity.numpy()[nodes]
        off = np.linalg.norm(self.targets.position.numpy() - expected, axis=1)[self._layout.pinned[nodes]]
        return bool(off.size and off.max() > max(JUMP * self._edge, JUMP_WAVE * self._wave * length))

    def _carry(self, substep: Interval) -> None:
        """Takes every node along with the animation: the pose changes, the velocities do not."""
        way = self.targets.all_nodes(substep.end) - self.targets.all_nodes(substep.start)
        motion, nodes = self._motion, self._nodes
        position, velocity = motion.position.numpy()[nodes] + way, motion.velocity.numpy()[nodes]
        motion.position[nodes].assign(position)
        motion.position_before[nodes].assign(position - self._step.length_before * velocity)
        motion.velocity_before[nodes].assign(velocity)
        self.tally.pops += 1
