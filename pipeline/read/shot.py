"""`read_shot`: the whole way from a file to a `Shot`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from pxr import Tf, Usd, UsdGeom, UsdUtils

from plait.pipeline.config import Config
from plait.pipeline.read import curves as drawn
from plait.pipeline.read import parameters, roles, values
from plait.pipeline.read.approximation import tell_of_approximation
from plait.pipeline.read.extents import Neighbourhood
from plait.pipeline.read.filtering import read_filtered
from plait.pipeline.read.grains import Heaps, middle_of
from plait.pipeline.read.gravity import read_gravity
from plait.pipeline.read.groom import Groom
from plait.pipeline.read.grooms import Assembly, read_grooms, tell_of_skipped
from plait.pipeline.read.guides import choose_leaders
from plait.pipeline.read.joint_kinds import take_drafts
from plait.pipeline.read.joints import read_joints
from plait.pipeline.read.parameter_table import COLLIDER, FLESH
from plait.pipeline.read.polygons import mesh_sizes
from plait.pipeline.read.rigid import Props, describe
from plait.pipeline.read.roles import Role
from plait.pipeline.read.roots import find_roots
from plait.pipeline.read.shells import tell_of_inward
from plait.pipeline.read.skeletons import Skeletons
from plait.pipeline.read.source import Source
from plait.pipeline.read.surfaces import Bodies, Body
from plait.pipeline.read.tissue import Tissue, estimate
from plait.pipeline.shot import INTERPOLATED, MeshOutput, PrimReport, Shot
from plait.solver.scene import Scene, Surface


def read_shot(path: Path, config: Config, frames: tuple[float, float] | None = None, *, fill: bool = True) -> Shot:
    """Reads a shot. frames: first and last time code wanted; the shot's own range if None.

    fill: False leaves flesh without tets, for a report: their numbers are estimates, and nothing is compiled.

    Roles whose physics does not exist yet are reported with `supported=False`, not refused. Where nothing is
    simulated no skin is read. Raises InputError for input that cannot be right, UsageError for such frames or
    parameters.
    """
    parameters.check_configuration(config)
    # USD prints its warnings; here they become the shot's.
    diagnostics = UsdUtils.CoalescingDiagnosticDelegate()
    source = Source(Path(path), frames)
    try:
        shot = _Reader(source, config, frames, fill).shot()
    except Tf.ErrorException as error:
        raise source.error(f"USD cannot evaluate it: {error}", mend="check it with usdchecker") from error
    for diagnostic in diagnostics.TakeUncoalescedDiagnostics():
        source.warn(" ".join(diagnostic.commentary.split()))
    return replace(shot, warnings=tuple(source.warnings), layers=source.layers)


class _Reader:
    def __init__(self, source: Source, config: Config, frames: tuple[float, float] | None, fill: bool) -> None:
        self.source, self.config, self.fill = source, config, fill
        self.frames = frames or (source.info.start, source.info.end)
        self.skeletons = Skeletons(source)
        self.bodies = Bodies(source, self.skeletons)
        take_drafts(source)
        self.roles = roles.assign(source, self.skeletons)

    def shot(self) -> Shot:
        self._check_patterns()
        parameters.tell_of_unknown(self.source)
        grooms = read_grooms(self.source, self.roles, self.config)
        self.source.origin = self._origin(grooms)
        tissues = self._tissues()
        props = Props(self.source, self.bodies, self.roles, self.config)
        heaps = Heaps(self.source, self.bodies, self.skeletons, self.roles, self.config, self.frames, self.fill)
        surfaces, carrying = self._surfaces(grooms, tissues, props, heaps)
        if len(heaps):
            tell_of_inward(self.source, surfaces)
        choose_leaders(self.source, grooms)
        assembly = Assembly(self.source, self.skeletons, grooms, surfaces)
        attachments = assembly.attachments(self.bodies, self.roles)
        props.tell_of_left_behind(surfaces, heaps.emitting)
        bodies = tuple(
            replace(tissue.tets, surface=next(i for i, s in enumerate(surfaces) if s.body == index))
            for index, tissue in enumerate(tissues.values())
        )
        scene = Scene(
            tuple(surfaces),
            assembly.strands,
            bodies=bodies,
            gravity=read_gravity(self.source),
            origin=self.source.origin,
            attachments=attachments,
            rigid_bodies=props.rigid_bodies(surfaces),
            joints=read_joints(self.source, self.roles, props),
            filtered=read_filtered(self.source, surfaces),
            granular=heaps.granular,
            granular_start=heaps.start,
            rigid_start=heaps.start,
        )
        tell_of_skipped(self.source, self.roles)
        told = describe(scene.rigid_bodies, scene.joints)
        reports = tuple(self._report(role, carrying, grooms, tissues, heaps, told) for role in self.roles)
        meshes = (*(tissue.output for tissue in tissues.values()), *self._riders(tissues))
        curves = assembly.outputs()
        carried = {o.prim_path: props.carrying(o.prim_path) for o in (*curves, *meshes, *heaps.outputs)}
        return Shot(
            self.source.info,
            scene,
            curves,
            reports,
            meshes=meshes,
            props=props.outputs(),
            on_props={path: prop for path, prop in carried.items() if prop is not None},
            grains=heaps.outputs,
        )

    # --- strands ----------------------------------------------------------------------------------------------

    def _origin(self, grooms: list[Groom]) -> np.ndarray:
        """The middle of all that is simulated where it is drawn at the first frame, to the metre."""
        drawn_points = [(groom.role.prim, groom.curves.points) for groom in grooms]
        for role in self._flesh_roles():
            points = values.vectors(self.source, UsdGeom.PointBased(role.prim).GetPointsAttr())
            drawn_points += [(role.prim, points)] if len(points) else []
        drawn_points += [(role.prim, np.zeros((1, 3))) for role in self.roles if role.body and role.supported]
        drawn_points += [
            (role.prim, middle_of(self.source, role.prim))
            for role in self.roles
            if role.role in roles.GRANULAR and role.supported
        ]
        if not drawn_points:
            return np.zeros(3)
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for prim, points in drawn_points:
            binding = self.skeletons.find(prim)
            holder = binding.skeleton.prim if binding else prim
            matrix = self.source.placed_at_start(holder)
            points = points @ matrix[:3, :3].T + matrix[:3, 3]
            low, high = np.minimum(low, points.min(axis=0)), np.maximum(high, points.max(axis=0))
        # Adding zero makes no zero negative.
        return np.round(0.5 * (low + high) * self.source.units.meters_per_unit) + 0.0

    # --- flesh ------------------------------------------------------------------------------------------------

    def _tissues(self) -> dict[str, Tissue]:
        """The flesh of the shot by prim path, in the order of `Scene.bodies`."""
        tissues: dict[str, Tissue] = {}
        for role in self._flesh_roles():
            body = self.bodies.get(role.prim)
            if body is None:
                raise self.source.error(
                    "has no triangle with an area", role.prim, "faceVertexIndices", "give the flesh a surface"
                )
            given = parameters.resolve(self.source, role.prim, FLESH, self.config)
            tissue = self._tissue(body, given)
            friction = given["friction"] if "friction" in given else None
            tissues[body.path] = tissue.placed(len(tissues), given["clearance"], friction)
        return tissues

    def _tissue(self, body: Body, given: parameters.Given) -> Tissue:
        if not self.fill:
            return estimate(self.source, body, given)
        # Here, so that a shot without flesh does not load Warp to be read.
        from plait.pipeline.read.flesh import facing_outward, read_tissue

        body = facing_outward(body)
        self.bodies.replace(body)
        return read_tissue(self.source, body, given)

    def _flesh_roles(self) -> list[Role]:
        return [role for role in self.roles if role.role == "flesh" and role.supported and not role.rides]

    def _riders(self, tissues: dict[str, Tissue]) -> list[MeshOutput]:
        """The other meshes of deformable bodies."""
        if not self.fill:
            return []
        from plait.pipeline.read.flesh import ride

        riders = [(role, self.bodies.get(role.prim)) for role in self._riding(tissues)]
        return [ride(self.source, body, tissues[role.rides]) for role, body in riders if body is not None]

    def _riding(self, tissues: dict[str, Tissue]) -> list[Role]:
        return [role for role in self.roles if role.supported and role.rides in tissues]

    # --- surfaces ---------------------------------------------------------------------------------------------

    def _surfaces(
        self, grooms: list[Groom], tissues: dict[str, Tissue], props: Props, heaps: Heaps
    ) -> tuple[list[Surface], dict[str, list[str]]]:
        """All that is simulated collides with, or strands grow on; and which prims carry which grooms.

        None where nothing is simulated.
        """
        if not (grooms or tissues or len(props) or len(heaps)):
            return [], {}
        carrying: dict[str, list[str]] = {}
        hidden = []
        for groom in grooms:
            named = self._named_skins(groom.role.prim)
            binding = self.skeletons.find(groom.role.prim)
            # What is free grows on nothing: it starts where its own prim is, unless a skin is named.
            candidates = named if named is not None else [] if groom.free.all() else self._candidates(groom)
            rooted = find_roots(self.source, groom.curves, groom.lines, binding, candidates, named is not None)
            groom.rooted = props.carry_roots(rooted, groom.curves.path)
            self._tell_of_animated_roots(groom, tissues)
            for body in groom.rooted.bodies:
                carrying.setdefault(body.path, []).append(groom.curves.path)
            if groom.rooted.hidden:
                hidden.append(groom.rooted.surface)
        surfaces = []
        for role in self.roles:
            path = str(role.prim.GetPath())
            if path in tissues:
                surfaces.append(tissues[path].surface)
            elif role.collides or (path in carrying and roles.is_solid(role.prim)):
                body = self.bodies.get(role.prim)
                if body is not None:
                    own = role.body or (body.surface.rigid is not None and not role.collides)
                    surfaces.append(body.surface if own else self._with_contact(body))
        return surfaces + hidden, carrying

    def _tell_of_animated_roots(self, groom: Groom, tissues: dict[str, Tissue]) -> None:
        """Strands that grow on several skins, or were drawn in a pose, follow the animation of these."""
        flesh = [body.path for body in groom.rooted.bodies if body.path in tissues]
        if flesh and groom.rooted.hidden:
            self.source.warn(
                f"its roots follow the animation of {', '.join(flesh)}, not the simulated flesh: "
                "the strands grow on several skins or were drawn in a pose",
                groom.role.prim,
            )

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

    def _candidates(self, groom: Groom) -> list[Body]:
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
        given = parameters.resolve(self.source, body.prim, COLLIDER, self.config)
        tell_of_approximation(self.source, body.prim, body.surface)
        return replace(
            body.surface,
            collides=True,  # also beneath a rigid body, which takes along what is drawn beneath it
            thickness=given["clearance"],
            friction=given["friction"] if "friction" in given else None,
            restitution=given["restitution"],
        )

    # --- report -----------------------------------------------------------------------------------------------

    def _check_patterns(self) -> None:
        paths = [str(role.prim.GetPath()) for role in self.roles]
        for pattern in self.config.prim:
            if not parameters.matches_any(pattern, paths):
                self.source.warn(f"prim.{pattern!r} of the configuration matches no prim")

    def _report(
        self,
        role: Role,
        carrying: dict[str, list[str]],
        grooms: list[Groom],
        tissues: dict[str, Tissue],
        heaps: Heaps,
        rigid: dict[str, str],
    ) -> PrimReport:
        prim = role.prim
        path = str(prim.GetPath())
        groom = next((g for g in grooms if g.role.prim == prim), None)
        kind, recognised, reason = role.role, role.recognised, role.reason
        if groom and groom.follows:
            kind = INTERPOLATED
        if path in carrying and not role.collides:
            kind, reason = "collider" if self.bodies.get(prim).surface.collides else "carrier", ""
            recognised = f"{', '.join(carrying[path])} grows on it"
        if prim.IsA(UsdGeom.Curves):
            sizes = drawn.sizes(prim, self.source)
        else:
            sizes = mesh_sizes(prim, self.source)
        if path in tissues:
            sizes |= tissues[path].sizes
        sizes |= heaps.sizes.get(path, {})
        told = heaps.told(path) or rigid.get(path, "")
        recognised += f"; {told}" if told else ""
        roots = groom.rooted.how if groom else ""
        if groom and groom.free.any():
            roots = f"{int(groom.free.sum())} of {len(groom.free)} strands are free; {roots}"
        return PrimReport(
            path=path,
            type_name=str(prim.GetTypeName()),
            role=kind,
            recognised=recognised,
            sizes=sizes,
            reason=reason,
            supported=role.supported,
            roots=roots,
            guides=groom.guides if groom else "",
            attachments=groom.attachments if groom else (),
        )
