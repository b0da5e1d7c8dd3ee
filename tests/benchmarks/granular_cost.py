"""What a step of sand costs, beside the same in Taichi: ns per particle and step.

    python tests/benchmarks/granular_cost.py [--threads N] [--growth] [--without-taichi]

The comparison needs `pip install taichi`. A block of sand falls apart on a floor; costs are taken in the midst of
it, the least and the median of several spans of steps, in wall time and in processor time over threads. Taichi
runs the same steps: MLS MPM with the return mapping on singular values as its own examples do it, float32, on a
dense grid just large enough, particles in cell order at the start.
"""

import argparse
import statistics
import time
from collections.abc import Callable
from importlib.util import find_spec

import numpy as np

from plait.solver.build import build
from plait.solver.scene import Granular, Scene, Surface
from plait.solver.settings import GranularSettings, Settings

CELL, PER_CELL = 0.01, 8
DENSITY, YOUNG, POISSON, ANGLE, FRICTION = 1600.0, 3.5e5, 0.3, 0.6, 0.5
SPAN = 5e-3  # [s] timed at once
FALL, TIMED_SPANS = 0.1, 5
# A span of these; they cost the same all along, but for the particles' order, which is best at the start.
STEPS_IN_TAICHI = 30
GROWTH = (10_000, 100_000, 500_000, 2_000_000)


def block(count: int) -> np.ndarray:
    """(n, 3) [m] a cube of about `count` particles, a cell above y = 0, in cell order."""
    side = round((count / PER_CELL) ** (1.0 / 3.0))
    cells = np.indices((side, side, side)).reshape(3, -1).T
    within = np.random.default_rng(0).random((len(cells) * PER_CELL, 3))
    return (np.repeat(cells, PER_CELL, axis=0) + within + [0.0, 1.0, 0.0]) * CELL


def scene(count: int) -> Scene:
    places = block(count)
    n, reach = len(places), 8.0 * places.max()
    sand = Granular(
        "sand",
        "sand",
        places,
        np.zeros((n, 3)),
        np.full(n, CELL**3 / PER_CELL),
        np.full(n, CELL / 2),
        np.arange(n),
        density=DENSITY,
        youngs_modulus=YOUNG,
        poissons_ratio=POISSON,
        friction_angle=ANGLE,
    )
    corners = np.array([[-reach, 0, -reach], [-reach, 0, reach], [reach, 0, reach], [reach, 0, -reach]])
    floor = Surface("floor", corners, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32), friction=FRICTION)
    return Scene(surfaces=(floor,), granular=(sand,))


def timed(step: Callable[[], int]) -> tuple[list[float], list[float]]:
    """ns of wall and processor time per particle and step; `step` returns particles times the steps it did."""
    walls, processors = [], []
    for _ in range(TIMED_SPANS):
        wall, processor = time.perf_counter(), time.process_time()
        done = step()
        walls.append((time.perf_counter() - wall) / done * 1e9)
        processors.append((time.process_time() - processor) / done * 1e9)
    return walls, processors


def cost(count: int, threads: int, fall: float = FALL) -> dict[str, float]:
    """After the block has fallen for so long [s]."""
    simulation = build(
        scene(count), Settings(threads=threads, substeps=1, granular=GranularSettings(cell_size=CELL))
    )
    simulation.advance_frame(fall)
    steps = 0

    def advance() -> int:
        nonlocal steps
        metrics = simulation.advance_frame(simulation.state.time + SPAN)["granular"]
        steps += metrics["steps"]
        return metrics["steps"] * metrics["particles"]

    walls, processors = timed(advance)
    matter = simulation.model.parts["granular"].matter
    held = sum(array.capacity for array in simulation.state.arrays.values())
    simulation.close()
    return {
        "particles": matter.count,
        "wall": min(walls),
        "wall_median": statistics.median(walls),
        "processor": min(processors) / threads,
        "bytes": (held + matter.grid.bytes) / matter.count,
        "step": TIMED_SPANS * SPAN / steps,
    }


def cost_in_taichi(count: int, threads: int, length: float) -> dict[str, float]:
    """The same block in Taichi, in steps of `length` [s]."""
    import taichi as ti

    ti.init(arch=ti.cpu, cpu_max_num_threads=threads, default_fp=ti.f32, log_level=ti.ERROR)
    places = block(count)
    n = len(places)
    side = round((n / PER_CELL) ** (1.0 / 3.0))
    nodes = (2 * side + 16, side + 16, 2 * side + 16)
    shift = np.array([side / 2 + 8, 4, side / 2 + 8]) * CELL
    floor = 4
    mu, lam = YOUNG / (2 * (1 + POISSON)), YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
    alpha = np.sqrt(2 / 3) * 2 * np.sin(ANGLE) / (3 - np.sin(ANGLE))
    volume = CELL**3 / PER_CELL
    mass = DENSITY * volume
    x, v = (ti.Vector.field(3, ti.f32, n) for _ in range(2))
    C, F = (ti.Matrix.field(3, 3, ti.f32, n) for _ in range(2))
    gained, grid_v, grid_m = ti.field(ti.f32, n), ti.Vector.field(3, ti.f32, nodes), ti.field(ti.f32, nodes)
    x.from_numpy((places + shift).astype(np.float32))
    F.from_numpy(np.tile(np.eye(3, dtype=np.float32), (n, 1, 1)))

    @ti.kernel
    def step(dt: ti.f32):
        for node in ti.grouped(grid_m):
            grid_v[node] = ti.Vector.zero(ti.f32, 3)
            grid_m[node] = 0.0
        for q in x:
            base = ti.cast(ti.floor(x[q] / CELL - 0.5), ti.i32)
            fx = x[q] / CELL - base
            w = [0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1) ** 2, 0.5 * (fx - 0.5) ** 2]
            trial = (ti.Matrix.identity(ti.f32, 3) + dt * C[q]) @ F[q]
            U, s, V = ti.svd(trial)
            e = ti.Vector([ti.log(s[0, 0]), ti.log(s[1, 1]), ti.log(s[2, 2])]) + gained[q] / 3
            dilation = e.sum()
            back = ti.Vector.zero(ti.f32, 3)
            gained[q] = ti.max(dilation, 0.0)
            if dilation < 0:
                shear = e - dilation / 3
                size = shear.norm()
                admissible = -alpha * (3 * lam + 2 * mu) / (2 * mu) * dilation
                back = e
                if size > admissible:
                    back = dilation / 3 + admissible / size * shear
            stretch, pull = ti.Matrix.zero(ti.f32, 3, 3), ti.Matrix.zero(ti.f32, 3, 3)
            for k in ti.static(range(3)):
                stretch[k, k] = ti.exp(back[k])
                pull[k, k] = 2 * mu * back[k] + lam * back.sum()
            F[q] = U @ stretch @ V.transpose()
            affine = mass * C[q] - dt * 4 / CELL**2 * volume * (U @ pull @ U.transpose())
            for i, j, k in ti.static(ti.ndrange(3, 3, 3)):
                offset = ti.Vector([i, j, k])
                weight = w[i][0] * w[j][1] * w[k][2]
                grid_v[base + offset] += weight * (mass * v[q] + affine @ ((offset - fx) * CELL))
                grid_m[base + offset] += weight * mass
        for node in ti.grouped(grid_m):
            if grid_m[node] > 0:
                u = grid_v[node] / grid_m[node]
                u[1] -= 9.81 * dt
                if node[1] <= floor and u[1] < 0:
                    across = ti.Vector([u[0], 0.0, u[2]])
                    size = across.norm()
                    u = across * ti.max(0.0, 1 + FRICTION * u[1] / ti.max(size, 1e-20))
                grid_v[node] = u
        for q in x:
            base = ti.cast(ti.floor(x[q] / CELL - 0.5), ti.i32)
            fx = x[q] / CELL - base
            w = [0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1) ** 2, 0.5 * (fx - 0.5) ** 2]
            new_v, new_C = ti.Vector.zero(ti.f32, 3), ti.Matrix.zero(ti.f32, 3, 3)
            for i, j, k in ti.static(ti.ndrange(3, 3, 3)):
                offset = ti.Vector([i, j, k])
                u = w[i][0] * w[j][1] * w[k][2] * grid_v[base + offset]
                new_v += u
                new_C += 4 / CELL * u.outer_product(offset - fx)
            v[q], C[q] = new_v, new_C
            x[q] += dt * new_v

    def advance() -> int:
        for _ in range(STEPS_IN_TAICHI):
            step(length)
        ti.sync()
        return STEPS_IN_TAICHI * n

    advance()
    walls, processors = timed(advance)
    assert np.isfinite(x.to_numpy()).all()
    return {"wall": min(walls), "wall_median": statistics.median(walls), "processor": min(processors) / threads}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--particles", type=int, default=200_000)
    parser.add_argument("--growth", action="store_true", help="from 1e4 to 2e6 particles, without Taichi")
    parser.add_argument("--without-taichi", action="store_true")
    options = parser.parse_args()
    if options.growth:
        rows = [cost(count, options.threads, SPAN) for count in GROWTH]
        for row in rows:
            print("  ".join(f"{name} {value:.5g}" for name, value in row.items()))
        total = np.log([row["particles"] * row["processor"] for row in rows])
        exponent = np.polyfit(np.log([row["particles"] for row in rows]), total, 1)[0]
        print(f"exponent {exponent:.3f}")
        return
    ours = cost(options.particles, options.threads)
    print("plait   " + "  ".join(f"{name} {value:.5g}" for name, value in ours.items()))
    if not options.without_taichi and find_spec("taichi"):
        theirs = cost_in_taichi(options.particles, options.threads, ours["step"])
        print("taichi  " + "  ".join(f"{name} {value:.5g}" for name, value in theirs.items()))
        print("ratio   " + "  ".join(f"{name} {theirs[name] / ours[name]:.2f}" for name in theirs))


if __name__ == "__main__":
    main()
