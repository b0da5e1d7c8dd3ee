"""Elastic bodies against the surfaces of the scene that no body carries: host side."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp

from plait.solver.contact.bodies import encloses_volume, rim_features
from plait.solver.contact.collision_particles import CollisionParticles
from plait.solver.contact.meeting_kernels import Bodies
from plait.solver.contact.obstacle_force_kernels import evaluate_pushes, hold_forces, leave_planes
from plait.solver.contact.obstacle_search_kernels import (
    SLOTS,
    ObstaclePlanes,
    SkinPoints,
    find_obstacle_planes,
    measure_travel,
)
from plait.solver.kinematics.colliders import Collider
from plait.solver.model import Interval, Model
from plait.solver.state import State

# Solves in a substep, at most; fewer when no force changes by more than would move its plane by this part of the
# distance kept from a surface.
MAX_ROUNDS = 8
LASTING = 0.05
# Distance kept from a surface, as part of a tet's edge.
REACH = 0.02
PLANE_ARRAYS = {
    "surface": wp.int32,
    "normal": wp.vec3d,
    "offset": wp.float64,
    "ground": wp.float64,
    "depth": wp.float64,
    "anchor": wp.vec3d,
    "friction": wp.float64,
    "pressure": wp.float64,
    "traction": wp.vec3d,
}
# What the next substep needs to know of this one's planes.
KEPT = ("surface", "normal", "depth", "pressure", "traction")


class Obstacles:
    """Contact of collision particles with moving triangle surfaces, by the nearest points of these.

    In each substep, after a first guess of where the bodies go:

        if obstacles.begin_substep(substep, start, guess):     planes; False: nothing in reach
            obstacles.alternate(start, position, inertia, solve)   with forces; `solve` asks `evaluate` for them
            obstacles.end_substep(position)                    if the substep stands

    Distances are float64; trees in float32 find the triangles. A point belongs on the side of a surface where it
    was last seen outside; what starts inside a solid meets it only after it has come out.

    State arrays: obstacles/surface, normal, depth, pressure, traction of each point's planes.
    """

    def __init__(self, model: Model, state: State, particles: CollisionParticles) -> None:
        self._launcher, self._particles = model.launcher, particles
        self._kinematics = model.parts["kinematics"]
        self._exit_speed = model.settings.contact.exit_speed
        self._points = self._hold_points(model, particles)
        self._before, self._planes = (self._allocate(particles.count) for _ in range(2))
        for name in KEPT:
            state.arrays[f"obstacles/{name}"] = getattr(self._before, name)
        device = model.launcher.device
        count = particles.count
        self.energy = wp.zeros(count, dtype=wp.float64, device=device)
        self.force = wp.zeros(count, dtype=wp.vec3d, device=device)
        self.stiffness = wp.zeros(count, dtype=wp.mat33d, device=device)
        self.active = wp.zeros(0, dtype=wp.int32, device=device)
        self._tracked = True
        self._surfaces = self._hold_surfaces()

    def begin_substep(self, substep: Interval, start: wp.array, position: wp.array) -> bool:
        """Finds the planes that bodies may meet between `start` and `position`, (node_count,) vec3d [m].

        False, with nothing launched, where no surface comes near.
        """
        near = self._find_near(substep, start, position)
        if not near:
            if self._tracked:
                self._before.surface.fill_(-1)
                self._tracked = False
            return False
        self._face(near, substep)
        self._exit_distance = self._exit_speed * substep.length
        self._examine(start, position, anew=True)
        return True

    def alternate(self, start: wp.array, position: wp.array, inertia: float, solve: Callable[[], None]) -> int:
        """Solves, holds the forces found, looks for planes met on the way, again until the forces last.

        solve: moves the bodies from `position`, in place, to where the forces of `evaluate` take them.
        inertia: as for `evaluate`. Returns how often it solved, none where no plane was found.
        """
        for rounds in range(MAX_ROUNDS):
            if not len(self.active):
                return rounds
            solve()
            change = wp.empty(len(self.active), dtype=wp.float64, device=self._launcher.device)
            inputs = [self.active, self._points, self._planes, inertia, position]
            self._launcher.launch(hold_forces, len(self.active), inputs, [change], work_per_item=20)
            lasts = float(change.numpy().max()) < LASTING
            planes = len(self.active)
            self._examine(start, position, anew=False)
            if lasts and len(self.active) == planes:
                return rounds + 1
        return MAX_ROUNDS

    def evaluate(self, position: wp.array, inertia: float) -> None:
        """Brings `energy` [J], `force` [N] and `stiffness` [N/m] of the particles in `active` up to `position`.

        inertia: [1/s2], 1 over the square of the time in which a force moves a mass: of (gamma h)^2.
        """
        inputs = [self.active, self._points, self._planes, inertia, position]
        outputs = [self.energy, self.force, self.stiffness]
        self._launcher.launch(evaluate_pushes, len(self.active), inputs, outputs, work_per_item=20)

    def end_substep(self, position: wp.array) -> float:
        """Keeps planes and forces for the next substep; how deep [m] a particle has been left under a surface."""
        deepest = wp.zeros(len(self.active), dtype=wp.float64, device=self._launcher.device)
        inputs = [self.active, self._points, position]
        self._launcher.launch(leave_planes, len(self.active), inputs, [self._planes, deepest], work_per_item=10)
        for name in KEPT:
            wp.copy(getattr(self._before, name), getattr(self._planes, name))
        self._tracked = True
        return float(deepest.numpy().max(initial=0.0))

    # -- set-up --------------------------------------------------------------------------------------------

    def _hold_points(self, model: Model, particles: CollisionParticles) -> SkinPoints:
        layout, device = particles.layout, model.launcher.device
        friction, edge, frequency = [], [], []
        for b, body in enumerate(layout.bodies):
            told = model.scene.surfaces[body.surface].friction
            friction.append(-1.0 if told is None else told)
            edge.append(layout.edge[b])
            speed = np.sqrt(np.mean(np.asarray(body.youngs_modulus) / np.asarray(body.density)))
            frequency.append(speed / layout.edge[b])
        held = np.any((particles.weights != 0.0) & ~layout.pinned[particles.nodes], axis=1)
        moves = held & (particles.mass > 0.0)
        points = SkinPoints()
        points.nodes, points.weights = particles.node_index, particles.weight

        def hold(values: np.ndarray) -> wp.array:
            return wp.array(values, dtype=wp.float64, device=device)

        points.reach = hold(np.where(moves, REACH * np.array(edge)[particles.body], 0.0))
        points.friction = hold(np.array(friction)[particles.body])
        points.mass = hold(particles.mass)
        points.frequency = hold(np.array(frequency)[particles.body])
        return points

    def _allocate(self, count: int) -> ObstaclePlanes:
        planes, device = ObstaclePlanes(), self._launcher.device
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
        surfaces.rim = wp.array(np.concatenate(rims), dtype=wp.int32, device=self._launcher.device)
        return surfaces

    # -- a substep -----------------------------------------------------------------------------------------

    def _find_near(self, substep: Interval, start: wp.array, position: wp.array) -> list[Collider]:
        """Colliders that come near where some body goes."""
        layout = self._particles.layout
        ends = [start.numpy(), position.numpy()]
        found = {}
        for b in range(layout.body_count):
            nodes = layout.nodes(b)
            margin = 2.0 * REACH * layout.edge[b]
            lower = np.minimum(*(x[nodes].min(axis=0) for x in ends)) - margin
            upper = np.maximum(*(x[nodes].max(axis=0) for x in ends)) + margin
            for collider in self._kinematics.colliders_near(lower, upper, substep):
                found[collider.index] = collider
        return [found[index] for index in sorted(found)]

    def _face(self, near: list[Collider], substep: Interval) -> None:
        kinematics, surfaces, device = self._kinematics, self._surfaces, self._launcher.device

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
        boxes = np.array([kinematics.box(c, [substep.start, substep.end]) for c in near])
        surfaces.lower, surfaces.upper = hold(boxes[:, 0], wp.vec3d), hold(boxes[:, 1], wp.vec3d)
        surfaces.points_start = kinematics.colliders.points[kinematics.start]
        surfaces.points_end = kinematics.colliders.points[kinematics.end]
        points = hold([(c.points.start, c.points.stop) for c in near], wp.vec2i)
        self._travel = wp.zeros(len(near), dtype=wp.float64, device=device)
        inputs = [points, surfaces.points_start, surfaces.points_end]
        work = max(c.deformer.count for c in near)
        self._launcher.launch(measure_travel, len(near), inputs, [self._travel], work_per_item=work)

    def _examine(self, start: wp.array, position: wp.array, *, anew: bool) -> None:
        inputs = [int(anew), self._surfaces, self._travel, self._points, start, position, self._exit_distance]
        outputs = [self._before, self._planes]
        self._launcher.launch(find_obstacle_planes, self._particles.count, inputs, outputs, work_per_item=40)
        has = (self._planes.surface.numpy().reshape(-1, int(SLOTS)) >= 0).any(axis=1)
        self.active = wp.array(np.flatnonzero(has), dtype=wp.int32, device=self._launcher.device)
