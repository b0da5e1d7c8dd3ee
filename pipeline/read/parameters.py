"""Every parameter a prim can carry: one table, from which reading is driven and the README's table is made."""

from __future__ import annotations

import difflib
import fnmatch
import math
from dataclasses import dataclass
from typing import Any

from pxr import Usd, UsdShade

from plait.pipeline.config import Config
from plait.pipeline.errors import UsageError
from plait.pipeline.read.source import Source

STRANDS, COLLIDER = "strands", "collider"


@dataclass(frozen=True)
class Parameter:
    """One parameter. On a prim or its physics material it is `plait:NAME`; in the configuration NAME.

    unit: SI; the configuration is in SI, what is authored in a stage is in the stage's own units.
    default: None where it follows from others, as `default_text` says.
    low, high: range in SI, `low` itself only if `low_allowed`.
    authored: other attribute names it is read from, weakest first: UsdPhysics', then the deformable proposal's.
    kilograms, meters: powers of the stage's units in it (seconds are seconds everywhere).
    zero_means_unset: in the other names, as UsdPhysics has it, zero asks for the default.
    """

    name: str
    unit: str
    meaning: str
    roles: tuple[str, ...] = (STRANDS,)
    default: float | str | None = None
    default_text: str = ""
    low: float = 0.0
    high: float = math.inf
    low_allowed: bool = False
    authored: tuple[str, ...] = ()
    kilograms: int = 0
    meters: int = 0
    zero_means_unset: bool = False
    choices: tuple[str, ...] = ()

    @property
    def range_text(self) -> str:
        if self.choices:
            return ", ".join(self.choices)
        return f"{'from' if self.low_allowed else 'above'} {self.low:g} to {self.high:g}"

    def stage_unit(self, source: Source) -> float:
        """SI value of one of the stage's units of this parameter."""
        units = source.units
        return units.kilograms_per_unit**self.kilograms * units.meters_per_unit**self.meters


PARAMETERS = (
    Parameter(
        "density", "kg/m3", "mass over volume of the strand's material",
        default=1300.0, low=0.01, high=1e6, low_allowed=True,
        authored=("physics:density",), kilograms=1, meters=-3, zero_means_unset=True,
    ),
    Parameter(
        "thickness", "m", "diameter; over the drawn `widths`",
        default_text="the drawn width, 8e-5 where none is drawn", low=0.0, high=10.0,
        authored=("physics:curvesThickness",), meters=1, zero_means_unset=True,
    ),
    Parameter(
        "youngsModulus", "Pa", "stiffness of the material; hair has 2e9 to 5e9",
        default=4e9, low=1.0, high=1e13, low_allowed=True,
        authored=("physics:youngsModulus",), kilograms=1, meters=-1, zero_means_unset=True,
    ),
    Parameter(
        "poissonsRatio", "1", "sideways over lengthwise strain; sets twist against bend",
        default=0.35, low=-1.0, high=0.5, authored=("physics:poissonsRatio",),
    ),
    Parameter(
        "stretchStiffness", "N", "EA, force over stretch",
        default_text="from youngsModulus and thickness", high=1e15,
        authored=("physics:curvesStretchStiffness",), kilograms=1, meters=1, zero_means_unset=True,
    ),
    Parameter(
        "bendStiffness", "N m2", "EI, moment over curvature",
        default_text="from youngsModulus and thickness; strands drawn thicker than any hair, with no stiffness "
        "authored, get one in proportion to their length and weight",
        high=1e12, authored=("physics:curvesBendStiffness",), kilograms=1, meters=3, zero_means_unset=True,
    ),
    Parameter(
        "twistStiffness", "N m2", "GJ, moment over twist",
        default_text="bendStiffness / (1 + poissonsRatio)",
        high=1e12, authored=("physics:curvesTwistStiffness",), kilograms=1, meters=3, zero_means_unset=True,
    ),
    Parameter(
        "damping", "1/s", "rate at which motion against the root dies out, air and neighbours together",
        default_text="2 + 8 (8e-5 / thickness)², the latter air's drag: 10 for a human hair",
        low=0.0, high=1e5, low_allowed=True,
    ),
    Parameter(
        "friction", "1", "Coulomb coefficient against bodies; a body's own comes before the strand's",
        roles=(STRANDS, COLLIDER), default=0.3, low=0.0, high=100.0, low_allowed=True,
        authored=("physics:staticFriction", "physics:dynamicFriction"),
    ),
    Parameter(
        "clearance", "m", "distance kept from this body beside the strand's radius",
        roles=(COLLIDER,), default=0.0, low=0.0, high=1.0, low_allowed=True, meters=1,
    ),
    Parameter(
        "restShape", "", "sagfree: at rest under gravity as drawn; authored: stress-free as drawn",
        default="sagfree", choices=("sagfree", "authored"),
    ),
)  # fmt: skip

BY_NAME = {parameter.name: parameter for parameter in PARAMETERS}


def as_markdown() -> str:
    """The table for people: a row a parameter."""
    lines = ["| `plait:` | also read from | unit (SI) | default | range | meaning |", "|---|---|---|---|---|---|"]
    for p in PARAMETERS:
        default = p.default_text or (f"{p.default:g}" if isinstance(p.default, float) else str(p.default))
        also = ", ".join(f"`{name}`" for name in reversed(p.authored))
        lines.append(f"| `{p.name}` | {also} | {p.unit} | {default} | {p.range_text} | {p.meaning} |")
    return "\n".join(lines) + "\n"


def matches_any(pattern: str, paths: list[str]) -> bool:
    return any(fnmatch.fnmatchcase(path, pattern) for path in paths)


def check_configuration(config: Config) -> None:
    """Raises UsageError for a name no prim knows, or a value it cannot have, wherever it would apply."""
    tables = [("parameters", config.parameters)]
    tables += [(f"prim.{pattern!r}", table) for pattern, table in config.prim.items()]
    for place, table in tables:
        for key, value in table.items():
            _configured(place, key, value)


@dataclass(frozen=True)
class Given:
    """A prim's parameters in SI: what is authored or configured, before the defaults of `PARAMETERS`."""

    authored: dict[str, Any]

    def __contains__(self, name: str) -> bool:
        return name in self.authored

    def __getitem__(self, name: str) -> Any:
        return self.authored.get(name, BY_NAME[name].default)


def resolve(source: Source, prim: Usd.Prim, role: str, config: Config) -> Given:
    """The parameters of a prim in SI.

    Weakest first: default, physics material, prim (on each: UsdPhysics, proposal, `plait:`), configuration for all
    prims, configuration for prims by path. Raises InputError and UsageError.
    """
    known = [parameter for parameter in PARAMETERS if role in parameter.roles]
    result: dict[str, Any] = {}
    for holder in (bound_material(source, prim), prim):
        if holder:
            for parameter in known:
                result |= _authored(source, holder, parameter)
    path = str(prim.GetPath())
    tables = [("parameters", config.parameters)]
    tables += [(f"prim.{p!r}", table) for p, table in config.prim.items() if fnmatch.fnmatchcase(path, p)]
    for place, table in tables:
        for key, value in table.items():
            parameter, value = _configured(place, key, value)
            if role in parameter.roles:
                result[parameter.name] = value
    return Given(result)


def bound_material(source: Source, prim: Usd.Prim) -> Usd.Prim | None:
    """The prim's physics material; found too where MaterialBindingAPI was not applied, as older shots have it."""
    ancestor = prim
    while ancestor and not ancestor.IsPseudoRoot():
        relationship = ancestor.GetRelationship("material:binding:physics")
        for target in relationship.GetTargets() if relationship else ():
            material = source.stage.GetPrimAtPath(target)
            if not material:
                raise source.error(
                    f"names <{target}>, which is not there", ancestor, relationship.GetName(), "name a Material"
                )
            return material
        ancestor = ancestor.GetParent()
    material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")
    return material.GetPrim() if material else None


def _authored(source: Source, holder: Usd.Prim, parameter: Parameter) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name in (*parameter.authored, f"plait:{parameter.name}"):
        attribute = holder.GetAttribute(name)
        if not attribute or not attribute.HasAuthoredValue():
            continue
        value = attribute.Get(source.start)
        if parameter.choices:
            if value not in parameter.choices:
                raise source.error(f"is {value!r}", holder, name, f"author one of {', '.join(parameter.choices)}")
            found[parameter.name] = value
            continue
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise source.error(f"is {value!r}, not a number", holder, name, f"author {parameter.range_text}")
        if value == 0.0 and parameter.zero_means_unset and not name.startswith("plait:"):
            continue
        unit = parameter.stage_unit(source)
        if not _in_range(parameter, value * unit):
            raise source.error(
                f"is {value:g}" + (f", which is {value * unit:g} {parameter.unit}" if unit != 1.0 else ""),
                holder,
                name,
                f"author a value {_range_in_stage(parameter, unit)}",
            )
        found[parameter.name] = value * unit
    return found


def _range_in_stage(parameter: Parameter, unit: float) -> str:
    low = "from" if parameter.low_allowed else "above"
    note = f" in the stage's own units ({unit:g} {parameter.unit})" if unit != 1.0 else ""
    return f"{low} {parameter.low / unit:g} to {parameter.high / unit:g}{note}"


def _in_range(parameter: Parameter, value: float) -> bool:
    above = value >= parameter.low if parameter.low_allowed else value > parameter.low
    return math.isfinite(value) and above and value <= parameter.high


def _configured(place: str, key: str, value: Any) -> tuple[Parameter, Any]:
    parameter = _find(key)
    if parameter is None:
        near = difflib.get_close_matches(key, BY_NAME, n=1)
        hint = f"did you mean {near[0]}" if near else f"known are {', '.join(BY_NAME)}"
        raise UsageError(f"{place}.{key}: no such parameter; {hint}")
    if parameter.choices:
        if value not in parameter.choices:
            raise UsageError(f"{place}.{key} is {value!r}; give one of {', '.join(parameter.choices)}")
        return parameter, value
    if isinstance(value, bool) or not isinstance(value, int | float) or not _in_range(parameter, value):
        raise UsageError(
            f"{place}.{key} is {value!r}; give a number {parameter.range_text} {parameter.unit}".rstrip()
        )
    return parameter, float(value)


def _find(key: str) -> Parameter | None:
    """By its name, or by any attribute name it is read from, without the prefix."""
    for parameter in PARAMETERS:
        if key == parameter.name or key in (name.split(":")[-1] for name in parameter.authored):
            return parameter
    return None
