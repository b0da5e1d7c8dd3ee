"""What of a scene's surfaces touches: shapes, points and edges, laid out for kernels."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import warp as wp

from plait.solver.contact.bodies import encloses_volume
from plait.solver.kinematics.colliders import Collider
from plait.solver.model import Model
from plait.solver.rigid import shape_kernels as kinds
from plait.solver.rigid.quaternions import quaternion
from plait.solver.rigid.types import Geoms
from plait.solver.scene import Shape

KINDS = {
    "sphere": kinds.SPHERE,
    "capsule": kinds.CAPSULE,
    "cylinder": kinds.CYLINDER,
    "cone": kinds.CONE,
    "box": kinds.BOX,
}
# Points on a rim beside that which is nearest to what it meets: for what stands on it. They lie a little within,
# so that what rolls does so on the nearest place alone, which is round.
RIM_POINTS, RIM_PART = 8, 0.995
# Angle between two faces [rad] from which on they are not one, and their edge is looked at by itself.
BEND, SHARP = 3e-4, 0.2
# Contacts that a geom's points and edges can have at once: so many, and so many for each point; at most.
SLOTS, SLOTS_A_POINT, MAX_SLOTS = 32, 4, 512
# Contacts are followed from this part of a geom's size on.
MARGIN = 0.02


@dataclass
class Features:
    """Points and edges of one geom, in the axes of its body about the centre of mass, or indices for a collider.

    points: (n, 3) [m], each with a radius (n,) [m] and an axis (n, 3), zero but for a rim about it, and
        the way in (n, 3), unit, zero where the surface is round.
    vertices: (m, 3) [m], that edges (e, 4) index: both ends, and what the two faces lie towards (-1: no face).
    edge_radius: (e,) [m].
    index: (n,) which of a mesh's vertices the points are, and fans: (n, 4) triangles about each, -1 for none.
    """

    points: np.ndarray
    radius: np.ndarray
    axis: np.ndarray
    inward: np.ndarray
    vertices: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    edges: np.ndarray = field(default_factory=lambda: np.zeros((0, 4), dtype=np.int32))
    edge_radius: np.ndarray = field(default_factory=lambda: np.zeros(0))
    index: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=np.int32))
    fans: np.ndarray = field(default_factory=lambda: np.zeros((0, 4), dtype=np.int32))


def of_shape(shape: Shape, frame: np.ndarray) -> Features:
    """Features of a shape that `frame`, (4, 4), carries to its body."""
    radius, half = float(shape.size[0]), float(shape.size[1])
    ends = np.array([[0.0, 0.0, -half], [0.0, 0.0, half]])
    axis_edge = {
        "vertices": _carry(frame, ends),
        "edges": np.array([[0, 1, -1, -1]]),
        "edge_radius": np.array([radius]),
    }
    if shape.kind == "sphere":
        return Features(_carry(frame, np.zeros((1, 3))), np.array([radius]), np.zeros((1, 3)), np.zeros((1, 3)))
    if shape.kind == "capsule":
        return Features(_carry(frame, ends), np.full(2, radius), np.zeros((2, 3)), np.zeros((2, 3)), **axis_edge)
    if shape.kind == "box":
        return _of_box(np.asarray(shape.size, dtype=np.float64), frame)
    rims = ends if shape.kind == "cylinder" else ends[:1]
    turn = 2.0 * np.pi * np.arange(RIM_POINTS) / RIM_POINTS
    circle = RIM_PART * radius * np.stack([np.cos(turn), np.sin(turn), np.zeros(RIM_POINTS)], axis=1)
    fixed = [rim + circle for rim in rims] + ([] if shape.kind == "cylinder" else [ends[1:]])
    fixed = np.concatenate(fixed)
    axis = np.zeros((len(rims) + len(fixed), 3))
    axis[: len(rims)] = frame[:3, 2]
    radii = np.where(np.arange(len(axis)) < len(rims), radius, 0.0)
    points = _carry(frame, np.concatenate([rims, fixed]))
    inward = np.concatenate([np.zeros((len(rims), 3)), -_unit(fixed) @ frame[:3, :3].T])
    return Features(points, radii, axis, inward, **(axis_edge if shape.kind == "cylinder" else {}))


def _carry(frame: np.ndarray, points: np.ndarray) -> np.ndarray:
    return points @ frame[:3, :3].T + frame[:3, 3]


def _of_box(half: np.ndarray, frame: np.ndarray) -> Features:
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    edges = []
    for a in range(8):
        for bit in (1, 2, 4):
            if not a & bit:
                edges.append([a, a | bit, *(a ^ other for other in (1, 2, 4) if other != bit)])
    corners = _carry(frame, signs * half)
    inward = -_unit(signs) @ frame[:3, :3].T
    return Features(corners, np.zeros(8), np.zeros((8, 3)), inward, corners, np.array(edges), np.zeros(12))


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300)


def _face_normals(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return _unit(np.cross(b - a, c - a))


def vertex_normals(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(n, 3) unit, weighted by the triangles' angles."""
    out = np.zeros_like(points)
    faces = np.asarray(triangles)
    for k in range(3):
        a, b, c = (points[faces[:, (k + m) % 3]] for m in range(3))
        u, v = _unit(b - a), _unit(c - a)
        angle = np.arccos(np.clip(np.einsum("ni,ni->n", u, v), -1.0, 1.0))
        np.add.at(out, faces[:, k], angle[:, None] * _unit(np.cross(u, v)))
    return _unit(out)


def fans_of(triangles: np.ndarray, vertices: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(n, 4) of each vertex up to four triangles that face differently, -1 for none."""
    faces = np.asarray(triangles)
    normals = _face_normals(points, faces)
    about: dict[int, list[int]] = {}
    for face, corners_of in enumerate(faces.tolist()):
        for v in corners_of:
            held = about.setdefault(v, [])
            if len(held) < 4 and all(normals[face] @ normals[k] < 1.0 - 1e-6 for k in held):
                held.append(face)
    return np.array([(about[v] + [-1] * 4)[:4] for v in vertices.tolist()], dtype=np.int32).reshape(-1, 4)


def convex_edges(points: np.ndarray, triangles: np.ndarray, bend: float) -> np.ndarray:
    """(n, 4) edges at which a surface ends, or bends outwards by more than `bend` [rad].

    Of each both ends and the corners opposite, -1 for none.
    """
    faces = np.asarray(triangles)
    normals = _face_normals(points, faces)
    sides: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for face, (i, j, k) in enumerate(faces.tolist()):
        for p, q, r in ((i, j, k), (j, k, i), (k, i, j)):
            sides.setdefault((min(p, q), max(p, q)), []).append((face, r))
    kept = []
    for (i, j), found in sides.items():
        if len(found) != 2:
            kept.append([i, j, found[0][1], -1])
            continue
        (f, k), (g, m) = found
        turned = np.arctan2(np.linalg.norm(np.cross(normals[f], normals[g])), normals[f] @ normals[g])
        if turned > bend and normals[f] @ (points[m] - points[i]) < 0.0:
            kept.append([i, j, k, m])
    return np.array(kept, dtype=np.int32).reshape(-1, 4)


def corners(points: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Of the vertices at convex edges those where these do not just go straight on: what touches first."""
    ways: dict[int, list[np.ndarray]] = {}
    along = _unit(points[edges[:, 1]] - points[edges[:, 0]])
    for (i, j), way in zip(edges[:, :2].tolist(), along, strict=True):
        ways.setdefault(i, []).append(way)
        ways.setdefault(j, []).append(-way)
    straight = [v for v, out in ways.items() if len(out) == 2 and out[0] @ out[1] < -1.0 + 1e-9]
    return np.array(sorted(ways.keys() - set(straight)), dtype=np.int32)


def of_mesh(points: np.ndarray, triangles: np.ndarray) -> Features:
    """Features of a triangle mesh."""
    kept = corners(points, convex_edges(points, triangles, BEND))
    count, edges = len(kept), convex_edges(points, triangles, SHARP)
    inward = -vertex_normals(points, triangles)[kept]
    fans = fans_of(triangles, kept, points)
    return Features(
        points[kept],
        np.zeros(count),
        np.zeros((count, 3)),
        inward,
        points,
        edges,
        np.zeros(len(edges)),
        kept,
        fans,
    )


class GeomTable:
    """`Geoms` of a scene: the surfaces that rigid bodies carry, then the colliders that the animation moves.

    names: of each geom.  colliders: the animated ones, in their order.
    """

    def __init__(self, model: Model, centers: list[np.ndarray]) -> None:
        """centers: [m] of mass, in rest space, a body each."""
        self._device = model.launcher.device
        kinematics = model.parts["kinematics"]
        items = kinematics.colliders.items if kinematics.colliders else []
        self.colliders: list[Collider] = [item for item in items if not item.carried]
        carried = [item for item in items if item.surface.rigid is not None]
        self.surfaces = [item.index for item in (*carried, *self.colliders)]
        self.carried_count = len(carried)
        self._triangles = kinematics.colliders.triangles.numpy() if items else np.zeros((0, 3), dtype=np.int32)
        self._parts: list[Features] = []
        self.meshes: list[wp.Mesh] = []
        self.geoms = Geoms()
        self.geoms.count, self.geoms.carried_count = len(self.surfaces), self.carried_count
        self._lay_out([*carried, *self.colliders], centers, model)

    def _local(self, item: Collider) -> np.ndarray:
        return self._triangles[item.first_triangle :][: item.triangle_count] - item.first_point

    def _lay_out(self, items: list[Collider], centers: list[np.ndarray], model: Model) -> None:
        columns: dict[str, list] = {
            name: [] for name in ("kind", "size", "offset", "turn", "center", "half", "solid")
        }
        meshes: list[tuple[np.ndarray, np.ndarray]] = []
        for item in items:
            surface, triangles = item.surface, self._local(item)
            points = np.asarray(surface.points, dtype=np.float64)
            solid = item.closed and encloses_volume(points[triangles])
            frame = np.eye(4)
            if surface.rigid is not None:
                points = points - centers[surface.rigid]
                if surface.shape is not None:
                    frame = np.array(surface.shape.frame, dtype=np.float64)
                    frame[:3, 3] -= centers[surface.rigid]
            shape = surface.shape if surface.rigid is not None else None
            part = of_mesh(points, triangles) if shape is None else of_shape(shape, frame)
            self._parts.append(part)
            meshes.append((points, triangles))
            lower, upper = _bounds(points, part)
            columns["kind"].append(kinds.MESH if shape is None else KINDS[shape.kind])
            columns["size"].append(np.zeros(3) if shape is None else shape.size)
            columns["offset"].append(frame[:3, 3])
            columns["turn"].append(quaternion(frame[:3, :3]))
            columns["center"].append(0.5 * (lower + upper))
            columns["half"].append(0.5 * (upper - lower))
            columns["solid"].append(int(solid))
        self._hold(columns, items, meshes, model)

    def _hold(self, columns: dict[str, list], items: list[Collider], meshes: list, model: Model) -> None:
        geoms, hold = self.geoms, self._array
        geoms.kind, geoms.solid = hold(columns["kind"], wp.int32), hold(columns["solid"], wp.int32)
        for name in ("size", "offset", "center", "half"):
            setattr(geoms, name, hold(columns[name], wp.vec3d))
        geoms.turn = hold(columns["turn"], wp.quatd)
        half = np.array(columns["half"]).reshape(-1, 3)
        reach = np.linalg.norm(half, axis=1)
        center = np.array(columns["center"]).reshape(-1, 3)
        geoms.reach = hold(reach + np.linalg.norm(center, axis=1), wp.float64)
        geoms.margin = hold(MARGIN * reach, wp.float64)
        surfaces = [item.surface for item in items]
        geoms.body = hold([-1 if s.rigid is None else s.rigid for s in surfaces], wp.int32)
        geoms.friction = hold([-1.0 if s.friction is None else s.friction for s in surfaces], wp.float64)
        geoms.thickness = hold([s.thickness for s in surfaces], wp.float64)
        geoms.restitution = hold([model.scene.restitution(s) for s in surfaces], wp.float64)
        self._hold_features()
        self._hold_meshes(items, meshes)
        offsets, others = filter_lists(self.surfaces, model)
        geoms.filter_offsets, geoms.filtered = hold(offsets, wp.int32), hold(others, wp.int32)

    def _hold_features(self) -> None:
        geoms, hold, parts = self.geoms, self._array, self._parts
        for name, width in (("points", 3), ("inward", 3), ("axis", 3), ("radius", 0), ("edge_radius", 0)):
            joined = _joined([getattr(part, name) for part in parts], width)
            setattr(geoms, name, hold(joined, wp.vec3d if width else wp.float64))
        counts = [len(part.points) for part in parts]
        self.first_slot = _offsets([min(SLOTS + SLOTS_A_POINT * count, MAX_SLOTS) for count in counts])
        geoms.first_slot = hold(self.first_slot, wp.int32)
        geoms.first_point = hold(_offsets(counts), wp.int32)
        geoms.first_edge = hold(_offsets([len(part.edges) for part in parts]), wp.int32)
        # What bodies carry has points of its own; the others' are where the animation has them.
        carried = parts[: self.carried_count]
        others = list(zip(parts[self.carried_count :], self.colliders, strict=True))
        index = [np.zeros(len(part.points)) for part in carried]
        index += [part.index + item.first_point for part, item in others]
        geoms.point_index = hold(_joined(index, 0), wp.int32)
        fans = [np.full((len(part.points), 4), -1) for part in carried]
        fans += [_moved(part.fans, item.first_triangle) for part, item in others]
        geoms.fans = hold(_joined(fans, 4), wp.vec4i)

    def _hold_meshes(self, items: list[Collider], meshes: list) -> None:
        """What bodies carry has vertices of its own, in `vertices`; edges and triangles index these."""
        count = self.carried_count
        geoms, hold, carried = self.geoms, self._array, self._parts[:count]
        vertex = _offsets([len(part.vertices) for part in carried])[:-1]
        geoms.vertices = hold(_joined([part.vertices for part in carried], 3), wp.vec3d)
        first_vertex = [*vertex, *(item.first_point for item in self.colliders)]
        edges = [_moved(part.edges, first) for part, first in zip(self._parts, first_vertex, strict=True)]
        geoms.edges = hold(_joined(edges, 4), wp.vec4i)
        meshed = [item.surface.shape is None for item in items[:count]]
        triangles = [mesh[1] if held else mesh[1][:0] for mesh, held in zip(meshes[:count], meshed, strict=True)]
        moved = [_moved(mine, first) for mine, first in zip(triangles, vertex, strict=True)]
        geoms.triangles = hold(_joined(moved, 3), wp.vec3i)
        first = [*_offsets([len(mine) for mine in triangles])[:-1]]
        geoms.first_triangle = hold(first + [item.first_triangle for item in self.colliders], wp.int32)
        ids = [self._mesh(*mesh) if held else 0 for mesh, held in zip(meshes[:count], meshed, strict=True)]
        geoms.mesh = hold(ids + [0] * len(self.colliders), wp.uint64)

    def _mesh(self, points: np.ndarray, triangles: np.ndarray) -> int:
        mesh = wp.Mesh(
            wp.array(points.astype(np.float32), dtype=wp.vec3f, device=self._device),
            wp.array(triangles.ravel(), dtype=wp.int32, device=self._device),
        )
        self.meshes.append(mesh)
        return mesh.id

    def _array(self, values: object, dtype: type) -> wp.array:
        return wp.array(np.array(values), dtype=dtype, device=self._device)


def filter_lists(geom_surfaces: list[int], model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Of each geom those it does not touch: offsets (n + 1,) and the geoms, ascending."""
    scene = model.scene
    geom_of = {surface: geom for geom, surface in enumerate(geom_surfaces)}
    apart: list[set[int]] = [set() for _ in geom_surfaces]

    def part(a: int, b: int) -> None:
        if a in geom_of and b in geom_of:
            apart[geom_of[a]].add(geom_of[b])
            apart[geom_of[b]].add(geom_of[a])

    for a, b in scene.filtered:
        part(a, b)
    for joint in scene.joints:
        if not joint.collide and None not in joint.bodies:
            for a in scene.rigid_bodies[joint.bodies[0]].surfaces:
                for b in scene.rigid_bodies[joint.bodies[1]].surfaces:
                    part(a, b)
    lists = [sorted(of_geom) for of_geom in apart]
    return _offsets([len(of_geom) for of_geom in lists]), np.concatenate([[], *lists]).astype(np.int32)


def _bounds(points: np.ndarray, part: Features) -> tuple[np.ndarray, np.ndarray]:
    """Of the triangles and the shape."""
    radius = part.radius[:, None]
    every = np.concatenate([points, part.points - radius, part.points + radius])
    return every.min(axis=0), every.max(axis=0)


def _moved(indices: np.ndarray, by: int) -> np.ndarray:
    """Into an array that these begin at; -1 stays."""
    return np.where(indices < 0, -1, indices + by)


def _offsets(counts: list[int]) -> np.ndarray:
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)


def _joined(arrays: list[np.ndarray], width: int) -> np.ndarray:
    empty = np.zeros((0, width) if width else 0)
    return np.concatenate([empty, *arrays]) if arrays else empty
