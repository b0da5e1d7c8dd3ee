"""Makes the sample shot: a character with shoulder-length hair who walks, spins and stops. Always the same bytes.

    python -m plait.assets.generate [--out DIR]

Writes `shot.usda` (the shot: open this), `character.usdc`, `walk.usdc` and `groom.usdc`. Centimetres, Y up, 24
frames a second, frames 1001 to 1097. The picture beside them is made from the simulated shot:

    plait sim assets/sample/shot.usda -o out.usda
    plait preview out.usda -o assets/sample/picture.webp -f 1001:1097x2 --size 272x340 --camera /World/Camera
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, UsdShade, UsdSkel, Vt

from plait.assets import character, groom, walk
from plait.assets.prop import STAFF_COLOUR, staff

# The skin is polygonised and simplified by VTK; another version may cut it into other triangles.
VTK_VERSION = "9.7"
RATE = 24.0
FIRST_FRAME = 1001.0
LAST_FRAME = FIRST_FRAME + walk.DURATION * RATE
SAMPLES_PER_FRAME = 2  # of the animation: substeps see its curvature
# [cm] A strand stands for a lock. Its mechanics and its contacts go by the thickness, of three hairs, so that it
# is stiff enough for its weight to keep its shape. It is drawn as wide as a lock looks.
THICKNESS = 0.025
DRAWN_ROOT, DRAWN_TIP = 0.11, 0.05
DAMPING = 6.0  # [1/s] air, and the neighbours it rubs against

WORLD = Sdf.Path("/World")
BODY = WORLD.AppendChild("Character")
HAIR = BODY.AppendChild("Hair")
SKIN = BODY.AppendChild("Skin")
DIGITS = 4  # of coordinates in centimetres: a micrometre


def main() -> None:
    parser = argparse.ArgumentParser(description="Make the sample shot.")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "sample")
    generate(parser.parse_args().out)


def generate(folder: Path) -> Path:
    """Writes the shot into `folder`, over what is there; returns its top file."""
    folder.mkdir(parents=True, exist_ok=True)
    body = character.build()
    write(folder / "character.usdc", lambda stage: author_character(stage, body))
    write(folder / "walk.usdc", lambda stage: author_walk(stage, body.joints))
    write(folder / "groom.usdc", lambda stage: author_groom(stage, body))
    top = folder / "shot.usda"
    write(top, author_shot, sublayers=("groom.usdc", "walk.usdc", "character.usdc"))
    return top


def write(
    path: Path,
    author: Callable[[Usd.Stage], None],
    sublayers: tuple[str, ...] = (),
    frames: tuple[float, float] = (FIRST_FRAME, LAST_FRAME),
) -> None:
    """One layer, written at once: what an older file of this name held plays no part."""
    layer = Sdf.Layer.CreateAnonymous(path.suffix)
    stage = Usd.Stage.Open(layer)
    stage.SetMetadata("metersPerUnit", 0.01)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    stage.SetTimeCodesPerSecond(RATE)
    stage.SetFramesPerSecond(RATE)
    stage.SetStartTimeCode(frames[0])
    stage.SetEndTimeCode(frames[1])
    author(stage)
    stage.SetDefaultPrim(stage.GetPrimAtPath(WORLD))
    del stage  # an anonymous layer cannot find its neighbours
    layer.subLayerPaths = list(sublayers)
    layer.Export(str(path))


# --- the character ---------------------------------------------------------------------------------------------


def author_character(stage: Usd.Stage, body: character.Character) -> None:
    UsdGeom.Xform.Define(stage, WORLD)
    root = UsdSkel.Root.Define(stage, BODY)
    Usd.ModelAPI(root.GetPrim()).SetKind("component")
    author_skeleton(stage, body.joints)
    skin = define_mesh(stage, SKIN, body.points, body.triangles)
    colour = UsdGeom.PrimvarsAPI(skin).CreatePrimvar(
        "displayColor", Sdf.ValueTypeNames.Color3fArray, UsdGeom.Tokens.uniform
    )
    shades, index = np.unique(body.colours, axis=0, return_inverse=True)
    colour.Set(Vt.Vec3fArray.FromNumpy(shades.astype(np.float32)))
    colour.SetIndices(Vt.IntArray.FromNumpy(index.ravel().astype(np.int32)))
    bind(skin.GetPrim(), body.joint_indices, body.joint_weights)
    UsdPhysics.CollisionAPI.Apply(skin.GetPrim())

    points, triangles = staff(body.joints)
    rod = define_mesh(stage, BODY.AppendChild("Staff"), points, triangles)
    rod.CreateDisplayColorAttr([Gf.Vec3f(*STAFF_COLOUR)])
    bind_to_joint(rod.GetPrim(), body.joints, "RightHand")
    UsdPhysics.CollisionAPI.Apply(rod.GetPrim())


def joint_paths(joints: tuple[character.Joint, ...]) -> list[str]:
    paths: list[str] = []
    for joint in joints:
        paths.append(joint.name if joint.parent < 0 else f"{paths[joint.parent]}/{joint.name}")
    return paths


def author_skeleton(stage: Usd.Stage, joints: tuple[character.Joint, ...], body: Sdf.Path = BODY) -> None:
    """The skeleton of the SkelRoot at `body`, driven by the clip `Walk` beside it."""
    skeleton = UsdSkel.Skeleton.Define(stage, body.AppendChild("Skeleton"))
    places = np.array([joint.place for joint in joints])
    parents = np.array([joint.parent for joint in joints])
    local = places - np.where(parents[:, None] < 0, 0.0, places[parents])
    skeleton.CreateJointsAttr(joint_paths(joints))
    skeleton.CreateBindTransformsAttr(translations_as_matrices(places))
    skeleton.CreateRestTransformsAttr(translations_as_matrices(local))
    skeleton.CreatePurposeAttr(UsdGeom.Tokens.guide)
    binding = UsdSkel.BindingAPI.Apply(skeleton.GetPrim())
    binding.CreateAnimationSourceRel().SetTargets([body.AppendChild("Walk")])
    root = UsdSkel.BindingAPI.Apply(stage.GetPrimAtPath(body))
    root.CreateSkeletonRel().SetTargets([skeleton.GetPath()])


def translations_as_matrices(places: np.ndarray) -> Vt.Matrix4dArray:
    return Vt.Matrix4dArray(
        [Gf.Matrix4d(1.0).SetTranslate(Gf.Vec3d(*map(float, row))) for row in rounded(places, 6)]
    )


def define_mesh(stage: Usd.Stage, path: Sdf.Path, points: np.ndarray, triangles: np.ndarray) -> UsdGeom.Mesh:
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr(vectors(points))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(triangles), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(triangles.astype(np.int32).ravel()))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(mesh.GetPointsAttr().Get()))
    return mesh


def bind(prim: Usd.Prim, indices: np.ndarray, weights: np.ndarray, constant: bool = False) -> None:
    """Linear blend skinning by (n, k) influences; `constant`: by (1, k), the same for all points."""
    binding = UsdSkel.BindingAPI.Apply(prim)
    joints = binding.CreateJointIndicesPrimvar(constant, indices.shape[1])
    joints.Set(Vt.IntArray.FromNumpy(indices.astype(np.int32).ravel()))
    shares = binding.CreateJointWeightsPrimvar(constant, weights.shape[1])
    shares.Set(Vt.FloatArray.FromNumpy(weights.astype(np.float32).ravel()))
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1.0))


def bind_to_joint(prim: Usd.Prim, joints: tuple[character.Joint, ...], name: str) -> None:
    """Moves rigidly with one joint."""
    index = next(k for k, joint in enumerate(joints) if joint.name == name)
    bind(prim, np.array([[index]]), np.array([[1.0]]), constant=True)


def rounded(values: np.ndarray, digits: int) -> np.ndarray:
    """To so many decimals, and no zero below zero: whether it is one hangs on the processor."""
    return values.round(digits) + 0.0


def vectors(values: np.ndarray) -> Vt.Vec3fArray:
    return Vt.Vec3fArray.FromNumpy(rounded(values.reshape(-1, 3), DIGITS).astype(np.float32))


# --- its motion ------------------------------------------------------------------------------------------------


def author_walk(stage: Usd.Stage, joints: tuple[character.Joint, ...]) -> None:
    stage.OverridePrim(WORLD)
    author_clip(stage, BODY, joints, np.arange(FIRST_FRAME, LAST_FRAME + 1e-6, 1.0 / SAMPLES_PER_FRAME))


def author_clip(
    stage: Usd.Stage,
    body: Sdf.Path,
    joints: tuple[character.Joint, ...],
    codes: np.ndarray,
    choreography: walk.Choreography = walk.SAMPLE,
) -> None:
    """`Walk` beneath `body`, sampled at time codes of which the first is the choreography's second 0."""
    clip = UsdSkel.Animation.Define(stage, body.AppendChild("Walk"))
    clip.CreateJointsAttr(joint_paths(joints))
    translations, rotations = walk.animation(joints, (codes - codes[0]) / RATE, choreography)
    turns = rounded(walk.quaternions(rotations), 7)
    clip.CreateScalesAttr(Vt.Vec3hArray([Gf.Vec3h(1.0)] * len(joints)))
    moving, turning = clip.CreateTranslationsAttr(), clip.CreateRotationsAttr()
    for code, places, quaternions in zip(codes, translations, turns, strict=True):
        moving.Set(vectors(places), code)
        turning.Set(Vt.QuatfArray([Gf.Quatf(*map(float, row)) for row in quaternions]), code)


# --- its hair --------------------------------------------------------------------------------------------------


def author_groom(stage: Usd.Stage, body: character.Character) -> None:
    stage.OverridePrim(WORLD)
    # On the skin as it is stored, so that roots lie on it to the last digit.
    hair = groom.build(np.array(vectors(body.points), dtype=float), body.triangles)
    strands, points = hair.points.shape[:2]
    curves = UsdGeom.BasisCurves.Define(stage, HAIR)
    prim = curves.GetPrim()
    curves.CreateTypeAttr(UsdGeom.Tokens.linear)
    curves.CreateWrapAttr(UsdGeom.Tokens.nonperiodic)
    curves.CreateCurveVertexCountsAttr(Vt.IntArray(strands, points))
    curves.CreatePointsAttr(vectors(hair.points))
    taper = DRAWN_ROOT + (DRAWN_TIP - DRAWN_ROOT) * np.linspace(0.0, 1.0, points) ** 2
    curves.CreateWidthsAttr(Vt.FloatArray.FromNumpy(np.tile(taper, strands).astype(np.float32)))
    curves.SetWidthsInterpolation(UsdGeom.Tokens.vertex)
    extent = UsdGeom.Curves.ComputeExtent(curves.GetPointsAttr().Get(), curves.GetWidthsAttr().Get())
    curves.CreateExtentAttr(extent)
    primvars = UsdGeom.PrimvarsAPI(prim)
    for name, kind, value in (
        ("displayColor", "Color3fArray", Vt.Vec3fArray.FromNumpy(hair_colours(strands).astype(np.float32))),
        ("skinprim", "IntArray", Vt.IntArray.FromNumpy(hair.face.astype(np.int32))),
        ("skinprimuv", "Float2Array", Vt.Vec2fArray.FromNumpy(hair.uv.astype(np.float32))),
    ):
        primvars.CreatePrimvar(name, getattr(Sdf.ValueTypeNames, kind), UsdGeom.Tokens.uniform).Set(value)
    prim.CreateRelationship("plait:skin").SetTargets([SKIN])
    bind_to_joint(prim, body.joints, "Head")  # what moves it in an application that does not simulate
    author_hair_physics(prim)


def author_hair_physics(prim: Usd.Prim) -> None:
    """The deformable-body proposal's schema is not registered with USD: it is applied by name."""
    applied = [*prim.GetMetadata("apiSchemas").GetAppliedItems(), "PhysicsCurvesDeformableSimAPI"]
    prim.SetMetadata("apiSchemas", Sdf.TokenListOp.Create(prependedItems=applied))
    for name, value in {"physics:curvesThickness": THICKNESS, "plait:damping": DAMPING}.items():
        prim.CreateAttribute(name, Sdf.ValueTypeNames.Float, custom=True).Set(value)


def hair_colours(count: int) -> np.ndarray:
    """(count, 3) linear RGB: chestnut, each strand a little lighter or darker."""
    random = np.random.Generator(np.random.PCG64(groom.SEED + 1))
    return (np.array([0.115, 0.052, 0.024]) * random.uniform(0.55, 1.5, (count, 1))).round(5)


# --- the shot --------------------------------------------------------------------------------------------------


def author_shot(stage: Usd.Stage) -> None:
    world = UsdGeom.Xform.Define(stage, WORLD)
    Usd.ModelAPI(world.GetPrim()).SetKind("assembly")
    author_ground(stage)
    UsdPhysics.Scene.Define(stage, WORLD.AppendChild("Physics"))
    author_material(stage)
    author_camera(stage)


def author_ground(stage: Usd.Stage) -> None:
    """A floor that things collide with."""
    ground = UsdGeom.Mesh.Define(stage, WORLD.AppendChild("Ground"))
    corners = [(-300.0, 0.0, -250.0), (-300.0, 0.0, 450.0), (300.0, 0.0, 450.0), (300.0, 0.0, -250.0)]
    ground.CreatePointsAttr([Gf.Vec3f(*corner) for corner in corners])
    ground.CreateFaceVertexCountsAttr([4])
    ground.CreateFaceVertexIndicesAttr([0, 1, 2, 3])
    ground.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    ground.CreateExtentAttr([Gf.Vec3f(*corners[0]), Gf.Vec3f(*corners[2])])
    ground.CreateDisplayColorAttr([Gf.Vec3f(0.35, 0.36, 0.38)])
    UsdPhysics.CollisionAPI.Apply(ground.GetPrim())


def author_camera(stage: Usd.Stage) -> None:
    """Goes along beside the character, before it."""
    camera = UsdGeom.Camera.Define(stage, WORLD.AppendChild("Camera"))
    camera.CreateFocalLengthAttr(46.0)
    camera.CreateHorizontalApertureAttr(24.0)
    camera.CreateVerticalApertureAttr(30.0)
    camera.CreateClippingRangeAttr(Gf.Vec2f(1.0, 5000.0))
    transform = camera.AddTransformOp()
    for code in np.arange(FIRST_FRAME, LAST_FRAME + 1e-6):
        along = 118.0 * walk.smooth(np.array([(code - FIRST_FRAME) / RATE]), 0.1, 2.4)[0]
        eye = Gf.Vec3d(190.0, 125.0, 250.0 + round(float(along), DIGITS))
        look = Gf.Matrix4d().SetLookAt(eye, eye - Gf.Vec3d(190.0, 33.0, 250.0), Gf.Vec3d.YAxis())
        transform.Set(look.GetInverse(), code)


def author_material(stage: Usd.Stage) -> None:
    """One matte surface that takes the colour authored on what it is bound to."""
    material = UsdShade.Material.Define(stage, WORLD.AppendPath("Looks/Painted"))
    reader = UsdShade.Shader.Define(stage, material.GetPath().AppendChild("Colour"))
    reader.CreateIdAttr("UsdPrimvarReader_float3")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("displayColor")
    colour = reader.CreateOutput("result", Sdf.ValueTypeNames.Float3)
    surface = UsdShade.Shader.Define(stage, material.GetPath().AppendChild("Surface"))
    surface.CreateIdAttr("UsdPreviewSurface")
    surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).ConnectToSource(colour)
    surface.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(0.55)
    material.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", Sdf.ValueTypeNames.Token))
    UsdShade.MaterialBindingAPI.Apply(stage.GetPrimAtPath(WORLD)).Bind(material)


if __name__ == "__main__":
    main()
