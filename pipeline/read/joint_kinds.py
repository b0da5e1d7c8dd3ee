"""Which joint of the solver a joint of UsdPhysics is, the generic one by what its limits lock."""

from __future__ import annotations

from dataclasses import dataclass

from pxr import Usd, UsdPhysics

from plait.solver.scene import JointKind

KINDS: dict[str, JointKind] = {
    "PhysicsFixedJoint": "fixed",
    "PhysicsRevoluteJoint": "revolute",
    "PhysicsSphericalJoint": "spherical",
    "PhysicsPrismaticJoint": "prismatic",
}
WAYS, TURNS = ("transX", "transY", "transZ"), ("rotX", "rotY", "rotZ")


@dataclass(frozen=True)
class Drawn:
    """axis: X, Y or Z, '' for a kind without.  lower, upper: names of the attributes with its limits."""

    kind: JointKind
    axis: str = ""
    lower: str = "physics:lowerLimit"
    upper: str = "physics:upperLimit"


def drawn_kind(prim: Usd.Prim) -> Drawn | None:
    """None for a joint that is none of the solver's: a distance joint, or a generic one of other freedoms."""
    name = str(prim.GetTypeName())
    if name == "PhysicsJoint":
        return _generic(prim)
    if name not in KINDS:
        return None
    kind = KINDS[name]
    return Drawn(kind, "" if kind == "fixed" else str(prim.GetAttribute("physics:axis").Get()))


def _generic(prim: Usd.Prim) -> Drawn | None:
    free = [freedom for freedom in (*WAYS, *TURNS) if not _locked(prim, freedom)]
    if not free:
        return Drawn("fixed")
    if len(free) == 1:
        limits = (f"limit:{free[0]}:physics:{side}" for side in ("low", "high"))
        return Drawn("prismatic" if free[0] in WAYS else "revolute", free[0][-1], *limits)
    unlimited = not any(prim.HasAPI(UsdPhysics.LimitAPI, turn) for turn in TURNS)
    return Drawn("spherical", "Z") if free == list(TURNS) and unlimited else None


def _locked(prim: Usd.Prim, freedom: str) -> bool:
    """As UsdPhysics has it: a lower limit above the upper one."""
    if not prim.HasAPI(UsdPhysics.LimitAPI, freedom):
        return False
    limit = UsdPhysics.LimitAPI(prim, freedom)
    return limit.GetLowAttr().Get() > limit.GetHighAttr().Get()
