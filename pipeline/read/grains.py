"""Sand and snow: prims that grains fill, that pour them or that are grains, as the scene has them."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from pxr import Usd, UsdGeom

from plait.pipeline.config import Config
from plait.pipeline.read import parameters, roles, values
from plait.pipeline.read.emitters import Nozzle, read_nozzle
from plait.pipeline.read.grain_points import Drawn, read_drawn
from plait.pipeline.read.motions import WorldToLocal
from plait.pipeline.read.parameters import Given
from plait.pipeline.read.roles import Role
from plait.pipeline.read.shells import Shell, read_shell
from plait.pipeline.read.skeletons import Skeletons
from plait.pipeline.read.source import Source
from plait.pipeline.read.surfaces import Bodies
from plait.pipeline.shot import GrainOutput, GrainSurfaceOutput
from plait.solver.scene import Granular

# [bytes] that a grain takes while it is simulated and surfaced, and in a sample until its chunk is written: held
# once as arrays and once as a layer.
BYTES, SAMPLE_BYTES = 500, 72
# A surface's cell and the spacing it goes with.
SURFACE_CELL = 1.5
# Grains of one shot lie on one grid: that fits spacings which differ by no more than this.
UNEVEN = 2.0
# Cells along a box of grains that can be numbered.
WIDEST = 1 << 20
GRAINS, SURFACE = "_grains", "_surface"


@dataclass(frozen=True)
class Heap:
    """One prim's grains on their way into the scene. shape: what its grains come from."""

    role: Role
    given: Given
    shape: Shell | Nozzle | Drawn

    @property
    def path(self) -> str:
        return str(self.role.prim.GetPath())


class Heaps:
    """All that is sand or snow in a shot, in the order of `Scene.granular`.

    granular: as the scene has it.  outputs: the way back.
    start: [s] time until which grains stay as drawn: the shot's first frame, or an earlier one that is written.
    sizes: for the report, by prim path.
    """

    def __init__(
        self,
        source: Source,
        bodies: Bodies,
        skeletons: Skeletons,
        assigned: Sequence[Role],
        config: Config,
        frames: tuple[float, float],
        fill: bool,
    ) -> None:
        """frames: first and last time code to write.  fill: False leaves meshes empty; `sizes` are estimates.

        Raises InputError for what cannot be filled, poured or taken as it is.
        """
        self._source, self._config = source, config
        rate = source.units.time_codes_per_second
        first = min(frames[0], source.info.start)
        last = frames[1] + max((0.0, *config.output.shutter))
        self.start, self._duration = first / rate, (last - first) / rate
        chosen = [role for role in assigned if role.role in roles.GRANULAR and role.supported]
        self._heaps = [self._read(role, bodies, skeletons) for role in chosen]
        self._spacings = self._choose_spacings()
        self.sizes = {heap.path: self._estimate(heap) for heap in self._heaps}
        self._fill = fill
        self._refuse_too_many()
        self._refuse_too_wide()
        self.granular = tuple(self._granular(heap) for heap in self._heaps)
        for heap, granular in zip(self._heaps, self.granular, strict=True):
            if fill and isinstance(heap.shape, Shell):
                self.sizes[heap.path] = {"grains": len(granular.positions)}
        self.outputs = tuple(self._outputs())

    def __len__(self) -> int:
        return len(self._heaps)

    @property
    def emitting(self) -> tuple[str, ...]:
        """Paths of the prims that pour."""
        return tuple(heap.path for heap in self._heaps if isinstance(heap.shape, Nozzle))

    def told(self, path: str) -> str:
        """Of the prim at `path`: where its grains come back, in words; '' for none."""
        places = [output.prim_path for output in self.outputs if output.source_path == path]
        added = [place for place in places if place != path]
        return f"comes back as {' and '.join(added)}" if added else ""

    # --- reading ----------------------------------------------------------------------------------------------

    def _read(self, role: Role, bodies: Bodies, skeletons: Skeletons) -> Heap:
        source, prim = self._source, role.prim
        given = parameters.resolve(source, prim, role.role, self._config)
        if prim.IsA(UsdGeom.Points):
            if "rate" in given:
                mend = "author it on a Mesh or a simple shape"
                raise source.error("is on Points, which are grains already", prim, "plait:rate", mend)
            return Heap(role, given, read_drawn(source, prim, given, skeletons.find(prim)))
        if "rate" in given:
            return Heap(role, given, read_nozzle(source, prim, given))
        body = bodies.get(prim)
        if body is None:
            raise source.error("has no triangle with an area", prim, mend="give what is filled a closed surface")
        return Heap(role, given, read_shell(source, body, given))

    def _choose_spacings(self) -> dict[str, float]:
        """[m] by path; alike in all meshes and emitters that do not give their own."""
        filled = [heap for heap in self._heaps if isinstance(heap.shape, Shell)]
        drawn = [heap.shape.spacing for heap in self._heaps if isinstance(heap.shape, Drawn)]
        asked = [
            (heap.shape.volume / heap.given["grainBudget"]) ** (1.0 / 3.0)
            for heap in filled
            if "spacing" not in heap.given
        ] or [heap.given["spacing"] for heap in filled]
        common = max([*asked, *drawn], default=None)
        chosen = {heap.path: self._spacing(heap, common) for heap in self._heaps}
        if chosen and max(chosen.values()) > UNEVEN * min(chosen.values()):
            widest, closest = (pick(chosen, key=chosen.get) for pick in (max, min))
            self._source.warn(
                f"its grains lie {chosen[widest]:.3g} m apart, those of {closest} {chosen[closest]:.3g} m: they "
                "share one grid, whose cells are too small for the one or too large for the other",
                widest,
                "plait:spacing",
            )
        return chosen

    def _spacing(self, heap: Heap, common: float | None) -> float:
        if isinstance(heap.shape, Drawn):
            return heap.shape.spacing
        spacing = heap.given["spacing"] or common
        return spacing or heap.shape.spacing(self._source, heap.given["rate"])

    def _estimate(self, heap: Heap) -> dict[str, int]:
        shape, spacing = heap.shape, self._spacings[heap.path]
        if isinstance(shape, Drawn):
            return {"grains": len(shape.positions)}
        if isinstance(shape, Nozzle):
            return {"grains at most": self._limit(heap)}
        return {"grains (about)": round(shape.volume / spacing**3)}

    def _limit(self, heap: Heap) -> int:
        poured = int(np.ceil(heap.given["rate"] * self._duration))
        return min(poured, int(heap.given["limit"])) if "limit" in heap.given else poured

    def _refuse_too_many(self) -> None:
        """Raises InputError for more grains than memory can hold."""
        if not self._heaps:
            return
        samples = self._config.output.chunk * len({0.0, *self._config.output.shutter})
        memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
        room = memory / (BYTES + SAMPLE_BYTES * samples)
        total = sum(sum(sizes.values()) for sizes in self.sizes.values())
        heap = max(self._heaps, key=lambda heap: sum(self.sizes[heap.path].values()))
        if total > room:
            poured = isinstance(heap.shape, Nozzle)
            raise self._source.error(
                f"{total:.3g} grains do not fit into memory, in which {room:.2g} have room",
                heap.role.prim,
                "plait:limit" if poured else "plait:spacing",
                "pour fewer" if poured else "author a larger one, a smaller grainBudget, or a smaller --chunk",
            )

    def _refuse_too_wide(self) -> None:
        """Raises InputError for a box of grains so wide that its cells have no numbers."""
        for heap in self._heaps:
            widest = float(np.ptp(heap.shape.box, axis=0).max()) / self._spacings[heap.path]
            cell = heap.given["surfaceCell"] if heap.given["surface"] else None
            if cell and not widest * self._spacings[heap.path] / cell < WIDEST:
                problem = f"is {cell:.3g} m, too small to number the cells of what is {widest:.3g} spacings wide"
                raise self._source.error(problem, heap.role.prim, "plait:surfaceCell", "author a larger one")
            if not widest < WIDEST:
                raise self._source.error(
                    f"is {widest:.3g} spacings wide, more than {WIDEST}",
                    heap.role.prim,
                    "points" if isinstance(heap.shape, Drawn) else "plait:spacing",
                    "remove points that lie far off" if isinstance(heap.shape, Drawn) else "author a larger one",
                )

    # --- the scene --------------------------------------------------------------------------------------------

    def _granular(self, heap: Heap) -> Granular:
        given, shape, spacing = heap.given, heap.shape, self._spacings[heap.path]
        width = given["width"] or spacing
        positions, velocities = np.zeros((0, 3)), np.zeros((0, 3))
        emitter, drawn = None, isinstance(shape, Drawn)
        if isinstance(shape, Drawn):
            positions, velocities = shape.positions, shape.velocities
        elif isinstance(shape, Nozzle):
            emitter = shape.emitter(self._source, given, self._limit(heap), spacing, width)
        elif self._fill:
            positions = shape.filled(self._source, spacing, int(given["seed"]), self._config.solver.threads)
            velocities = np.broadcast_to(shape.velocity, positions.shape)
        count, law = len(positions), heap.role.role
        own = {"friction_angle": np.radians(given["frictionAngle"])} if law == "sand" else _snow(given)
        return Granular(
            name=heap.path,
            law=law,
            positions=positions,
            velocities=np.ascontiguousarray(velocities),
            volumes=np.full(count, spacing**3),
            widths=shape.widths if drawn and shape.widths is not None else np.full(count, width),
            ids=shape.ids if drawn else np.arange(count),
            density=given["density"],
            youngs_modulus=given["youngsModulus"],
            poissons_ratio=given["poissonsRatio"],
            friction=given["friction"],
            emitter=emitter,
            **own,
        )

    # --- the way back -----------------------------------------------------------------------------------------

    def _outputs(self) -> Iterator[GrainOutput | GrainSurfaceOutput]:
        taken: set[str] = set()
        for index, heap in enumerate(self._heaps):
            prim, beside, home = heap.role.prim, _beside(heap.role.prim), heap.shape.box.mean(axis=0)
            own, surfaced = isinstance(heap.shape, Drawn), heap.given["surface"]
            path = heap.path if own else _free_path(self._source, beside, f"{prim.GetName()}{GRAINS}", taken)
            to_local = WorldToLocal(self._source, prim if own else beside)
            law = heap.role.role
            yield GrainOutput(path, heap.path, index, to_local, law, home, hidden=surfaced)
            if surfaced:
                path = _free_path(self._source, beside, f"{prim.GetName()}{SURFACE}", taken)
                to_local, spacing = WorldToLocal(self._source, beside), self._spacings[heap.path]
                cell = heap.given["surfaceCell"] or SURFACE_CELL * spacing
                if cell < spacing:
                    problem = (
                        f"is {cell:.3g} m, less than the {spacing:.3g} m between grains: gaps between them show"
                    )
                    self._source.warn(problem, prim, "plait:surfaceCell")
                yield GrainSurfaceOutput(path, heap.path, index, to_local, law, home, cell, spacing**3)


def middle_of(source: Source, prim: Usd.Prim) -> np.ndarray:
    """(1, 3) [stage units], in its own space, of what is sand or snow: the median, which no stray grain moves."""
    based = UsdGeom.PointBased(prim)
    points = values.vectors(source, based.GetPointsAttr()) if based else np.zeros((0, 3))
    return np.quantile(points, [0.5], axis=0, method="lower") if len(points) else np.zeros((1, 3))


def _snow(given: Given) -> dict[str, float]:
    return {
        "critical_compression": given["criticalCompression"],
        "critical_stretch": given["criticalStretch"],
        "hardening": given["hardening"],
    }


def _beside(prim: Usd.Prim) -> Usd.Prim:
    """The prim under which what is added beside `prim` goes: no geometry, since that must not hold other."""
    parent = prim.GetParent()
    while parent.IsA(UsdGeom.Gprim):
        parent = parent.GetParent()
    return parent


def _free_path(source: Source, parent: Usd.Prim, name: str, taken: set[str]) -> str:
    """A path beneath `parent` that no prim has: by that name, or with the first number that is free after it.

    Warns of a prim by that name which looks like grains: over a result they are drawn a second time.
    """
    stage, number = parent.GetStage(), 1
    while True:
        path = str(parent.GetPath().AppendChild(name if number == 1 else f"{name}{number}"))
        there = stage.GetPrimAtPath(path)
        if path not in taken and not there:
            taken.add(path)
            return path
        if path not in taken and there.IsA(UsdGeom.PointBased):
            source.warn("is drawn already, and stays beside what comes back: is the shot a result?", there)
        number += 1
