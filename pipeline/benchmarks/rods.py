"""Cases of the rods: heavy cantilever, 45° bend, released cantilever, shaken hair."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

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
from plait.pipeline.benchmarks.scenes import HAIR, Fibre, arc, rods, shaking, straight
from plait.solver.build import build
from plait.solver.scene import Scene
from plait.solver.settings import Settings, StrandContactSettings, StrandSettings
from plait.solver.step import Simulation

GRAVITY = 9.81
COPIES = 8  # equal rods side by side, so that the rods cost more than the launches
EXACT = 1e-8  # Newton's tolerance where only the discretisation shall show


def simulation_of(scene: Scene, variant: Variant, hardware: Hardware, **settings: Any) -> Simulation:
    """Rods for themselves. settings: what else `Settings` takes."""
    strands = StrandSettings(
        integrator=variant.integrator, tolerance=variant.tolerance, precision=variant.precision
    )
    alone = {"strand_contact": StrandContactSettings(method="none")}
    hardware_settings = {"device": hardware.device, "threads": hardware.threads}
    return build(scene, Settings(strands=strands, **(alone | hardware_settings | settings)))


def equilibrium(scene: Scene, variant: Variant, hardware: Hardware) -> Trial:
    """Lets `scene` come to rest and gives the tip of its first rod, (1, 3) [m]."""
    simulation = simulation_of(scene, variant, hardware)

    def run() -> Outcome:
        iterations = simulation.model.parts["strands"].relax(variant.tolerance)
        stuck = np.count_nonzero(iterations < 0)
        figures = {"iterations": float(np.abs(iterations).mean())}
        return Outcome(_tip(simulation)[None], figures, unconverged(stuck, "rods"))

    return Trial(run, simulation.close)


def trajectory(scene: Scene, variant: Variant, hardware: Hardware, sample_times: np.ndarray) -> Trial:
    """Runs `scene` and gives the tip of its first rod at `sample_times` [s], (sample_count, 3) [m]."""
    simulation = simulation_of(scene, variant, hardware)

    def run() -> Outcome:
        tips, solved = [], []
        for time in sample_times:
            solved.append(simulation.advance_frame(float(time), variant.substeps)["strands"])
            tips.append(_tip(simulation))
        figures = _figures(solved)
        return Outcome(np.array(tips), figures, unconverged(figures["unconverged"], "rod-substeps"))

    return Trial(run, simulation.close)


def _tip(simulation: Simulation) -> np.ndarray:
    points = simulation.model.parts["strands"].points(0)
    return np.array(points[len(points) // COPIES - 1], dtype=np.float64)


def _figures(solved: list[dict[str, float]]) -> dict[str, float]:
    """Newton iterations a rod and substep; rod-substeps cut in parts, and those not converged even then."""
    return {
        "iterations": float(np.mean([metrics["iterations_mean"] for metrics in solved])),
        "subdivided": float(sum(metrics["subdivided"] for metrics in solved)),
        "unconverged": float(sum(metrics["unconverged"] for metrics in solved)),
    }


# Heavy cantilever ---------------------------------------------------------------------------------------------

RADIUS, DENSITY = 1e-3, 1000.0


def cantilever_fibre(gamma: float) -> Fibre:
    """Of a rod one metre long: Gamma = weight L^2 / EI."""
    line_weight = DENSITY * np.pi * RADIUS**2 * GRAVITY
    return Fibre(RADIUS, DENSITY, youngs_modulus=line_weight / gamma / (np.pi * RADIUS**4 / 4.0))


def _cantilever(gamma: float, segments: int) -> Scene:
    """Drawn straight and level, stress-free."""
    shapes = [straight(segments, 1.0, (1, 0, 0), root=(0, 0, 0.1 * i)) for i in range(COPIES)]
    ground, strands = rods("cantilever", shapes, cantilever_fibre(gamma), rest_shape="authored")
    return Scene((ground,), (strands,), gravity=np.array([0.0, -GRAVITY, 0.0]))


HEAVY_GAMMA = 10.0
# Tip of the heavy elastica, length 1: EI theta'' = -(1 + N / EA) q (L - s) cos theta, theta(0) = theta'(L) = 0, of
# slenderness EA / (q L) = 4 L^2 / (Gamma r^2); (0.6563537612, -0.7001997155) where EA is infinite.
HEAVY_TIP = (0.656353976780, -0.700200456645, 0.0)


def _prepare_heavy(variant: Variant, hardware: Hardware) -> Trial:
    return equilibrium(_cantilever(HEAVY_GAMMA, variant.segments), variant, hardware)


# 45° bend -----------------------------------------------------------------------------------------------------

BEND_RADIUS = 100.0
BEND_FORCE = 600.0
# Tip of the extensible, unshearable rod: r' = (1 + n.t / EA) t, m' = n x r', m = EI (kappa - kappa_0), n = F at
# the tip. With EA infinite, or with shear, the same solve gives the tables' Kirchhoff and Simo-Reissner values.
BEND_TIP = (47.152150218, 15.685355777, 53.471762950)
BEND_DRAWN_TIP = tuple(arc(1, BEND_RADIUS, np.pi / 4.0)[-1])


def _bend(segments: int) -> Scene:
    """R = 100, EA = 1e7, EI = GJ = 1e7 / 12, no gravity, a dead load out of plane at the tip."""
    one = arc(segments, BEND_RADIUS, np.pi / 4.0)
    shapes = [one] * COPIES
    # E, nu and r such that EA = 1e7, EI = 1e7 / 12 and GJ = EI.
    radius = np.sqrt(4.0 / 12.0)
    fibre = Fibre(radius, density=1.0, youngs_modulus=1e7 / (np.pi * radius**2), poissons_ratio=0.0)
    loads = np.zeros((COPIES, segments + 1, 3))
    loads[:, -1, 2] = BEND_FORCE
    ground, strands = rods("bend", shapes, fibre, rest_shape="authored", loads=loads.reshape(-1, 3))
    return Scene((ground,), (strands,), gravity=np.zeros(3))


def _prepare_bend(variant: Variant, hardware: Hardware) -> Trial:
    return equilibrium(_bend(variant.segments), variant, hardware)


# Released cantilever ------------------------------------------------------------------------------------------

RELEASED_GAMMA = 1.0
# The first mode's period, 2 pi / 3.51602 sqrt(rho A L^4 / EI) for L = 1.
RELEASED_PERIOD = 2.0 * np.pi / 3.5160153 * np.sqrt(RELEASED_GAMMA / GRAVITY)


def _prepare_released(variant: Variant, hardware: Hardware) -> Trial:
    times = RELEASED_PERIOD / 12.0 * np.arange(1, 25)
    return trajectory(_cantilever(RELEASED_GAMMA, variant.segments), variant, hardware, times)


# Shaken hair --------------------------------------------------------------------------------------------------

HAIR_LENGTH = 0.25
SHAKE_FREQUENCY = 2.0  # [1/s]
# Hair this limp has no trajectory to converge to where it is shaken with 1 g: it whips, and round-off grows by
# 1e5 within half a second.
SHAKE_ACCELERATION = 0.3 * GRAVITY
FRAME = 1.0 / 24.0


def _shaken(segments: int) -> Scene:
    """A lock that hangs, bent by half a radian, at rest as drawn; shaken out of its plane."""
    bent = arc(segments, HAIR_LENGTH / 0.5, 0.5)[:, [1, 0, 2]] * np.array([1.0, -1.0, 1.0])
    shapes = [bent + np.array([0.0, 0.0, 0.01 * i]) for i in range(COPIES)]
    motion = shaking(SHAKE_ACCELERATION, SHAKE_FREQUENCY, axis=2)
    ground, strands = rods("lock", shapes, replace(HAIR, damping=2.0), motion=motion)
    return Scene((ground,), (strands,), gravity=np.array([0.0, -GRAVITY, 0.0]))


def _prepare_shaken(variant: Variant, hardware: Hardware) -> Trial:
    return trajectory(_shaken(variant.segments), variant, hardware, FRAME * np.arange(1, 25))


# Ladders ------------------------------------------------------------------------------------------------------


def refined(base: Variant, **values: tuple) -> tuple[Variant, ...]:
    """A rung for each value: `refined(base, segments=(10, 20))`; several names change together."""
    rungs = zip(*values.values(), strict=True)
    return tuple(base._replace(**dict(zip(values, rung, strict=True))) for rung in rungs)


def _static_ladders(segments: tuple[int, ...]) -> tuple[Ladder, ...]:
    """Resolutions, each twice the one before, tolerances, and float32."""
    exact = Variant(segments[-2], 0, EXACT)
    return (
        Ladder("space", refined(exact, segments=segments), nominal_order=2.0),
        Ladder("tolerance", refined(exact, tolerance=(3e-1, 3e-2, 3e-3))),
        Ladder("float32", refined(exact._replace(precision="float32", tolerance=3e-3), segments=segments[:-1])),
    )


def _dynamic_ladders(segments: int, substeps: int) -> tuple[Ladder, ...]:
    """Steps with either integrator, resolutions, both together, tolerances, float32, about one middle variant."""
    middle = Variant(segments, substeps, EXACT, "sdirk2")
    implicit_euler = middle._replace(integrator="backward-euler")
    steps = tuple(substeps * 2**i // 4 for i in range(4))
    together = {"segments": (segments // 2, segments, 2 * segments), "substeps": steps[1:4]}
    return (
        Ladder("time, Euler", refined(implicit_euler, substeps=steps), nominal_order=1.0),
        Ladder("time, SDIRK2", refined(middle, substeps=steps), nominal_order=2.0),
        Ladder("space", refined(middle, segments=(segments // 4, *together["segments"])), nominal_order=2.0),
        Ladder("both, SDIRK2", refined(middle._replace(tolerance=3e-2), **together)),
        Ladder("both, Euler", refined(implicit_euler._replace(tolerance=3e-2), **together)),
        Ladder("tolerance", refined(middle, tolerance=(3e-1, 3e-2, 3e-3))),
        Ladder("float32", refined(middle._replace(precision="float32", tolerance=3e-2), **together)),
    )


def _extrapolated(segments: int, substeps: int) -> Richardson:
    """To four times these: at least as fine as any rung of `_dynamic_ladders`, and in time finer."""
    finest = Variant(segments, substeps, EXACT, "sdirk2")
    levels = refined(
        finest, segments=(segments, 2 * segments, 4 * segments), substeps=tuple(substeps * i for i in (1, 2, 4))
    )
    return Richardson(levels, nominal_order=2.0)


CASES = (
    Case(
        "heavy-cantilever",
        f"static cantilever under its own weight, Gamma = {HEAVY_GAMMA:g}",
        "distance of the tip over the rod's length",
        1.0,
        _prepare_heavy,
        Known(np.array([HEAVY_TIP]), "heavy elastica, boundary value problem"),
        _static_ladders((25, 50, 100, 200)),
    ),
    Case(
        "bend-45",
        f"static 45 degree bend under an out-of-plane tip force F = {BEND_FORCE:g}",
        "distance of the tip over its displacement",
        float(np.linalg.norm(np.subtract(BEND_TIP, BEND_DRAWN_TIP))),
        _prepare_bend,
        Known(np.array([BEND_TIP]), "extensible Kirchhoff rod, boundary value problem"),
        _static_ladders((8, 16, 32, 64, 128)),
    ),
    Case(
        "released-cantilever",
        f"level cantilever let go, Gamma = {RELEASED_GAMMA:g}, two periods",
        "distance of the tip, rms over 24 times, over the rod's length",
        1.0,
        _prepare_released,
        _extrapolated(16, 8),
        _dynamic_ladders(32, 8),
        interval=RELEASED_PERIOD / 12.0,
    ),
    Case(
        "shaken-hair",
        f"hair of {HAIR_LENGTH:g} m, root shaken at {SHAKE_FREQUENCY:g} Hz with 0.3 g, one second",
        "distance of the tip, rms over 24 frames, over the hair's length",
        HAIR_LENGTH,
        _prepare_shaken,
        _extrapolated(32, 32),
        _dynamic_ladders(32, 16),
        interval=FRAME,
    ),
)
