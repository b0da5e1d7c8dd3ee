"""A mannequin with a full head of hair, which collides with it and with itself; and what must hold of the result.

Centimetres, Y up, facing +Z.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from pxr import Gf, Usd, UsdGeom, Vt
from scipy.spatial import cKDTree

from plait.assets import generate, groom, mannequin, walk
from plait.assets.character import HEAD_MIDDLE, scalp
from plait.assets.stages import (
    author_parameters,
    author_roots,
    frame_codes,
    make_smooth,
    pose_points,
    read_points,
    read_triangles,
)
from plait.assets.walk import Choreography

BODY, HAIR = generate.WORLD.AppendChild("Mannequin"), generate.WORLD.AppendChild("Hair")
CAMERA = generate.WORLD.AppendChild("Camera")
SAMPLES_PER_FRAME = 2  # of what the skeleton does
DRAWN = 1.5  # widths of `Wig.width` that strands are drawn with: locks are soft
THICKNESS = 0.025  # [cm] of a strand's mechanics: it stands for a lock of hair, which is as wide as `Wig.width`
DAMPING = 6.0  # [1/s] air, and the hair within a lock
FINE, ROUNDS = 192, 60  # points of a strand, and rounds, in which strands are moved apart
# linear RGB
SKIN, DARK, LIGHT = np.array([[0.42, 0.43, 0.45], [0.10, 0.035, 0.014], [0.36, 0.15, 0.05]])


@dataclass(frozen=True)
class Wig:
    """strands, segments: of each.  width: [cm] that strands keep from each other, and are drawn with.
    length: [cm] of the lowest strands, and what the highest have more."""

    strands: int
    segments: int
    width: float
    length: tuple[float, float] = (18.0, 9.0)

    @property
    def style(self) -> groom.Style:
        return groom.Style(
            strands=self.strands,
            points=self.segments + 1,
            length=self.length,
            clearance=self.width,
            layers=0.8,
            wave=0.0,
            distance=lambda points: mannequin.body_distance(points, mannequin.AVERAGE.fat),
        )


def write(
    path: Path,
    wig: Wig,
    choreography: Choreography,
    frames: tuple[float, float],
    look_at: np.ndarray,
    offset: np.ndarray,
) -> None:
    """A shot.  frames: the first and the last.  look_at, offset: of the camera, see `author_camera`."""
    codes = np.arange(frames[0], frames[1] + 1e-6, 1.0 / SAMPLES_PER_FRAME)

    def author_all(stage: Usd.Stage) -> None:
        author(stage, wig, codes, choreography)
        author_camera(stage, choreography, codes, look_at, offset)

    generate.write(path, author_all, frames=frames)


def author(stage: Usd.Stage, wig: Wig, codes: np.ndarray, choreography: Choreography) -> None:
    """The mannequin at `BODY`, moving from the first of the time `codes`, and its hair at `HAIR`."""
    UsdGeom.Xform.Define(stage, generate.WORLD)
    generate.author_ground(stage)
    skin = mannequin.author(stage, BODY, mannequin.AVERAGE, codes, choreography)
    author_parameters(skin.GetPrim(), {"clearance": 0.5 * wig.width}, role="collider")
    points = np.array(skin.GetPointsAttr().Get(), dtype=float)
    triangles = np.array(skin.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    bald = np.clip(1.0 + scalp(points), 0.0, 1.0)[:, None]
    colours = (bald * SKIN + (1.0 - bald) * DARK).round(5).astype(np.float32)
    skin.GetDisplayColorAttr().Set(Vt.Vec3fArray.FromNumpy(colours))
    skin.GetDisplayColorPrimvar().SetInterpolation(UsdGeom.Tokens.vertex)
    author_hair(stage, wig, grow(wig, points, triangles))


def grow(wig: Wig, points: np.ndarray, triangles: np.ndarray) -> groom.Groom:
    """On a skin of points (n, 3) [cm] and triangles (m, 3); strands keep off each other."""
    hair = groom.build(points, triangles, wig.style)
    return replace(hair, points=spread(hair.points, wig))


def spread(strands: np.ndarray, wig: Wig) -> np.ndarray:
    """(strands, points, 3) off the skin, few nearer each other than `Wig.width`; their first two points stay.

    Seen as points much nearer to each other than to the next strand, each is pushed away from others' that are too
    near; the strand's own points take over the mean of those on the segments beside them.
    """
    moved, kept = strands.copy(), 1.15 * wig.width
    count = moved.shape[1]
    weights = np.maximum(0.0, 1.0 - np.abs(np.linspace(0.0, count - 1.0, FINE)[:, None] - np.arange(count)))
    clearance = np.full(moved[:, 2:].size // 3, wig.style.clearance)
    for _ in range(ROUNDS):
        places = (weights @ moved).reshape(-1, 3)
        near = cKDTree(places).query_pairs(kept, output_type="ndarray")
        near = near[near[:, 0] // FINE != near[:, 1] // FINE]
        offset = places[near[:, 0]] - places[near[:, 1]]
        far = np.linalg.norm(offset, axis=1, keepdims=True)
        push = np.column_stack([(kept - far) * offset / np.maximum(far, 1e-6), np.ones(len(near))])
        total = np.zeros((len(places), 4))
        np.add.at(total, near[:, 0], push)
        np.add.at(total, near[:, 1], push * (-1.0, -1.0, -1.0, 1.0))
        taken = weights.T @ total.reshape(len(moved), FINE, 4)
        moved[:, 2:] += (taken[..., :3] / np.maximum(taken[..., 3:], 1e-6))[:, 2:]
        free = moved[:, 2:].reshape(-1, 3)
        moved[:, 2:] = groom.outside(free, clearance, wig.style.distance).reshape(len(moved), -1, 3)
    return moved


def author_hair(stage: Usd.Stage, wig: Wig, hair: groom.Groom) -> None:
    curves = UsdGeom.BasisCurves.Define(stage, HAIR)
    make_smooth(curves)
    curves.CreateCurveVertexCountsAttr([wig.segments + 1] * wig.strands)
    curves.CreatePointsAttr(generate.vectors(hair.points))
    curves.CreateWidthsAttr([DRAWN * wig.width])
    curves.SetWidthsInterpolation(UsdGeom.Tokens.constant)
    shade = np.random.default_rng(groom.SEED).random((wig.strands, 1))
    colours = ((1.0 - shade) * DARK + shade * LIGHT).round(5).astype(np.float32)
    curves.CreateDisplayColorAttr(Vt.Vec3fArray.FromNumpy(colours))
    curves.GetDisplayColorPrimvar().SetInterpolation(UsdGeom.Tokens.uniform)
    author_roots(curves, hair.face, np.column_stack([1.0 - hair.uv.sum(axis=1), hair.uv]))
    curves.GetPrim().CreateRelationship("plait:skin").SetTargets([BODY.AppendChild("Skin")])
    kept = {"thickness": THICKNESS, "clearance": wig.width - THICKNESS, "damping": DAMPING}
    author_parameters(curves.GetPrim(), kept, role="strands")


def author_camera(
    stage: Usd.Stage, choreography: Choreography, codes: np.ndarray, look_at: np.ndarray, offset: np.ndarray
) -> None:
    """Goes along with the hips.  look_at: (3,) [cm] at the first of the time codes.  offset: [cm] from there."""
    camera = UsdGeom.Camera.Define(stage, CAMERA)
    camera.CreateFocalLengthAttr(50.0)
    camera.CreateClippingRangeAttr(Gf.Vec2f(1.0, 5000.0))
    transform = camera.AddTransformOp()
    hips = walk.Walk(mannequin.skeleton(), choreography).world((codes - codes[0]) / generate.RATE)["place"]
    for code, gone in zip(codes, (hips - hips[0]) * (1.0, 0.0, 1.0), strict=True):
        target, eye = (Gf.Vec3d(*map(float, place + gone)) for place in (look_at, look_at + offset))
        transform.Set(Gf.Matrix4d().SetLookAt(eye, target, Gf.Vec3d.YAxis()).GetInverse(), code)


# --- what came of it -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Worn:
    """hair: (frame_count, strand_count, point_count, 3) [cm].  skin: (frame_count, n, 3) [cm].
    triangles: (m, 3) of the skin."""

    hair: np.ndarray
    skin: np.ndarray
    triangles: np.ndarray

    @property
    def tips(self) -> np.ndarray:
        """(frame_count, strand_count, 3) [cm] of the strands, from the middle of the head."""
        head = self.skin[0, :, 1] > HEAD_MIDDLE[1] - 4.0
        return self.hair[:, :, -1] - self.skin[:, head].mean(axis=1)[:, None]

    def height(self, frame: int) -> float:
        """[cm] over the skin of the point nearest to it, negative inside, but for points held at the roots."""
        from plait.pipeline.tetrahedra.skin import Inside

        return float(
            Inside(self.skin[frame], self.triangles).query(self.hair[frame, :, 2:].reshape(-1, 3))[0].min()
        )


def check(cache: Path) -> Worn:
    """Reads what `plait sim` made of such a shot. AssertionError if hair went through hair or skin, or tore."""
    from plait.pipeline.validate import validate

    assert validate(cache) == []
    frames = json.loads(cache.with_suffix(".metrics.json").read_text())["frames"]
    strands = [frame["strands"] for frame in frames]
    missed, inside = (sum(one[name] for one in strands) for name in ("missed", "penetrating"))
    strain, contacts = (max(one[name] for one in strands) for name in ("strain_max", "strand_contacts"))
    print(f"passed through: {missed}; points in the body: {inside}; largest strain {100.0 * strain:.2g} %")
    print(f"pairs of segments in contact: {contacts}; {sum(f['wall_seconds'] for f in frames):.0f} s")
    assert missed == 0 and inside == 0
    assert strain < 0.03
    worn = read(cache)
    assert np.isfinite(worn.hair).all()
    # Judged from what was written, too: hair is out of the skin as it is drawn.
    assert min(worn.height(frame) for frame in np.linspace(0, len(worn.hair) - 1, 4).astype(int)) > 0.0
    # Hair lies on hair.
    assert contacts > worn.hair.shape[1] // 4
    return worn


def read(cache: Path) -> Worn:
    stage = Usd.Stage.Open(str(cache))
    codes, curves = frame_codes(stage), stage.GetPrimAtPath(HAIR)
    count = len(UsdGeom.BasisCurves(curves).GetCurveVertexCountsAttr().Get())
    hair = read_points(curves, codes).reshape(len(codes), count, -1, 3)
    triangles = read_triangles(stage.GetPrimAtPath(BODY.AppendChild("Skin")))
    return Worn(hair, pose_points(stage, str(BODY), codes), triangles)
