"""Values of attributes as numpy arrays, each checked when it is read."""

from __future__ import annotations

import numpy as np
from pxr import Gf, Usd

from plait.pipeline.read.source import Source


def vectors(source: Source, attribute: Usd.Attribute, code: float | None = None) -> np.ndarray:
    """An array of 3-vectors, (n, 3) float64; (0, 3) where nothing is authored.

    Raises InputError for values that are not finite or not 3-vectors.
    """
    value = array(source, attribute, code)
    if value.size == 0:
        return np.zeros((0, 3))
    if value.ndim != 2 or value.shape[1] != 3:
        raise _wrong_type(source, attribute, "3-vectors")
    return value


def steady_vectors(source: Source, attribute: Usd.Attribute) -> np.ndarray:
    """`vectors` at the first frame; raises InputError where the first, middle or last sample has another number.

    Reading every sample of a cache here would take longer than simulating beside it; motions check each they use.
    """
    result = vectors(source, attribute)
    codes = attribute.GetTimeSamples()
    for code in (codes[0], codes[len(codes) // 2], codes[-1]) if len(codes) > 1 else ():
        check_count(source, attribute, code, vectors(source, attribute, code), len(result))
    return result


def number(source: Source, attribute: Usd.Attribute) -> float | None:
    """One number, which may be inf or nan, at the first frame; None for none. InputError for another type."""
    value = attribute.Get(source.start) if attribute else None
    if value is not None and (isinstance(value, bool) or not isinstance(value, int | float)):
        raise _wrong_value(source, attribute, value, "a number")
    return None if value is None else float(value)


def flag(source: Source, attribute: Usd.Attribute) -> bool | None:
    """True or false at the first frame, None for nothing; raises InputError for another type."""
    value = attribute.Get(source.start) if attribute else None
    if value is not None and not isinstance(value, bool):
        raise _wrong_value(source, attribute, value, "true or false")
    return value


def vector(source: Source, attribute: Usd.Attribute) -> np.ndarray | None:
    """(3,) float64, which may hold inf or nan, at the first frame; None for none. InputError for another type."""
    value = attribute.Get(source.start) if attribute else None
    if value is not None and not isinstance(value, Gf.Vec3f | Gf.Vec3d | Gf.Vec3h | Gf.Vec3i):
        raise _wrong_value(source, attribute, value, "a vector")
    return None if value is None else np.array(value, dtype=np.float64)


def quaternion(source: Source, attribute: Usd.Attribute) -> Gf.Quatd | None:
    """A finite one at the first frame, None for none; raises InputError for others."""
    value = attribute.Get(source.start) if attribute else None
    if value is None:
        return None
    if not isinstance(value, Gf.Quatf | Gf.Quatd | Gf.Quath):
        raise _wrong_value(source, attribute, value, "a quaternion")
    if not np.isfinite([value.GetReal(), *value.GetImaginary()]).all():
        raise _wrong_value(source, attribute, value, "a rotation")
    return Gf.Quatd(value)


def check_count(source: Source, attribute: Usd.Attribute, code: float, found: np.ndarray, count: int) -> None:
    """Raises InputError unless `found`, read at `code`, has as many entries as at the first frame."""
    if len(found) != count:
        raise source.error(
            f"has {len(found)} entries at time code {code:g}, {count} at the first frame",
            attribute.GetPrim(),
            attribute.GetName(),
            "the number of points must not change",
        )


def check_fits(source: Source, attribute: Usd.Attribute, found: np.ndarray, counts: tuple[int, ...]) -> None:
    """Raises InputError unless `found`, of the attribute, has as many entries as one of `counts`."""
    if len(found) not in counts:
        problem = f"has {len(found)} entries, not {' or '.join(str(count) for count in dict.fromkeys(counts))}"
        raise source.error(problem, attribute.GetPrim(), attribute.GetName(), "author one for each point")


def check_sizes(
    source: Source, sizes: Usd.Attribute, counts: np.ndarray, entries: Usd.Attribute, count: int
) -> None:
    """Raises InputError unless `counts`, of the attribute `sizes`, divide the `count` values of `entries`."""
    prim = entries.GetPrim()
    if len(counts) and counts.min() < 0:
        raise source.error("has a negative count", prim, sizes.GetName(), "author counts from 0 up")
    if counts.sum() != count:
        problem = f"has {count} entries, {sizes.GetName()} add up to {int(counts.sum())}"
        raise source.error(problem, prim, entries.GetName(), "make the counts fit them")


def check_tokens(source: Source, prim: Usd.Prim) -> None:
    """Raises InputError for a token of UsdPhysics, at the first frame, that its schema does not have."""
    schema = prim.GetPrimDefinition()
    for attribute in prim.GetAuthoredAttributes():
        name = attribute.GetName()
        declared = schema.GetAttributeDefinition(name) if "physics:" in name else None
        allowed = declared.GetMetadata("allowedTokens") if declared else None
        value = attribute.Get(source.start) if allowed else None
        if value is not None and value not in allowed:
            raise source.error(f"is {value!r}", prim, name, f"author one of {', '.join(allowed)}")


def scalars(source: Source, attribute: Usd.Attribute, code: float | None = None) -> np.ndarray:
    """An array of numbers, (n,) float64; empty where nothing is authored. Raises InputError as `vectors` does."""
    value = array(source, attribute, code)
    if value.ndim != 1:
        raise _wrong_type(source, attribute, "numbers")
    return value


def integers(source: Source, attribute: Usd.Attribute, code: float | None = None) -> np.ndarray:
    """An array of whole numbers, (n,) int64; empty where nothing is authored."""
    return scalars(source, attribute, code).astype(np.int64)


def array(source: Source, attribute: Usd.Attribute, code: float | None = None) -> np.ndarray:
    """The attribute's array in float64 at `code` (the first frame if None), finite."""
    value = attribute.Get(source.start if code is None else code) if attribute else None
    return checked(source, attribute.GetPrim(), attribute.GetName(), value) if value is not None else np.zeros(0)


def checked(source: Source, prim: Usd.Prim, name: str, value: object) -> np.ndarray:
    """`value` in float64; raises InputError that names the first entry which is not finite."""
    try:
        result = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise source.error("holds no numbers", prim, name, "author numbers") from error
    if result.ndim == 0:
        raise source.error("is one value, not an array", prim, name, "author an array")
    if result.size == 0:
        return np.zeros(0)
    bad = ~np.isfinite(result.reshape(len(result), -1)).all(axis=1)
    if bad.any():
        first = int(np.argmax(bad))
        raise source.error(
            f"{int(bad.sum())} of {len(bad)} entries are not finite, the first is entry {first}",
            prim,
            name,
            "author finite numbers",
        )
    return result


def _wrong_value(source: Source, attribute: Usd.Attribute, value: object, wanted: str) -> Exception:
    text = repr(value) if isinstance(value, str) else str(value)
    return source.error(f"is {text}, not {wanted}", attribute.GetPrim(), attribute.GetName(), f"author {wanted}")


def _wrong_type(source: Source, attribute: Usd.Attribute, wanted: str) -> Exception:
    return source.error(
        f"is {attribute.GetTypeName()}, not {wanted}", attribute.GetPrim(), attribute.GetName(), f"author {wanted}"
    )
