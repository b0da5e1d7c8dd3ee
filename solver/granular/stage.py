"""Sand and snow: the stage that owns their particles and steps them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from plait.solver.diagnostics import Diverged
from plait.solver.granular.contact import GrainContact
from plait.solver.granular.disturbance import moving_boxes
from plait.solver.granular.emission import emitted
from plait.solver.granular.matter import Matter
from plait.solver.granular.transfer_kernels import LOST
from plait.solver.model import Interval, Model
from plait.solver.state import State


def build(model: Model, state: State) -> GranularStage | None:
    """The stage of the scene's granular matter; None without any."""
    return GranularStage(model, state) if model.scene.granular else None


@dataclass(frozen=True)
class Grains:
    """The particles of one `Granular` as they are, in the order given and then as poured in.

    positions, velocities: (n, 3) float64 [m], [m/s], world.  ids: (n,) int64.  widths: (n,) float64 [m].
    """

    positions: np.ndarray
    velocities: np.ndarray
    ids: np.ndarray
    widths: np.ndarray


class GranularStage:
    """All granular matter of a scene on one grid, in steps of its own within each substep.

    It never asks for shorter steps. As long as it is the last stage its steps stand, and nothing is kept of how a
    substep began.

    matter: the particles and the grid.  contact: with all that is not grains.

    State arrays: granular/position, velocity, affine, strain, memory, volume, material, number of the particles,
    in cell order (struct `Particles`); granular/told: (3,) how many there are, `Matter.speed` and `Matter.sound`;
    granular/poured: (granular_count, 2), see `emitted`. What else is kept between substeps follows from these at a
    frame's start.
    """

    name = "granular"

    def __init__(self, model: Model, state: State) -> None:
        self._model, self._settings = model, model.settings.granular
        scene, granular = model.scene, model.scene.granular
        real = wp.float64 if model.settings.precision == "float64" else wp.float32
        room = [len(g.positions) + (g.emitter.limit if g.emitter else 0) for g in granular]
        still = self._settings.still
        self.matter = Matter(granular, sum(room), self._cell_size(), scene.gravity, real, model.launcher, still)
        for index, g in enumerate(granular):
            self.matter.add(index, g.positions, g.velocities, g.volumes)
        device = model.launcher.device
        self._told = wp.zeros(3, dtype=wp.float64, device=device)
        self._poured = wp.zeros((len(granular), 2), dtype=wp.float64, device=device)
        particles = self.matter.particles
        for name in self.matter.types.Particles.vars:
            state.arrays[f"granular/{name}"] = getattr(particles, name)
        state.arrays |= {"granular/told": self._told, "granular/poured": self._poured}
        self._tell()
        self.contact = GrainContact(model, state, self.matter, real)
        self._steps = self._sorts = 0
        self._own = {name: array for name, array in state.arrays.items() if name.startswith("granular/")}
        self._kept: dict[str, wp.array] = {}

    def _cell_size(self) -> float:
        """[m] as set, or that of eight particles to a cell."""
        volumes = [g.volumes for g in self._model.scene.granular]
        volumes += [np.array([g.emitter.volume]) for g in self._model.scene.granular if g.emitter]
        return self._settings.cell_size or 2.0 * float(np.median(np.concatenate(volumes))) ** (1.0 / 3.0)

    def _tell(self) -> None:
        self._told.assign([self.matter.count, self.matter.speed, self.matter.sound])

    def begin_frame(self, state: State, frame: Interval) -> None:
        """Puts the particles in cell order, so that a run goes on from a frame's state as from its own."""
        self._steps, self._sorts = 0, self.matter.sorts
        self._take_up()

    def _take_up(self) -> None:
        matter = self.matter
        count, matter.speed, matter.sound = self._told.numpy().tolist()
        matter.count = int(count)
        if matter.count:
            matter.sort()
        self.contact.begin_frame()

    def step(self, state: State, substep: Interval, last_resort: bool = False) -> bool:
        """Steps the matter to the substep's end; raises `Diverged` for what is no longer finite."""
        if next(reversed(self._model.parts)) != self.name:
            self._kept = {name: wp.clone(array) for name, array in self._own.items()}
        if 0.5 * (substep.start + substep.end) < self._model.scene.granular_start:
            return True
        if self.matter.count:
            self._move(substep)
        self._pour(substep)
        self._tell()
        return True

    def _move(self, substep: Interval) -> None:
        if not self.matter.speed < LOST:
            raise Diverged("velocity", self._where_lost(), substep.start)
        self.contact.begin_substep(substep, self.matter.grid.cell_size + self.matter.speed * substep.length)
        self.matter.disturbed = moving_boxes(self._model, substep)
        # In a substep in which all sleeps, nothing is done.
        time = substep.start if self.matter.wake() else substep.end
        while time < substep.end:
            left = substep.end - time
            steps = max(1, int(np.ceil(left / self._stable_length() * (1.0 - 1e-9))))
            self._advance(time, left / steps)
            time = time + left / steps if steps > 1 else substep.end
        self.contact.end_substep()

    def _stable_length(self) -> float:
        """[s] by the matter, and by the surfaces it may be struck by."""
        cfl, length = self._settings.cfl, self.matter.stable_length(self._settings.cfl)
        if self.contact.speed > 0.0:
            length = min(length, cfl * self.matter.grid.cell_size / self.contact.speed)
        return length

    def _advance(self, time: float, length: float) -> None:
        matter = self.matter
        matter.to_grid(length)
        matter.to_velocities()
        self.contact.act(time, length)
        if not matter.to_particles():
            raise Diverged("velocity", self._where_lost(), time + length)
        self.contact.lead_out()
        self._steps += 1

    def _pour(self, substep: Interval) -> None:
        poured = self._poured.numpy().copy()
        for index, g in enumerate(self._model.scene.granular):
            if g.emitter is not None:
                places, velocities = emitted(g.emitter, poured[index], substep)
                if len(places):
                    self.matter.add(index, places, velocities, np.full(len(places), g.emitter.volume))
                    self.matter.sort()
        self._poured.assign(poured)

    def retract(self, state: State, substep: Interval) -> None:
        """The particles are again as they were at the substep's start."""
        for name, array in self._own.items():
            wp.copy(array, self._kept[name])
        self._take_up()

    def end_frame(self, state: State, frame: Interval) -> dict[str, Any]:
        """How many particles and blocks there are, blocks awake, steps and sorts of the frame, energies [J]."""
        matter = self.matter
        kinetic, elastic, potential = matter.energies() if matter.count else (0.0, 0.0, 0.0)
        return {
            "particles": matter.count,
            "blocks": matter.grid.block_count,
            "awake": matter.awake,
            "steps": self._steps,
            "sorts": matter.sorts - self._sorts,
            "kinetic_energy": kinetic,
            "elastic_energy": elastic,
            "potential_energy": potential,
        }

    def grains(self, index: int) -> Grains:
        """The particles of `Scene.granular[index]`."""
        g, held = self._model.scene.granular[index], self.matter.particles
        count = self.matter.count
        of_this = np.flatnonzero(held.material.numpy()[:count] == index)
        order = of_this[np.argsort(held.number.numpy()[of_this])]
        more = len(order) - len(g.ids)
        ids = np.concatenate([g.ids, np.max(g.ids, initial=-1) + 1 + np.arange(more)])
        widths = np.concatenate([g.widths, np.full(more, g.emitter.width if g.emitter else 0.0)])
        positions, velocities = (x.numpy()[order].astype(float) for x in (held.position, held.velocity))
        return Grains(positions, velocities, ids.astype(np.int64), widths)

    def _where_lost(self) -> str:
        held, count = self.matter.particles, self.matter.count
        fine = np.isfinite(held.velocity.numpy()[:count]).all(axis=1)
        fine &= np.isfinite(held.strain.numpy()[:count]).all(axis=1)
        lost = int(np.argmin(fine))
        granular = self._model.scene.granular[int(held.material.numpy()[lost])]
        return f"{granular.name} particle {int(held.number.numpy()[lost])}"
