"""Elastic bodies against each other and against themselves: particles of a skin against triangles of skins."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from plait.solver.contact.collision_particles import CollisionParticles
from plait.solver.contact.contact_rows import ContactRows, Contacts
from plait.solver.contact.drawn_together import drawn_together
from plait.solver.contact.patches import SkinPatches
from plait.solver.contact.skin_search_kernels import SLOTS, Skins, Touching, find_places
from plait.solver.model import Model
from plait.solver.scene import Scene
from plait.solver.state import State
from plait.solver.tets.layout import TetLayout

# [cells] Gap kept between skins, beyond which they are free; and how far ahead contact looks beyond what moves.
KEPT_GAP, LOOK_AHEAD = 0.02, 0.1
# [cells] Nearer parts of a body touch only where they face each other at rest.
APART_AT_REST = 3.0
# Part of an overlap that the position pass takes away.
PARTING = 0.25
# Jacobi sweeps over the rows in each of the outer sweeps.
INNER_SWEEPS = 4
DEFAULT_FRICTION = 0.5
REMEMBERED = ("triangle", "normal", "gap")
# Part of a point's weight on nodes that are not pinned, from which on contact moves it.
LEAST_MOBILE = 0.25
# A point is not moved within its tet by more than this in barycentric weights: that tet is squashed.
MOST_WEIGHT_CHANGE = 1.0
# How far impulses act from a tet, in changes of its barycentric weights.
FURTHEST = 1.0


class SkinContact:
    """Contact of skins, as impulses between particles and the nearest points of triangles.

    State arrays contact/skin_triangle, skin_normal, skin_gap: (particle_count * SLOTS,), see `Touching`: where
    each particle touched last.

    too_fast: in this substep something that meets moves by more than the settings' `cfl` cells.
    pairs: (pair_count, 2), the bodies with places that may touch, valid while there are any; see `BodyContact`.
    """

    def __init__(self, model: Model, state: State, particles: CollisionParticles, mobile: np.ndarray) -> None:
        self._launcher, self._particles = model.launcher, particles
        self._cell, self._cfl = particles.spacing, model.settings.grid.cfl
        self._patches = SkinPatches(particles, APART_AT_REST * self._cell, model.launcher)
        self._rows, self._mobile = ContactRows(mobile, model.launcher), mobile
        bodies = particles.layout.bodies
        self._friction = told_friction(model.scene, particles.layout)
        self._restitution = np.array([body.restitution for body in bodies])
        self._thickness = np.array([model.scene.surfaces[body.surface].thickness for body in bodies])
        start = particles.evaluate_positions(state.arrays["tets/position"]).numpy()
        self._skins = self._make_skins(start)
        device, slots = model.launcher.device, particles.count * SLOTS
        self._touching, self._before = _touching(slots, device), _touching(slots, device)
        state.arrays |= {f"contact/skin_{name}": getattr(self._touching, name) for name in REMEMBERED}
        self._end = wp.zeros_like(particles.position)
        self.too_fast = False
        self._begin_counts()

    def _make_skins(self, start: np.ndarray) -> Skins:
        """start: (count, 3) float64 [m], the particles where the shot starts."""
        particles, device = self._particles, self._launcher.device

        def hold(values: np.ndarray, dtype: type) -> wp.array:
            return wp.array(values, dtype=dtype, device=device)

        skins = Skins()
        skins.triangles, skins.nodes = particles.triangle, particles.node_index
        skins.triangle_body = hold(particles.triangle_body, wp.int32)
        body_count = particles.layout.body_count
        first = np.searchsorted(particles.triangle_body, np.arange(body_count + 1))
        skins.first_triangle = hold(first, wp.int32)
        welded = _weld(particles)
        offsets, ring = _rings(welded, particles.triangles)
        skins.welded, skins.ring_offsets, skins.ring = (hold(v, wp.int32) for v in (welded, offsets, ring))
        skins.rest = hold(particles.rest, wp.vec3d)
        skins.rest_normal = hold(particles.rest_normal, wp.vec3d)
        skins.body = hold(particles.body, wp.int32)
        skins.patch = self._patches.of_particle
        skins.cell, skins.apart_at_rest = self._cell, APART_AT_REST * self._cell
        together = drawn_together(particles, start, APART_AT_REST * self._cell, self._launcher)
        skins.together_offsets, skins.together = (hold(v, wp.int32) for v in together)
        # Built at rest, whenever the run starts, so that a resumed run finds the same.
        self._query_points = hold(particles.rest, wp.vec3f)
        self._meshes, ids = [], np.zeros(body_count, dtype=np.uint64)
        for b in range(body_count):
            own = slice(int(particles.first[b]), int(particles.first[b + 1]))
            triangles = particles.triangles[first[b] : first[b + 1]] - own.start
            if len(triangles):
                self._meshes.append(wp.Mesh(self._query_points[own], hold(triangles.ravel(), wp.int32)))
                ids[b] = self._meshes[-1].id
        skins.mesh = hold(ids, wp.uint64)
        return skins

    # -- finding -------------------------------------------------------------------------------------------

    def begin_substep(self, start: wp.array, position: wp.array, base: wp.array, lying: np.ndarray) -> bool:
        """Finds the places that may touch; False, with nothing changed, if there are none."""
        particles = self._particles
        self.too_fast = self._searched = False
        if lying.all():
            return False
        particles.evaluate_positions(start)
        particles.gather(position, self._end)
        if not self._patches.come_near(particles.position, self._end, LOOK_AHEAD * self._cell):
            return False
        self._searched = True
        self._find()
        contacts = self._contacts(start.numpy(), base.numpy(), lying)
        if contacts is None:
            return False
        self._rows.build(contacts)
        self._wanted = wp.array(self._kept, dtype=wp.float64, device=self._launcher.device)
        return True

    def _find(self) -> None:
        particles, skins = self._particles, self._skins
        particles.evaluate_normals()
        wp.utils.array_cast(particles.position, self._query_points)
        for mesh in self._meshes:
            mesh.refit()
        for name in REMEMBERED:
            wp.copy(getattr(self._before, name), getattr(self._touching, name))
        inputs = [
            particles.layout.body_count,
            skins,
            self._patches.patches,
            self._patches.reach,
            wp.float64(LOOK_AHEAD * self._cell),
            particles.position,
            particles.normal,
            self._before,
        ]
        self._launcher.launch(find_places, particles.count, inputs, [self._touching], work_per_item=50)

    def _contacts(self, node_start: np.ndarray, base: np.ndarray, lying: np.ndarray) -> Contacts | None:
        """Rows of the places found that may close within the substep; None without any."""
        particles, found = self._particles, np.flatnonzero(self._touching.triangle.numpy() >= 0)
        q = found // SLOTS
        triangle = self._touching.triangle.numpy()[found]
        weights, normal, gap = (getattr(self._touching, n).numpy()[found] for n in ("weights", "normal", "gap"))
        corners = particles.triangles[triangle]
        start, end = particles.position.numpy(), self._end.numpy()
        moved = (end - start)[q] - np.einsum("ck,ckd->cd", weights, (end - start)[corners])
        closing = gap + np.einsum("cd,cd->c", moved, normal)
        a, b = particles.body[q], particles.triangle_body[triangle]
        kept = self._thickness[a] + self._thickness[b] + KEPT_GAP * self._cell
        self.too_fast = bool(((closing < kept) & (np.linalg.norm(moved, axis=1) > self._cfl * self._cell)).any())
        near = (closing < kept + LOOK_AHEAD * self._cell) & self._gives_way(q, corners, weights)
        near &= ~(lying[a] & lying[b])
        near &= (a != b) | ~(self._turned(q, node_start) | self._turned(corners, node_start).any(axis=1))
        if not near.any():
            return None
        q, corners, weights, normal, gap, a, b, kept = (
            v[near] for v in (q, corners, weights, normal, gap, a, b, kept)
        )
        self._kept, self.pairs = kept, np.unique(np.stack([a, b], axis=1), axis=0)
        nodes, theirs = (
            particles.nodes[corners].reshape(len(q), -1),
            -weights[:, :, None] * particles.weights[corners],
        )
        theirs = theirs.reshape(len(q), -1)
        own = particles.weights[q]
        apart = np.einsum("ck,ckd->cd", theirs, base[nodes]) + np.einsum(
            "ck,ckd->cd", own, base[particles.nodes[q]]
        )
        over_there = own + _weight_change(base[particles.nodes[q]], -apart)
        return Contacts(
            np.concatenate([particles.nodes[q], nodes], axis=1),
            np.concatenate([own, theirs], axis=1),
            np.concatenate([over_there, theirs], axis=1),
            normal,
            np.minimum(gap, kept),
            0.5 * (self._friction[a] + self._friction[b]),
            np.maximum(self._restitution[a], self._restitution[b]),
            particles.mass[q],
        )

    def _turned(self, particles: np.ndarray, node_start: np.ndarray) -> np.ndarray:
        """Whether the particles lie in tets that are inside out: a skin there has no outside to be met from.

        What a body's own skin meets there is the elastic solve's to bring back, which pushing apart would hinder.
        """
        corners = node_start[self._particles.nodes[particles]]
        return np.linalg.det(corners[..., 1:, :] - corners[..., :1, :]) <= 0.0

    def _gives_way(self, q: np.ndarray, corners: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """(n,) whether a particle or the place it touches can be moved without its nodes moving far more.

        What hangs on pinned nodes but for a little goes where these go, and what it meets has to bear it.
        """
        particles, mobile = self._particles, self._mobile
        own = (np.abs(particles.weights[q]) * mobile[particles.nodes[q]]).sum(axis=1)
        theirs = (np.abs(particles.weights[corners]) * mobile[particles.nodes[corners]]).sum(axis=2)
        return np.maximum(own, (weights * theirs).sum(axis=1)) >= LEAST_MOBILE

    # -- solving -------------------------------------------------------------------------------------------

    def begin_pass(
        self, position: wp.array, velocity: wp.array, displacement_per_velocity: float, inverse_mass: wp.array
    ) -> None:
        """Takes up where an elastic solve took the nodes."""
        self._displacement_per_velocity = displacement_per_velocity
        self._rows.begin_pass(position, velocity, inverse_mass)

    def sweep(self, velocity: wp.array) -> None:
        """Changes the nodes' velocities [m/s] in place."""
        for _ in range(INNER_SWEEPS):
            self._rows.sweep(velocity, self._displacement_per_velocity)

    def separate(self, position: wp.array) -> None:
        """Takes away a part of what still overlaps; positions only."""
        self._rows.part(position, self._wanted, PARTING)
        self._count()

    def impulses(self) -> tuple[np.ndarray, np.ndarray]:
        """(contact_count,) [kg m/s] each, along and across the normals: of the contacts of this substep."""
        return self._rows.impulses()

    def add_impulses(self, on_nodes: wp.array) -> None:
        """Adds the nodes' impulses in this substep so far."""
        self._rows.add_impulses(on_nodes)

    def retract(self) -> None:
        """All as it was before `begin_substep`."""
        if self._searched:
            for name in REMEMBERED:
                wp.copy(getattr(self._touching, name), getattr(self._before, name))

    # -- reporting -----------------------------------------------------------------------------------------

    def _begin_counts(self) -> None:
        self._most, self._deepest = 0, 0.0

    def _count(self) -> None:
        self._most = max(self._most, self._rows.count)
        self._deepest = max(self._deepest, -float(self._rows.gap.numpy().min()))

    def end_frame(self) -> dict[str, Any]:
        """The most contacts in a substep, and the deepest overlap [m] that one left."""
        metrics = {"skin_contacts": self._most, "skin_overlap": self._deepest}
        self._begin_counts()
        return metrics


def told_friction(scene: Scene, layout: TetLayout) -> np.ndarray:
    """(body_count,) Coulomb coefficients of the bodies' skins."""
    told = [scene.surfaces[body.surface].friction for body in layout.bodies]
    return np.array([DEFAULT_FRICTION if friction is None else friction for friction in told])


def _touching(slots: int, device: wp.Device) -> Touching:
    touching = Touching()
    touching.triangle = wp.full(slots, -1, dtype=wp.int32, device=device)
    touching.weights, touching.normal = (wp.zeros(slots, dtype=wp.vec3d, device=device) for _ in range(2))
    touching.gap = wp.zeros(slots, dtype=wp.float64, device=device)
    return touching


def _weight_change(corners: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """(n, 4) what barycentric weights in tets, (n, 4, 3) [m], change by when their point moves by (n, 3) [m].

    None where the tet is so flat that they would change too much.
    """
    edges = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
    size = np.abs(edges).max(axis=(1, 2))
    solid = np.abs(np.linalg.det(edges)) > 1e-6 * size**3
    edges[~solid] = np.eye(3)
    change = np.linalg.solve(edges, shift[:, :, None])[:, :, 0]
    change = np.concatenate([-change.sum(axis=1, keepdims=True), change], axis=1)
    return change * (solid & (np.abs(change).max(axis=1) <= MOST_WEIGHT_CHANGE))[:, None]


def _weld(particles: CollisionParticles) -> np.ndarray:
    """(count,) the first particle of the same body that lies in exactly the same place at rest."""
    keyed = np.concatenate([particles.body[:, None], particles.rest], axis=1)
    _, first, inverse = np.unique(keyed, axis=0, return_index=True, return_inverse=True)
    return first[inverse.ravel()]


def _rings(welded: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Offsets (count + 1,) and the triangles around each particle's place, ascending; none but at corners."""
    corner = welded[triangles].ravel()
    owner = np.repeat(np.arange(len(triangles)), 3)
    order = np.lexsort((owner, corner))
    counts = np.bincount(corner, minlength=len(welded))
    offsets = np.concatenate([[0], np.cumsum(counts)])
    # A particle that is not the first of its place has the ring of that.
    begin, lengths = offsets[:-1][welded], counts[welded]
    all_offsets = np.concatenate([[0], np.cumsum(lengths)])
    within = np.arange(all_offsets[-1]) - np.repeat(all_offsets[:-1], lengths)
    return all_offsets, owner[order][np.repeat(begin, lengths) + within]
