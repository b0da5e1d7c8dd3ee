"""Elastic bodies against the surfaces of the scene that no body carries: host side."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from plait.solver.contact.bodies import encloses_volume, rim_features
from plait.solver.contact.collision_particles import CollisionParticles
from plait.solver.contact.meeting_kernels import Bodies
from plait.solver.contact.obstacle_forces import ObstacleForces
from plait.solver.contact.obstacle_search_kernels import (
    SLOTS,
    ObstaclePlanes,
    SkinPoints,
    measure_travel,
)
from plait.solver.kinematics.colliders import Collider
from plait.solver.model import Interval, Model
from plait.solver.state import State

if TYPE_CHECKING:
    from plait.solver.contact.carriers import RigidCarriers

# Distance kept from a surface, as part of a tet's edge.
REACH = 0.02
PLANE_ARRAYS = {
    "surface": wp.int32,
    "normal": wp.vec3d,
    "offset": wp.float64,
    "ground": wp.float64,
    "rebound": wp.float64,
    "depth": wp.float64,
    "anchor": wp.vec3d,
    "shift": wp.vec3d,
    "friction": wp.float64,
    "pressure": wp.float64,
    "traction": wp.vec3d,
    "let_go": wp.int32,
}
# What the next substep needs to know of this one's planes.
KEPT = ("surface", "normal", "depth", "pressure", "traction", "let_go")


class Obstacles:
    """Contact of collision particles with moving triangle surfaces, by the nearest points of these.

    In each substep, after a first guess of where the bodies go:

        if obstacles.begin_substep(substep, start, guess):     False: nothing in reach
            for each body that obstacles.bodies[b].pushes:
                obstacles.bodies[b].alternate(start, position, solve)
            deepest = obstacles.leave(position)

    where `solve` minimises the body's energy with what `obstacles.bodies[b]` adds to it; then `retract`, if the
    substep does not stand.

    Distances are float64; trees in float32 find the triangles. A point belongs on the side of a surface where it
    was last seen outside; what starts inside a solid meets it only after it has come out.

    What hangs on a surface by flesh that is torn is let go.

    moving: indices of the surfaces in reach that move in the substep.

    State arrays: obstacles/surface, normal, depth, pressure, traction, let_go of each point's planes.
    """

    def __init__(self, model: Model, state: State, particles: CollisionParticles) -> None:
        self.launcher, self.particles = model.launcher, particles
        self.real = wp.float64 if model.settings.precision == "float64" else wp.float32
        self._kinematics, self._rigid = model.parts["kinematics"], model.parts.get("rigid")
        self._exit_speed = model.settings.contact.exit_speed
        self.points = self._hold_points(model, particles)
        told = [model.scene.restitution(surface) for surface in model.scene.surfaces]
        self.restitution = wp.array(told, dtype=wp.float64, device=self.launcher.device)
        self.before, self.planes = (self._allocate(particles.count) for _ in range(2))
        for name in KEPT:
            state.arrays[f"obstacles/{name}"] = getattr(self.before, name)
        self.surfaces = self._hold_surfaces()
        self.carriers: RigidCarriers | None = None
        if any(collider.surface.rigid is not None for collider in self._kinematics.colliders.items):
            from plait.solver.contact.carriers import RigidCarriers

            self.carriers = RigidCarriers(model, state)
        self.travel = wp.zeros(0, dtype=wp.float64, device=model.launcher.device)
        self.moving = np.zeros(0, dtype=np.int32)
        self.length = self.exit_distance = 0.0  # [s], [m] of the substep
        self.bodies = [ObstacleForces(self, b) for b in range(particles.layout.body_count)]
        self._tracked, self._left = True, False

    def begin_substep(
        self, substep: Interval, start: wp.array, position: wp.array, lying: np.ndarray | None = None
    ) -> bool:
        """Finds the planes that bodies may meet between `start` and `position`, (node_count,) vec3d [m].

        False, with nothing launched, where no surface comes near.

        lying: (body_count,) bool, bodies that stay where they are, and keep their planes; none by default.
        """
        self._keep()
        if self.carriers is not None:
            self.carriers.begin_substep(substep)
        lying = np.zeros(len(self.bodies), dtype=bool) if lying is None else lying
        for b in np.flatnonzero(lying):
            self._hold(self.bodies[b])
        if lying.all():
            return False
        near = self._find_near(substep, start, position)
        if near:
            self._face(near, substep)
            self._near = near
            if self.carriers is not None:
                self.carriers.face([collider.index for collider in near])
            for b in np.flatnonzero(~lying):
                self.bodies[b].examine(start, position, anew=True)
        else:
            self.moving = self.moving[:0]
            if self._tracked:
                self.planes.surface.fill_(-1)
                self.planes.let_go.zero_()
                self._left = True
        self._tracked = bool(near)
        return self._tracked

    def disturb(self, body: int, substep: Interval, position: wp.array) -> bool:
        """Whether a surface moves in the substep that a body lies on, or that reaches it at `position`."""
        self._keep()
        x = position.numpy()[self.particles.layout.nodes(body)]
        margin = 2.0 * REACH * self.particles.layout.edge[body]
        lower, upper = x.min(axis=0) - margin, x.max(axis=0) + margin
        near = self._kinematics.colliders_near(lower, upper, substep, rigid=True)
        near = [collider for collider in near if collider.moves]
        if near:
            self._face(near, substep)
        if not near or not len(self.moving):
            return False
        forces = self.bodies[body]
        if forces.meets(self.moving, before=True):
            return True
        forces.examine(position, position, anew=True)
        return forces.meets(self.moving)

    def lasts(self, base: wp.array) -> bool:
        """Whether elastic bodies that push the same rigid one, each solved by itself, have come to terms.

        base: (node_count,) vec3d [m] where impulses act.
        """
        if self.carriers is None or not len(self.carriers.near):
            return True
        self._note(base)
        return self.carriers.lasts(REACH * float(self.particles.layout.edge.min()))

    def agree(self) -> bool:
        """Whether rigid bodies go where elastic bodies, which have been solved with them, took them to go."""
        if self.carriers is None or not len(self.carriers.near):
            return True
        return self.carriers.agree(REACH * float(self.particles.layout.edge.min()))

    def face_again(self, substep: Interval, start: wp.array, position: wp.array) -> None:
        """Takes rigid bodies to go where they now do; forgets the planes found before."""
        for collider in self._near:
            if collider.surface.rigid is not None:
                self._kinematics.take_rigid(collider)
        self._face(self._near, substep)
        self.carriers.face([collider.index for collider in self._near])
        for body in self.bodies:
            if not body.holds:
                body.examine(start, position, anew=True)

    def _note(self, base: wp.array) -> None:
        for body in self.bodies:
            body.yielding.note(base, pushes=body.rounds > 0 and not body.holds)

    def finish(self, base: wp.array) -> None:
        """Before `leave`, gives rigid bodies what they gave elastic bodies."""
        if self.carriers is not None:
            if len(self.carriers.near):
                self._note(base)
            self.carriers.finish()

    def leave(self, position: wp.array) -> float:
        """Ends a substep with the nodes at `position`; how deep [m] a particle has been left under a surface."""
        self._left = True
        return max(body.leave(position) for body in self.bodies)

    def retract(self, substep: Interval) -> None:
        """As before `begin_substep`."""
        self._left, self._tracked = False, True
        if self.carriers is not None:
            self.carriers.retract(substep)

    def end_frame(self) -> dict[str, Any]:
        """Of the last substep: particles with a surface near, most solves that a body took, particles let go."""
        self._keep()
        return {
            "near_obstacles": sum(body.count for body in self.bodies),
            "obstacle_rounds": max(body.rounds for body in self.bodies),
            "let_go": int(self.before.let_go.numpy().sum()),
        }

    def _keep(self) -> None:
        """Makes the planes of the substep that has passed those of the substep before."""
        if self._left:
            for name in KEPT:
                wp.copy(getattr(self.before, name), getattr(self.planes, name))
            self._left = False

    def _hold(self, body: ObstacleForces) -> None:
        """Gives a body that stays where it is the planes of the substep before."""
        if not body.holds:
            for name in KEPT:
                wp.copy(getattr(self.planes, name)[body.slots], getattr(self.before, name)[body.slots])
            body.hold()

    # -- set-up --------------------------------------------------------------------------------------------

    def _hold_points(self, model: Model, particles: CollisionParticles) -> SkinPoints:
        layout, device = particles.layout, model.launcher.device
        friction, edge, frequency, restitution = [], [], [], []
        for b, body in enumerate(layout.bodies):
            told = model.scene.surfaces[body.surface].friction
            friction.append(-1.0 if told is None else told)
            edge.append(layout.edge[b])
            restitution.append(body.restitution)
            speed = np.sqrt(np.mean(np.asarray(body.youngs_modulus) / np.asarray(body.density)))
            frequency.append(speed / layout.edge[b])
        held = np.any((particles.weights != 0.0) & ~layout.pinned[particles.nodes], axis=1)
        moves = held & (particles.mass > 0.0)
        points = SkinPoints()
        points.nodes, points.weights = particles.node_index, particles.weight
        points.rest = wp.array(layout.rest, dtype=wp.vec3d, device=device)

        def hold(values: np.ndarray) -> wp.array:
            return wp.array(values, dtype=wp.float64, device=device)

        points.reach = hold(np.where(moves, REACH * np.array(edge)[particles.body], 0.0))
        points.friction = hold(np.array(friction)[particles.body])
        points.mass = hold(particles.mass)
        points.restitution = hold(np.array(restitution)[particles.body])
        points.frequency = hold(np.array(frequency)[particles.body])
        return points

    def _allocate(self, count: int) -> ObstaclePlanes:
        planes, device = ObstaclePlanes(), self.launcher.device
        for name, dtype in PLANE_ARRAYS.items():
            setattr(planes, name, wp.zeros(count * int(SLOTS), dtype=dtype, device=device))
        planes.surface.fill_(-1)
        return planes

    def _hold_surfaces(self) -> Bodies:
        """What is constant of the colliders."""
        colliders = self._kinematics.colliders
        triangles = colliders.triangles.numpy()
        surfaces, rims = Bodies(), []
        self._solid = {}
        for collider in colliders.items:
            held = triangles[collider.first_triangle :][: collider.triangle_count] - collider.first_point
            rims.append(rim_features(held))
            points = np.asarray(collider.surface.points)
            self._solid[collider.index] = collider.closed and encloses_volume(points[held])
        surfaces.triangles = colliders.triangles
        surfaces.rim = wp.array(np.concatenate(rims), dtype=wp.int32, device=self.launcher.device)
        return surfaces

    # -- a substep -----------------------------------------------------------------------------------------

    def _find_near(self, substep: Interval, start: wp.array, position: wp.array) -> list[Collider]:
        """Colliders that come near where some body goes."""
        layout = self.particles.layout
        ends = [start.numpy(), position.numpy()]
        found = {}
        for b in range(layout.body_count):
            nodes = layout.nodes(b)
            # What is turned aside goes no further than it would have gone.
            way = float(np.abs(ends[1][nodes] - ends[0][nodes]).max())
            margin = way + 2.0 * REACH * layout.edge[b]
            lower = np.minimum(*(x[nodes].min(axis=0) for x in ends)) - margin
            upper = np.maximum(*(x[nodes].max(axis=0) for x in ends)) + margin
            for collider in self._kinematics.colliders_near(lower, upper, substep, rigid=True):
                found[collider.index] = collider
        return [found[index] for index in sorted(found)]

    def _face(self, near: list[Collider], substep: Interval) -> None:
        kinematics, surfaces, device = self._kinematics, self.surfaces, self.launcher.device

        def hold(values: Any, dtype: type) -> wp.array:
            return wp.array(np.array(values), dtype=dtype, device=device)

        surfaces.count = len(near)
        surfaces.mesh_start = hold([c.meshes[kinematics.start].id for c in near], wp.uint64)
        surfaces.mesh_end = hold([c.meshes[kinematics.end].id for c in near], wp.uint64)
        surfaces.surface = hold([c.index for c in near], wp.int32)
        surfaces.first_triangle = hold([c.first_triangle for c in near], wp.int32)
        surfaces.solid = hold([int(self._solid[c.index]) for c in near], wp.int32)
        surfaces.thickness = hold([c.surface.thickness for c in near], wp.float64)
        surfaces.friction = hold(
            [-1.0 if c.surface.friction is None else c.surface.friction for c in near], wp.float64
        )
        boxes = np.array([self._box(c, substep) for c in near])
        surfaces.lower, surfaces.upper = hold(boxes[:, 0], wp.vec3d), hold(boxes[:, 1], wp.vec3d)
        surfaces.points_start = kinematics.colliders.points[kinematics.start]
        surfaces.points_end = kinematics.colliders.points[kinematics.end]
        points = hold([(c.points.start, c.points.stop) for c in near], wp.vec2i)
        self.travel = wp.zeros(len(near), dtype=wp.float64, device=device)
        inputs = [points, surfaces.points_start, surfaces.points_end]
        work = max(c.deformer.count for c in near)
        self.launcher.launch(measure_travel, len(near), inputs, [self.travel], work_per_item=work)
        self.moving = np.array([c.index for c in near])[self.travel.numpy() > 0.0]
        self.length = substep.length
        self.exit_distance = self._exit_speed * substep.length

    def _box(self, collider: Collider, substep: Interval) -> np.ndarray:
        if collider.surface.rigid is not None:
            return self._rigid.bounds(collider.surface.rigid)
        return self._kinematics.box(collider, [substep.start, substep.end])


def build_obstacles(model: Model, state: State, particles: CollisionParticles) -> Obstacles | None:
    """None where no surface collides but skins."""
    colliders = model.parts["kinematics"].colliders
    if colliders is None or all(collider.surface.body is not None for collider in colliders.items):
        return None
    return Obstacles(model, state, particles)
