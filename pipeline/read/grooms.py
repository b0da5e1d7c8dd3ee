"""Strands prims of a shot: read, split into what is simulated and what follows, and put into the scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from pxr import Usd, UsdGeom

from plait.pipeline.config import Config
from plait.pipeline.read import bezier, guides, parameters, roles, strands
from plait.pipeline.read import curves as drawn
from plait.pipeline.read.attachments import NAMESPACE, Attachments, Tied, has_attachments
from plait.pipeline.read.groom import Groom
from plait.pipeline.read.motions import WorldToLocal
from plait.pipeline.read.normals import read_normals
from plait.pipeline.read.parameter_table import STRANDS
from plait.pipeline.read.roles import Role
from plait.pipeline.read.roots import Rooted
from plait.pipeline.read.skeletons import Skeletons
from plait.pipeline.read.source import Source
from plait.pipeline.read.surfaces import Bodies
from plait.pipeline.shot import CurveOutput, Followers, as_drawn
from plait.solver.scene import Attachment, RootBinding, Strands, Surface


def read_grooms(source: Source, assigned: list[Role], config: Config) -> list[Groom]:
    """Every strands prim; one without any length becomes a skipped one in `assigned`."""
    grooms = []
    for index, role in enumerate(assigned):
        if role.role != "strands" or not role.supported:
            continue
        curves = drawn.read_curves(source, role.prim)
        lines = drawn.polylines(curves)
        if lines is None:
            reason = "no curve has a length"
            assigned[index] = replace(role, role=roles.SKIPPED, reason=reason, authored=False)
            continue
        stubs = len(lines.stub_tips)
        if stubs:
            source.warn(f"{stubs} curves have no length; they follow their roots unsimulated", role.prim, "points")
        marked, mark = guides.read_marks(source, curves)
        given = parameters.resolve(source, role.prim, STRANDS, config)
        grooms.append(Groom(role, curves, lines, given, marked[lines.curves], mark))
    return grooms


@dataclass(frozen=True)
class _Part:
    """The strands of a prim that are simulated: their part of the scene, and which of the prim's points they have.

    first: how many strands the scene has before them.
    """

    index: int
    first: int
    strands: Strands
    point_map: np.ndarray


class Assembly:
    """From grooms whose roots and leaders are known to strands of the scene, and the way back."""

    def __init__(
        self, source: Source, skeletons: Skeletons, grooms: Sequence[Groom], surfaces: list[Surface]
    ) -> None:
        self._source, self._skeletons, self._grooms, self._surfaces = source, skeletons, grooms, surfaces
        self._parts: dict[str, _Part] = {}
        first = 0
        for groom in grooms:
            if groom.simulated.any():
                part = self._simulate(groom, first)
                self._parts[groom.path] = part
                first += part.strands.strand_count

    @property
    def strands(self) -> tuple[Strands, ...]:
        """Those of the scene."""
        return tuple(part.strands for part in self._parts.values())

    def outputs(self) -> tuple[CurveOutput, ...]:
        return tuple(self._output(groom) for groom in self._grooms)

    def attachments(self, bodies: Bodies, assigned: Sequence[Role]) -> tuple[Attachment, ...]:
        """Those of every groom; surfaces that only they need join the scene's."""
        prims = {groom.path: groom.prim for groom in self._grooms}
        tied = [Tied(prims[path], part.index, part.strands, part.point_map) for path, part in self._parts.items()]
        hosts = {str(role.prim.GetPath()): role.rides for role in assigned if role.rides}
        reader = Attachments(self._source, bodies, self._surfaces, tied, hosts)
        found: list[Attachment] = []
        for groom in self._grooms:
            if groom.path in self._parts:
                attached = reader.read(groom.prim)
                groom.attachments = attached.words
                found += attached.attachments
            elif has_attachments(groom.prim):
                raise self._source.error("follows guides", groom.prim, NAMESPACE, "attach its guides instead")
        for role in assigned:
            if str(role.prim.GetPath()) not in prims and has_attachments(role.prim):
                self._source.warn("without effect: only strands have it", role.prim, NAMESPACE)
        return tuple(found)

    def _simulate(self, groom: Groom, first: int) -> _Part:
        chosen = groom.simulated
        lines, _ = groom.lines.select(chosen)
        free = groom.free[chosen] if groom.free.any() else None
        rooted = groom.rooted.select(chosen)
        held = strands.build(self._source, groom.curves, lines, rooted, self._binding(rooted), groom.given, free)
        return _Part(len(self._parts), first, held, lines.point_map)

    def _binding(self, rooted: Rooted) -> RootBinding:
        surface = next(i for i, s in enumerate(self._surfaces) if s.name == rooted.surface.name)
        return RootBinding(surface, rooted.triangle, rooted.barycentric)

    def _output(self, groom: Groom) -> CurveOutput:
        prim, curves = groom.prim, groom.curves
        widths = drawn.read_widths(self._source, curves)
        part = self._parts.get(groom.path)
        return CurveOutput(
            prim_path=curves.path,
            world_to_local=WorldToLocal(self._source, prim),
            strands=part.index if part else None,
            point_map=groom.lines.point_map,
            widths=np.zeros(len(curves.points)) if widths is None else widths,
            stencil=bezier.stencil(curves.counts, groom.lines.point_map) if drawn.is_bezier(prim) else None,
            skinned=self._skeletons.find(prim) is not None,
            normals=read_normals(self._source, curves, groom.lines, groom.rooted),
            followers=self._followers(groom) if groom.leaders else None,
        )

    def _followers(self, groom: Groom) -> Followers:
        chosen = ~groom.simulated
        lines, points = groom.lines.select(chosen)
        rooted = groom.rooted.select(chosen)
        held = strands.unsimulated(self._source, groom.curves, lines, rooted, self._binding(rooted))
        leading = [self._parts[leader.path] for leader in groom.leaders]
        numbers = np.concatenate([part.first + np.arange(part.strands.strand_count) for part in leading])
        roots = np.concatenate([as_drawn(part.strands)[part.strands.offsets[:-1]] for part in leading])
        nearest, weights = guides.bind(as_drawn(held)[held.offsets[:-1]], roots)
        return Followers(
            held,
            points,
            np.nonzero(chosen)[0],
            groom.lines.offsets,
            numbers[nearest].astype(np.int32),
            weights,
        )


def tell_of_skipped(source: Source, assigned: Sequence[Role]) -> None:
    """One line a reason: what might have been meant to be simulated and is not."""
    skipped: dict[str, list[Usd.Prim]] = {}
    for role in assigned:
        if role.prim.IsA(UsdGeom.Curves) and role.role == roles.SKIPPED and not role.authored:
            skipped.setdefault(role.reason, []).append(role.prim)
    for reason, prims in skipped.items():
        others = f" (and {len(prims) - 1} more)" if len(prims) > 1 else ""
        source.warn(f"not simulated{others}: {reason}", prims[0])
