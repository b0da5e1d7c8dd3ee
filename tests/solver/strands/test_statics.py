"""Static equilibrium against references that no simulator made."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from .rod_scenes import line, rod_scene, simulate

TABLE = "heavy_elastica_cantilever.csv"


def reference_tip(shared: Path, gamma: float) -> np.ndarray:
    """Drop and reach of the tip over the length."""
    with open(shared / "references" / TABLE) as file:
        rows = {float(row[0]): (float(row[1]), float(row[2])) for row in list(csv.reader(file))[1:]}
    return np.array(rows[gamma])


def cantilever_tip(gamma: float, segments: int) -> tuple[np.ndarray, int]:
    """Drop and reach over length of a horizontal rod that weighs gamma EI / L^3 a length, and the iterations."""
    length, radius, density, gravity = 1.0, 1e-3, 1000.0, 9.81
    weight = density * np.pi * radius**2 * gravity
    bend = weight * length**3 / gamma
    scene = rod_scene([line(length, segments)], radius=radius, density=density, bend=bend, twist=bend, stretch=1e6)
    strands = simulate(scene).model.parts["strands"]
    iterations = int(strands.relax(tolerance=1e-9)[0])
    tip = strands.points(0)[-1] / length
    return np.array([-tip[1], tip[0]]), iterations


@pytest.mark.parametrize("gamma", [1.0, 10.0, 100.0, 1000.0])
def test_heavy_cantilever_hangs_as_the_elastica(shared: Path, gamma: float) -> None:
    """Error in drop at most 3e-4 of the length with 100 segments; Newton converges from the straight rod."""
    tip, iterations = cantilever_tip(gamma, 100)
    assert 0 < iterations <= 20  # an exact Hessian: a handful of steps, however far the rod falls
    assert abs(tip[0] - reference_tip(shared, gamma)[0]) < 3e-4


@pytest.mark.parametrize("gamma", [1.0, 10.0, 100.0, 1000.0])
def test_heavy_cantilever_converges_with_second_order(shared: Path, gamma: float) -> None:
    """The ghost clamp is second order in the tip's drop, from 25 to 200 segments (observed: 2 - 0.1 or more)."""
    exact = reference_tip(shared, gamma)[0]
    counts = [25, 50, 100, 200]
    errors = [abs(cantilever_tip(gamma, segments)[0][0] - exact) for segments in counts]
    order = np.polyfit(np.log(counts), -np.log(errors), 1)[0]
    assert order > 1.9, errors


@pytest.mark.parametrize("force", [300.0, 450.0, 600.0])
def test_bend_of_45_degrees_under_a_force_across_it(shared: Path, force: float) -> None:
    """Bathe and Bolourchi (1979): bending and twisting together; 2e-4 of the displacement with 64 segments."""
    with open(shared / "references" / "bend45_tip.csv") as file:
        rows = {float(row[0]): np.array([float(v) for v in row[4:7]]) for row in list(csv.reader(file))[1:]}
    segments, radius = 64, 100.0
    angle = np.linspace(0.0, np.pi / 4.0, segments + 1)
    arc = radius * np.stack([1.0 - np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    loads = np.zeros_like(arc)
    loads[-1, 2] = force
    stiffness = 1e7 / 12.0
    scene = rod_scene(
        [arc], bend=stiffness, twist=stiffness, stretch=1e7, radius=0.5, gravity=(0.0, 0.0, 0.0), loads=loads
    )
    strands = simulate(scene).model.parts["strands"]
    assert strands.relax(tolerance=1e-9)[0] > 0
    tip = strands.points(0)[-1]
    assert np.linalg.norm(tip - rows[force]) < 2e-4 * np.linalg.norm(rows[force] - arc[-1])
