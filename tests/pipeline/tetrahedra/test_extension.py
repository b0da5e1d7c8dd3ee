"""Values of the skin in the tets, bone, and tets from files."""

from __future__ import annotations

import meshio
import numpy as np
import pytest
import trimesh
from scipy.special import i0, i1

from plait.pipeline.errors import InputError
from plait.pipeline.flesh import (
    Lattice,
    core,
    embed,
    extend,
    fill_anew,
    influences,
    read_tet_mesh,
    volumes,
)
from plait.solver.scene import Embedding


@pytest.fixture(scope="module")
def limb():
    """A limb of radius .3 about z = 0 to 4, its joints at 0, 2 and 4, of which the middle one bends."""
    mesh = trimesh.creation.capsule(height=4.0, radius=0.3, count=[24, 24])
    points, triangles = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, 0.12)
    points += np.array([0.0, 0.0, 2.0 - mesh.bounds.mean(axis=0)[2]])
    lattice = fill_anew(points, triangles, edge=0.09)
    return points, triangles, lattice, embed(points, lattice)[0]


JOINTS = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 2.0], [0.0, 0.0, 4.0]])
PARENTS = np.array([-1, 0, 1])


def bent_weights(z: np.ndarray) -> np.ndarray:
    """Handed over from the first joint to the second about z = 2."""
    second = np.clip((z - 1.8) / 0.4, 0.0, 1.0)
    return np.column_stack([1.0 - second, second, np.zeros(len(z))])


def test_affine_functions_are_carried_exactly(limb):
    points, _, lattice, embedding = limb
    matrix, offset = np.random.default_rng(2).normal(size=(3, 4)), np.arange(4.0)
    result = extend(lattice, embedding, points @ matrix + offset)
    assert np.abs(result - lattice.nodes @ matrix - offset).max() <= 1e-12 * np.abs(lattice.nodes).max() * 10


def test_nothing_is_made_of_the_noise_of_a_flat_skin():
    """A sheet flat but for a float32's rounding: its values run on across it, not along a slope of the noise."""
    grid = np.stack(np.meshgrid(np.linspace(0, 1, 11), np.linspace(0, 1, 11), indexing="ij"), -1).reshape(-1, 2)
    points = np.column_stack([grid, 1e-7 * np.random.default_rng(3).normal(size=len(grid))])
    corner = np.arange(121).reshape(11, 11)[:-1, :-1].ravel()
    triangles = np.concatenate([corner[:, None] + [0, 11, 12], corner[:, None] + [0, 12, 1]])
    lattice = fill_anew(points, triangles, edge=0.1)
    values = np.sin(3.0 * points[:, :1])
    result = extend(lattice, embed(points, lattice)[0], values)
    assert result.min() > -0.3 and result.max() < 1.3


def test_interpolates_a_smooth_function_to_second_order():
    """A quadratic on a ball: the error at the skin falls fourfold, or nearly, as the edge is halved."""
    mesh = trimesh.creation.icosphere(5)
    points = np.array(mesh.vertices)
    values = (points[:, 0] ** 2 - points[:, 1] * points[:, 2])[:, None]
    errors = []
    for edge in (0.36, 0.18):
        lattice = fill_anew(points, mesh.faces, edge=edge)
        embedding, _ = embed(points, lattice)
        result = extend(lattice, embedding, values)
        at_skin = np.einsum("nk,nkc->nc", embedding.barycentric, result[lattice.tets[embedding.tet]])
        errors.append(np.sqrt(np.mean((at_skin - values) ** 2)))
    assert errors[0] < 0.02 and errors[1] < errors[0] / 3.0


def test_harmonic_inside(limb):
    """cos(k z) on a cylinder of radius R is I0(k r) / I0(k R) cos(k z) within it.

    Tets with the kink at the skin inside them are off by half an edge times the slope there, k I1(k R) / I0(k R).
    """
    points, _, lattice, embedding = limb
    k = np.pi
    result = extend(lattice, embedding, np.cos(k * points[:, 2]))[:, 0]
    across, along = np.hypot(*lattice.nodes[:, :2].T), lattice.nodes[:, 2]
    asked = (across < 0.25) & (np.abs(along - 2.0) < 1.2)
    expected = i0(k * across) / i0(k * 0.3) * np.cos(k * along)
    assert asked.sum() > 200
    assert np.abs(result - expected)[asked].max() <= 0.5 * 0.09 * k * i1(k * 0.3) / i0(k * 0.3)


def test_influences_keep_the_largest():
    joints, weights = influences(np.array([[0.1, -0.2, 0.6, 0.3], [0.0, 0.0, 0.0, 0.0]]), 2)
    assert joints[0].tolist() == [2, 3]
    assert weights[0] == pytest.approx([0.6 / 0.9, 0.3 / 0.9])
    assert weights[1].tolist() == [1.0, 0.0]


def test_bone_keeps_clear_of_a_joint_that_bends(limb):
    points, triangles, lattice, embedding = limb
    weights = bent_weights(lattice.nodes[:, 2])
    bone = core(lattice, embedding, points, triangles, weights, JOINTS, PARENTS)
    place = lattice.nodes[bone.pinned]
    across = np.hypot(place[:, 0], place[:, 1])
    assert not bone.notes and not bone.attached.any()
    assert across.max() < 0.15  # half of the radius
    # The limb is a polygon: its flat sides are nearer than its corners.
    assert np.linalg.norm(place - JOINTS[1], axis=1).min() >= 0.3 * np.cos(np.pi / 24)
    assert (place[:, 2] < 1.7).any() and (place[:, 2] > 2.3).any()


def test_bone_is_left_between_joints_close_to_one_another(limb):
    """Joints every half radius, as of a twisted forearm, still leave the limb some bone."""
    points, triangles, lattice, embedding = limb
    heights = np.arange(0.0, 4.0, 0.15)
    owner = np.clip(np.floor(lattice.nodes[:, 2] / 0.15), 0, len(heights) - 1).astype(int)
    joints = np.column_stack([np.zeros((len(heights), 2)), heights])
    parents = np.arange(len(heights)) - 1
    bone = core(lattice, embedding, points, triangles, np.eye(len(heights))[owner], joints, parents)
    assert len(np.unique(owner[bone.pinned])) > 0.8 * len(heights)


def test_an_end_without_bone_is_attached(limb):
    """A joint at the end whose own flesh is all skin (here: the outermost nodes) hangs on springs."""
    points, triangles, lattice, embedding = limb
    weights = bent_weights(lattice.nodes[:, 2])
    outermost = lattice.nodes[:, 2] > 4.3
    weights[outermost] = [0.0, 0.0, 1.0]
    bone = core(lattice, embedding, points, triangles, weights, JOINTS, PARENTS)
    assert outermost.any() and np.array_equal(bone.attached, outermost)
    assert "1 joints have no bone" in bone.notes[0]


def test_painted_depth_is_meant_to_the_letter(limb):
    """Nothing is bone where 0 is painted, everything where 1 is, the skin too."""
    points, triangles, lattice, embedding = limb
    depth = np.where(points[:, 2] < 1.0, 1.0, 0.0)
    weights = bent_weights(lattice.nodes[:, 2])
    bone = core(lattice, embedding, points, triangles, weights, JOINTS, PARENTS, depth)
    assert bone.pinned[lattice.nodes[:, 2] < 0.6].all()
    assert not bone.pinned[lattice.nodes[:, 2] > 1.4].any()
    assert not bone.notes


def test_a_single_joint_pins_what_lies_deepest(limb):
    points, triangles, lattice, embedding = limb
    away = np.array([[0.0, 5.0, 0.0]])  # as of a helmet, whose joint is in the neck
    bone = core(lattice, embedding, points, triangles, np.ones((len(lattice.nodes), 1)), away, np.array([-1]))
    across = np.hypot(*lattice.nodes[bone.pinned][:, :2].T)
    assert bone.pinned.any() and across.max() < 0.2


def test_flesh_without_bone_is_attached(limb):
    points, triangles, lattice, embedding = limb
    weights = bent_weights(lattice.nodes[:, 2])
    bone = core(lattice, embedding, points, triangles, weights, JOINTS, PARENTS, 0.0)
    assert not bone.pinned.any() and bone.attached.all()
    assert "attached" in bone.notes[0]


@pytest.mark.parametrize("suffix", [".vtk", ".vtu", ".msh", ".mesh"])
def test_tets_of_a_file(suffix, tmp_path, shapes):
    """Turned ones are righted, nodes of no tet dropped; the skin is embedded in them to rounding."""
    shape = shapes["ball"]
    lattice = fill_anew(shape.points, shape.triangles, edge=0.3)
    tets = lattice.tets.copy()
    tets[::3] = tets[::3][:, [1, 0, 2, 3]]
    nodes = np.concatenate([np.full((1, 3), 9.0), lattice.nodes])
    path = tmp_path / f"ball{suffix}"
    meshio.write(path, meshio.Mesh(nodes, [("tetra", tets + 1)]))
    read = read_tet_mesh(path)
    assert len(read.nodes) == len(lattice.nodes) and volumes(read).min() > 0.0
    assert volumes(read).sum() == pytest.approx(volumes(lattice).sum(), rel=1e-9)
    embedding, report = embed(shape.points, read)
    assert report.count == 0
    back = np.einsum("nk,nkd->nd", embedding.barycentric, read.nodes[read.tets[embedding.tet]])
    assert np.abs(back - shape.points).max() <= 1e-12


@pytest.mark.parametrize(
    "case,told",
    [
        ("none", "no such file"),
        ("noise", "cannot be read as a mesh"),
        ("surface", "holds no tetrahedra"),
        ("flat", "tet 1 has no volume"),
        ("infinite", "not finite"),
        ("astray", "names node 7 of 5"),
    ],
)
def test_files_that_are_no_tet_meshes(case, told, tmp_path, capfd):
    path = tmp_path / "body.vtk"
    nodes = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0]])
    if case == "noise":
        path.write_bytes(b"\x00\x01 nothing of the kind")
    elif case == "surface":
        meshio.write(path, meshio.Mesh(nodes, [("triangle", np.array([[0, 1, 2]]))]))
    elif case != "none":
        nodes[4, 0] = np.inf if case == "infinite" else 1.0
        last = 7 if case == "astray" else 4
        meshio.write(path, meshio.Mesh(nodes, [("tetra", np.array([[0, 1, 2, 3], [0, 1, 2, last]]))]))
    with pytest.raises(InputError) as caught:
        read_tet_mesh(path)
    assert told in str(caught.value) and str(path) in str(caught.value) and "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_least_extrapolation_outside(shapes):
    """A point outside all tets lies behind the closest face, and an affine function is right there too."""
    shape = shapes["cube"]
    lattice = fill_anew(shape.points, shape.triangles, edge=0.4)
    bare = Lattice(lattice.nodes, lattice.tets)
    places = np.array([[3.0, 0.1, 0.2], [0.1, 0.2, 0.05]])
    embedding, report = embed(places, bare)
    assert isinstance(embedding, Embedding) and report.count == 1 and report.strong == 1
    back = np.einsum("nk,nkd->nd", embedding.barycentric, lattice.nodes[lattice.tets[embedding.tet]])
    assert np.abs(back - places).max() <= 1e-12
