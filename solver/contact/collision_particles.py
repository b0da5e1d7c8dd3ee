"""Points of elastic bodies' skins that contact acts on, and that pass on to the tets what acts on them."""

from __future__ import annotations

import numpy as np
import warp as wp

from plait.solver.contact.particle_kernels import face_areas, gather, particle_normals, vec4i
from plait.solver.contact.skin_lattice import SkinLattice, lay_lattice, locate
from plait.solver.launch import Launcher
from plait.solver.scene import Scene, Surface
from plait.solver.tets.layout import TetLayout

# Rounds of the mass fit: the first by all of a node's particles, the last such that no node is overdrawn.
FIT_ROUNDS, GROW_ROUNDS = 40, 40


class CollisionParticles:
    """A lattice of particles on every body's skin, at most `spacing` [m] apart (Han 2019 §4.1, not at random).

    Particle q sits in the tet with nodes p at plain barycentric weights b_pq: x_q = sum_p b_pq x_p. Body b owns
    particles first[b]:first[b + 1]; the first of them are the points of its surface, in the surface's order, so
    that `triangles` name particles. A surface that does not collide has no triangles here, and only those points.

    On the host, constant:
    body: (count,) int32.  first: (body_count + 1,) int32.  rest: (count, 3) float64 [m], each body's rest space.
    rest_normal: (count, 3) float64, outward, zero for points of no triangle.  area: (count,) float64 [m2].
    tet: (count,) int32 into `layout.tets`, whose row there is `nodes`, (count, 4).  weights: (count, 4) float64.
    mass: (count,) float64 [kg], see `fit_masses`.  triangles: (triangle_count, 3) int32, of all skins.
    triangle_body: (triangle_count,) int32.  first_triangle_of_particle: (count,) int32, one it lies on, -1: none.
    On the device:
    adjoint: node offsets (node_count + 1,), particles int32 and weights float64: the particles of each node.
    node_index, weight: `nodes` (vec4i) and `weights` (vec4d).  triangle: `triangles` (vec3i).
    position [m], velocity [m/s], normal: (count,) vec3d, world, as last evaluated.
    """

    def __init__(self, scene: Scene, layout: TetLayout, spacing: float, launcher: Launcher) -> None:
        self.layout, self.spacing, self._launcher = layout, spacing, launcher
        parts = [_body_particles(scene, layout, b, spacing) for b in range(layout.body_count)]
        lattices = [part[0] for part in parts]
        counts = [lattice.count for lattice in lattices]
        self.first = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
        self.count = int(self.first[-1])
        self.body = np.repeat(np.arange(len(counts)), counts).astype(np.int32)
        self.rest, self.tet, self.weights = (np.concatenate([part[k] for part in parts]) for k in (1, 2, 3))
        self.nodes = layout.tets[self.tet]
        self.area = np.concatenate([lattice.area for lattice in lattices])
        skins = [_skin(scene.surfaces[body.surface]) for body in layout.bodies]
        self.triangles = np.concatenate([skin + self.first[b] for b, skin in enumerate(skins)]).astype(np.int32)
        self.triangle_body = np.repeat(np.arange(len(skins)), [len(skin) for skin in skins]).astype(np.int32)
        self.mass = fit_masses(self.nodes, self.weights, self.area, layout.mass)
        self._hold(lattices, np.cumsum([0, *(len(skin) for skin in skins)]))
        self.rest_normal = self._rest_normals()

    def _hold(self, lattices: list[SkinLattice], first_triangle: np.ndarray) -> None:
        device = self._launcher.device
        self.node_index = wp.array(self.nodes, dtype=vec4i, device=device)
        self.weight = wp.array(self.weights, dtype=wp.vec4d, device=device)
        self.triangle = wp.array(self.triangles, dtype=wp.vec3i, device=device)
        lies_on = np.concatenate([lattice.triangles + first_triangle[b] for b, lattice in enumerate(lattices)])
        on_offsets = _offsets(np.concatenate([np.diff(lattice.triangle_offsets) for lattice in lattices]))
        self.first_triangle_of_particle = np.full(self.count, -1, dtype=np.int32)
        lies = on_offsets[1:] > on_offsets[:-1]
        self.first_triangle_of_particle[lies] = lies_on[on_offsets[:-1][lies]]
        self._lies_on = wp.array(lies_on, dtype=wp.int32, device=device)
        self._lies_on_offsets = wp.array(on_offsets, dtype=wp.int32, device=device)
        # The adjoint: particles of each node, in ascending order.
        particle, slot = np.nonzero(self.weights)
        node = self.nodes[particle, slot]
        order = np.argsort(node, kind="stable")
        node_counts = np.bincount(node, minlength=self.layout.node_count)
        node_offsets = wp.array(_offsets(node_counts), dtype=wp.int32, device=device)
        node_particles = wp.array(particle[order], dtype=wp.int32, device=device)
        node_weights = wp.array(self.weights[particle, slot][order], dtype=wp.float64, device=device)
        self.adjoint = (node_offsets, node_particles, node_weights)
        self.position, self.velocity, self.normal = (
            wp.zeros(self.count, dtype=wp.vec3d, device=device) for _ in range(3)
        )
        self._area_vector = wp.zeros(len(self.triangles), dtype=wp.vec3d, device=device)

    def _rest_normals(self) -> np.ndarray:
        rest = wp.array(self.rest, dtype=wp.vec3d, device=self._launcher.device)
        return self.evaluate_normals(rest).numpy().copy()

    def gather(self, of_nodes: wp.array, of_particles_out: wp.array) -> wp.array:
        """y_q = sum_p b_pq y_p, of any (node_count,) vec3d; returns `of_particles_out`, (count,) vec3d."""
        inputs = [self.node_index, self.weight, of_nodes]
        self._launcher.launch(gather, self.count, inputs, [of_particles_out], work_per_item=2)
        return of_particles_out

    def evaluate_positions(self, node_position: wp.array) -> wp.array:
        """Moves `position` to where the nodes, (node_count,) vec3d [m], are."""
        return self.gather(node_position, self.position)

    def evaluate_velocities(self, node_velocity: wp.array) -> wp.array:
        """Brings `velocity` up to that of the nodes, (node_count,) vec3d [m/s]."""
        return self.gather(node_velocity, self.velocity)

    def evaluate_normals(self, position: wp.array | None = None) -> wp.array:
        """Brings `normal` up to the particles' `position`, or another (count,) vec3d [m]."""
        position = self.position if position is None else position
        launch = self._launcher.launch
        launch(face_areas, len(self.triangles), [self.triangle, position], [self._area_vector])
        inputs = [self._lies_on_offsets, self._lies_on, self._area_vector]
        launch(particle_normals, self.count, inputs, [self.normal], work_per_item=2)
        return self.normal


def fit_masses(nodes: np.ndarray, weights: np.ndarray, area: np.ndarray, node_mass: np.ndarray) -> np.ndarray:
    """(count,) float64 [kg]: masses m_q of particles with sum_q |b_pq| m_q = m_p on the boundary, never above.

    nodes: (count, 4).  weights: (count, 4), b_pq.  area: (count,) [m2], of which zero takes no part.  node_mass:
    (node_count,) m_p [kg]. So particles that all change their velocity alike change that of the boundary's nodes
    by as much, and none by more: Han 2019 (24) with b_pq m_q / m_p for (25), which conserves momentum.

    From masses in proportion to the areas, m_q <- m_q sum_p |b_pq| m_p / s_p, with s_p = sum_q |b_pq| m_q and
    sums over the nodes that some particle lies nearest to (a maximum-likelihood step for the equality); then
    m_q <- m_q min_p m_p / s_p, after which no node is above its mass, and which, repeated, only adds where every
    node of a particle has mass to give. In the end each particle has a node whose mass is used up.
    """
    b = np.abs(weights)
    taking_part = area > 0.0
    if not taking_part.any():
        return np.zeros(len(b))

    def drawn(mass: np.ndarray) -> np.ndarray:
        return np.bincount(nodes.ravel(), (b * mass[:, None]).ravel(), minlength=len(node_mass))

    boundary = np.zeros(len(node_mass), dtype=bool)
    nearest = nodes[np.arange(len(b)), b.argmax(axis=1)]
    boundary[nearest[taking_part]] = True
    on_boundary = b * boundary[nodes]
    total = on_boundary.sum(axis=1, keepdims=True)
    share = np.divide(on_boundary, total, out=np.zeros_like(b), where=total > 0.0)
    mass = np.where(taking_part, area * node_mass[boundary].sum() / area.sum(), 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        for _ in range(FIT_ROUNDS):
            room = np.where(boundary, node_mass / drawn(mass), 0.0)
            mass *= np.where(taking_part, (share * room[nodes]).sum(axis=1), 1.0)
        for _ in range(GROW_ROUNDS):
            room = np.nan_to_num(node_mass / drawn(mass), nan=np.inf, posinf=np.inf)
            mass *= np.where(taking_part, np.where(b > 0.0, room[nodes], np.inf).min(axis=1), 1.0)
    return mass


def _skin(surface: Surface) -> np.ndarray:
    """(n, 3) the triangles that collide."""
    triangles = np.asarray(surface.triangles, dtype=np.int32).reshape(-1, 3)
    return triangles if surface.collides else triangles[:0]


def _offsets(counts: np.ndarray) -> np.ndarray:
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)


def _body_particles(
    scene: Scene, layout: TetLayout, index: int, spacing: float
) -> tuple[SkinLattice, np.ndarray, np.ndarray, np.ndarray]:
    """One body's lattice, rest points (n, 3), tets (n,) among those of all bodies, and weights (n, 4)."""
    body = layout.bodies[index]
    points = np.asarray(scene.surfaces[body.surface].points, dtype=np.float64)
    lattice = lay_lattice(points, _skin(scene.surfaces[body.surface]), spacing)
    rest = np.einsum("nk,nkd->nd", lattice.weight, points[lattice.corner])
    tets = np.asarray(body.tets)
    tet, weights = locate(rest[len(points) :], np.asarray(body.nodes, dtype=np.float64), tets)
    tet = np.concatenate([np.asarray(body.embedding.tet), tet])
    weights = np.concatenate([np.asarray(body.embedding.barycentric, dtype=np.float64), weights])
    # What is zero but for rounding is zero: a point on a face has no part in the node opposite.
    weights = np.where(np.abs(weights) < 1e-12, 0.0, weights)
    return lattice, rest, (tet + layout.first_tet[index]).astype(np.int32), weights
