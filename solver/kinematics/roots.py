"""The frames that carry strand roots, from the triangles they grow on."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import warp as wp

from plait.solver.diagnostics import Refused
from plait.solver.kinematics import root_kernels as kernels
from plait.solver.kinematics.deformer import Deformer
from plait.solver.launch import Launcher
from plait.solver.scene import Pose, RootBinding, Scene, Strands

PoseAt = Callable[[int, float], Pose]
PlacePoints = Callable[[wp.array, wp.array], None]


class TriangleFrames:
    """Places frames on triangles of surfaces, those of `groups` one after another; skins no other triangles.

    surfaces: those they are on, indices into `Scene.surfaces`.
    """

    def __init__(self, groups: list[FrameGroup], scene: Scene, launcher: Launcher) -> None:
        self.launcher = launcher
        self.count = sum(len(group.triangles) for group in groups)
        # Vertices are placed once however many strands share them.
        self.surfaces = sorted({group.surface for group in groups})
        self._first_vertex = {}
        used, total = {}, 0
        for surface in self.surfaces:
            triangles = [group.triangles for group in groups if group.surface == surface]
            used[surface] = np.unique(np.concatenate(triangles))
            self._first_vertex[surface] = total
            total += len(used[surface])
        device = launcher.device
        self._vertices = wp.zeros(total, dtype=wp.vec3d, device=device)
        self._unused = wp.zeros(0, dtype=wp.vec3f, device=device)
        self._used = {s: wp.array(used[s], dtype=wp.int32, device=device) for s in self.surfaces}
        self._points = {
            s: wp.empty(len(scene.surfaces[s].points), dtype=wp.vec3d, device=device)
            for s in self.surfaces
            if scene.surfaces[s].body is not None or scene.surfaces[s].rigid is not None
        }
        self._deformers = {s: Deformer(scene.surfaces[s], launcher, used[s]) for s in self.surfaces}
        self._still = {s for s in self.surfaces if not scene.surfaces[s].motion.animated and s not in self._points}
        self._placed_still: set[int] = set()
        slots = [
            self._first_vertex[group.surface] + np.searchsorted(used[group.surface], group.triangles)
            for group in groups
        ]
        self._triangles = kernels.RootTriangles()
        self._triangles.vertices = wp.array(np.concatenate(slots), dtype=wp.vec3i, device=device)
        for name, dtype in (
            ("barycentric", wp.vec3d),
            ("offset", wp.vec3d),
            ("rest_frame", wp.mat33d),
            ("rest_edges_inverse", wp.mat22d),
        ):
            held = np.concatenate([getattr(group, name) for group in groups])
            setattr(self._triangles, name, wp.array(held, dtype=dtype, device=device))

    def place(
        self,
        pose_at: PoseAt,
        time: float,
        position_out: wp.array,
        rotation_out: wp.array,
        skins: Mapping[int, PlacePoints],
    ) -> None:
        """Frames at `time` [s]; `rotation_out` must hold the last rotations, for triangles that have collapsed.

        skins: what places the points of surfaces that bodies carry now, by surface; others follow their pose.
        """
        for surface in self.surfaces:
            if surface in self._placed_still:
                continue
            first = self._first_vertex[surface]
            deformer = self._deformers[surface]
            vertices = self._vertices[first : first + deformer.count]
            if surface in skins:
                skins[surface](self._points[surface], self._unused)
                inputs = [self._used[surface], self._points[surface]]
                self.launcher.launch(kernels.pick_points, deformer.count, inputs, [vertices])
            else:
                deformer.place(pose_at(surface, time), vertices, self._unused)
            if surface in self._still:
                self._placed_still.add(surface)
        self.launcher.launch(
            kernels.place_roots, self.count, [self._triangles, self._vertices], [position_out, rotation_out]
        )


class Roots(TriangleFrames):
    """Places every strand's root, in the order of `Scene.strands`.

    Raises `Refused` where a root's triangle does not exist or has no area at rest.
    """

    def __init__(self, scene: Scene, launcher: Launcher) -> None:
        groups = [
            FrameGroup(strands.name, "strand", strands.roots, strands.points[strands.offsets[:-1]], scene)
            for strands in scene.strands
        ]
        super().__init__(groups, scene, launcher)
        self.arc_length = np.concatenate([_arc_lengths(strands) for strands in scene.strands])
        self.radius = np.concatenate([_largest_radii(strands) for strands in scene.strands])


class FrameGroup:
    """Frames on triangles of one surface, at rest.

    name, each: of them all, and what one of them carries, for messages.
    points: (n, 3) [m] that they carry, beside the surface's rest points; None: the places on the triangles.
    """

    def __init__(
        self, name: str, each: str, binding: RootBinding, points: np.ndarray | None, scene: Scene
    ) -> None:
        self.surface = binding.surface
        if not 0 <= binding.surface < len(scene.surfaces):
            raise Refused(f"{name}: bound to surface {binding.surface} of {len(scene.surfaces)}")
        surface = scene.surfaces[binding.surface]
        triangle = np.asarray(binding.triangle)
        outside = (triangle < 0) | (triangle >= len(surface.triangles))
        if np.any(outside):
            strand = int(np.argmax(outside))
            raise Refused(
                f"{name}: {each} {strand} is bound to triangle {triangle[strand]} of {surface.name}, "
                f"which has {len(surface.triangles)}"
            )
        self.triangles = np.asarray(surface.triangles)[triangle].astype(np.int64)
        corners = np.asarray(surface.points, dtype=np.float64)[self.triangles]
        edges = corners[:, 1:] - corners[:, :1]
        normal = np.cross(edges[:, 0], edges[:, 1])
        area = np.linalg.norm(normal, axis=1)
        flat = ~(area > float(kernels.FLAT) * np.einsum("nij,nij->n", edges, edges))
        if np.any(flat):
            strand = int(np.argmax(flat))
            raise Refused(
                f"{name}: {each} {strand} grows on triangle {triangle[strand]} of {surface.name}, "
                "which has no area at rest; bind it to another triangle or mend the mesh"
            )
        normal /= area[:, None]
        tangent = edges[:, 0] / np.linalg.norm(edges[:, 0], axis=1, keepdims=True)
        bitangent = np.cross(normal, tangent)
        self.rest_frame = np.stack([tangent, bitangent, normal], axis=2)
        in_plane = np.einsum("nax,nex->nae", np.stack([tangent, bitangent], axis=1), edges)
        self.rest_edges_inverse = np.linalg.inv(in_plane)
        self.barycentric = np.asarray(binding.barycentric, dtype=np.float64)
        place = corners[:, 0] + np.einsum("ne,nex->nx", self.barycentric[:, 1:], edges)
        self.offset = np.zeros_like(place) if points is None else points - place


def _arc_lengths(strands: Strands) -> np.ndarray:
    """(strand_count,) [m]."""
    with np.errstate(invalid="ignore"):  # points that are not finite are refused by name with the strands
        lengths = np.linalg.norm(np.diff(strands.points, axis=0), axis=1)
        along = np.concatenate([[0.0], np.cumsum(lengths)])
        return along[strands.offsets[1:] - 1] - along[strands.offsets[:-1]]


def _largest_radii(strands: Strands) -> np.ndarray:
    """(strand_count,) [m]."""
    return np.maximum.reduceat(strands.radius, strands.offsets[:-1])
