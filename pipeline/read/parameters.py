"""The parameters of a prim: what is authored on it and its material, painted on it, or configured; all checked."""

from __future__ import annotations

import difflib
import fnmatch
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade

from plait.pipeline.config import Config
from plait.pipeline.errors import UsageError
from plait.pipeline.read import values
from plait.pipeline.read.parameter_table import NAMES, PARAMETERS, Parameter, of_role
from plait.pipeline.read.source import PREDICATE, Source

# What is authored under `plait:` beside the parameters.
OTHERS = ("role", "skin", "guides", "attach", "emit")


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

    A painted one is an array, a value for each of the prim's points or curves.
    """

    role: str
    authored: dict[str, Any]

    def __contains__(self, name: str) -> bool:
        return name in self.authored

    def __getitem__(self, name: str) -> Any:
        return self.authored.get(name, of_role(self.role)[name].default)


def tell_of_unknown(source: Source) -> None:
    """A warning for every `plait:` attribute or relationship that nothing reads: it may be misspelt."""
    for prim in source.stage.Traverse(PREDICATE):
        for held in prim.GetAuthoredPropertiesInNamespace("plait"):
            name = held.GetName().split(":")[1]
            if name not in (*NAMES, *OTHERS):
                near = difflib.get_close_matches(name, (*NAMES, *OTHERS), n=1)
                hint = f"; did you mean plait:{near[0]}" if near else ""
                source.warn(f"is nothing that is read{hint}", prim, held.GetName())


def resolve(
    source: Source, prim: Usd.Prim, role: str, config: Config, holder_above: Usd.Prim | None = None
) -> Given:
    """The parameters of a prim in SI.

    Weakest first: default, physics material, `holder_above` (what the prim is part of), the prim (on each:
    UsdPhysics, proposal, `plait:`), what is painted on it, configuration for all prims, configuration for prims by
    path. Raises InputError and UsageError.
    """
    known = of_role(role)
    result: dict[str, Any] = {}
    for holder in (bound_material(source, prim), holder_above, prim):
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
        if parameter.flag:
            found[parameter.name] = _flag(source, attribute, value)
            continue
        if parameter.vector:
            found[parameter.name] = _vector(source, attribute, parameter, value)
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


def _flag(source: Source, attribute: Usd.Attribute, value: object) -> bool:
    prim, name = attribute.GetPrim(), attribute.GetName()
    if not isinstance(value, bool):
        raise source.error(f"is {value!r}, not a bool", prim, name, "author true or false")
    _refuse_animated(source, attribute)
    return value


def _vector(source: Source, attribute: Usd.Attribute, parameter: Parameter, value: object) -> np.ndarray:
    """(3,)"""
    prim, name = attribute.GetPrim(), attribute.GetName()
    unit = parameter.stage_unit(source)
    mend = f"author three numbers, each from {-parameter.high / unit:g} to {parameter.high / unit:g}"
    if not isinstance(value, Gf.Vec3f | Gf.Vec3d | Gf.Vec3h):
        raise source.error(f"is {value!r}, not a vector", prim, name, mend)
    vector = np.array(value, dtype=np.float64) * unit
    if not _is_in_size(parameter, vector):
        raise source.error(f"is {value}", prim, name, mend)
    return vector


def _is_in_size(parameter: Parameter, vector: np.ndarray) -> bool:
    return vector.shape == (3,) and all(_in_range(parameter, abs(float(part))) for part in vector)


def _refuse_animated(source: Source, attribute: Usd.Attribute) -> None:
    if attribute.ValueMightBeTimeVarying():
        mend = "author one value; what lets go during a shot is an attachment with plait:attach:NAME:enabled"
        raise source.error("is animated", attribute.GetPrim(), attribute.GetName(), mend)


def _painted(source: Source, prim: Usd.Prim, parameter: Parameter) -> dict[str, np.ndarray]:
    """A value for each point or curve of the prim; none where nothing is painted."""
    primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar(f"plait:{parameter.name}")
    if not primvar or not primvar.HasAuthoredValue():
        return {}
    name, held = primvar.GetName(), primvar.ComputeFlattened(source.start)
    each = parameter.painted.removesuffix("s")
    if isinstance(held, float | int) and isinstance(held, bool) == parameter.flag:
        held = [held]
    if held is None:
        raise source.error("its indices do not fit its values", prim, name, f"author a value a {each}")
    given = values.checked(source, prim, name, held)
    if given.ndim != 1:
        raise source.error("holds no numbers", prim, name, f"author a number a {each}")
    interpolation, count = str(primvar.GetInterpolation()), _painted_count(source, prim, parameter)
    fitting = ("vertex", "varying") if parameter.painted == "points" else ("uniform",)
    if interpolation not in (*fitting, "constant"):
        mend = f"paint {parameter.painted}: interpolation {fitting[0]}"
        raise source.error(f"has interpolation {interpolation}", prim, name, mend)
    wanted = 1 if interpolation == "constant" else count
    if len(given) != wanted:
        problem = f"has {len(given)} values, interpolation {interpolation} needs {wanted}"
        raise source.error(problem, prim, name, f"author a value a {each}, or one with interpolation constant")
    if parameter.flag:
        _refuse_animated(source, primvar.GetAttr())
        if not np.isin(given, (0.0, 1.0)).all():
            raise source.error("holds values that are neither true nor false", prim, name, "author a bool[]")
        return {parameter.name: np.broadcast_to(given > 0.0, count)}
    unit = parameter.stage_unit(source)
    wrong = np.array([not _in_range(parameter, value) for value in given * unit])
    if wrong.any():
        first = int(np.argmax(wrong))
        problem = f"{int(wrong.sum())} of {len(given)} values are out of range, the first is {given[first]:g}"
        raise source.error(problem, prim, name, f"author values {_range_in_stage(parameter, unit)}")
    return {parameter.name: np.broadcast_to(given * unit, count)}


def _painted_count(source: Source, prim: Usd.Prim, parameter: Parameter) -> int:
    if parameter.painted == "points":
        return len(UsdGeom.PointBased(prim).GetPointsAttr().Get(source.start) or [])
    return len(UsdGeom.Curves(prim).GetCurveVertexCountsAttr().Get(source.start) or [])


def _range_in_stage(parameter: Parameter, unit: float) -> str:
    low = ("that is whole, " if parameter.whole else "") + ("from" if parameter.low_allowed else "above")
    note = f" in the stage's own units ({unit:g} {parameter.unit})" if unit != 1.0 else ""
    return f"{low} {parameter.low / unit:g} to {parameter.high / unit:g}{note}"


def _in_range(parameter: Parameter, value: float) -> bool:
    above = value >= parameter.low if parameter.low_allowed else value > parameter.low
    whole = not parameter.whole or float(value).is_integer()
    return math.isfinite(value) and above and value <= parameter.high and whole


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
    if parameter.flag:
        if not isinstance(value, bool):
            raise UsageError(f"{place}.{key} is {value!r}; give true or false")
        return value
    if parameter.vector:
        if not isinstance(value, tuple) or not _is_in_size(parameter, np.array(value)):
            raise UsageError(f"{place}.{key} is {value!r}; give {parameter.range_text} {parameter.unit}")
        return np.array(value, dtype=np.float64)
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
