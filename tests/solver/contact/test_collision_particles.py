"""Collision particles lie on the skin in a lattice, and pass on exactly what acts on them."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from plait.solver.contact.collision_particles import CollisionParticles
from plait.solver.contact.skin_lattice import lay_lattice, locate
from plait.solver.launch import Launcher
from plait.solver.scene import Embedding, Scene, Surface, TetBody
from plait.solver.tets.layout import build_layout

from ..tets.lattices import box_body, box_lattice


def bodies(spacing: float) -> CollisionParticles:
    """A box with its lattice's own boundary as skin, and a ball of skin inside a cube of tets."""
    first, skin = box_body(size=(1.0, 0.5, 0.5), cells=(4, 2, 2))
    nodes, tets = box_lattice(size=(1.0, 1.0, 1.0), cells=4)
    points, triangles = _octahedron(2)
    points = 0.45 * points
    tet, barycentric = locate(points, nodes, tets)
    count = len(tets)
    second = TetBody(
        "ball",
        nodes,
        tets,
        1,
        Embedding(tet.astype(np.int32), barycentric),
        np.full(count, 1000.0),
        np.full(count, 1e5),
        np.full(count, 0.3),
        np.zeros(len(nodes), dtype=bool),
        np.zeros(len(nodes)),
    )
    scene = Scene(surfaces=(skin, Surface("ball skin", points, triangles, body=1)), bodies=(first, second))
    return CollisionParticles(scene, build_layout(scene), spacing, Launcher(threads=1))


def _octahedron(rounds: int) -> tuple[np.ndarray, np.ndarray]:
    points = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float)
    triangles = np.array(
        [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]], dtype=np.int32
    )
    for _ in range(rounds):
        corner = points[triangles]
        middle = corner + corner[:, [1, 2, 0]]
        middle /= np.linalg.norm(middle, axis=2, keepdims=True)
        count = len(points)
        stacked = np.concatenate([points, middle.reshape(-1, 3)])
        unique, index = np.unique(stacked.round(9), axis=0, return_inverse=True)
        a, b, c = index[triangles].T
        ab, bc, ca = index[count:].reshape(-1, 3).T
        triangles = np.stack([a, ab, ca, b, bc, ab, c, ca, bc, ab, bc, ca], axis=1).reshape(-1, 3).astype(np.int32)
        points = unique
    return points, triangles


@pytest.mark.parametrize("spacing", [0.05, 0.13, 2.0])
def test_lattice_is_as_fine_as_asked(spacing):
    """No point of a triangle is further from a particle of it than a lattice of that spacing leaves."""
    points, triangles = _octahedron(1)
    lattice = lay_lattice(points, triangles, spacing)
    x = np.einsum("nk,nkd->nd", lattice.weight, points[lattice.corner])
    assert np.array_equal(x[: len(points)], points)
    owner = np.repeat(np.arange(lattice.count), np.diff(lattice.triangle_offsets))
    random = np.random.default_rng(0)
    for t, triangle in enumerate(triangles):
        on = x[owner[lattice.triangles == t]]
        somewhere = random.dirichlet(np.ones(3), 200) @ points[triangle]
        distance = np.linalg.norm(somewhere[:, None] - on, axis=2).min(axis=1)
        # The corner of a triangle of sides at most `spacing` is no further from all its points than a side.
        assert distance.max() <= min(spacing, np.sqrt(2.0))
        flat = np.cross(points[triangle[1]] - points[triangle[0]], points[triangle[2]] - points[triangle[0]])
        np.testing.assert_allclose((on - points[triangle[0]]) @ flat, 0.0, atol=1e-12)
    assert len(np.unique(x.round(9), axis=0)) == lattice.count
    corners = points[triangles]
    areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    assert lattice.area.sum() == pytest.approx(areas.sum(), rel=1e-12)
    assert (lattice.area > 0.0).all()


@pytest.mark.parametrize("spacing", [0.04, 0.3, 1.0])
def test_particles_are_where_their_tets_say(spacing):
    particles = bodies(spacing)
    at = np.einsum("nk,nkd->nd", particles.weights, particles.layout.rest[particles.nodes])
    np.testing.assert_allclose(at, particles.rest, atol=1e-12)
    assert particles.weights.min() >= -1e-9
    node_body = np.searchsorted(particles.layout.first_node, particles.nodes, side="right") - 1
    assert (node_body == particles.body[:, None]).all()


@pytest.mark.parametrize("spacing", [0.04, 0.3, 1.0])
def test_no_node_is_overdrawn(spacing):
    """sum_q b_pq m_q <= m_p everywhere, and equal where only the boundary's own nodes carry the skin."""
    particles = bodies(spacing)
    node_mass = particles.layout.mass
    drawn = np.zeros(len(node_mass))
    np.add.at(drawn, particles.nodes.ravel(), (np.abs(particles.weights) * particles.mass[:, None]).ravel())
    assert (drawn <= node_mass * (1.0 + 1e-12)).all()
    assert (particles.mass > 0.0).all()
    # The box's particles are carried by the nodes of its boundary alone: all their mass can be shared out.
    carried = np.unique(particles.nodes[particles.body == 0][particles.weights[particles.body == 0] > 0.0])
    np.testing.assert_allclose(drawn[carried], node_mass[carried], rtol=1e-2)


def test_adjoint_is_that_of_gather():
    """sum_q J_q . y_q = sum_p J_p . y_p for y_q = sum_p b_pq y_p; linear and angular momentum pass exactly."""
    particles = bodies(0.2)
    random = np.random.default_rng(1)
    node_count, device = particles.layout.node_count, "cpu"
    of_nodes = random.normal(size=(node_count, 3))
    impulse = random.normal(size=(particles.count, 3))
    gathered = particles.evaluate_velocities(wp.array(of_nodes, dtype=wp.vec3d, device=device)).numpy()
    offsets, of_node, weight = (array.numpy() for array in particles.adjoint)
    onto_nodes = np.zeros((node_count, 3))
    np.add.at(onto_nodes, np.repeat(np.arange(node_count), np.diff(offsets)), weight[:, None] * impulse[of_node])
    assert np.sum(impulse * gathered) == pytest.approx(np.sum(onto_nodes * of_nodes), rel=1e-12)
    np.testing.assert_allclose(onto_nodes.sum(axis=0), impulse.sum(axis=0), atol=1e-10)
    position = particles.layout.rest
    at = np.einsum("nk,nkd->nd", particles.weights, position[particles.nodes])
    np.testing.assert_allclose(
        np.cross(position, onto_nodes).sum(axis=0), np.cross(at, impulse).sum(axis=0), atol=1e-10
    )


def test_normals_point_outwards():
    """On a sphere the mean normal is the radius; on a box's faces it is the face's."""
    particles = bodies(0.1)
    ball = particles.body == 1
    radius = particles.rest[ball] / np.linalg.norm(particles.rest[ball], axis=1, keepdims=True)
    assert (np.einsum("nd,nd->n", particles.rest_normal[ball], radius) > 0.95).all()
    top = (particles.body == 0) & (np.abs(particles.rest - [0.0, 0.25, 0.0]) < [0.49, 1e-9, 0.24]).all(axis=1)
    assert top.sum() > 10
    np.testing.assert_allclose(particles.rest_normal[top], np.tile([0.0, 1.0, 0.0], (top.sum(), 1)), atol=1e-12)
