"""Which joint of the solver a joint of UsdPhysics is, the generic one by what its limits lock."""

from __future__ import annotations

from dataclasses import dataclass

from pxr import Usd, UsdPhysics

from plait.pipeline.read import values
from plait.pipeline.read.source import Source
from plait.solver.scene import JointKind

KINDS: dict[str, JointKind] = {
    "PhysicsFixedJoint": "fixed",
    "PhysicsRevoluteJoint": "revolute",
    "PhysicsSphericalJoint": "spherical",
    "PhysicsPrismaticJoint": "prismatic",
    "PhysicsDistanceJoint": "distance",
}
# What types were called before UsdPhysics was part of USD.
DRAFTS = {f"{name}PhysicsJoint": f"Physics{name}Joint" for name in ("Distance", "Fixed", "Prismatic", "Revolute")}
DRAFTS |= {"SphericalPhysicsJoint": "PhysicsSphericalJoint"}
WAYS, TURNS = ("transX", "transY", "transZ"), ("rotX", "rotY", "rotZ")


@dataclass(frozen=True)
class Drawn:
    """axis: X, Y or Z, '' for a kind without.  lower, upper: names of the attributes with its limits.
    drive: the instance of PhysicsDriveAPI that acts along what is free, '' for none.
    """

    kind: JointKind
    axis: str = ""
    lower: str = "physics:lowerLimit"
    upper: str = "physics:upperLimit"
    drive: str = ""


def take_drafts(source: Source) -> None:
    """Joints whose type has its name of a draft are what USD has instead; in memory alone."""
    stage = source.stage
    for prim in stage.Traverse():
        name = str(prim.GetTypeName())
        if name.endswith("Joint") and "Phys" in name and name not in DRAFTS and not prim.IsA(UsdPhysics.Joint):
            source.warn(f"is a {name}, which USD does not know; left out", prim)
    found = [prim for prim in stage.Traverse() if str(prim.GetTypeName()) in DRAFTS]
    with Usd.EditContext(stage, stage.GetSessionLayer()):
        for prim in found:
            name = str(prim.GetTypeName())
            source.warn(f"is a {name}, which USD does not know; taken as a {DRAFTS[name]}", prim)
            prim.SetTypeName(DRAFTS[name])


def drawn_kind(source: Source, prim: Usd.Prim) -> Drawn | None:
    """At the first frame; None for a joint that is none of the solver's: a generic one of other freedoms."""
    name = str(prim.GetTypeName())
    if name == "PhysicsJoint":
        return _generic(source, prim)
    if name not in KINDS:
        return None
    kind = KINDS[name]
    if kind == "distance":
        return Drawn(kind, "", "physics:minDistance", "physics:maxDistance")
    axis = "" if kind == "fixed" else str(prim.GetAttribute("physics:axis").Get(source.start))
    return Drawn(kind, axis, drive={"revolute": "angular", "prismatic": "linear"}.get(kind, ""))


def _generic(source: Source, prim: Usd.Prim) -> Drawn | None:
    free = [freedom for freedom in (*WAYS, *TURNS) if not _locked(source, prim, freedom)]
    if not free:
        return Drawn("fixed")
    if len(free) == 1:
        limits = (f"limit:{free[0]}:physics:{side}" for side in ("low", "high"))
        return Drawn("prismatic" if free[0] in WAYS else "revolute", free[0][-1], *limits, free[0])
    unlimited = not any(prim.HasAPI(UsdPhysics.LimitAPI, turn) for turn in TURNS)
    return Drawn("spherical", "Z") if free == list(TURNS) and unlimited else None


def _locked(source: Source, prim: Usd.Prim, freedom: str) -> bool:
    """As UsdPhysics has it: a lower limit above the upper one."""
    if not prim.HasAPI(UsdPhysics.LimitAPI, freedom):
        return False
    limit = UsdPhysics.LimitAPI(prim, freedom)
    return values.number(source, limit.GetLowAttr()) > values.number(source, limit.GetHighAttr())
