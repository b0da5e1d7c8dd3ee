"""The opened stage: units, range, transforms, and how what is wrong with it is said."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pxr import Pcp, Sdf, Tf, Usd, UsdGeom, UsdPhysics

from plait.pipeline.errors import InputError, UsageError
from plait.pipeline.shot import StageInfo

PREDICATE = Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)


@dataclass(frozen=True)
class Units:
    """What one unit of the stage is in SI."""

    meters_per_unit: float
    kilograms_per_unit: float
    time_codes_per_second: float


class Source:
    """An open stage that is read from; every reader takes its values, transforms and errors through it.

    origin: (3,) float64 [m], what scene coordinates are relative to; set before the first pose is asked for.
    start: time code at which whatever is not animated by a motion is read: the shot's first frame.
    """

    def __init__(self, path: Path, frames: tuple[float, float] | None = None) -> None:
        self.path = path
        self.warnings: list[str] = []
        self.origin = np.zeros(3)
        self.stage = _open(path)
        self._refuse_broken_composition()
        self.units = self._read_units()
        self.info = self._read_info(frames)
        self.start = self.info.start
        self._transforms = UsdGeom.XformCache(self.start)

    @property
    def layers(self) -> tuple[Path, ...]:
        """Every file the shot is composed of, sorted."""
        paths = {layer.realPath for layer in self.stage.GetUsedLayers(includeClipLayers=True)}
        return tuple(sorted(Path(path) for path in paths if path and Path(path).is_file()))

    # --- saying what is wrong ---------------------------------------------------------------------------------

    def error(self, problem: str, prim: Usd.Prim | str = "", attribute: str = "", mend: str = "") -> InputError:
        path = prim if isinstance(prim, str) else str(prim.GetPath())
        return InputError(_one_line(problem), file=self.path, prim=path, attribute=attribute, mend=mend)

    def warn(self, text: str, prim: Usd.Prim | str = "", attribute: str = "") -> None:
        line = str(self.error(text, prim, attribute))
        if line not in self.warnings:
            self.warnings.append(line)

    def tell_if_animated(self, attribute: Usd.Attribute) -> None:
        """Of an attribute that is read at the first frame alone."""
        if attribute and attribute.ValueMightBeTimeVarying():
            text = "is animated; its value at the first frame holds"
            self.warn(text, attribute.GetPrim(), attribute.GetName())

    # --- time and place ---------------------------------------------------------------------------------------

    def code(self, time: float) -> float:
        """The time code of `time` [s]; rounding errors of the division do not miss a sample."""
        code = time * self.units.time_codes_per_second
        whole = round(code)
        return float(whole if abs(code - whole) < 1e-6 else code)

    def local_to_world(self, prim: Usd.Prim, code: float) -> np.ndarray:
        """(4, 4) float64, column vectors, in stage units."""
        if self._transforms.GetTime().GetValue() != code:
            self._transforms.SetTime(code)
        return np.array(self._transforms.GetLocalToWorldTransform(prim)).T

    def metric(self, matrix: np.ndarray) -> np.ndarray:
        """A local-to-world matrix in stage units as it acts on metres and gives scene coordinates."""
        result = matrix.copy()
        result[:3, 3] = result[:3, 3] * self.units.meters_per_unit - self.origin
        return result

    def placed_at_start(self, prim: Usd.Prim) -> np.ndarray:
        """`local_to_world` at the first frame; raises InputError where it is not finite."""
        matrix = self.local_to_world(prim, self.start)
        if not np.all(np.isfinite(matrix)):
            raise self.error(
                "the transform to world is not finite", prim, "xformOpOrder", "mend the transform operations"
            )
        return matrix

    # --- opening ----------------------------------------------------------------------------------------------

    def _refuse_broken_composition(self) -> None:
        for error in self.stage.GetCompositionErrors():
            prim, kind = _site_of(error)
            raise self.error(f"{kind} cannot be resolved", prim, mend="mend the asset path or deactivate the prim")

    def _read_units(self) -> Units:
        stage = self.stage
        for key, value, given in (
            ("metersPerUnit", UsdGeom.GetStageMetersPerUnit(stage), UsdGeom.StageHasAuthoredMetersPerUnit(stage)),
            ("upAxis", UsdGeom.GetStageUpAxis(stage), stage.HasAuthoredMetadata("upAxis")),
            ("timeCodesPerSecond", stage.GetTimeCodesPerSecond(), _rate_is_authored(stage)),
        ):
            if not given:
                self.warn(f"not authored, taken as {value}", attribute=key)
        meters, rate = UsdGeom.GetStageMetersPerUnit(stage), stage.GetTimeCodesPerSecond()
        kilograms = UsdPhysics.GetStageKilogramsPerUnit(stage)
        for key, value, low, high in (
            ("metersPerUnit", meters, 1e-9, 1e6),
            ("kilogramsPerUnit", kilograms, 1e-12, 1e12),
            ("timeCodesPerSecond", rate, 1e-3, 1e6),
            ("framesPerSecond", stage.GetFramesPerSecond(), 1e-3, 1e6),
        ):
            if not low <= value <= high:
                raise self.error(
                    f"is {value:g}", attribute=key, mend=f"author a number between {low:g} and {high:g}"
                )
        return Units(meters, kilograms, rate)

    def _read_info(self, frames: tuple[float, float] | None) -> StageInfo:
        stage = self.stage
        start, end = stage.GetStartTimeCode(), stage.GetEndTimeCode()
        for key, value in (("startTimeCode", start), ("endTimeCode", end)):
            if not math.isfinite(value):
                raise self.error(f"is {value}", attribute=key, mend="author a number")
        if start > end:
            raise self.error(
                f"is {end:g}, before startTimeCode {start:g}", attribute="endTimeCode", mend="swap them"
            )
        if frames is not None:
            self._check_frames(frames, start, end)
        if not stage.HasAuthoredTimeCodeRange():
            start, end = frames or (start, end)
            self.warn(f"not authored, taken as {start:g} to {end:g}", attribute="startTimeCode and endTimeCode")
        return StageInfo(
            path=self.path,
            meters_per_unit=self.units.meters_per_unit,
            up_axis=str(UsdGeom.GetStageUpAxis(stage)),
            time_codes_per_second=self.units.time_codes_per_second,
            frames_per_second=stage.GetFramesPerSecond(),
            start=start,
            end=end,
        )

    def _check_frames(self, frames: tuple[float, float], start: float, end: float) -> None:
        first, last = frames
        if not (math.isfinite(first) and math.isfinite(last)) or first > last:
            raise UsageError(f"frames {first:g}:{last:g}: the first must not come after the last")
        if self.stage.HasAuthoredTimeCodeRange() and (first < start or last > end):
            self.warn(f"frames {first:g} to {last:g} were asked for; the shot has {start:g} to {end:g}")


def _open(path: Path) -> Usd.Stage:
    if not path.exists():
        raise InputError("no such file", file=path, mend="check the path")
    try:
        return Usd.Stage.Open(str(path))
    except Tf.ErrorException as error:
        # The parser's own message, which holds the line number, comes first; the rest repeats the file name.
        raise InputError(_parser_message(str(error)), file=path, mend="give a file that USD opens") from error


def _parser_message(text: str) -> str:
    quoted = text.split(" : '", 1)
    message = quoted[1] if len(quoted) == 2 else text
    return _one_line(message.split("'\n", 1)[0].rstrip("'"))


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _rate_is_authored(stage: Usd.Stage) -> bool:
    layers = (stage.GetSessionLayer(), stage.GetRootLayer())
    return any(layer and (layer.HasTimeCodesPerSecond() or layer.HasFramesPerSecond()) for layer in layers)


_COMPOSITION = {
    Pcp.ErrorType_InvalidAssetPath: "a reference or payload",
    Pcp.ErrorType_UnresolvedPrimPath: "the prim named by a reference or payload",
    Pcp.ErrorType_InvalidSublayerPath: "a sublayer",
    Pcp.ErrorType_InvalidReferenceOffset: "a reference's time offset",
    Pcp.ErrorType_InvalidSublayerOffset: "a sublayer's time offset",
    Pcp.ErrorType_ArcCycle: "a cycle of references",
    Pcp.ErrorType_SublayerCycle: "a cycle of sublayers",
}


def _site_of(error: Pcp.ErrorBase) -> tuple[str, str]:
    site = str(error.rootSite)
    path = site[site.rfind("<") + 1 : site.rfind(">")] if site.endswith(">") else ""
    path = "" if path == str(Sdf.Path.absoluteRootPath) else path
    return path, _COMPOSITION.get(error.errorType, f"composition ({error.errorType.displayName})")
