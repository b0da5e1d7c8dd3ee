"""Columns of sand that fall apart, against measurements."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace

import numpy as np
import pytest

from plait.solver.scene import Scene, Surface

from .heaps import CELL, granular, lattice, plate, simulated

LENGTH, GRAVITY, DENSITY, POISSON = 32, 9.81, 1600.0, 0.3  # cells, [m/s2], [kg/m3]
# A usual angle of repose of dry sand; the laws of the run-out were measured with several grains, alike.
ANGLE = np.radians(30.0)
# Where less sand lies is no deposit: a layer of grains of a 64th of the length, in cells.
LAYER = LENGTH / 64


class Column(ABC):
    """LENGTH long and so many times as high, on a floor as rough as the sand, between walls without friction.

    Kinds tell what is long in it, and how wide it is there. It stands under its own weight until it is let go, and
    is stiff: its foot gives way by less than a hundredth. Without either it swings as it falls, and the deposit
    goes on creeping.
    """

    def __init__(self, aspect: float) -> None:
        self._height = aspect * LENGTH * CELL
        places = self._places(int(aspect * LENGTH))
        places += np.random.default_rng(0).uniform(-CELL / 8, CELL / 8, places.shape)
        modulus = 100.0 * DENSITY * GRAVITY * self._height
        values = {"youngs_modulus": modulus, "poissons_ratio": POISSON, "density": DENSITY}
        sand = granular(places, np.zeros_like(places), friction_angle=ANGLE, **values)
        floor = plate(100.0, friction=float(np.tan(ANGLE)))
        self._simulation = simulated(Scene(surfaces=(floor, *self._walls()), granular=(sand,)))
        wave_modulus = modulus * (1.0 - POISSON) / ((1.0 + POISSON) * (1.0 - 2.0 * POISSON))
        strain = np.zeros((len(places), 6))
        strain[:, 1] = -DENSITY * GRAVITY * (self._height - places[:, 1]) / wave_modulus
        self._simulation.state.arrays["granular/strain"].assign(strain)

    def fall(self, times: float) -> None:
        """By so many times sqrt(h / g)."""
        for _ in range(int(2 * times)):
            self._simulation.advance_frame(self._simulation.state.time + 0.5 * np.sqrt(self._height / GRAVITY))

    def run_out(self) -> float:
        """(l - l0) / l0."""
        volumes = np.bincount(self._along(self._grains().positions / CELL).astype(int)) / 8.0
        heights = volumes / self._width(np.arange(len(volumes)) + 0.5)
        return float(np.flatnonzero(heights >= LAYER)[-1] + 1) / LENGTH - 1.0

    def speed(self) -> float:
        """The mean over sqrt(g h)."""
        return float(np.abs(self._grains().velocities).mean() / np.sqrt(GRAVITY * self._height))

    def _grains(self):
        return self._simulation.model.parts["granular"].grains(0)

    @abstractmethod
    def _places(self, height: int) -> np.ndarray:
        """(grain_count, 3) [m] at first, for so many cells of height."""

    @abstractmethod
    def _walls(self) -> list[Surface]: ...

    @abstractmethod
    def _along(self, places: np.ndarray) -> np.ndarray:
        """How far along grains are; in cells, as are `places`."""

    @abstractmethod
    def _width(self, along: np.ndarray) -> np.ndarray:
        """[cells]"""


class Slab(Column):
    """Of a cell's width, between two walls and against a third; only along x does it go."""

    def _places(self, height: int) -> np.ndarray:
        return lattice((LENGTH, height, 1))

    def _walls(self) -> list[Surface]:
        sides = [plate(100.0, (0.0, 0.0, z), friction=0.0) for z in (1.0, -1.0)]
        sides[1] = replace(sides[1], points=sides[1].points + np.array([0.0, 0.0, CELL]))
        return [plate(100.0, (1.0, 0.0, 0.0), friction=0.0), *sides]

    def _along(self, places: np.ndarray) -> np.ndarray:
        return np.maximum(places[:, 0], 0.0)

    def _width(self, along: np.ndarray) -> np.ndarray:
        return np.ones(len(along))


class Cylinder(Column):
    """A quarter of one, between two planes of symmetry; LENGTH is its radius."""

    def _places(self, height: int) -> np.ndarray:
        places = lattice((LENGTH, height, LENGTH))
        return places[np.hypot(places[:, 0], places[:, 2]) < LENGTH * CELL]

    def _walls(self) -> list[Surface]:
        return [plate(100.0, normal, friction=0.0) for normal in ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0))]

    def _along(self, places: np.ndarray) -> np.ndarray:
        return np.hypot(places[:, 0], places[:, 2])

    def _width(self, along: np.ndarray) -> np.ndarray:
        return 0.5 * np.pi * along


@pytest.mark.slow
def test_a_deposit_is_final():
    """Where the front is after 5 falls it stays: in the next 3 by no cell, at under a thousandth of sqrt(g h)."""
    column = Slab(1.0)
    column.fall(5.0)
    front = column.run_out()
    column.fall(3.0)
    assert column.run_out() == front
    assert column.speed() < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("aspect", [1.0, 1.5])
def test_run_out_of_a_cylinder(aspect):
    """(r - r0) / r0 = 1.24 a for cylinders a times as high as r0, a < 1.7 (Lube et al. 2004), to 5 %."""
    column = Cylinder(aspect)
    column.fall(4.0)
    assert column.run_out() == pytest.approx(1.24 * aspect, rel=0.05)


@pytest.mark.slow
@pytest.mark.xfail(reason="it was measured in a channel, whose walls hold back; these do not", strict=True)
@pytest.mark.parametrize("aspect", [1.0, 2.0])
def test_run_out_of_a_slab(aspect):
    """(l - l0) / l0 = 1.2 a for columns a times as high as long, a < 2.3 (Lube et al. 2005), to 5 %."""
    column = Slab(aspect)
    column.fall(6.0)
    assert column.run_out() == pytest.approx(1.2 * aspect, rel=0.05)
