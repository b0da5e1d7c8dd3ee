"""Every parameter a prim can carry: one table, from which reading is driven and the README's table is made."""

from __future__ import annotations

import difflib
import fnmatch
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdShade

from plait.pipeline.config import Config
from plait.pipeline.errors import UsageError
from plait.pipeline.read import values
from plait.pipeline.read.source import Source

STRANDS, COLLIDER, FLESH = "strands", "collider", "flesh"


@dataclass(frozen=True)
class Parameter:
    """One parameter. On a prim or its physics material it is `plait:NAME`; in the configuration NAME.

    Where roles differ in what a name means to them, or in its default or range, it has a row for each.

    unit: SI; the configuration is in SI, what is authored in a stage is in the stage's own units.
    default: None where it follows from others, as `default_text` says.
    low, high: range in SI, `low` itself only if `low_allowed`.
    authored: other attribute names it is read from, weakest first: UsdPhysics', then the deformable proposal's.
    kilograms, meters: powers of the stage's units in it (seconds are seconds everywhere).
    zero_means_unset: in the other names, as UsdPhysics has it, zero asks for the default.
    choices: words, one of which it is.  file: it is a path.
    painted: `primvars:plait:NAME` may give a value a point, and comes before one for all.
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
    file: bool = False
    painted: bool = False

    @property
    def range_text(self) -> str:
        if self.choices:
            return ", ".join(self.choices)
        if self.file:
            return "a path"
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
        "density", "kg/m3", "mass over volume of the flesh", roles=(FLESH,),
        default=1000.0, low=0.01, high=1e6, low_allowed=True,
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
        "youngsModulus", "Pa", "stiffness of the flesh; jelly has 1e3 to 1e4, fat and relaxed muscle 1e4 to 1e5, "
        "rubber 1e6 to 1e7", roles=(FLESH,),
        default=5e4, low=1.0, high=1e13, low_allowed=True,
        authored=("physics:youngsModulus",), kilograms=1, meters=-1, zero_means_unset=True,
    ),
    Parameter(
        "poissonsRatio", "1", "sideways over lengthwise strain; sets twist against bend",
        default=0.35, low=-1.0, high=0.5, authored=("physics:poissonsRatio",),
    ),
    Parameter(
        "poissonsRatio", "1", "sideways over lengthwise strain; towards 0.5 the volume is kept", roles=(FLESH,),
        default=0.45, low=-1.0, high=0.495, authored=("physics:poissonsRatio",),
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
        "damping", "1/s", "rate at which all motion dies out, falling too; see stiffnessDamping", roles=(FLESH,),
        default=0.0, low=0.0, high=1e5, low_allowed=True,
    ),
    Parameter(
        "stiffnessDamping", "s", "damps what deforms and leaves what moves as a whole alone: a swing of "
        "frequency f is damped by the part pi f stiffnessDamping of critically", roles=(FLESH,),
        default=0.005, low=0.0, high=100.0, low_allowed=True,
    ),
    Parameter(
        "friction", "1", "Coulomb coefficient against bodies; a body's own comes before the strand's",
        roles=(STRANDS, COLLIDER), default=0.3, low=0.0, high=100.0, low_allowed=True,
        authored=("physics:staticFriction", "physics:dynamicFriction"),
    ),
    Parameter(
        "friction", "1", "Coulomb coefficient; of a pair the mean counts", roles=(FLESH,),
        default_text="0.5 among bodies; for hair on it the hair's own", low=0.0, high=100.0, low_allowed=True,
        authored=("physics:staticFriction", "physics:dynamicFriction"),
    ),
    Parameter(
        "restitution", "1", "speed after over speed before an impact; of a pair the larger counts", roles=(FLESH,),
        default=0.0, low=0.0, high=1.0, low_allowed=True, authored=("physics:restitution",),
    ),
    Parameter(
        "clearance", "m", "distance kept from this body beside the strand's radius",
        roles=(COLLIDER, FLESH), default=0.0, low=0.0, high=1.0, low_allowed=True, meters=1,
    ),
    Parameter(
        "restShape", "", "sagfree: at rest under gravity as drawn; authored: stress-free as drawn",
        default="sagfree", choices=("sagfree", "authored"),
    ),
    Parameter(
        "law", "", "how stress follows from strain", roles=(FLESH,),
        default="fixed-corotated", choices=("fixed-corotated", "neo-hookean", "stvk"),
    ),
    Parameter(
        "tetEdge", "m", "mean edge of the tets that fill the mesh", roles=(FLESH,),
        default_text="as tetBudget asks", low=0.0, high=1e3, meters=1,
    ),
    Parameter(
        "tetBudget", "1", "how many tets fill the mesh, roughly, where no tetEdge is given", roles=(FLESH,),
        default=20000.0, low=1.0, high=1e8, low_allowed=True,
    ),
    Parameter(
        "tetMesh", "", "file with the tets to use, of any kind that meshio reads, in the prim's own space",
        roles=(FLESH,), default_text="none: the mesh is filled", file=True,
    ),
    Parameter(
        "coreDepth", "1", "part of the way from a bone to the skin that moves with the bone", roles=(FLESH,),
        default=0.5, low=0.0, high=1.0, low_allowed=True, painted=True,
    ),
    Parameter(
        "attachStiffness", "N/m4", "spring to the animated place, a volume of flesh; over the density it is the "
        "square of the angular frequency at which flesh alone would swing about that place", roles=(FLESH,),
        default=0.0, low=0.0, high=1e15, low_allowed=True, kilograms=1, meters=-3, painted=True,
    ),
)  # fmt: skip

NAMES = tuple(dict.fromkeys(parameter.name for parameter in PARAMETERS))


def of_role(role: str) -> dict[str, Parameter]:
    """The parameters that a role knows, by name."""
    return {parameter.name: parameter for parameter in PARAMETERS if role in parameter.roles}


def as_markdown() -> str:
    """The table for people: a row a parameter."""
    lines = [
        "| `plait:` | of | also read from | unit (SI) | default | range | meaning |",
        "|---|---|---|---|---|---|---|",
    ]
    for p in PARAMETERS:
        default = p.default_text or (f"{p.default:g}" if isinstance(p.default, float) else str(p.default))
        names = [*reversed(p.authored), *([f"primvars:plait:{p.name}"] if p.painted else [])]
        also, roles = ", ".join(f"`{name}`" for name in names), ", ".join(p.roles)
        lines.append(f"| `{p.name}` | {roles} | {also} | {p.unit} | {default} | {p.range_text} | {p.meaning} |")
    return "\n".join(lines) + "\n"


def matches_any(pattern: str, paths: list[str]) -> bool:
    return any(fnmatch.fnmatchcase(path, pattern) for path in paths)


def check_configuration(config: Config) -> None:
    """Raises UsageError for a name no prim knows, or a value it cannot have, wherever it would apply."""
    tables = [("parameters", config.parameters)]
    tables += [(f"prim.{pattern!r}", table) for pattern, table in config.prim.items()]
    for place, table in tables:
        for key, value in table.items():
            _check_configured(place, key, value)


@dataclass(frozen=True)
class Given:
    """A prim's parameters in SI: what is authored or configured, before the defaults of `PARAMETERS`.

    A painted one is an array, a value for each of the prim's points.
    """

    role: str
    authored: dict[str, Any]

    def __contains__(self, name: str) -> bool:
        return name in self.authored

    def __getitem__(self, name: str) -> Any:
        return self.authored.get(name, of_role(self.role)[name].default)


def resolve(source: Source, prim: Usd.Prim, role: str, config: Config) -> Given:
    """The parameters of a prim in SI.

    Weakest first: default, physics material, prim (on each: UsdPhysics, proposal, `plait:`), what is painted on
    the prim, configuration for all prims, configuration for prims by path. Raises InputError and UsageError.
    """
    known = of_role(role)
    result: dict[str, Any] = {}
    for holder in (bound_material(source, prim), prim):
        if holder:
            for parameter in known.values():
                result |= _authored(source, holder, parameter)
    for parameter in known.values():
        if parameter.painted:
            result |= _painted(source, prim, parameter)
    path = str(prim.GetPath())
    tables = [("parameters", config.parameters)]
    tables += [(f"prim.{p!r}", table) for p, table in config.prim.items() if fnmatch.fnmatchcase(path, p)]
    for place, table in tables:
        for key, value in table.items():
            for parameter in _find(place, key):
                if role in parameter.roles:
                    result[parameter.name] = _configured(place, key, parameter, value)
    return Given(role, result)


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
        if parameter.file:
            found[parameter.name] = _file(source, holder, name, value)
            continue
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


def _file(source: Source, holder: Usd.Prim, name: str, value: object) -> Path:
    if not isinstance(value, Sdf.AssetPath):
        raise source.error(f"is {value!r}, not an asset path", holder, name, "author an asset")
    path = Path(value.resolvedPath)
    if not value.resolvedPath or not path.is_file():
        raise source.error(f"names @{value.path}@, which is not there", holder, name, "name a file")
    return path


def _painted(source: Source, prim: Usd.Prim, parameter: Parameter) -> dict[str, np.ndarray]:
    """A value for each point of the prim; none where nothing is painted."""
    primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar(f"plait:{parameter.name}")
    if not primvar or not primvar.HasAuthoredValue():
        return {}
    name, held = primvar.GetName(), primvar.ComputeFlattened(source.start)
    if isinstance(held, float | int) and not isinstance(held, bool):
        held = [held]
    if held is None:
        raise source.error("its indices do not fit its values", prim, name, "author a value a point")
    given = values.checked(source, prim, name, held)
    if given.ndim != 1:
        raise source.error("holds no numbers", prim, name, "author a number a point")
    interpolation = str(primvar.GetInterpolation())
    count = len(UsdGeom.PointBased(prim).GetPointsAttr().Get(source.start) or [])
    wanted = {"constant": 1, "vertex": count, "varying": count}.get(interpolation)
    if wanted is None:
        raise source.error(f"has interpolation {interpolation}", prim, name, "paint points: interpolation vertex")
    if len(given) != wanted:
        problem = f"has {len(given)} values, interpolation {interpolation} needs {wanted}"
        raise source.error(problem, prim, name, "author a value a point, or one with interpolation constant")
    unit = parameter.stage_unit(source)
    wrong = np.array([not _in_range(parameter, value) for value in given * unit])
    if wrong.any():
        first = int(np.argmax(wrong))
        problem = f"{int(wrong.sum())} of {len(given)} values are out of range, the first is {given[first]:g}"
        raise source.error(problem, prim, name, f"author values {_range_in_stage(parameter, unit)}")
    return {parameter.name: np.broadcast_to(given * unit, count) if wanted == 1 else given * unit}


def _range_in_stage(parameter: Parameter, unit: float) -> str:
    low = "from" if parameter.low_allowed else "above"
    note = f" in the stage's own units ({unit:g} {parameter.unit})" if unit != 1.0 else ""
    return f"{low} {parameter.low / unit:g} to {parameter.high / unit:g}{note}"


def _in_range(parameter: Parameter, value: float) -> bool:
    above = value >= parameter.low if parameter.low_allowed else value > parameter.low
    return math.isfinite(value) and above and value <= parameter.high


def _check_configured(place: str, key: str, value: Any) -> None:
    """Raises UsageError for a value that no role can have."""
    problem = None
    for parameter in _find(place, key):
        try:
            _configured(place, key, parameter, value)
        except UsageError as error:
            problem = problem or error
        else:
            return
    raise problem


def _configured(place: str, key: str, parameter: Parameter, value: Any) -> Any:
    if parameter.file:
        if not isinstance(value, str) or not Path(value).is_file():
            raise UsageError(f"{place}.{key} is {value!r}; give the path of a file")
        return Path(value)
    if parameter.choices:
        if value not in parameter.choices:
            raise UsageError(f"{place}.{key} is {value!r}; give one of {', '.join(parameter.choices)}")
        return value
    if isinstance(value, bool) or not isinstance(value, int | float) or not _in_range(parameter, value):
        raise UsageError(
            f"{place}.{key} is {value!r}; give a number {parameter.range_text} {parameter.unit}".rstrip()
        )
    return float(value)


def _find(place: str, key: str) -> list[Parameter]:
    """By its name, or by any attribute name it is read from, without the prefix: the row of each role."""
    found = [p for p in PARAMETERS if key == p.name or key in (name.split(":")[-1] for name in p.authored)]
    if not found:
        near = difflib.get_close_matches(key, NAMES, n=1)
        hint = f"did you mean {near[0]}" if near else f"known are {', '.join(NAMES)}"
        raise UsageError(f"{place}.{key}: no such parameter; {hint}")
    return found
