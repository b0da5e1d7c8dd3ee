"""What Newton's soft bodies (VBD and XPBD) take for the bar of `flesh_cost.py`, for comparison.

Needs `pip install plait[bench]`. Both integrate by backward Euler in float32 and stop after a set number of
sweeps; each is measured against the motion it converges to itself, by shorter steps and more sweeps, since their
laws of elasticity differ from ours and each other's: VBD's is a stable neo-Hookean one, XPBD's has no shear
stiffness in small strains. XPBD's relaxation is the largest at which this lattice, of 24 tets to a node, does
not explode.
"""

from __future__ import annotations

import time
from importlib.metadata import version
from importlib.util import find_spec
from typing import Any

import numpy as np

# Steps a second and sweeps a step: tried, and those that the reference is extrapolated from.
VBD_LADDER = ((384, 32), (768, 8), (768, 16), (1536, 4), (1536, 8), (3072, 2), (3072, 4), (6144, 1), (6144, 2))
VBD_FINEST = ((1536, 48), (3072, 32))
XPBD_LADDER = ((3072, 8), (6144, 4), (12288, 2), (12288, 4))
XPBD_FINEST = ((12288, 8), (24576, 4))
XPBD_RELAXATION = 0.05


def relative_error(found: np.ndarray, exact: np.ndarray, rest: np.ndarray) -> float:
    """Largest distance of a node from where it should be, over the largest way a node goes."""
    return float(np.linalg.norm(found - exact, axis=-1).max() / np.linalg.norm(exact - rest, axis=-1).max())


def cheapest(rows: list[dict[str, Any]], level: float) -> dict[str, Any] | None:
    """The quickest row with an error of at most `level`."""
    good = [row for row in rows if row["error"] <= level]
    return min(good, key=lambda row: row["seconds"]) if good else None


def measure(
    nodes: np.ndarray, tets: np.ndarray, pinned: np.ndarray, level: float, **settings: float
) -> dict[str, Any] | None:
    """Rows by solver, on one thread as ours; None where Newton is not installed."""
    if find_spec("newton") is None:
        return None
    from newton.solvers import SolverVBD, SolverXPBD

    model = _model(nodes, tets, pinned, settings["modulus"], settings["ratio"], settings["density"])

    def vbd(sweeps: int) -> Any:
        return SolverVBD(model, iterations=sweeps, particle_enable_tile_solve=False)

    def xpbd(sweeps: int) -> Any:
        return SolverXPBD(model, iterations=sweeps, soft_body_relaxation=XPBD_RELAXATION)

    out: dict[str, Any] = {}
    for name, make, ladder, finest in (
        ("vbd", vbd, VBD_LADDER, VBD_FINEST),
        ("xpbd", xpbd, XPBD_LADDER, XPBD_FINEST),
    ):
        near, nearest = (_run(model, make(sweeps), steps, settings)[0] for steps, sweeps in finest)
        exact = 2.0 * nearest - near
        rows = []
        for steps, sweeps in ladder:
            found, seconds = _run(model, make(sweeps), steps, settings)
            row = {"steps_a_second": steps, "iterations": sweeps, "seconds": seconds}
            rows.append(row | {"error": relative_error(found, exact, nodes)})
        uncertain = relative_error(nearest, exact, nodes)
        out[name] = {"rows": rows, "to_level": cheapest(rows, level), "reference_error": uncertain}
    return out | {"newton_version": version("newton")}


def _model(
    nodes: np.ndarray, tets: np.ndarray, pinned: np.ndarray, modulus: float, ratio: float, density: float
) -> Any:
    import newton
    import warp as wp

    builder = newton.ModelBuilder(up_axis=newton.Axis.Y, gravity=(0.0, -9.81, 0.0))
    builder.add_soft_mesh(
        pos=wp.vec3(0.0, 0.0, 0.0),
        rot=wp.quat_identity(),
        scale=1.0,
        vel=wp.vec3(0.0, 0.0, 0.0),
        vertices=[wp.vec3(*node) for node in nodes],
        indices=tets.ravel().tolist(),
        density=density,
        k_mu=modulus / (2.0 + 2.0 * ratio),
        k_lambda=modulus * ratio / ((1.0 + ratio) * (1.0 - 2.0 * ratio)),
        k_damp=0.0,
    )
    for node in np.flatnonzero(pinned):
        builder.particle_mass[node] = 0.0
        builder.particle_flags[node] &= ~int(newton.ParticleFlags.ACTIVE)
    builder.color()
    return builder.finalize(device="cpu")


def _run(model: Any, solver: Any, steps_a_second: int, settings: dict[str, float]) -> tuple[np.ndarray, float]:
    """(looks, node_count, 3) [m] positions, and the seconds it took, the first step left out."""
    now, then, control, looks = model.state(), model.state(), model.control(), []
    count = round(steps_a_second * settings["time"])
    solver.step(now, model.state(), control, None, settings["time"] / count)
    started = time.perf_counter()
    for k in range(count):
        now.clear_forces()
        solver.step(now, then, control, None, settings["time"] / count)
        now, then = then, now
        if (k + 1) % (count // settings["looks"]) == 0:
            looks.append(now.particle_q.numpy().astype(np.float64))
    return np.array(looks), time.perf_counter() - started
