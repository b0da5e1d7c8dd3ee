"""Flesh: meshes and tet meshes as elastic bodies of the scene, and the way back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from pxr import UsdGeom

from plait.pipeline.flesh import Lattice, core, embed, extend, fill, fractions, influences, volumes
from plait.pipeline.read import values
from plait.pipeline.read.mesh_normals import read_mesh_normals
from plait.pipeline.read.motions import (
    InnerMotion,
    RigidMotion,
    ShapedMotion,
    SkinnedMotion,
    WorldToLocal,
    transform,
)
from plait.pipeline.read.parameters import Given
from plait.pipeline.read.source import Source
from plait.pipeline.read.surfaces import NO_TRIANGLES, Body, bind, keep_points
from plait.pipeline.read.tets import read_tet_file, read_tets
from plait.pipeline.read.tissue import Tissue, is_tet_mesh
from plait.pipeline.shot import Embedded, MeshOutput
from plait.pipeline.tetrahedra.skin import prepare
from plait.solver.scene import BlendShapes, Embedding, Motion, Skinning, Surface, TetBody

# Joints that move a node at most; what a ninth one adds is below what the eye sees.
INFLUENCES = 8
# [Hz] at which flesh swings about its animated place where no bone holds it and no attachStiffness is given.
HELD = 6.0
# Of a blend shape's largest offset, what a node must move by to be in it.
LEAST_OFFSET = 1e-5


@dataclass(frozen=True)
class _Inner:
    """Tets and how the animation moves them.

    part: (tet_count,) of each tet's volume that is flesh, by which mass and stiffness go.
    node_of: (authored point count,) the node that each authored point is, -1 for none; None where they are the
        skin's points.
    """

    lattice: Lattice
    embedding: Embedding
    part: np.ndarray
    motion: Motion
    skinning: Skinning | None
    blend_shapes: BlendShapes | None
    node_of: np.ndarray | None = None


def read_tissue(source: Source, body: Body, given: Given) -> Tissue:
    """Fills a mesh with tets, or takes those it brings along.

    Raises InputError for tets, painted values or bindings that cannot be right.
    """
    skin, point_map, authored = _skin(body)
    inner = _own_tets(source, body, authored) if is_tet_mesh(body.prim) else _filled(source, body, skin, given)
    pinned, attachment = _held(source, body, skin, inner, given, authored)
    count = len(inner.lattice.tets)
    tets = TetBody(
        name=body.path,
        nodes=inner.lattice.nodes,
        tets=inner.lattice.tets,
        surface=-1,
        embedding=inner.embedding,
        density=given["density"] * inner.part,
        youngs_modulus=given["youngsModulus"] * inner.part,
        poissons_ratio=np.full(count, given["poissonsRatio"]),
        pinned=pinned,
        attachment=attachment,
        motion=inner.motion,
        skinning=inner.skinning,
        blend_shapes=inner.blend_shapes,
        law=given["law"],
        mass_damping=given["damping"],
        stiffness_damping=given["stiffnessDamping"],
        restitution=given["restitution"],
    )
    sizes = {"tets": count, "nodes": len(tets.nodes), "pinned": int(pinned.sum())}
    return Tissue(body, skin, tets, _output(source, body, point_map, inner), sizes)


# --- the skin ---------------------------------------------------------------------------------------------------


def facing_outward(body: Body) -> Body:
    """The body with its closed shells the right way round: contact needs to know where outside is."""
    triangles = body.surface.triangles
    skin = prepare(body.surface.points, triangles)
    corners = skin.welded[triangles]
    kept = (corners[:, 0] != corners[:, 1]) & (corners[:, 1] != corners[:, 2]) & (corners[:, 2] != corners[:, 0])
    turned = np.zeros(len(triangles), dtype=bool)
    turned[kept] = skin.triangles[:, 1] != corners[kept, 1]
    if not turned.any():
        return body
    triangles, points, entries = (
        np.ascontiguousarray(np.where(turned[:, None], rows[:, [0, 2, 1]], rows))
        for rows in (triangles, body.authored_points, body.authored_corners)
    )
    surface = replace(body.surface, triangles=triangles)
    return replace(body, surface=surface, authored_points=points, authored_corners=entries)


def _skin(body: Body) -> tuple[Surface, np.ndarray, np.ndarray]:
    """The surface without points that no triangle has; for each authored point the one of its points, or -1; and
    for each of its points an authored one."""
    surface = body.surface
    used, triangles = np.unique(surface.triangles, return_inverse=True)
    number = np.full(len(surface.points), -1)
    number[used] = np.arange(len(used))
    if len(used) < len(surface.points):
        motion = surface.motion
        if isinstance(motion, ShapedMotion):
            motion = replace(motion, kept=motion.kept[used])
        surface = keep_points(surface, used, triangles.reshape(-1, 3).astype(np.int32), motion)
    point_map = number[body.welded]
    authored = np.zeros(len(used), dtype=np.int64)
    shown = np.flatnonzero(point_map >= 0)[::-1]
    authored[point_map[shown]] = shown
    return surface, point_map, authored


# --- tets -------------------------------------------------------------------------------------------------------


def _filled(source: Source, body: Body, skin: Surface, given: Given) -> _Inner:
    if "tetMesh" in given:
        lattice = read_tet_file(source, body.prim, given["tetMesh"], body.own_to_rest)
        part = np.ones(len(lattice.tets))
    else:
        lattice = fill(skin.points, skin.triangles, edge=given["tetEdge"], budget=int(given["tetBudget"]))
        part = fractions(lattice, skin.points, skin.triangles)
        if np.ptp(part) == 0.0:  # a skin that has an inside has tets that are not all of them inside
            source.warn("encloses no volume; it is taken as a slab as thick as its tets", body.prim, "points")
    embedding, report = embed(skin.points, lattice)
    if 2 * report.strong > len(skin.points):
        problem = f"its tets do not hold the mesh: {report.strong} of {len(skin.points)} points lie far outside"
        raise source.error(problem, body.prim, "plait:tetMesh", "give tets in the prim's own space and units")
    if report.strong:
        source.warn(
            f"{report.strong} points lie outside its tets, by up to {report.largest:.2g} of one: extrapolated",
            body.prim,
            "plait:tetMesh",
        )

    def carry(values: np.ndarray) -> np.ndarray:
        return extend(lattice, embedding, values)

    motion = skin.motion
    if isinstance(motion, ShapedMotion):
        to_shape = np.linalg.inv(body.bind_to_rest[:3, :3]).T * source.units.meters_per_unit
        skin_there, nodes_there = skin.points @ to_shape, lattice.nodes @ to_shape
        # What moves is extended, not the places: a flat skin's say nothing of what lies across it.
        motion = InnerMotion(motion, lambda shape: nodes_there + carry(shape - skin_there))
    return _Inner(lattice, embedding, part, motion, _skinning(skin, carry), _blend_shapes(skin, carry))


def _own_tets(source: Source, body: Body, authored: np.ndarray) -> _Inner:
    """The tets of a TetMesh, its points being the nodes."""
    points = values.vectors(source, UsdGeom.TetMesh(body.prim).GetPointsAttr())
    bound = bind(source, body.prim, points, body.binding)
    lattice, used = read_tets(source, body.prim, bound.surface.points)
    node_of = np.full(len(points), -1)
    node_of[used] = np.arange(len(used))
    nodes = node_of[authored]
    if (nodes < 0).any():
        lost = int(authored[np.argmax(nodes < 0)])
        raise source.error(
            f"names point {lost}, which no tet has", body.prim, "surfaceFaceVertexIndices", "use points of tets"
        )
    _, first = np.unique(lattice.tets, return_index=True)
    embedding = Embedding((first[nodes] // 4).astype(np.int32), np.eye(4)[first[nodes] % 4])
    held = bound.keep(used, NO_TRIANGLES)
    part = np.ones(len(lattice.tets))
    return _Inner(lattice, embedding, part, held.motion, held.skinning, held.blend_shapes, node_of)


def _skinning(skin: Surface, carry: Callable[[np.ndarray], np.ndarray]) -> Skinning | None:
    if skin.skinning is None:
        return None
    return Skinning(*influences(carry(_dense(skin.skinning)), INFLUENCES), skin.skinning.method)


def _dense(skinning: Skinning) -> np.ndarray:
    """(point_count, joint_count) weights."""
    joints, weights = skinning.joint_indices, skinning.joint_weights
    result = np.zeros((len(joints), int(joints.max()) + 1))
    np.add.at(result, (np.arange(len(joints))[:, None], joints), weights)
    return result


def _blend_shapes(skin: Surface, carry: Callable[[np.ndarray], np.ndarray]) -> BlendShapes | None:
    shapes = skin.blend_shapes
    if shapes is None:
        return None
    count = len(shapes.shape_offsets) - 1
    shape_of = np.repeat(np.arange(count), np.diff(shapes.shape_offsets))
    offsets = np.zeros((len(skin.points), count, 3))
    np.add.at(offsets, (shapes.point_indices, shape_of), shapes.point_offsets)
    moved = carry(offsets.reshape(len(offsets), -1)).reshape(-1, count, 3).swapaxes(0, 1)
    size = np.linalg.norm(moved, axis=2)
    shape, node = np.nonzero(size > LEAST_OFFSET * size.max(axis=1, initial=0.0, keepdims=True))
    runs = np.searchsorted(shape, np.arange(count + 1))
    return BlendShapes(runs.astype(np.int32), node.astype(np.int32), np.ascontiguousarray(moved[shape, node]))


# --- what holds it ----------------------------------------------------------------------------------------------


def _held(
    source: Source, body: Body, skin: Surface, inner: _Inner, given: Given, authored: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Which nodes are bone, (node_count,) bool, and how firmly the others are attached, (node_count,) [N/m].

    A prop that only its transform moves is free, unless a depth of its core is given.
    """
    lattice = inner.lattice
    prop = isinstance(skin.motion, RigidMotion)
    if prop and "coreDepth" not in given:
        pinned, alone = np.zeros(len(lattice.nodes), dtype=bool), np.zeros(len(lattice.nodes), dtype=bool)
    else:
        weights, joints, parents = _skeleton(body, skin, inner)
        depth = given["coreDepth"]
        depth = depth[authored] if isinstance(depth, np.ndarray) else depth
        bone = core(lattice, inner.embedding, skin.points, skin.triangles, weights, joints, parents, depth)
        for note in bone.notes:
            source.warn(note, body.prim)
        pinned, alone = bone.pinned, bone.attached
        if not isinstance(skin.motion, SkinnedMotion):
            alone = np.full(len(alone), not prop)
    stiffness = given["attachStiffness"]
    if isinstance(stiffness, np.ndarray):
        carried = extend(lattice, inner.embedding, stiffness[authored])[:, 0]
        stiffness = np.clip(carried, stiffness.min(), stiffness.max())
    elif "attachStiffness" not in given:
        stiffness = np.where(alone, given["density"] * (2.0 * np.pi * HELD) ** 2, 0.0)
    volume = np.repeat(0.25 * inner.part * volumes(lattice), 4)
    share = np.bincount(lattice.tets.ravel(), volume, minlength=len(lattice.nodes))
    return pinned, np.where(pinned, 0.0, stiffness * share)


def _skeleton(body: Body, skin: Surface, inner: _Inner) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weights of the nodes, (node_count, joint_count), joints at rest, (joint_count, 3) [m], and their parents.

    What no skeleton moves has one joint, in its middle.
    """
    count = len(inner.lattice.nodes)
    if not isinstance(skin.motion, SkinnedMotion):
        return np.ones((count, 1)), skin.points.mean(axis=0, keepdims=True), np.array([-1])
    query = skin.motion.skeleton.query
    bind_pose = np.array(query.GetJointWorldBindTransforms()).reshape(-1, 4, 4)
    joints = transform(body.bind_to_rest, bind_pose[:, 3, :3])
    weights = np.zeros((count, len(joints)))
    if inner.skinning is None:
        weights[:, skin.motion.used[0]] = 1.0
    else:
        dense = _dense(inner.skinning)
        weights[:, skin.motion.used[: dense.shape[1]]] = dense
    return weights, joints, np.array(query.GetTopology().GetParentIndices())


# --- the way back -----------------------------------------------------------------------------------------------


def _output(source: Source, body: Body, point_map: np.ndarray, inner: _Inner) -> MeshOutput:
    to_local = WorldToLocal(source, body.prim)
    to_local(body.start)
    of_nodes = inner.node_of is not None
    point_map = inner.node_of if of_nodes else point_map
    lost = np.flatnonzero(point_map < 0)
    loose = None
    if len(lost):
        lattice = Lattice(inner.lattice.nodes, inner.lattice.tets)
        where, _ = embed(body.surface.points[body.welded[lost]], lattice)
        loose = Embedded(lost, lattice.tets[where.tet], where.barycentric)
    return MeshOutput(
        body.path,
        to_local,
        skinned=body.binding is not None,
        body=-1,
        point_map=point_map,
        of_nodes=of_nodes,
        loose=loose,
        normals=read_mesh_normals(source, body),
    )


def ride(source: Source, body: Body, host: Tissue) -> MeshOutput:
    """The way back of a mesh that is drawn in the tets of `host`, from how it lies in them at the first frame."""
    to_local = WorldToLocal(source, body.prim)
    to_local(body.start)
    to_host = np.linalg.solve(host.body.rest_to_world, body.rest_to_world)
    places = transform(to_host, body.surface.points[body.welded])
    where, report = embed(places, Lattice(host.tets.nodes, host.tets.tets))
    if report.strong:
        source.warn(f"{report.strong} points lie outside the tets of {host.body.path}: extrapolated", body.prim)
    return MeshOutput(
        body.path,
        to_local,
        skinned=body.binding is not None,
        body=host.output.body,
        point_map=np.full(len(places), -1),
        loose=Embedded(np.arange(len(places)), host.tets.tets[where.tet], where.barycentric),
        normals=read_mesh_normals(source, body),
    )
