"""What each prim of a shot is for, by what is authored on it (see the table in the README)."""

from __future__ import annotations

from dataclasses import dataclass, replace

from pxr import Usd, UsdGeom, UsdPhysics

from plait.pipeline.read import curves, shapes, values
from plait.pipeline.read.joint_kinds import drawn_kind
from plait.pipeline.read.skeletons import INFLUENCES, Skeletons
from plait.pipeline.read.source import PREDICATE, Source

CHOICES = ("strands", "flesh", "cloth", "rigid", "sand", "snow", "enriched", "collider", "none")
DEFORMABLE_BODY, VOLUME = "PhysicsDeformableBodyAPI", "PhysicsVolumeDeformableSimAPI"
APPLIED = {
    "PhysicsCurvesDeformableSimAPI": "strands",
    VOLUME: "flesh",
    "PhysicsSurfaceDeformableSimAPI": "cloth",
}
# Roles whose physics does not exist yet. Their prims stay as authored, and strands collide with them as such.
UNSUPPORTED = ("cloth", "enriched")
GRANULAR = ("sand", "snow")
SIMULATED = ("strands", "flesh", "rigid", *GRANULAR, *UNSUPPORTED)
RIGID_BODY, COLLISION = "PhysicsRigidBodyAPI", "PhysicsCollisionAPI"
PROP = "animated prop"
SKIPPED = "skipped"


@dataclass(frozen=True)
class Role:
    """role: of CHOICES, PROP or SKIPPED.  recognised: by what.  reason: why skipped or refused.
    authored: the shot says so, rather than that nothing speaks against it.
    carries: strands may grow on it though it has no role: a visible mesh.
    rides: path of the TetMesh in whose tets it is drawn, '' for none: a deformable body's other meshes.
    body: path of the prim whose transform says where it is, '' for what is part of no simulated rigid body.
    touches: False for a rigid body's prim that is no collider itself.
    """

    prim: Usd.Prim
    role: str
    recognised: str
    reason: str = ""
    authored: bool = True
    supported: bool = True
    carries: bool = False
    rides: str = ""
    body: str = ""
    touches: bool = True

    @property
    def collides(self) -> bool:
        """Whether strands collide with it; also with what is skipped by its own physics: it stays where it is."""
        solid = is_solid(self.prim) and self.role in ("collider", PROP, "flesh", "cloth", "rigid")
        return solid and self.touches and not self.rides


def assign(source: Source, skeletons: Skeletons) -> list[Role]:
    """The role of every prim that has one or that a user would expect to have one, in the stage's order.

    Raises InputError for a role that does not exist or that the prim's type cannot have.
    """
    return _Assignment(source, skeletons).roles()


def applied_schemas(prim: Usd.Prim) -> set[str]:
    """Names of applied schemas, those USD does not know included."""
    listed = prim.GetMetadata("apiSchemas")
    return set(prim.GetAppliedSchemas()) | set(listed.GetAppliedItems() if listed else ())


def is_solid(prim: Usd.Prim) -> bool:
    return prim.IsA(UsdGeom.Mesh) or prim.IsA(UsdGeom.TetMesh) or shapes.is_shape(prim)


def is_granular(prim: Usd.Prim) -> bool:
    """Whether a prim of this type can be filled with grains, pour them, or is grains."""
    return is_solid(prim) or prim.IsA(UsdGeom.Points)


class _Assignment:
    def __init__(self, source: Source, skeletons: Skeletons) -> None:
        self._source, self._skeletons = source, skeletons
        self._prims = [p for p in source.stage.Traverse(PREDICATE) if not p.IsInPrototype()]
        self._authored = {str(p.GetPath()): self._authored_role(p) for p in self._prims}
        self._first = next((r for r in self._authored.values() if r and r.role in SIMULATED), None)

    def roles(self) -> list[Role]:
        found = []
        for prim in self._prims:
            role = self._authored[str(prim.GetPath())] or self._implied_role(prim)
            if role is not None:
                found.append(self._checked(role))
        return found

    # --- authored ---------------------------------------------------------------------------------------------

    def _authored_role(self, prim: Usd.Prim) -> Role | None:
        own = self._plait_role(prim)
        if own is not None:
            return own
        schemas = applied_schemas(prim)
        host = self._tets_beside(prim) if prim.IsA(UsdGeom.Mesh) and not schemas & set(APPLIED) else None
        if host is not None:
            return Role(prim, "flesh", f"beside {host.GetPath()}", rides=str(host.GetPath()))
        body, body_schemas = self._body_above(prim)
        for name, role in APPLIED.items():
            if name in schemas:
                return Role(prim, role, name)
            if name in body_schemas and _is_geometry(prim) and role != "strands":
                return Role(prim, role, f"{name} on {body.GetPath()}")
        enabled = self._enabled(prim, "physics:collisionEnabled")
        if is_solid(prim) and COLLISION in schemas and (enabled or RIGID_BODY not in schemas):
            return self._collision_role(prim, enabled)
        if RIGID_BODY in schemas and self._enabled(prim, "physics:rigidBodyEnabled"):
            if self._is_kinematic(prim):
                return Role(prim, PROP, f"{RIGID_BODY}, kinematicEnabled", touches=False)
            return Role(prim, "rigid", RIGID_BODY, body=str(prim.GetPath()), touches=False)
        if prim.IsA(UsdPhysics.Joint):
            return Role(prim, "rigid", str(prim.GetTypeName()))
        return None

    def _plait_role(self, prim: Usd.Prim) -> Role | None:
        """`plait:role` of the nearest prim, itself or above, that has one; groups pass theirs on to geometry."""
        holder = prim
        while holder and not holder.IsPseudoRoot():
            attribute = holder.GetAttribute("plait:role")
            if attribute and attribute.HasAuthoredValue():
                break
            holder = holder.GetParent()
        else:
            return None
        value = attribute.Get()
        if value not in CHOICES:
            raise self._source.error(f"is {value!r}", holder, "plait:role", f"author one of {', '.join(CHOICES)}")
        if not _is_geometry(prim):
            return None
        self._check_type(prim, value, holder)
        where = "" if holder == prim else f" on {holder.GetPath()}"
        recognised = f"plait:role{where}"
        if value == "none":
            return Role(prim, SKIPPED, recognised, "plait:role is none")
        if value == "collider" and is_solid(prim):
            body, _ = self._body_of(holder.GetParent())
            if body is not None and not self._is_kinematic(body):
                return Role(prim, "rigid", f"{recognised}, part of {body.GetPath()}", body=str(body.GetPath()))
        return Role(prim, value, recognised, body=str(prim.GetPath()) if value == "rigid" else "")

    def _check_type(self, prim: Usd.Prim, value: str, holder: Usd.Prim) -> None:
        is_curves = prim.IsA(UsdGeom.Curves)
        fits = {
            "strands": is_curves,
            "flesh": _is_tissue(prim),
            "cloth": prim.IsA(UsdGeom.Mesh),
            "collider": is_solid(prim),
            "rigid": is_solid(prim),
            **dict.fromkeys(GRANULAR, is_granular(prim)),
        }.get(value, True)
        if not fits and holder == prim:
            raise self._source.error(
                f"is '{value}', which a {prim.GetTypeName()} cannot be", prim, "plait:role", "author another role"
            )

    def _tets_beside(self, prim: Usd.Prim) -> Usd.Prim | None:
        """The TetMesh that is simulated for the deformable body the prim is part of."""
        holder = prim.GetParent()
        while holder and not holder.IsPseudoRoot():
            schemas = applied_schemas(holder)
            if schemas & {DEFORMABLE_BODY, VOLUME}:
                for other in Usd.PrimRange(holder, PREDICATE):
                    if other.IsA(UsdGeom.TetMesh) and VOLUME in schemas | applied_schemas(other):
                        return other
                return None
            holder = holder.GetParent()
        return None

    def _body_above(self, prim: Usd.Prim) -> tuple[Usd.Prim | None, set[str]]:
        holder = prim.GetParent()
        while holder and not holder.IsPseudoRoot():
            schemas = applied_schemas(holder)
            if schemas & set(APPLIED):
                return holder, schemas
            holder = holder.GetParent()
        return None, set()

    def _collision_role(self, prim: Usd.Prim, enabled: bool) -> Role:
        if not enabled:
            return Role(prim, SKIPPED, COLLISION, "physics:collisionEnabled is false")
        holder, disabled = self._body_of(prim)
        if holder is None:
            where = "" if disabled in (None, prim) else f" on {disabled.GetPath()}"
            off = f", {RIGID_BODY}{where} is disabled" if disabled else ""
            return Role(prim, "collider", f"{COLLISION}{off}")
        where = "" if holder == prim else f" on {holder.GetPath()}"
        if self._is_kinematic(holder):
            return Role(prim, PROP, f"{RIGID_BODY}{where}, kinematicEnabled")
        return Role(prim, "rigid", f"{RIGID_BODY}{where}", body=str(holder.GetPath()))

    def _body_of(self, prim: Usd.Prim) -> tuple[Usd.Prim | None, Usd.Prim | None]:
        """The nearest prim, itself or above, whose PhysicsRigidBodyAPI is enabled; and the first that is not."""
        disabled = None
        while prim and not prim.IsPseudoRoot():
            if RIGID_BODY in applied_schemas(prim):
                if self._enabled(prim, "physics:rigidBodyEnabled"):
                    return prim, disabled
                disabled = disabled or prim
            prim = prim.GetParent()
        return None, disabled

    def _enabled(self, prim: Usd.Prim, name: str) -> bool:
        return self._switch(prim, name, True)

    def _is_kinematic(self, prim: Usd.Prim) -> bool:
        return self._switch(prim, "physics:kinematicEnabled", False)

    def _switch(self, prim: Usd.Prim, name: str, unauthored: bool) -> bool:
        """A bool of UsdPhysics at the first frame."""
        attribute = prim.GetAttribute(name)
        if not attribute:
            return unauthored
        self._source.tell_if_animated(attribute)
        value = values.flag(self._source, attribute)
        return unauthored if value is None else value

    # --- implied ----------------------------------------------------------------------------------------------

    def _implied_role(self, prim: Usd.Prim) -> Role | None:
        if not _is_geometry(prim):
            return None
        hidden = self._why_hidden(prim)
        if prim.IsA(UsdGeom.Curves):
            return self._implied_curves(prim, hidden)
        if self._skeletons.find(prim) is not None and is_solid(prim):
            if hidden:
                return Role(prim, SKIPPED, "skinned", hidden, authored=False)
            return Role(prim, "collider", f"skinned {prim.GetTypeName()} without a role", authored=False)
        carries = not hidden and prim.IsA(UsdGeom.Mesh)
        return Role(prim, SKIPPED, "no role", self._why_skipped(prim), authored=False, carries=carries)

    def _implied_curves(self, prim: Usd.Prim, hidden: str) -> Role:
        if self._first is not None and not curves.names_guides(prim):
            reason = (
                f"no role, while {self._first.prim.GetPath()} has one ({self._first.recognised}); "
                "apply PhysicsCurvesDeformableSimAPI, author plait:role = 'strands', or name its plait:guides"
            )
            return Role(prim, SKIPPED, "no role", reason, authored=False)
        reason = hidden or curves.refusal(prim) or self._why_unwritable(prim)
        if not reason and curves.is_empty(prim, self._source):
            reason = "empty"
        change = None if reason else curves.topology_change(self._source, prim)
        if change is not None:
            reason = f"curveVertexCounts change at time code {change:g}"
        if reason:
            return Role(prim, SKIPPED, "no role", reason, authored=False)
        named = curves.names_guides(prim)
        recognised = curves.GUIDES if named else f"{prim.GetTypeName()} in a shot without roles"
        return Role(prim, "strands", recognised, authored=False)

    def _why_hidden(self, prim: Usd.Prim) -> str:
        image = UsdGeom.Imageable(prim)
        invisible = image.ComputeVisibility(self._source.start) == UsdGeom.Tokens.invisible
        if invisible and not _visibility_varies(prim):
            return "invisible"
        purpose = image.ComputePurpose()
        if purpose == UsdGeom.Tokens.proxy or (purpose == UsdGeom.Tokens.guide and not prim.IsA(UsdGeom.Curves)):
            return f"purpose {purpose}"
        return "" if not _under_instancer(prim) else "a prototype of a PointInstancer"

    def _why_skipped(self, prim: Usd.Prim) -> str:
        path = str(prim.GetPath())
        if path in self._skeletons.hidden:
            return (
                f"skinned, but UsdSkel does not see it beneath {self._skeletons.hidden[path]}, which has no type"
            )
        if prim.HasAttribute(INFLUENCES[0]):
            return "has joint influences, but no SkelRoot or no skeleton binds it"
        if is_solid(prim):
            return "neither skinned nor physics; for a collider apply PhysicsCollisionAPI or author plait:role"
        return f"{prim.GetTypeName()} takes no part"

    def _why_unwritable(self, prim: Usd.Prim) -> str:
        return "inside an instance, which cannot be overridden; de-instance it" if prim.IsInstanceProxy() else ""

    def _checked_flesh(self, role: Role) -> Role:
        prim = role.prim
        if not _is_geometry(prim):
            if any(self._authored.get(str(p.GetPath())) for p in Usd.PrimRange(prim, PREDICATE) if _is_tissue(p)):
                return replace(role, role=SKIPPED, reason="its meshes are the flesh")
            return replace(role, reason="has neither Mesh nor TetMesh beneath it", supported=False)
        reason = "" if _is_tissue(prim) else f"a {prim.GetTypeName()} has no points to write; convert it to a Mesh"
        reason = reason or self._why_unwritable(prim)
        return replace(role, reason=reason, supported=not reason)

    def _checked_rigid(self, role: Role) -> Role:
        prim = role.prim
        if prim.IsA(UsdPhysics.Joint):
            known = drawn_kind(self._source, prim) is not None
            return (
                role if known else replace(role, reason=f"{prim.GetTypeName()} is not simulated", supported=False)
            )
        body = self._source.stage.GetPrimAtPath(role.body)
        reason = self._why_unwritable(body)
        if not reason and (body.IsA(UsdGeom.PointInstancer) or _under_instancer(body)):
            reason = "a prototype of a PointInstancer; make prims of its instances"
        if not reason and not any(part.body == role.body and part.collides for part in self._parts_of(body)):
            massive = body.HasAPI(UsdPhysics.MassAPI) and body.GetAttribute("physics:mass").HasAuthoredValue()
            reason = "" if massive else "has neither a collider nor a mass; apply PhysicsCollisionAPI to its shape"
        return replace(role, reason=reason, supported=not reason)

    def _checked_granular(self, role: Role) -> Role:
        prim = role.prim
        if not is_granular(prim):
            return replace(role, reason=f"a {prim.GetTypeName()} cannot be {role.role}", supported=False)
        if prim.IsA(UsdGeom.Points) and not UsdGeom.Points(prim).GetPointsAttr().Get(self._source.start):
            return replace(role, role=SKIPPED, reason="empty")
        reason = self._why_unwritable(prim)
        if not reason and _under_instancer(prim):
            reason = "a prototype of a PointInstancer"
        return replace(role, reason=reason, supported=not reason)

    def _parts_of(self, body: Usd.Prim) -> list[Role]:
        found = (self._authored.get(str(prim.GetPath())) for prim in Usd.PrimRange(body, PREDICATE))
        return [role for role in found if role is not None]

    def _checked(self, role: Role) -> Role:
        if role.role != SKIPPED:
            values.check_tokens(self._source, role.prim)
        if role.role == "strands" and role.authored:
            reason = curves.refusal(role.prim) or self._why_unwritable(role.prim)
            if reason:
                return replace(role, reason=reason, supported=False)
        if role.role == "flesh":
            return self._checked_flesh(role)
        if role.role == "rigid":
            return self._checked_rigid(role)
        if role.role in GRANULAR:
            return self._checked_granular(role)
        if role.role in UNSUPPORTED:
            return replace(role, reason=f"{role.role} is not simulated yet", supported=False)
        if role.role in ("collider", PROP) and role.authored and _under_instancer(role.prim):
            reason = "a prototype of a PointInstancer; make prims of its instances"
            self._source.warn(f"does not collide: {reason}", role.prim)
            return replace(role, role=SKIPPED, reason=reason)
        return role


def _is_geometry(prim: Usd.Prim) -> bool:
    return prim.IsA(UsdGeom.Gprim)


def _is_tissue(prim: Usd.Prim) -> bool:
    return prim.IsA(UsdGeom.Mesh) or prim.IsA(UsdGeom.TetMesh)


def _visibility_varies(prim: Usd.Prim) -> bool:
    while prim and not prim.IsPseudoRoot():
        image = UsdGeom.Imageable(prim)
        if image and image.GetVisibilityAttr().ValueMightBeTimeVarying():
            return True
        prim = prim.GetParent()
    return False


def _under_instancer(prim: Usd.Prim) -> bool:
    holder = prim.GetParent()
    while holder and not holder.IsPseudoRoot():
        if holder.IsA(UsdGeom.PointInstancer):
            return True
        holder = holder.GetParent()
    return False
