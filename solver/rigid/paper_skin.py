"""Collision particles of rigid bodies and of what the animation moves, for Han 2019 §6."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import warp as wp

from plait.solver.kinematics.colliders import Collider, Colliders
from plait.solver.model import Model
from plait.solver.rigid.face_particles import fill, fill_boxes
from plait.solver.rigid.paper_types import Skin

# Sides of triangles' parts, in cells: particles in the middle of parts then lie less than a cell apart.
SIDE = 1.5
# Cells along the side of a cube with the skin of the smallest body, where no cell size is told.
CELLS_A_SIDE = 10.0


class BodySkin:
    """All bodies' particles, their mass in proportion to their area; a body's together, in the bodies' order.

    cell_size: dx [m].  first: (body_count + 1,).  place: (count, 3) [m] about the centre of mass, in the axes of
    rest space.  body: (count,).  mass: (count,) [kg].  friction: (count,), negative where not told.
    radius: (body_count,) [m] from the centre of mass to the furthest.
    density: (body_count,) [kg/m2] of the skin, 0 without one.  data: struct `Skin`.
    """

    def __init__(self, model: Model, masses: Sequence[float], centers: Sequence[np.ndarray]) -> None:
        """masses: [kg] and centers: [m] of mass, in rest space, a body each."""
        colliders, count = model.parts["kinematics"].colliders, len(masses)
        items = [item for item in (colliders.items if colliders else []) if item.surface.rigid is not None]
        items.sort(key=lambda item: item.surface.rigid)
        parts = [_triangles(colliders, item, np.asarray(item.surface.points)) for item in items]
        parts = [part - centers[item.surface.rigid] for part, item in zip(parts, items, strict=True)]
        corners = np.concatenate([np.zeros((0, 3, 3)), *parts])
        sizes = [len(part) for part in parts]
        body = np.repeat(np.array([item.surface.rigid for item in items], dtype=np.int32), sizes)
        told = np.repeat([_told(item) for item in items], sizes)
        corners = thickened(corners, np.repeat([item.surface.thickness for item in items], sizes))
        normal, area = faces(corners)
        of_body = np.bincount(body, area, minlength=count)
        self.cell_size = model.settings.grid.cell_size or cell_size_for(of_body)
        held = fill(corners, SIDE * self.cell_size)
        held = held.take(np.argsort(body[held.triangle], kind="stable"))
        at = held.triangle
        self.first = np.concatenate([[0], np.cumsum(np.bincount(body[at], minlength=count))])
        self.place = np.einsum("nk,nkd->nd", held.weight, corners[at])
        self.body, self.friction = body[at], told[at]
        self.density = np.divide(masses, of_body, out=np.zeros(count), where=of_body > 0.0)
        self.radius = np.zeros(count)
        np.maximum.at(self.radius, self.body, np.linalg.norm(self.place, axis=1))
        own_area = held.share * area[at]
        self.mass = self.density[self.body] * own_area
        self._hold(model, normal[at], own_area)

    def _hold(self, model: Model, normal: np.ndarray, area: np.ndarray) -> None:
        device = model.launcher.device
        self.data = Skin()
        self.data.body = wp.array(self.body, dtype=wp.int32, device=device)
        self.data.normal = wp.array(normal, dtype=wp.vec3d, device=device)
        self.data.director = wp.clone(self.data.normal)
        # V_q: a layer as thick as a cell.
        self.data.volume = wp.array(self.cell_size * area, dtype=wp.float64, device=device)
        self.data.density = wp.array(self.density, dtype=wp.float64, device=device)
        self.data.stiffness = model.settings.rigid.stiffness

    def levers(self, body: int, rotation: np.ndarray) -> np.ndarray:
        """(n, 3) [m] from a body's centre of mass to its particles, turned by (3, 3)."""
        local = self.place[self.first[body] : self.first[body + 1]]
        # Written out: how a product of matrices is summed may depend on their shapes.
        return local[:, :1] * rotation[:, 0] + local[:, 1:2] * rotation[:, 1] + local[:, 2:] * rotation[:, 2]


class AnimatedSkin(NamedTuple):
    """Particles on surfaces that the animation moves.

    start, end: (n, 3) [m] at the ends of a substep.  normal: (n, 3), and area: (n,) [m2], at its start.
    friction: (n,), negative where not told.
    """

    start: np.ndarray
    end: np.ndarray
    normal: np.ndarray
    area: np.ndarray
    friction: np.ndarray


def animated_skin(
    colliders: Colliders | None, near: Sequence[Collider], start: int, boxes: np.ndarray, cell_size: float
) -> AnimatedSkin:
    """Of surfaces `near` the particles that are in some of the (n, 2, 3) boxes [m] when the substep starts.

    start: the buffer of `colliders` that holds that.  cell_size: [m].
    """
    found = [AnimatedSkin(*np.zeros((3, 0, 3)), *np.zeros((2, 0)))]
    for item in near:
        ends = []
        for buffer in (start, 1 - start):
            corners = _triangles(colliders, item, colliders.points[buffer].numpy()[item.points])
            ends.append(thickened(corners, np.full(len(corners), item.surface.thickness)))
        held = fill_boxes(ends[0], SIDE * cell_size, boxes)
        at = held.triangle
        places = [np.einsum("nk,nkd->nd", held.weight, corners[at]) for corners in ends]
        normal, area = faces(ends[0])
        if not item.closed:
            normal = _towards(normal, ends[0].mean(axis=1), boxes.mean(axis=1))
        found.append(AnimatedSkin(*places, normal[at], held.share * area[at], np.full(len(at), _told(item))))
    return AnimatedSkin(*(np.concatenate(arrays) for arrays in zip(*found, strict=True)))


def cell_size_for(area: np.ndarray) -> float:
    """[m] a tenth of a cube's side, the cube with as much skin as the smallest body; any where none has a skin.

    area: (body_count,) [m2].
    """
    skins = area[area > 0.0]
    return float(np.sqrt(skins.min() / 6.0)) / CELLS_A_SIDE if len(skins) else 1.0


def faces(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit outward normals (n, 3) and areas (n,) [m2] of triangles (n, 3, 3) [m]."""
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    twice = np.linalg.norm(cross, axis=1)
    return cross / np.maximum(twice, 1e-300)[:, None], 0.5 * twice


def thickened(corners: np.ndarray, thickness: np.ndarray) -> np.ndarray:
    """Triangles (n, 3, 3) [m] moved out along their normals by (n,) [m]."""
    normal, _ = faces(corners)
    return corners + thickness[:, None, None] * normal[:, None]


def _triangles(colliders: Colliders, item: Collider, points: np.ndarray) -> np.ndarray:
    """(n, 3, 3) [m]; points: of that surface alone."""
    triangles = colliders.triangles.numpy()[item.first_triangle :][: item.triangle_count]
    return np.asarray(points, dtype=np.float64)[triangles - item.first_point]


def _towards(normal: np.ndarray, place: np.ndarray, centers: np.ndarray) -> np.ndarray:
    """Normals (n, 3) of a surface without an inside at places (n, 3), turned to the nearest of the bodies."""
    nearest = np.square(place[:, None] - centers).sum(axis=2).argmin(axis=1)
    return np.where(np.einsum("ni,ni->n", centers[nearest] - place, normal)[:, None] < 0.0, -normal, normal)


def _told(item: Collider) -> float:
    return -1.0 if item.surface.friction is None else item.surface.friction
