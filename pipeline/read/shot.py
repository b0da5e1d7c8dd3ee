"""`read_shot`: the whole way from a file to a `Shot`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from pxr import Tf, Usd, UsdGeom, UsdUtils

from plait.pipeline.config import Config
from plait.pipeline.read import bezier, parameters, roles, strands
from plait.pipeline.read import curves as drawn
from plait.pipeline.read.extents import Neighbourhood
from plait.pipeline.read.gravity import read_gravity
from plait.pipeline.read.normals import read_normals
from plait.pipeline.read.roles import Role
from plait.pipeline.read.roots import Rooted, find_roots
from plait.pipeline.read.skeletons import Skeletons
from plait.pipeline.read.source import Source
from plait.pipeline.read.surfaces import Bodies, Body, mesh_sizes
from plait.pipeline.shot import CurveOutput, PrimReport, Shot
from plait.solver.scene import RootBinding, Scene, Strands, Surface


def read_shot(path: Path, config: Config, frames: tuple[float, float] | None = None) -> Shot:
    """Reads a shot. frames: first and last time code wanted; the shot's own range if None.

    Roles whose physics does not exist yet are reported with `supported=False`, not refused. Without strands no
    skin is read. Raises InputError for input that cannot be right, UsageError for such frames or parameters.
    """
    parameters.check_configuration(config)
    # USD prints its warnings; here they become the shot's.
    diagnostics = UsdUtils.CoalescingDiagnosticDelegate()
    source = Source(Path(path), frames)
    try:
        shot = _Reader(source, config).shot()
    except Tf.ErrorException as error:
        raise source.error(f"USD cannot evaluate it: {error}", mend="check it with usdchecker") from error
    for diagnostic in diagnostics.TakeUncoalescedDiagnostics():
        source.warn(" ".join(diagnostic.commentary.split()))
    return replace(shot, warnings=tuple(source.warnings), layers=source.layers)


@dataclass
class _Groom:
    """One strands prim on its way into the scene."""

    role: Role
    curves: drawn.Curves
    lines: drawn.Polylines
    rooted: Rooted | None = None


class _Reader:
    def __init__(self, source: Source, config: Config) -> None:
        self.source, self.config = source, config
        self.skeletons = Skeletons(source)
        self.bodies = Bodies(source, self.skeletons)
        self.roles = roles.assign(source, self.skeletons)

    def shot(self) -> Shot:
        self._check_patterns()
        grooms = self._grooms()
        self.source.origin = self._origin(grooms)
        surfaces, carrying = self._surfaces(grooms)
        scene_strands, outputs = [], []
        for groom in grooms:
            outputs.append(self._output(groom, len(scene_strands)))
            scene_strands.append(self._strands(groom, surfaces))
        gravity = read_gravity(self.source)
        scene = Scene(tuple(surfaces), tuple(scene_strands), gravity, self.source.origin)
        self._tell_of_skipped_curves()
        reports = tuple(self._report(role, carrying, grooms) for role in self.roles)
        return Shot(self.source.info, scene, tuple(outputs), reports)

    # --- strands ----------------------------------------------------------------------------------------------

    def _grooms(self) -> list[_Groom]:
        grooms = []
        for index, role in enumerate(self.roles):
            if role.role != "strands" or not role.supported:
                continue
            curves = drawn.read_curves(self.source, role.prim)
            lines = drawn.polylines(curves)
            if lines is None:
                reason = "no curve has a length"
                self.roles[index] = replace(role, role=roles.SKIPPED, reason=reason, authored=False)
                continue
            stubs = len(lines.stub_tips)
            if stubs:
                self.source.warn(
                    f"{stubs} curves have no length; they follow their roots unsimulated", role.prim, "points"
                )
            if drawn.are_guides(role.prim):
                self.source.warn("marked as guides; nothing else is interpolated from them yet", role.prim)
            grooms.append(_Groom(role, curves, lines))
        return grooms

    def _origin(self, grooms: list[_Groom]) -> np.ndarray:
        """The middle of the grooms where they are drawn at the first frame, to the metre."""
        if not grooms:
            return np.zeros(3)
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for groom in grooms:
            binding = self.skeletons.find(groom.role.prim)
            holder = binding.skeleton.prim if binding else groom.role.prim
            matrix = self.source.placed_at_start(holder)
            points = groom.curves.points @ matrix[:3, :3].T + matrix[:3, 3]
            low, high = np.minimum(low, points.min(axis=0)), np.maximum(high, points.max(axis=0))
        # Adding zero makes no zero negative.
        return np.round(0.5 * (low + high) * self.source.units.meters_per_unit) + 0.0

    def _strands(self, groom: _Groom, surfaces: list[Surface]) -> Strands:
        given = parameters.resolve(self.source, groom.role.prim, parameters.STRANDS, self.config)
        surface = next(i for i, s in enumerate(surfaces) if s.name == groom.rooted.surface.name)
        binding = RootBinding(surface, groom.rooted.triangle, groom.rooted.barycentric)
        return strands.build(self.source, groom.curves, groom.lines, groom.rooted, binding, given)

    def _output(self, groom: _Groom, index: int) -> CurveOutput:
        prim, curves = groom.role.prim, groom.curves
        widths = drawn.read_widths(self.source, curves)
        return CurveOutput(
            prim_path=curves.path,
            strands=index,
            point_map=groom.lines.point_map,
            world_to_local=strands.WorldToLocal(self.source, prim),
            widths=np.zeros(len(curves.points)) if widths is None else widths,
            stencil=bezier.stencil(curves.counts, groom.lines.point_map) if drawn.is_bezier(prim) else None,
            skinned=self.skeletons.find(prim) is not None,
            normals=read_normals(self.source, curves, groom.lines, groom.rooted),
        )

    def _tell_of_skipped_curves(self) -> None:
        """One line a reason: what might have been meant to be simulated and is not."""
        skipped: dict[str, list[Usd.Prim]] = {}
        for role in self.roles:
            if role.prim.IsA(UsdGeom.Curves) and role.role == roles.SKIPPED and not role.authored:
                skipped.setdefault(role.reason, []).append(role.prim)
        for reason, prims in skipped.items():
            others = f" (and {len(prims) - 1} more)" if len(prims) > 1 else ""
            self.source.warn(f"not simulated{others}: {reason}", prims[0])

    # --- surfaces ---------------------------------------------------------------------------------------------

    def _surfaces(self, grooms: list[_Groom]) -> tuple[list[Surface], dict[str, list[str]]]:
        """All that strands collide with or grow on; and which prims carry which grooms. None without strands."""
        if not grooms:
            return [], {}
        carrying: dict[str, list[str]] = {}
        hidden = []
        for groom in grooms:
            named = self._named_skins(groom.role.prim)
            binding = self.skeletons.find(groom.role.prim)
            candidates = named if named is not None else self._candidates(groom)
            groom.rooted = find_roots(
                self.source, groom.curves, groom.lines, binding, candidates, named is not None
            )
            for body in groom.rooted.bodies:
                carrying.setdefault(body.path, []).append(groom.curves.path)
            if not groom.rooted.surface.collides:
                hidden.append(groom.rooted.surface)
        surfaces = []
        for role in self.roles:
            path = str(role.prim.GetPath())
            if role.collides or (path in carrying and roles.is_solid(role.prim)):
                body = self.bodies.get(role.prim)
                if body is not None:
                    surfaces.append(self._with_contact(body))
        return surfaces + hidden, carrying

    def _named_skins(self, prim: Usd.Prim) -> list[Body] | None:
        relationship = prim.GetRelationship("plait:skin")
        targets = relationship.GetTargets() if relationship else []
        if not targets:
            return None
        named = []
        for target in targets:
            skin = self.source.stage.GetPrimAtPath(target)
            if not skin or not roles.is_solid(skin):
                raise self.source.error(
                    f"names <{target}>, which is no Mesh", prim, "plait:skin", "name the mesh the strands grow on"
                )
            body = self.bodies.get(skin)
            if body is None:
                raise self.source.error(
                    f"names <{target}>, which has no triangles", prim, "plait:skin", "name another mesh"
                )
            named.append(body)
        return named

    def _candidates(self, groom: _Groom) -> list[Body]:
        """Meshes that strands may grow on: colliders, and visible meshes nearby that have no role of their own."""
        near = Neighbourhood(self.source, groom.curves)
        prims = [
            role.prim
            for role in self.roles
            if role.prim.IsA(UsdGeom.Mesh) and (role.collides or (role.carries and near.touches(role.prim)))
        ]
        bodies = [self.bodies.get(prim) for prim in prims]
        return [body for body in bodies if body is not None]

    def _with_contact(self, body: Body) -> Surface:
        given = parameters.resolve(self.source, body.prim, parameters.COLLIDER, self.config)
        return replace(
            body.surface, thickness=given["clearance"], friction=given["friction"] if "friction" in given else None
        )

    # --- report -----------------------------------------------------------------------------------------------

    def _check_patterns(self) -> None:
        paths = [str(role.prim.GetPath()) for role in self.roles]
        for pattern in self.config.prim:
            if not parameters.matches_any(pattern, paths):
                self.source.warn(f"prim.{pattern!r} of the configuration matches no prim")

    def _report(self, role: Role, carrying: dict[str, list[str]], grooms: list[_Groom]) -> PrimReport:
        prim = role.prim
        path = str(prim.GetPath())
        groom = next((g for g in grooms if g.role.prim == prim), None)
        kind, recognised, reason = role.role, role.recognised, role.reason
        if path in carrying and not role.collides:
            kind, reason = "collider", ""
            recognised = f"{', '.join(carrying[path])} grows on it"
        if prim.IsA(UsdGeom.Curves):
            sizes = drawn.sizes(prim, self.source)
        else:
            sizes = mesh_sizes(prim, self.source)
        return PrimReport(
            path=path,
            type_name=str(prim.GetTypeName()),
            role=kind,
            recognised=recognised,
            sizes=sizes,
            reason=reason,
            supported=role.supported,
            roots=groom.rooted.how if groom else "",
        )
