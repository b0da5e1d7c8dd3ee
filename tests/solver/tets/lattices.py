"""Boxes of tets for the tests: body-centred lattices, and elastic bodies made of them."""

from __future__ import annotations

from typing import Any

import numpy as np

from plait.solver.scene import Embedding, KeyedMotion, StaticMotion, Surface, TetBody

FACE = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])


def box_lattice(
    size: tuple[float, float, float] = (1.0, 0.25, 0.25), cells: tuple[int, int, int] | int = (8, 2, 2)
) -> tuple[np.ndarray, np.ndarray]:
    """Nodes (node_count, 3) [m] about the origin, tets (tet_count, 4) int32 of equal volume.

    A node at each corner and in the middle of each cell. The middles of two cells and an edge of the face between
    them are a tet; on the boundary, a middle and half a face are, cut along diagonals that alternate. A single
    `cells` is the count along every axis.
    """
    counts = np.broadcast_to(cells, 3).astype(int)
    corner_index = np.arange(np.prod(counts + 1)).reshape(counts + 1)
    middle_index = corner_index.size + np.arange(np.prod(counts)).reshape(counts)
    corners = np.stack(np.meshgrid(*[np.arange(n + 1.0) for n in counts], indexing="ij"), -1).reshape(-1, 3)
    middles = np.stack(np.meshgrid(*[np.arange(n) + 0.5 for n in counts], indexing="ij"), -1).reshape(-1, 3)
    nodes = (np.concatenate([corners, middles]) / counts - 0.5) * np.asarray(size, dtype=float)
    tets = []
    for cell in np.ndindex(*counts):
        for axis in range(3):
            for side in (0, 1):
                other = np.array(cell)
                other[axis] += 2 * side - 1
                inside = 0 <= other[axis] < counts[axis]
                if inside and not side:
                    continue  # the neighbour adds what both share
                face = _face(np.array(cell), axis, side)
                ring = [corner_index[tuple(corner)] for corner in face]
                middle = middle_index[cell]
                if inside:
                    opposite = middle_index[tuple(other)]
                    tets += [[middle, opposite, ring[k], ring[(k + 1) % 4]] for k in range(4)]
                else:
                    k = int(face[0].sum()) % 2
                    tets += [[middle, ring[k], ring[k + 1], ring[k + 2]]]
                    tets += [[middle, ring[k], ring[k + 2], ring[(k + 3) % 4]]]
    return nodes, _positive(nodes, np.array(tets, dtype=np.int32))


def boundary_triangles(tets: np.ndarray) -> np.ndarray:
    """(triangle_count, 3) int32, faces of one tet only, counter-clockwise from outside."""
    faces = tets[:, [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]].reshape(-1, 3)
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return faces[first[count == 1]]


def tet_body(
    nodes: np.ndarray,
    tets: np.ndarray,
    *,
    index: int = 0,
    surface: int = 0,
    name: str = "body",
    youngs_modulus: float = 1e5,
    poissons_ratio: float = 0.3,
    density: float = 1000.0,
    pinned: np.ndarray | None = None,
    attachment: np.ndarray | None = None,
    transform: np.ndarray | None = None,
    friction: float | None = None,
    **body: Any,
) -> tuple[TetBody, Surface]:
    """A body of tets and its skin, the boundary triangles on the nodes that they use.

    index, surface: where the two will stand in `Scene.bodies` and `Scene.surfaces`.
    transform: (4, 4), rest to world; or pass `motion`. body: any other field of `TetBody`.
    """
    outside = boundary_triangles(tets)
    used, triangles = np.unique(outside, return_inverse=True)
    motion = body.pop("motion", None) or StaticMotion(np.eye(4) if transform is None else transform)
    skinning = body.get("skinning")
    flesh = TetBody(
        name,
        nodes,
        tets,
        surface,
        _embed_nodes(used, tets),
        np.full(len(tets), density),
        np.full(len(tets), youngs_modulus),
        np.full(len(tets), poissons_ratio),
        np.zeros(len(nodes), dtype=bool) if pinned is None else pinned,
        np.zeros(len(nodes)) if attachment is None else attachment,
        motion=motion,
        **body,
    )
    if skinning is not None:
        skinning = type(skinning)(skinning.joint_indices[used], skinning.joint_weights[used], skinning.method)
    skin = Surface(
        f"{name} skin",
        nodes[used],
        triangles.reshape(-1, 3).astype(np.int32),
        motion=motion,
        skinning=skinning,
        friction=friction,
        body=index,
    )
    return flesh, skin


def box_body(
    size: tuple[float, float, float] = (1.0, 0.25, 0.25),
    cells: tuple[int, int, int] | int = (8, 2, 2),
    **body: Any,
) -> tuple[TetBody, Surface]:
    """A box of `box_lattice` as a body and its skin; `body` as for `tet_body`."""
    return tet_body(*box_lattice(size, cells), **body)


def placed(
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0), rotation: np.ndarray | None = None
) -> np.ndarray:
    """(4, 4) rest to world."""
    transform = np.eye(4)
    transform[:3, 3] = translation
    if rotation is not None:
        transform[:3, :3] = rotation
    return transform


def turn(axis: np.ndarray, angle: float) -> np.ndarray:
    """(3, 3) rotation about a unit axis, Rodrigues."""
    cross = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def keyed(times: list[float], transforms: list[np.ndarray]) -> KeyedMotion:
    """A rigid motion through (4, 4) transforms at `times` [s]."""
    return KeyedMotion(np.array(times), np.array(transforms)[:, None])


def _face(cell: np.ndarray, axis: int, side: int) -> np.ndarray:
    """(4, 3) lattice corners of a cell's face, in order around it."""
    face = np.empty((4, 3), dtype=int)
    face[:, axis] = cell[axis] + side
    face[:, [k for k in range(3) if k != axis]] = np.delete(cell, axis) + FACE
    return face


def _positive(nodes: np.ndarray, tets: np.ndarray) -> np.ndarray:
    x = nodes[tets]
    negative = np.linalg.det(x[:, 1:] - x[:, :1]) < 0.0
    tets[negative, 2:] = tets[negative, :1:-1]
    return tets


def _embed_nodes(nodes: np.ndarray, tets: np.ndarray) -> Embedding:
    """Each node in the first tet that has it as a corner."""
    corners, first = np.unique(tets.ravel(), return_index=True)
    place = first[np.searchsorted(corners, nodes)]
    return Embedding((place // 4).astype(np.int32), np.eye(4)[place % 4])
