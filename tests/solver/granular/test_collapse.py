"""Columns of sand that fall apart between walls, against measurements."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from plait.solver.scene import Scene

from .heaps import CELL, granular, lattice, plate, simulated

LENGTH, GRAVITY, DENSITY, POISSON = 30, 9.81, 1600.0, 0.3  # cells, [m/s2], [kg/m3]
# A usual angle of repose of dry sand; the law of the run-out was measured with several grains, alike.
ANGLE = np.radians(30.0)


class Column:
    """So many times as high as long, in a slot with walls without friction, on a floor as rough as the sand.

    It stands under its own weight until the wall at one end is gone, and is stiff: its foot gives way by less than
    a hundredth. Without either it swings as it falls, and the deposit goes on creeping.
    """

    def __init__(self, aspect: float) -> None:
        self.height = aspect * LENGTH * CELL
        places = lattice((LENGTH, int(aspect * LENGTH), 1))
        places += np.random.default_rng(0).uniform(-CELL / 8, CELL / 8, places.shape)
        modulus = 100.0 * DENSITY * GRAVITY * self.height
        values = {"youngs_modulus": modulus, "poissons_ratio": POISSON, "density": DENSITY}
        sand = granular(places, np.zeros_like(places), friction_angle=ANGLE, **values)
        sides = [plate(100.0, (0.0, 0.0, z), friction=0.0) for z in (1.0, -1.0)]
        sides[1] = replace(sides[1], points=sides[1].points + np.array([0.0, 0.0, CELL]))
        end = plate(100.0, (1.0, 0.0, 0.0), friction=0.0)
        floor = plate(100.0, friction=float(np.tan(ANGLE)))
        self._simulation = simulated(Scene(surfaces=(floor, end, *sides), granular=(sand,)))
        wave_modulus = modulus * (1.0 - POISSON) / ((1.0 + POISSON) * (1.0 - 2.0 * POISSON))
        strain = np.zeros((len(places), 6))
        strain[:, 1] = -DENSITY * GRAVITY * (self.height - places[:, 1]) / wave_modulus
        self._simulation.state.arrays["granular/strain"].assign(strain)

    def fall(self, times: float) -> None:
        """By so many times sqrt(h / g)."""
        for _ in range(int(2 * times)):
            self._simulation.advance_frame(self._simulation.state.time + 0.5 * np.sqrt(self.height / GRAVITY))

    def front(self) -> float:
        """(l - l0) / l0, where less than half a cell's height of sand lies."""
        along = np.maximum(self._grains().positions[:, 0] / CELL, 0.0).astype(int)
        return float(np.flatnonzero(np.bincount(along) / 8.0 >= 0.5)[-1] + 1) / LENGTH - 1.0

    def speed(self) -> float:
        """The mean over sqrt(g h)."""
        return float(np.abs(self._grains().velocities).mean() / np.sqrt(GRAVITY * self.height))

    def _grains(self):
        return self._simulation.model.parts["granular"].grains(0)


@pytest.mark.slow
def test_a_deposit_is_final():
    """Where the front is after 5 falls it stays: in the next 3 by no cell, at under a thousandth of sqrt(g h)."""
    column = Column(1.0)
    column.fall(5.0)
    front = column.front()
    column.fall(3.0)
    assert column.front() == front
    assert column.speed() < 1e-3


@pytest.mark.slow
@pytest.mark.xfail(reason="a thin layer runs on; friction does not rise with speed as in sand", strict=True)
@pytest.mark.parametrize("aspect", [1.0, 2.0])
def test_run_out_of_a_column(aspect):
    """(l - l0) / l0 = 1.2 a for columns a times as high as long, a < 2.3 (Lube et al. 2005), to 5 %."""
    column = Column(aspect)
    column.fall(6.0)
    assert column.front() == pytest.approx(1.2 * aspect, rel=0.05)
