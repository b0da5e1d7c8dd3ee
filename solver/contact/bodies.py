"""The colliders of a scene, laid out for contact kernels."""

from __future__ import annotations

import numpy as np
import warp as wp

from plait.solver.contact.geometry_kernels import Groups, bound_groups
from plait.solver.contact.meeting_kernels import Bodies
from plait.solver.kinematics.colliders import Collider
from plait.solver.kinematics.stage import KinematicsStage
from plait.solver.launch import Launcher

# Triangles in a group: at least so many, and at most so many groups to a surface.
GROUP_SIZE = 64
MAX_GROUPS = 64


class BodyTable:
    """`Bodies` of the surfaces in reach, kept in step with the kinematics stage.

    Triangles are gathered in groups of neighbours whose boxes and motions are taken once a substep: they
    tell which strands come near which part of a surface, and how fast that part moves.
    solid: by index into `Scene.surfaces`, whether it has an inside that nothing belongs in: closed, and facing
    outwards at rest.
    """

    def __init__(self, kinematics: KinematicsStage, launcher: Launcher) -> None:
        self.kinematics, self.launcher = kinematics, launcher
        self.colliders = kinematics.colliders
        device = launcher.device
        rims, vertices, first_group, total = [], [], [0], 0
        self._triangles = self.colliders.triangles.numpy()
        for collider in self.colliders.items:
            triangles = self.triangles(collider)
            rims.append(rim_features(triangles - collider.first_point))
            centres = collider.surface.points[triangles - collider.first_point].mean(axis=1)
            groups = group_triangles(centres)
            vertices += [np.unique(triangles[group]) for group in groups]
            total += len(groups)
            first_group.append(total)
        self._first_group = np.array(first_group)
        counts = [len(v) for v in vertices]
        groups = Groups()
        groups.vertex_offsets = wp.array(np.concatenate([[0], np.cumsum(counts)]), dtype=wp.int32, device=device)
        groups.vertices = wp.array(np.concatenate(vertices), dtype=wp.int32, device=device)
        for name in ("lower", "upper", "centre", "shift"):
            setattr(groups, name, wp.zeros(total, dtype=wp.vec3d, device=device))
        groups.rotation = wp.zeros(total, dtype=wp.mat33d, device=device)
        groups.deformation = wp.zeros(total, dtype=wp.float64, device=device)
        self.bodies = Bodies()
        self.bodies.groups = groups
        self.bodies.triangles = self.colliders.triangles
        self.bodies.rim = wp.array(np.concatenate(rims), dtype=wp.int32, device=device)
        self.solid = {c.index: c.closed and encloses_volume(self._corners(c)) for c in self.colliders.items}
        self._trees: list[wp.array] = []
        self._moving = wp.zeros(0, dtype=wp.int32, device=device)

    def triangles(self, collider: Collider) -> np.ndarray:
        """(n, 3) of one surface, into the points of all."""
        return self._triangles[collider.first_triangle :][: collider.triangle_count]

    def _corners(self, collider: Collider) -> np.ndarray:
        return collider.surface.points[self.triangles(collider) - collider.first_point]

    def begin_frame(self) -> None:
        """Takes up the surfaces now in reach, and bounds those that stand still."""
        near, device = self.kinematics.in_reach, self.launcher.device
        position = {id(collider): k for k, collider in enumerate(self.colliders.items)}
        order = [position[id(collider)] for collider in near]
        bodies = self.bodies
        bodies.count = len(near)
        if not near:
            return

        def hold(values: object, dtype: type) -> wp.array:
            return wp.array(np.array(values), dtype=dtype, device=device)

        self._trees = [hold([c.meshes[buffer].id for c in near], wp.uint64) for buffer in range(2)]
        bodies.surface = hold([c.index for c in near], wp.int32)
        bodies.first_triangle = hold([c.first_triangle for c in near], wp.int32)
        bodies.solid = hold([int(self.solid[c.index]) for c in near], wp.int32)
        bodies.thickness = hold([c.surface.thickness for c in near], wp.float64)
        friction = [-1.0 if c.surface.friction is None else c.surface.friction for c in near]
        bodies.friction = hold(friction, wp.float64)
        boxes = np.array(self.kinematics.boxes)
        bodies.lower, bodies.upper = hold(boxes[:, 0], wp.vec3d), hold(boxes[:, 1], wp.vec3d)
        bodies.first_group = hold(self._first_group[order], wp.int32)
        bodies.group_count = hold(np.diff(self._first_group)[order], wp.int32)
        self._face(self.kinematics.end, self.kinematics.end)
        self._bound([c for c in near if not c.moves])
        self._moving = self._groups_of([c for c in near if c.moves])

    def begin_substep(self) -> None:
        """Bounds the motion of the surfaces between the substep's start and end."""
        self._face(self.kinematics.start, self.kinematics.end)
        self._launch_bounds(self._moving)

    def _face(self, start: int, end: int) -> None:
        bodies = self.bodies
        bodies.mesh_start, bodies.mesh_end = self._trees[start], self._trees[end]
        bodies.points_start, bodies.points_end = self.colliders.points[start], self.colliders.points[end]

    def _groups_of(self, colliders: list[Collider]) -> wp.array:
        near = {id(collider) for collider in colliders}
        runs = [
            np.arange(*self._first_group[k : k + 2])
            for k, collider in enumerate(self.colliders.items)
            if id(collider) in near
        ]
        held = np.concatenate(runs) if runs else np.zeros(0)
        return wp.array(held, dtype=wp.int32, device=self.launcher.device)

    def _bound(self, colliders: list[Collider]) -> None:
        self._launch_bounds(self._groups_of(colliders))

    def _launch_bounds(self, active: wp.array) -> None:
        bodies = self.bodies
        inputs = [active, bodies.points_start, bodies.points_end, bodies.groups]
        self.launcher.launch(bound_groups, len(active), inputs, work_per_item=GROUP_SIZE)


def group_triangles(centres: np.ndarray) -> list[np.ndarray]:
    """Triangles split at the median of the longest side of their box, again and again."""
    size = max(GROUP_SIZE, -(-len(centres) // MAX_GROUPS))
    groups, waiting = [], [np.arange(len(centres))]
    while waiting:
        group = waiting.pop()
        if len(group) <= size:
            groups.append(group)
            continue
        axis = np.argmax(np.ptp(centres[group], axis=0))
        order = group[np.argsort(centres[group, axis], kind="stable")]
        waiting += [order[len(order) // 2 :], order[: len(order) // 2]]
    return groups


def encloses_volume(corners: np.ndarray) -> bool:
    """Whether the triangles of a closed surface, (n, 3, 3) [m], face outwards."""
    corners = corners - corners.reshape(-1, 3).mean(axis=0)
    return float(np.einsum("ni,ni->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))) > 0.0


def rim_features(triangles: np.ndarray) -> np.ndarray:
    """(n,) bits of the features (see `Closest`) that lie on an open border: edges opposite corners, corners."""
    edges = triangles[:, [[1, 2], [2, 0], [0, 1]]]
    keys = np.sort(edges, axis=2) @ np.array([1 << 32, 1])
    _, inverse, counts = np.unique(keys, return_inverse=True, return_counts=True)
    open_edge = (counts[inverse] == 1).reshape(-1, 3)
    on_rim = np.zeros(triangles.max() + 1, dtype=bool)
    on_rim[edges[open_edge].ravel()] = True
    bits = np.concatenate([open_edge, on_rim[triangles]], axis=1)
    return bits @ (1 << np.arange(1, 7))
