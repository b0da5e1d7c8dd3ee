"""Rigid bodies by Han 2019 §6, a variant for comparison: collision particles with a potential, on a grid.

What is done otherwise than printed, and why:

- A velocity changes by the sum of impulses over the body's mass, not the particle's; the inertia is the world's.
- Particles see their own body's exact velocity at nodes, not one filtered by the grid: a node that is one body's
  alone pushes nothing, so a lone body, however it spins, is left as it is.
- Both sides' particles say one half of the impulse between two bodies, which acts in one place: momenta stay.
- What is normal is said by the surface that is met, see `look`.
- Directors follow the bodies' velocities after the impulses, see `carry_directors`.
- What is animated weighs as much for its area as what meets it, and does not give way: were it infinitely heavy,
  how far it keeps others off would jump with where its surface lies between nodes.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import warp as wp

from plait.solver.diagnostics import Refused
from plait.solver.grid.sparse_grid import SparseGrid
from plait.solver.grid.transfer_kernels import BLOCK_NODES
from plait.solver.model import Interval, Model
from plait.solver.rigid.paper_kernels import (
    carry_directors,
    gather_forces,
    gather_layers,
    look,
    place_directors,
    press,
    push_bodies,
    share_out,
)
from plait.solver.rigid.paper_law import longest_step
from plait.solver.rigid.paper_skin import AnimatedSkin, BodySkin, animated_skin
from plait.solver.rigid.paper_types import Field, Layers
from plait.solver.rigid.quaternions import rotation_matrix
from plait.solver.rigid.stage import RigidStage
from plait.solver.state import State

# Cells within which, along each axis, two particles share nodes.
SHARING = 3.0
# Part of the longest stable step that is taken.
SAFETY = 0.7
FOUND = {
    "facing": wp.vec3d,
    "director": wp.vec3d,
    "pull": wp.vec3d,
    "impulse": wp.vec3d,
    "seen": wp.float64,
    "animated": wp.float64,
    "met_friction": wp.float64,
}
LAYERED = {
    "mass": wp.float64,
    "velocity": wp.vec3d,
    "normal": wp.vec3d,
    "force": wp.vec3d,
    "friction": wp.float64,
}
# Costs of items in units of `Launcher.launch`.
DIRECTOR_WORK, NODE_WORK, PARTICLE_WORK, PAIR_WORK, BODY_WORK = 10, 60, 400, 100, 200


class PaperStage(RigidStage):
    """`RigidStage` with this contact: a substep falls into steps of its own where bodies are near something.

    Raises `Refused` for what the variant does not know: joints, restitution, pairs that do not touch.
    """

    def __init__(self, model: Model, state: State) -> None:
        scene = model.scene
        unknown = {
            "joints": bool(scene.joints),
            "restitution": any(scene.restitution(s) > 0.0 for s in scene.surfaces if s.body is None),
            "filtered pairs": bool(scene.filtered),
        }
        for what, there in unknown.items():
            if there:
                raise Refused(f"solver.rigid.method=paper knows no {what}: use solver.rigid.method=exact")
        super().__init__(model, state)

    def _lay_out_contact(self, state: State) -> PaperContact:
        return PaperContact(self._model, state, self)

    def _go(self, substep: Interval) -> None:
        for part in self.contact.parts(substep):
            self._tell_length(part.length)
            super()._go(part)


class PaperContact:
    """(34) to (41) on a sparse grid, with the particles that are near another body or an animated surface.

    reach: (body_count,) [m] from a centre of mass to what of the body is furthest, and the particles' range.
    unconverged: none, as nothing is iterated.

    State array: rigid/director, (particle_count,) vec3d, d of F in the axes of rest space; the normal where
    nothing presses.
    """

    unconverged = 0

    def __init__(self, model: Model, state: State, stage: RigidStage) -> None:
        self._model, self._stage, self._launcher = model, stage, model.launcher
        self._kinematics = model.parts["kinematics"]
        self.skin = BodySkin(
            model, [body.mass for body in stage.bodies], [body.center_of_mass for body in stage.bodies]
        )
        self.cell_size = self.skin.cell_size
        self.reach = self.skin.radius + SHARING * self.cell_size
        self._grid = SparseGrid(self.cell_size, model.launcher)
        self._field = Field()
        masses, start, _, step = stage.parts
        self._field.cell_size, self._field.step, self._field.motion = self.cell_size, step, stage.motion
        self._field.masses, self._field.start, self._field.skin = masses, start, self.skin.data
        self._has_skin = self.skin.radius > 0.0
        lightest = float(self.skin.density[self._has_skin].min(initial=np.inf))
        self._longest = SAFETY * longest_step(lightest, self.cell_size, model.settings.rigid.stiffness)
        state.arrays["rigid/director"] = self.skin.data.director
        self._before = wp.clone(self.skin.data.director)
        self._near: list[tuple[int, int]] = []
        self._animated: AnimatedSkin | None = None
        self._whole = Interval(0.0, 0.0)
        self._touching: wp.array | None = None

    # -- the substep -----------------------------------------------------------------------------------------

    def begin_frame(self) -> None:
        """Nothing that lasts a frame."""

    def parts(self, substep: Interval) -> list[Interval]:
        """The steps of a substep: within the potential's limit and CFL, where bodies are near something."""
        wp.copy(self._before, self.skin.data.director)
        if not self._has_skin.any():
            return [substep]
        speed = self._look_around(substep)
        if not self._near and not len(self._animated.area):
            return [substep]
        cfl = 0.5 * self._model.settings.grid.cfl * self.cell_size
        count = max(1, int(np.ceil(max(substep.length / self._longest, substep.length * speed / cfl))))
        edges = [substep.start + substep.length * k / count for k in range(count)] + [substep.end]
        return [Interval(*ends) for ends in pairwise(edges)]

    def _look_around(self, substep: Interval) -> float:
        """Finds what may come near to what in a substep; the fastest of bodies and surfaces, at most [m/s]."""
        stage, length = self._stage, substep.length
        position, speeds = stage.position.numpy(), stage.speeds()
        gravity = float(np.linalg.norm(self._model.scene.gravity))
        pace = np.linalg.norm(speeds[:, :3], axis=1) + length * gravity
        reach = self.skin.radius + length * pace + 0.5 * SHARING * self.cell_size
        has_skin = self._has_skin
        apart = np.linalg.norm(position[:, None] - position, axis=2)
        near = (apart < reach[:, None] + reach) & has_skin & has_skin[:, None]
        self._near = [(int(a), int(b)) for a, b in np.argwhere(near) if a < b]
        reach = (reach + 0.5 * SHARING * self.cell_size)[has_skin, None]
        boxes = np.stack([position[has_skin] - reach, position[has_skin] + reach], axis=1)
        surfaces = self._kinematics.colliders_near(boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0), substep)
        colliders, start = self._kinematics.colliders, self._kinematics.start
        self._whole = substep
        self._animated = animated_skin(colliders, surfaces, start, boxes, self.cell_size)
        turning = np.linalg.norm(speeds[:, 3:], axis=1) * self.skin.radius
        ways = np.linalg.norm(self._animated.end - self._animated.start, axis=1)
        return max(float((pace + turning).max()), float(ways.max(initial=0.0)) / length)

    def solve(self, part: Interval) -> None:
        """Gives the bodies the impulses of one of `parts`, whose forces they have taken up."""
        held = self._place(part)
        self._touching = None
        if held is None:
            self._rest()
            return
        bodies, pairs, own_first = held
        field, launch = self._field, self._launcher.launch
        count = int(own_first[-1])
        launch(place_directors, count, [field], work_per_item=DIRECTOR_WORK)
        launch(gather_layers, len(field.layers.mass), [field], work_per_item=NODE_WORK)
        launch(look, count, [field], work_per_item=PARTICLE_WORK)
        launch(gather_forces, len(field.layers.mass), [field], work_per_item=NODE_WORK)
        launch(press, count, [field], work_per_item=PARTICLE_WORK)
        pair_particle, pair_body, pair_first = self._pair_up(bodies, pairs, own_first)
        share = wp.zeros(len(pair_particle), dtype=wp.float64, device=self._launcher.device)
        inputs = [field, pair_particle, pair_body]
        launch(share_out, len(pair_particle), inputs, [share], work_per_item=PAIR_WORK)
        firsts = [self._hold(bodies), self._hold(own_first), pair_first]
        launch(push_bodies, len(bodies), [field, *firsts, pair_particle, share], work_per_item=BODY_WORK)
        self._rest()
        launch(carry_directors, count, [field], work_per_item=PARTICLE_WORK)
        self._touching = field.placed.seen

    def _rest(self) -> None:
        """Directors of what sees no other body are the normals."""
        wp.copy(self.skin.data.director, self.skin.data.normal)

    def _place(self, part: Interval) -> tuple[np.ndarray, list[tuple[int, int]], np.ndarray] | None:
        """Puts on the grid what may share nodes, or None.

        Bodies (n,) that have particles there, the pairs of them that are near each other, and where the particles
        of each begin, (n + 1,).
        """
        animated, whole = self._animated, self._whole
        if not self._near and (animated is None or not len(animated.area)):
            return None
        moved = (part.start - whole.start) / whole.length
        around = (1.0 - moved) * animated.start + moved * animated.end
        levers, world = self._bodies_in_world()
        chosen = {b: np.zeros(len(x), dtype=bool) for b, x in world.items()}
        pairs = [pair for pair in self._near if self._choose_of_pair(*pair, world, chosen)]
        met = np.zeros(len(around), dtype=bool)
        for b, x in world.items():
            touching = self._shared(x, around[self._shared(around, x)])
            chosen[b] |= self._shared(x, x[touching])
            met |= self._shared(around, x[touching])
        chosen = {b: np.flatnonzero(picked) for b, picked in chosen.items() if picked.any()}
        if not chosen:
            return None
        bodies = np.array(sorted(chosen))
        first = np.concatenate([[0], np.cumsum([len(chosen[b]) for b in bodies])])
        position = np.concatenate([*(world[b][chosen[b]] for b in bodies), around[met]])
        self._grid.place(position)
        particles = np.concatenate([self.skin.first[b] + chosen[b] for b in bodies])
        levers = np.concatenate([levers[b][chosen[b]] for b in bodies])
        self._lay_out(particles, levers, met)
        return bodies, pairs, first

    def _choose_of_pair(self, a: int, b: int, world: dict[int, np.ndarray], chosen: dict[int, np.ndarray]) -> bool:
        """Adds the particles of two bodies that may see each other, and those that weigh at the nodes seen."""
        seeing = {c: self._shared(world[c], world[d]) for c, d in ((a, b), (b, a))}
        if not (seeing[a].any() and seeing[b].any()):
            return False
        for c in (a, b):
            for d in (a, b):
                chosen[c] |= self._shared(world[c], world[d][seeing[d]])
        return True

    def _shared(self, x: np.ndarray, others: np.ndarray) -> np.ndarray:
        """(n,) whether particles at (n, 3) may share nodes with some at (m, 3), by the box about these."""
        if not len(others):
            return np.zeros(len(x), dtype=bool)
        margin = SHARING * self.cell_size
        return ((x >= others.min(axis=0) - margin) & (x <= others.max(axis=0) + margin)).all(axis=1)

    def _bodies_in_world(self) -> tuple[dict[int, np.ndarray], dict[int, np.ndarray]]:
        """Of bodies that are near something the particles, (n, 3) [m] from their centres of mass, and in world."""
        position, orientation = self._stage.position.numpy(), self._stage.orientation.numpy()
        if len(self._animated.area):
            bodies = np.flatnonzero(self._has_skin)
        else:
            bodies = np.unique(self._near)
        levers = {int(b): self.skin.levers(int(b), rotation_matrix(orientation[b])) for b in bodies}
        return levers, {b: position[b] + lever for b, lever in levers.items()}

    def _lay_out(self, particles: np.ndarray, levers: np.ndarray, met: np.ndarray) -> None:
        """Fills `Placed` and `Layers`: bodies' particles (n,) at levers (n, 3), and the animated ones met."""
        skin, animated, whole = self.skin, self._animated, self._whole
        count, total = len(particles), self._grid.particle_count
        field, device = self._field, self._launcher.device
        none, nowhere = np.full(total - count, -1), np.zeros((total - count, 3))
        body = np.concatenate([skin.body[particles], none])
        velocity = (animated.end[met] - animated.start[met]) / whole.length
        placed = field.placed
        placed.particle = self._hold(np.concatenate([particles, none]))
        placed.body = self._hold(body)
        placed.lever = self._hold(np.concatenate([levers, nowhere]), wp.vec3d)
        placed.velocity = self._hold(np.concatenate([np.zeros((count, 3)), velocity]), wp.vec3d)
        normal = np.concatenate([np.zeros((count, 3)), animated.normal[met]])
        placed.normal = self._hold(normal, wp.vec3d)
        placed.mass = self._hold(np.concatenate([skin.mass[particles], animated.area[met]]), wp.float64)
        placed.friction = self._hold(
            np.concatenate([skin.friction[particles], animated.friction[met]]), wp.float64
        )
        for name, dtype in FOUND.items():
            setattr(placed, name, wp.zeros(total, dtype=dtype, device=device))
        field.placed, field.grid = placed, self._grid.data
        field.layers = self._lay_out_layers(body)

    def _lay_out_layers(self, body: np.ndarray) -> Layers:
        """Of each block the bodies with particles whose stencils reach it."""
        blocks, block = self._grid.reached_blocks()
        bodies = int(body.max()) + 2
        keys = np.unique(block * bodies + body[blocks] + 1)
        layers, device = Layers(), self._launcher.device
        counts = np.bincount(keys // bodies, minlength=self._grid.node_count // BLOCK_NODES)
        layers.first = self._hold(np.concatenate([[0], np.cumsum(counts)]))
        layers.block, layers.body = self._hold(keys // bodies), self._hold(keys % bodies - 1)
        for name, dtype in LAYERED.items():
            setattr(layers, name, wp.zeros(len(keys) * BLOCK_NODES, dtype=dtype, device=device))
        return layers

    def _pair_up(
        self, bodies: np.ndarray, pairs: list[tuple[int, int]], own_first: np.ndarray
    ) -> tuple[wp.array, wp.array, wp.array]:
        """Particles that may push some of `bodies`, and which, (m,) each; where those of each body begin."""
        at = {int(b): np.arange(own_first[k], own_first[k + 1]) for k, b in enumerate(bodies)}
        pushing: list[list[np.ndarray]] = [[np.zeros(0, dtype=int)] for _ in bodies]
        place = {int(b): k for k, b in enumerate(bodies)}
        for pair in pairs:
            for a, b in (pair, pair[::-1]):
                if a in at and b in at:
                    pushing[place[a]].append(at[b])
        lists = [np.concatenate(parts) for parts in pushing]
        counts = [len(held) for held in lists]
        return (
            self._hold(np.concatenate(lists)),
            self._hold(np.repeat(bodies, counts)),
            self._hold(np.concatenate([[0], np.cumsum(counts)])),
        )

    def _hold(self, values: np.ndarray, dtype: type = wp.int32) -> wp.array:
        return wp.array(values, dtype=dtype, device=self._launcher.device)

    # -- for the stage ---------------------------------------------------------------------------------------

    def passed(self, substep: Interval) -> bool:
        """Steps are too short for that."""
        return False

    def retract(self) -> None:
        """As before the substep."""
        wp.copy(self.skin.data.director, self._before)

    def loaded(self) -> Iterator[tuple[tuple[int, int], tuple[np.ndarray, np.ndarray], np.ndarray]]:
        """No contact holds what others push."""
        return iter(())

    def end_frame(self) -> dict[str, Any]:
        """How many particles saw another body in the last step."""
        seen = 0 if self._touching is None else int((self._touching.numpy() > 0.0).sum())
        return {"contacts": seen}
