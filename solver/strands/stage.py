"""Strands as implicit discrete elastic rods: the stage that owns their state and advances it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from plait.solver.contact.planes import PLANES_A_NODE, allocate_planes
from plait.solver.contact.surfaces import SurfaceContact
from plait.solver.diagnostics import Diverged, Refused
from plait.solver.model import Interval, Model
from plait.solver.state import State
from plait.solver.strands.free import FreeStrands
from plait.solver.strands.kernels import strand_kernels
from plait.solver.strands.layout import Layout, build_layout
from plait.solver.strands.rest_shape import fit_rest_shapes
from plait.solver.strands.scratch import allocate_scratch, count_chunks
from plait.solver.strands.stretch import softened_stretch
from plait.solver.strands.types import rod_types

if TYPE_CHECKING:
    from plait.solver.contact.reaction import SkinReaction
    from plait.solver.strand_contact.coupled import StrandContact
    from plait.solver.strand_contact.missed import MissedCollisions
    from plait.solver.strand_contact.paper import PaperStrandContact
    from plait.solver.strands.pushes import Pushes

# A strand that does not converge is stepped in halves, quarters, ... of its substep, down to this many parts.
MAX_PIECES = 16
# Cost of a node's solve in units of `Launcher.launch`.
NODE_WORK = 50
# Strain that contact may add in a substep before bodies are made to move in shorter steps; and that beyond which
# shorter steps have not helped: the contacts are out of the strand's reach.
STRAINED, TORN = 0.02, 0.1
# [s] A strand that shorter steps did not help asks for none for so long: it may be caught between bodies.
EXCUSED = 0.25
# Friction is full from ways of this part of a radius on.
SLIP = 1.0e-2
LEAST_TOLERANCE_FLOAT32 = 1.0e-3
STATE_ARRAYS = ("position", "velocity", "director", "twist", "tension", "root_position", "root_rotation")


def build(model: Model, state: State) -> StrandsStage | None:
    """The stage of the scene's strands, at rest at `model.start_time`; None without strands."""
    if not model.scene.strands:
        return None
    return StrandsStage(model, state)


class StrandsStage:
    """All strands of a scene, one direct solve per strand and Newton iteration.

    State arrays (see `RodState`): strands/position, velocity, director, twist, tension, root_position,
    root_rotation; with free strands spin, and those of `FreeStrands`.

    position, velocity: (node_count,) vec3d [m], [m/s], world, ghosts included.
    warnings: lines for the user about what could not be taken as given.
    pushes: impulses that others give; None where nobody does.
    """

    name = "strands"

    def __init__(self, model: Model, state: State) -> None:
        self._model = model
        self._launcher = model.launcher
        self._kinematics = model.parts["kinematics"]
        self.layout = build_layout(model.scene)
        self.real = _precision(model)
        self._types = rod_types(self.real)
        self._kernels = strand_kernels(self.real)
        self._place(state)
        self._allocate()
        self._method = self._make_method()
        self._reaction: SkinReaction | None = None
        self.pushes = self._make_pushes(state)
        self._contact = self._make_contact(state)
        self._meetings = self._make_meetings(state)
        self._impulses = self._make_impulses(state)
        self._judge = self._make_judge()
        if self._contact is not None or self._meetings is not None or self._impulses is not None:
            self._result = self._allocate_result()
        self._iterations: list[np.ndarray] = []
        self._unconverged = 0
        self._subdivided = 0
        self._let_go_count = 0
        self._missed = 0

    # -- building ------------------------------------------------------------------------------------------

    def _place(self, state: State) -> None:
        """Constants; the drawn shape carried rigidly to where its root is now."""
        layout, device, launcher = self.layout, self._launcher.device, self._launcher
        shape = fit_rest_shapes(layout, launcher)
        self._note_stiffening(shape.stiffening)
        strand, ghosts, root_nodes = layout.node_strand, layout.first_node[:-1], layout.first_node[:-1] + 1
        real, types = self.real, self._types

        def hold(values: np.ndarray, dtype: Any = real) -> wp.array:
            return wp.array(values, dtype=dtype, device=device)

        rods = types.Rods()
        rods.first_node = hold(layout.first_node, wp.int32)
        rods.mass = hold(layout.mass)
        rods.force = hold(layout.force, types.vec3)
        stretch = softened_stretch(layout, real)
        rest_length = layout.rest_length(shape.tension, stretch)
        rods.rest_length, rods.inverse_rest_length = hold(rest_length), hold(1.0 / rest_length)
        rods.stretch, rods.stretch_beyond = hold(stretch), hold(layout.stretch - stretch)
        rods.bend, rods.twist = (hold(values) for values in layout.vertex_stiffness(shape.stiffening))
        rods.rest_curvature = hold(shape.curvature, types.vec2)
        rods.rest_twist = hold(shape.twist)
        rods.damping = hold(layout.damping)
        rods.segment = hold(layout.mean_segment)
        rods.slip = hold(SLIP * layout.radius[root_nodes])
        rods.ghost = hold(layout.position[ghosts] - layout.position[root_nodes], wp.vec3d)
        rods.clamp_director = hold(shape.director[ghosts], wp.vec3d)
        rods.free = hold(layout.free, wp.int32)
        some_free = layout.free.any()
        rods.turn_inertia = hold(layout.turn_inertia if some_free else np.zeros(0))
        self.rods = rods

        root_position = self._kinematics.root_position.numpy()
        root_rotation = self._kinematics.root_rotation.numpy()
        rotation = root_rotation[strand]
        relative = layout.position - layout.position[root_nodes][strand]
        held = types.RodState()
        held.position = hold(np.einsum("nij,nj->ni", rotation, relative) + root_position[strand], wp.vec3d)
        held.velocity = wp.zeros(layout.node_count, dtype=wp.vec3d, device=device)
        held.director = hold(np.einsum("nij,nj->ni", rotation, shape.director), wp.vec3d)
        held.twist = wp.zeros(layout.node_count, dtype=wp.float64, device=device)
        held.tension = hold(shape.tension, wp.float64)
        held.root_position = hold(root_position, wp.vec3d)
        held.root_rotation = hold(root_rotation, wp.mat33d)
        held.spin = wp.zeros(layout.node_count if some_free else 0, dtype=wp.float64, device=device)
        self._held = held
        self.position, self.velocity = held.position, held.velocity
        self._names = (*STATE_ARRAYS, "spin") if some_free else STATE_ARRAYS
        gained = 0.5 if self._model.settings.strands.integrator == "sdirk2" else 1.0
        self._free = FreeStrands(layout, launcher, state, gained) if some_free else None
        for name in self._names:
            state.arrays[f"strands/{name}"] = getattr(held, name)

    def _note_stiffening(self, stiffening: np.ndarray) -> None:
        """A warning a prim whose strands are too soft to stay as drawn."""
        layout, warnings = self.layout, []
        for prim, name in enumerate(layout.names):
            factors = stiffening[layout.prim_strands[prim] : layout.prim_strands[prim + 1]]
            soft = int((factors > 1.0).sum())
            if soft:
                warnings.append(
                    f"{name}: {soft} of {len(factors)} strands are too soft to stay as drawn under gravity, "
                    f"whatever their rest shape; they are made up to {factors.max():.3g} times as stiff to bend "
                    "and twist"
                )
        self.warnings = tuple(warnings)
        self._stiffened = int((stiffening > 1.0).sum())

    def _allocate(self) -> None:
        device, types = self._launcher.device, self._types
        strands = self.layout.strand_count
        self._chunks = count_chunks(strands, self._launcher)
        self._scratch = allocate_scratch(self.real, self.layout, self._chunks, device)
        report = types.Report()
        for name in ("iterations", "unconverged", "pieces", "contacts"):
            setattr(report, name, wp.zeros(strands, dtype=wp.int32, device=device))
        self._report = report
        self._no_planes = allocate_planes(0, device)
        self._all = wp.ones(strands, dtype=wp.int32, device=device)
        self._measures = wp.zeros((strands, len(MEASURES)), dtype=wp.float64, device=device)

    def _make_method(self) -> Any:
        settings = self._model.settings.strands
        method = self._types.Method()
        method.stages = 2 if settings.integrator == "sdirk2" else 1
        method.tolerance = self._reachable(settings.tolerance)
        method.max_iterations = settings.max_iterations
        method.max_pieces = MAX_PIECES
        return method

    def _make_contact(self, state: State) -> SurfaceContact | None:
        """Contact with the surfaces that collide."""
        if self._kinematics.colliders is None:
            return None
        device = self._launcher.device
        self._flags = wp.zeros(self.layout.strand_count, dtype=wp.int32, device=device)
        if self._model.scene.bodies or self._model.scene.rigid_bodies:
            from plait.solver.contact.reaction import SkinReaction

            self._reaction = SkinReaction(self._model)
            self._report.reaction = wp.zeros(self.layout.node_count * PLANES_A_NODE, dtype=wp.vec3d, device=device)
        self._excused_until = wp.full(self.layout.strand_count, -np.inf, dtype=wp.float64, device=device)
        state.arrays["strands/excused_until"] = self._excused_until
        return SurfaceContact(
            self._model,
            state,
            first_node=self.layout.first_node,
            position=self._held.position,
            radius=self.layout.radius,
            friction=self.layout.friction,
            free=self.layout.free,
        )

    def _make_meetings(self, state: State) -> StrandContact | None:
        """Contact of strands with each other, and what holds points of strands."""
        contact = self._model.settings.strand_contact.method == "implicit" and self.layout.strand_count > 1
        if not contact and not self._model.scene.attachments:
            return None
        from plait.solver.strand_contact.coupled import StrandContact

        return StrandContact(self._model, state, self.layout, self.rods, self.real)

    def _make_pushes(self, state: State) -> Pushes | None:
        """Where something pushes strands that they do not see."""
        if not self._model.scene.granular:
            return None
        from plait.solver.strands.pushes import Pushes

        return Pushes(self.layout.mass, self.layout.prescribed, self._launcher, state)

    def _make_judge(self) -> MissedCollisions | None:
        """Counts what contact of strands lets through."""
        if self._model.settings.strand_contact.method == "none" or self.layout.strand_count < 2:
            return None
        from plait.solver.strand_contact.missed import MissedCollisions

        return MissedCollisions(self._launcher, self.layout)

    def _make_impulses(self, state: State) -> PaperStrandContact | None:
        """The variant of that: impulses after the solve."""
        if self._model.settings.strand_contact.method != "paper":
            return None
        from plait.solver.strand_contact.paper import PaperStrandContact

        return PaperStrandContact(self._model, state, self.layout, self.layout.prescribed)

    def _allocate_result(self) -> Any:
        """Room for a substep's result while it is tried."""
        result = self._types.RodState()
        result.spin = self._held.spin
        for name in self._names:
            setattr(result, name, wp.zeros_like(getattr(self._held, name)))
        return result

    def _reachable(self, tolerance: float) -> float:
        """The tolerance, or what rounding lets float32 reach."""
        return tolerance if self.real == wp.float64 else max(tolerance, LEAST_TOLERANCE_FLOAT32)

    # -- stepping ------------------------------------------------------------------------------------------

    def begin_frame(self, state: State, frame: Interval) -> None:
        self._iterations.clear()
        self._unconverged = self._subdivided = self._let_go_count = self._missed = 0
        if self._contact is not None:
            self._contact.begin_frame()
        if self._meetings is not None:
            self._meetings.begin_frame()

    def step(self, state: State, substep: Interval, last_resort: bool = False) -> bool:
        """One implicit substep of every strand; with surfaces in reach, solve and detection in turns.

        Does not stand where contact tears a strand, or keeps it from converging: bodies then move too far at once.
        """
        self._method.step = substep.length
        self._method.warm = 0
        if self.pushes is not None:
            self.pushes.take_up(self._held.velocity)
        if self._free is not None:
            self._free.lead(self._held, self._kinematics, substep.length)
        stands, meetings = True, self._meetings
        if meetings is not None:
            meetings.begin_substep(substep, self._held.position)
            if meetings.ties is not None and self._contact is not None:
                self._contact.leave_out(meetings.ties.held_nodes)
        touching = self._contact is not None and self._contact.active
        if not touching and meetings is None and self._impulses is None:
            self._solve(self._method, self._held, self._all, constrained=False)
        else:
            if touching:
                stands = self._step_in_contact(substep, last_resort)
            else:
                self._solve(self._method, self._result, self._all, constrained=False)
            if stands and meetings is not None and meetings.find(self._held, self._result, substep.length):
                stands = self._meet(touching, last_resort)
            if stands and self._impulses is not None:
                self._apply_impulses(substep, touching)
            if stands:
                self._commit(substep, touching)
        if stands and self._free is not None:
            self._free.commit(self._held.velocity, substep.length)
        self._count(stands)
        return stands

    def _meet(self, touching: bool, last_resort: bool) -> bool:
        """Solves strands that meet together, and finds the planes in their way, in turns; whether that stands."""
        meetings, contact, held, result = self._meetings, self._contact, self._held, self._result
        free_strain = self._strain(result)
        meetings.begin(self._method, held, result, self._roots())
        planes = contact.planes if touching else self._no_planes
        for _ in range(self._model.settings.contact.passes):
            stands = meetings.solve(result, planes, touching, last_resort)
            if stands and not last_resort:
                stands = not ((self._strain(result) - free_strain > STRAINED) & ~meetings.attached).any()
            if not (stands and touching):
                return stands
            self._flags.assign(meetings.solved.astype(np.int32))
            if not contact.examine(held.position, result.position, self._flags):
                return True
        contact.guard(held.position, result.position, self._flags)
        self._realign(self._flags)
        return last_resort or not meetings.crossed(result.position)

    def _apply_impulses(self, substep: Interval, touching: bool) -> None:
        """Impulses between strands, in the result; what they drive into surfaces is led out again."""
        held, result = self._held, self._result
        self._impulses.apply(held.position, result.position, result.velocity, substep.length)
        if touching:
            self._flags.fill_(1)
            self._contact.examine(held.position, result.position, self._flags)
            self._contact.guard(held.position, result.position, self._flags)
        self._realign(self._all)

    def _commit(self, substep: Interval, touching: bool) -> None:
        """The result is what there is from now on."""
        if touching:
            self._contact.end_substep()
            if self._broken and self._reaction is not None:
                self._reaction.give(self._contact, self._result.position, self._report.reaction, substep.length)
        if self._meetings is not None:
            self._meetings.commit()
        if self._judge is not None and (self._impulses is not None or self._meetings.meets):
            self._missed += self._judge.count(self._held.position, self._result.position)
        for name in self._names:
            wp.copy(getattr(self._held, name), getattr(self._result, name))

    def retract(self, state: State, substep: Interval) -> None:
        """A step that does not stand has left the state alone, but for what others gave."""
        if self.pushes is not None:
            self.pushes.retract(self._held.velocity)

    def _step_in_contact(self, substep: Interval, last_resort: bool) -> bool:
        """First without contact; then what broke a plane again with planes, from where it is, while any does."""
        contact, held, result, flags = self._contact, self._held, self._result, self._flags
        contact.begin_substep(substep.length)
        self._solve(self._method, result, self._all, constrained=False)
        flags.fill_(1)
        broken = self._broken = contact.examine(held.position, result.position, flags)
        if broken:
            tried, free_strain = flags.numpy() > 0, self._strain(result)
            self._solve_in_contact(broken, last_resort)
            strain, failed = self._judge_contact(tried, free_strain)
            troubled, excused = failed | (strain > STRAINED), self._excused_until.numpy()
            if not last_resort and (troubled & (excused <= substep.start)).any():
                return False
            self._excused_until.assign(np.where(troubled, substep.end + EXCUSED, excused))
            self._let_go(strain > TORN)
        return True

    def _solve_in_contact(self, broken: int, last_resort: bool) -> None:
        """Solve and detection in turns for the strands flagged; what remains is put right by hand."""
        contact, held, result, flags = self._contact, self._held, self._result, self._flags
        self._method.warm = 1
        # Rather the bodies move less at once, than strands in parts against bodies that have moved all the way.
        self._method.max_pieces = MAX_PIECES if last_resort else 1
        for _ in range(self._model.settings.contact.passes):
            if broken == 0:
                break
            self._solve(self._method, result, flags, constrained=True)
            broken = contact.examine(held.position, result.position, flags)
        self._method.max_pieces = MAX_PIECES
        contact.guard(held.position, result.position, flags)
        if broken:
            self._realign(flags)

    def _realign(self, flags: wp.array) -> None:
        """Directors across their edges again, in the result, for the strands flagged."""
        result = self._result
        inputs = [flags, self.rods.first_node, result.position]
        self._launcher.launch(
            self._kernels.realign, self.layout.strand_count, inputs, [result.director, result.twist]
        )

    def _judge_contact(self, tried: np.ndarray, free_strain: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(strand_count,) what contact stretched each strand by; whether it kept it from converging."""
        stretched = np.where(tried, self._strain(self._result) - free_strain, 0.0)
        return np.where(np.isnan(stretched), np.inf, stretched), tried & (self._report.unconverged.numpy() > 0)

    def _strain(self, rods: Any) -> np.ndarray:
        """(strand_count,) the largest strain of each strand."""
        self._launcher.launch(self._kernels.measure, self.layout.strand_count, [self.rods, rods], [self._measures])
        return self._measures.numpy()[:, 0].copy()

    def _let_go(self, torn: np.ndarray) -> None:
        """Strands whose contacts are out of their reach go as if nothing were in their way.

        Where a body has jumped onto them they are then led out of it, like hair that starts inside.
        """
        if not torn.any():
            return
        self._method.warm = 0
        self._flags.assign(torn.astype(np.int32))
        self._solve(self._method, self._result, self._flags, constrained=False)
        self._contact.examine(self._held.position, self._result.position, self._flags)
        self._let_go_count += int(torn.sum())

    def _roots(self) -> Any:
        roots = self._types.Roots()
        if self._free is not None:
            roots.position, roots.rotation = self._free.position, self._free.rotation
            return roots
        roots.position = self._kinematics.root_position
        roots.rotation = self._kinematics.root_rotation
        return roots

    def _solve(self, method: Any, out: Any, active: wp.array, *, constrained: bool) -> None:
        roots = self._roots()
        nodes_a_chunk = max(1, self.layout.node_count // self._chunks)
        planes = self._contact.planes if constrained else self._no_planes
        inputs = [self._chunks, active, constrained, planes, method, self.rods, self._held, roots, self._scratch]
        self._launcher.launch(
            self._kernels.solve, self._chunks, inputs, [out, self._report], work_per_item=NODE_WORK * nodes_a_chunk
        )

    def _count(self, stands: bool) -> None:
        self._iterations.append(self._report.iterations.numpy().copy())
        if not stands:
            return
        self._unconverged += int(self._report.unconverged.numpy().sum())
        self._subdivided += int((self._report.pieces.numpy() > 1).sum())

    def relax(self, tolerance: float = 1e-6, max_iterations: int = 200) -> np.ndarray:
        """Moves every strand to static equilibrium at the present roots; velocities become zero.

        tolerance: as `StrandSettings.tolerance`. Returns the Newton iterations of each strand, (strand_count,)
        int32, negative where they did not converge; such a strand is left where the iteration ended.
        Raises `Refused` for free strands, which nothing keeps anywhere, and for attachments.
        """
        if self._model.scene.attachments:
            raise Refused(
                f"{self._model.scene.attachments[0].name}: static equilibria are found without attachments"
            )
        if self._free is not None:
            where = self.layout.where(int(np.argmax(self.layout.free)))
            raise Refused(f"{where}: it is free; what nothing holds has no static equilibrium")
        method = self._make_method()
        method.step, method.stages, method.max_pieces = 0.0, 1, 1
        method.tolerance, method.max_iterations = self._reachable(tolerance), max_iterations
        self._solve(method, self._held, self._all, constrained=False)
        self._held.velocity.zero_()
        return np.where(self._report.unconverged.numpy() > 0, -1, 1) * self._report.iterations.numpy()

    def end_frame(self, state: State, frame: Interval) -> dict[str, Any]:
        """Iterations, strains and energies of the frame; raises `Diverged` for a strand that is not finite."""
        self._launcher.launch(
            self._kernels.measure, self.layout.strand_count, [self.rods, self._held], [self._measures]
        )
        values = self._measures.numpy()
        finite = np.isfinite(values).all(axis=1)
        if not finite.all():
            raise Diverged("position", self.layout.where(int(np.argmin(finite))), frame.end)
        iterations = np.concatenate(self._iterations) if self._iterations else np.zeros(1)
        total = dict(zip(MEASURES, values.sum(axis=0), strict=True))
        contacts = self._contact.end_frame(self._held.position) if self._contact is not None else {}
        if self._meetings is not None:
            contacts |= self._meetings.end_frame()
        if self._impulses is not None:
            contacts |= self._impulses.end_frame()
        if self._judge is not None:
            contacts |= {"missed": self._missed}
        return contacts | {
            "iterations_mean": float(iterations.mean()),
            "iterations_max": int(iterations.max()),
            "unconverged": self._unconverged,
            "subdivided": self._subdivided,
            "let_go": self._let_go_count,
            "stiffened": self._stiffened,
            "contacts": int(self._report.contacts.numpy().sum()),
            "strain_max": float(values[:, 0].max()),
            "strain_median": float(np.median(values[:, 0])),
            "kinetic_energy": float(total["kinetic"]),
            "elastic_energy": float(total["elastic"]),
            "potential_energy": float(total["potential"]),
        }

    # -- results -------------------------------------------------------------------------------------------

    def points(self, prim: int) -> np.ndarray:
        """(point_count, 3) float64 [m]: prim's points in the artist's order, scene world."""
        return self._held.position.numpy()[self._nodes(prim)]

    def velocities(self, prim: int) -> np.ndarray:
        """(point_count, 3) float64 [m/s] at the same points."""
        return self._held.velocity.numpy()[self._nodes(prim)]

    def directors(self, prim: int) -> np.ndarray:
        """(point_count, 3) float64, unit, scene world: material axis 1 of the segment that begins at each point.

        A tip begins none; its own is without meaning.
        """
        return self._held.director.numpy()[self._nodes(prim)]

    def root_rotations(self, prim: int) -> np.ndarray:
        """(strand_count, 3, 3) float64: the strands' rest space to scene world, at the roots."""
        begin, end = self.layout.prim_strands[prim : prim + 2]
        return self._held.root_rotation.numpy()[begin:end]

    def _nodes(self, prim: int) -> np.ndarray:
        layout: Layout = self.layout
        return layout.point_node[layout.prim_points[prim] : layout.prim_points[prim + 1]]


MEASURES = ("strain", "kinetic", "elastic", "potential")


def _precision(model: Model) -> type:
    settings = model.settings
    if settings.precision == "float64" or settings.strands.precision == "float64":
        return wp.float64
    if settings.strands.precision == "float32" or model.launcher.device.is_cuda:
        return wp.float32
    return wp.float64
