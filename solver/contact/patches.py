"""The bounds test of elastic bodies: which parts of their skins come near another in a substep."""

from __future__ import annotations

import numpy as np
import warp as wp

from plait.solver.contact.bodies import group_triangles
from plait.solver.contact.collision_particles import CollisionParticles
from plait.solver.contact.patch_kernels import Patches, bound_bodies, bound_patches, find_near_patches
from plait.solver.launch import Launcher

# [rad] Skins face each other where normals differ by more than 102 degrees, less what they may turn in a substep.
OPPOSED = 1.65


class SkinPatches:
    """All skins in patches of neighbouring triangles, and where those are.

    of_particle: (particle_count,) int32 device array, the patch that each collision particle lies on; -1: none.
    reach: (patch_count,) float64 device array, see `find_near_patches`.
    """

    def __init__(self, particles: CollisionParticles, apart_at_rest: float, launcher: Launcher) -> None:
        self._particles, self._launcher = particles, launcher
        self._apart_at_rest = apart_at_rest
        corners = particles.rest[particles.triangles]
        body_count = particles.layout.body_count
        groups, first = [], [0]
        for b in range(body_count):
            own = np.flatnonzero(particles.triangle_body == b)
            groups += [own[group] for group in group_triangles(corners[own].mean(axis=1))] if len(own) else []
            first.append(len(groups))
        self.count, self._body_count = len(groups), body_count
        device = launcher.device

        def hold(values: object, dtype: type) -> wp.array:
            return wp.array(np.array(values), dtype=dtype, device=device)

        patches = Patches()
        patches.first = hold(first, wp.int32)
        patches.body = hold(np.repeat(np.arange(body_count), np.diff(first)), wp.int32)
        patches.offsets = hold(np.cumsum([0, *(len(group) for group in groups)]), wp.int32)
        patches.triangles = hold(np.concatenate(groups), wp.int32)
        patches.rest_lower = hold([corners[group].min(axis=(0, 1)) for group in groups], wp.vec3d)
        patches.rest_upper = hold([corners[group].max(axis=(0, 1)) for group in groups], wp.vec3d)
        for name in ("lower", "upper", "shift", "axis"):
            setattr(patches, name, wp.zeros(self.count, dtype=wp.vec3d, device=device))
        for name in ("spread", "cone"):
            setattr(patches, name, wp.zeros(self.count, dtype=wp.float64, device=device))
        for name in ("body_lower", "body_upper"):
            setattr(patches, name, wp.zeros(body_count, dtype=wp.vec3d, device=device))
        patches.body_travel = wp.zeros(body_count, dtype=wp.float64, device=device)
        self.patches = patches
        self.reach = wp.zeros(self.count, dtype=wp.float64, device=device)
        self.of_particle = hold(self._patch_of_particle(groups), wp.int32)

    def _patch_of_particle(self, groups: list[np.ndarray]) -> np.ndarray:
        patch_of_triangle = np.full(len(self._particles.triangles), -1)
        for g, group in enumerate(groups):
            patch_of_triangle[group] = g
        triangle = self._particles.first_triangle_of_particle
        return np.where(triangle >= 0, patch_of_triangle[triangle], -1)

    def come_near(self, start: wp.array, end: wp.array, margin: float) -> bool:
        """Whether anything comes within `margin` [m] of anything while particles go from `start` to `end`."""
        launch = self._launcher.launch
        inputs = [self._particles.triangle, start, end]
        launch(bound_patches, self.count, inputs, [self.patches], work_per_item=200)
        launch(bound_bodies, self._body_count, [], [self.patches])
        inputs = [self._body_count, self.patches, *map(wp.float64, (margin, self._apart_at_rest, OPPOSED))]
        launch(find_near_patches, self.count, inputs, [self.reach], work_per_item=self.count)
        return bool((self.reach.numpy() >= 0.0).any())
