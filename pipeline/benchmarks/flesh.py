"""Cases of elastic bodies: a bar of tets that bends, and one that rings."""

from __future__ import annotations

import numpy as np

from plait.pipeline.benchmarks.bars import bar_lattice, bar_scene
from plait.pipeline.benchmarks.case import (
    Case,
    Hardware,
    Known,
    Ladder,
    Outcome,
    Richardson,
    Trial,
    Variant,
    unconverged,
)
from plait.pipeline.benchmarks.rods import refined
from plait.solver.build import build
from plait.solver.scene import Scene
from plait.solver.settings import FleshSettings, Settings
from plait.solver.step import Simulation

EXACT = 1e-8  # Newton's tolerance where only the discretisation shall show
CELLS = "cells across"


def _simulation(scene: Scene, variant: Variant, hardware: Hardware) -> Simulation:
    flesh = FleshSettings(integrator=variant.integrator, tolerance=variant.tolerance)
    settings = Settings(device=hardware.device, threads=hardware.threads, precision=variant.precision, flesh=flesh)
    return build(scene, settings)


# Bending ------------------------------------------------------------------------------------------------------

DEPTH, ASPECT, MODULUS, RATIO = 0.1, 6, 1e6, 0.3
# EI [N m2] of the beam, and k GA [N], the shear coefficient k after Cowper 1966.
RIGIDITY = MODULUS * DEPTH**4 / 12.0
SHEAR = 10.0 * (1.0 + RATIO) / (12.0 + 11.0 * RATIO) * DEPTH**2 * MODULUS / (2.0 + 2.0 * RATIO)
# A step [s] in which inertia plays no part: equilibrium; and deflections so small that they stay linear.
STATIC, SMALL = 1e4, 1e-3


def _prepare_bending(variant: Variant, hardware: Hardware) -> Trial:
    """Deflection over that of Timoshenko's beam, (1, 1), of the piece one depth off either end.

    There the stress is the beam's whatever clamp and load do in detail (Saint-Venant), and the deflection is taken
    relative to the mean deflection and slope of the piece's first section.
    """
    cells, length = variant.segments, ASPECT * DEPTH
    nodes, tets = bar_lattice((ASPECT * cells, cells, cells), length)
    simulation = _simulation(
        bar_scene(nodes, tets, youngs_modulus=MODULUS, poissons_ratio=RATIO), variant, hardware
    )
    load = 3.0 * SMALL * RIGIDITY / length**2

    def run() -> Outcome:
        stage = simulation.model.parts["tets"]
        impulse = np.zeros_like(nodes)
        end, share = _section(nodes, length)
        impulse[end, 1] = load * STATIC * share
        stage.external_impulse.assign(impulse)
        metrics = simulation.advance_frame(STATIC, substeps=1)["tets"]
        span, moved = length - 2.0 * DEPTH, stage.nodes(0) - nodes
        (start, slope), (stop, _) = (_mean_of(nodes, moved, place) for place in (DEPTH, length - DEPTH))
        theory = load * ((length - DEPTH) * span**2 / 2.0 - span**3 / 6.0) / RIGIDITY + load * span / SHEAR
        figures = {"newton": metrics["newton_iterations"], "linear": metrics["linear_iterations"]}
        value = np.array([[(stop - start - slope * span) / theory]])
        return Outcome(value, figures, unconverged(metrics["unconverged"], "steps"))

    return Trial(run, simulation.close)


def _section(nodes: np.ndarray, place: float) -> tuple[np.ndarray, np.ndarray]:
    """The nodes of a plane across the bar at x = `place`, and their shares of its area."""
    inside = np.flatnonzero(np.isclose(nodes[:, 0], place))
    edge = np.isclose(nodes[inside, 1:], 0.0) | np.isclose(nodes[inside, 1:], DEPTH)
    share = np.where(edge, 0.5, 1.0).prod(axis=1)
    return inside, share / share.sum()


def _mean_of(nodes: np.ndarray, moved: np.ndarray, place: float) -> tuple[float, float]:
    """Deflection and slope of a section, its nodes `moved` (node_count, 3) [m]."""
    inside, share = _section(nodes, place)
    height = nodes[inside, 1] - 0.5 * DEPTH
    return share @ moved[inside, 1], -(share * height) @ moved[inside, 0] / ((share * height) @ height)


_BENT = Variant(4, 0, EXACT, "backward-euler", unit=CELLS)

# Ringing ------------------------------------------------------------------------------------------------------

# A free bar's first longitudinal mode; without Poisson's effect its wave travels at sqrt(E / rho).
RINGING_LENGTH, RINGING_MODULUS, DENSITY, SPEED = 0.6, 1e5, 1000.0, 0.1
RINGING_PERIOD = 2.0 * RINGING_LENGTH / np.sqrt(RINGING_MODULUS / DENSITY)
SAMPLES, PERIODS = 12, 2


def _prepare_ringing(variant: Variant, hardware: Hardware) -> Trial:
    """The mode's amplitude over that of its first swing, (SAMPLES PERIODS, 1), at equal times."""
    cells = variant.segments
    nodes, tets = bar_lattice((6 * cells, cells, cells), RINGING_LENGTH)
    scene = bar_scene(
        nodes, tets, youngs_modulus=RINGING_MODULUS, poissons_ratio=0.0, density=DENSITY, clamped=False
    )
    simulation = _simulation(scene, variant, hardware)
    stage = simulation.model.parts["tets"]
    mode = np.cos(np.pi * nodes[:, 0] / RINGING_LENGTH)
    swing = SPEED * RINGING_PERIOD / (2.0 * np.pi)

    def run() -> Outcome:
        stage.velocity.assign(SPEED * mode[:, None] * np.array([1.0, 0.0, 0.0]))
        weight = stage.layout.mass * mode / (stage.layout.mass @ mode**2)
        places, metrics = [], []
        for k in range(SAMPLES * PERIODS):
            time = (k + 1) * RINGING_PERIOD / SAMPLES
            metrics.append(simulation.advance_frame(time, variant.substeps)["tets"])
            places.append(weight @ (stage.nodes(0) - nodes)[:, 0] / swing)
        steps = variant.substeps * len(metrics)
        figures = {
            "newton": sum(held["newton_iterations"] for held in metrics) / steps,
            "linear": sum(held["linear_iterations"] for held in metrics) / steps,
        }
        failed = unconverged(sum(held["unconverged"] for held in metrics), "steps")
        return Outcome(np.array(places)[:, None], figures, failed)

    return Trial(run, simulation.close)


_RUNG = Variant(2, 8, EXACT, "bdf2", unit=CELLS)
_STEPS = (2, 4, 8, 16, 32)

CASES = (
    Case(
        "bar-bending",
        f"static bar of tets under a tip load, nu = {RATIO:g}",
        "what is missing of the deflection",
        1.0,
        _prepare_bending,
        Known(np.ones((1, 1)), "Timoshenko beam, shear coefficient of Cowper 1966"),
        (
            Ladder("space", refined(_BENT, segments=(2, 4, 8)), nominal_order=2.0),
            Ladder("tolerance", refined(_BENT, tolerance=(1e-1, 1e-2, 1e-3))),
            Ladder("float32", refined(_BENT._replace(precision="float32", tolerance=1e-3), segments=(2, 4, 8))),
        ),
    ),
    Case(
        "bar-ringing",
        "free bar of tets in its first longitudinal mode, two periods",
        f"of the mode's amplitude, rms over {SAMPLES * PERIODS} times",
        1.0,
        _prepare_ringing,
        Richardson(refined(_RUNG, substeps=(16, 32, 64)), nominal_order=2.0),
        (
            Ladder("time, Euler", refined(_RUNG._replace(integrator="backward-euler"), substeps=_STEPS[:-1]), 1.0),
            Ladder("time, BDF2", refined(_RUNG, substeps=_STEPS), 2.0),
            Ladder("symplectic", refined(_RUNG._replace(integrator="symplectic-euler"), substeps=_STEPS[:3])),
            Ladder("tolerance", refined(_RUNG, tolerance=(1e-1, 1e-2, 1e-3))),
            Ladder("float32", refined(_RUNG._replace(precision="float32", tolerance=1e-3), substeps=_STEPS[:3])),
        ),
        interval=RINGING_PERIOD / SAMPLES,
    ),
)
