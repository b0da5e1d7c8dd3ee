"""The paper's contact rule beside the default, on the same scenes.

    python tests/benchmarks/contact_rules.py

Elasticity is stepped by symplectic Euler in float64, so that what is lost or gained is contact's doing.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from plait.solver.scene import Scene
from tests.solver.contact.explicit import Explicit
from tests.solver.tets.lattices import box_body, placed

RULES = ("none", "paper", "pairwise")
CUBE = {"size": (0.1, 0.1, 0.1), "cells": 4, "youngs_modulus": 1e5, "friction": 0.3}
LONE_STEPS = 400


def _boxes(*specs: dict[str, Any], gravity: float = 0.0) -> Scene:
    made = [box_body(index=i, surface=i, name=f"box {i}", **spec) for i, spec in enumerate(specs)]
    bodies, skins = zip(*made, strict=True)
    return Scene(surfaces=skins, bodies=bodies, gravity=np.array([0.0, -gravity, 0.0]))


def _start(scene: Scene, rule: str, ratio: float = 1.0, **more: Any) -> Explicit:
    """ratio: grid cells per mean edge of the tets."""
    if rule == "none":
        return Explicit(scene, contact=False, **more)
    edge = float(Explicit(scene, contact=False).layout.edge.mean())
    return Explicit(scene, rule=rule, cell_size=ratio * edge, **more)


def _lone(rule: str, motion: str) -> dict[str, float]:
    """A lone bar, spinning at 2 turns a second or vibrating: what is left of energy and angular momentum."""
    body = _start(_boxes({**CUBE, "size": (0.3, 0.1, 0.1), "cells": (6, 2, 2)}), rule)
    x = body.position
    if motion == "spin":
        body.velocity[:] = np.cross([0.0, 4.0 * np.pi, 0.0], x)
    else:
        body.velocity[:, 0] = np.sin(np.pi * x[:, 0] / 0.3)
    energy, spin, step = body.energy(), np.linalg.norm(body.angular_momentum()), body.wave_step(0.3)
    for _ in range(LONE_STEPS):
        body.step(step)
    found = {"energy": body.energy() / energy}
    if motion == "spin":
        found["angular_momentum"] = float(np.linalg.norm(body.angular_momentum()) / spin)
    return found


def _oblique(rule: str) -> dict[str, float]:
    """Two blocks meet at an angle: relative errors of both momenta, and the largest energy over that before."""
    axis = np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0)
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    rotation = np.eye(3) + np.sin(0.44) * cross + (1.0 - np.cos(0.44)) * cross @ cross
    pair = _start(_boxes(CUBE, {**CUBE, "transform": placed((0.03, 0.135, 0.02), rotation)}), rule)
    pair.velocity[pair.nodes(1)] = [0.2, -1.0, 0.1]
    momentum, spin, energy = pair.momentum(), pair.angular_momentum(), pair.energy()
    step, most = pair.wave_step(0.3), 0.0
    while pair.time < 0.12:
        pair.step(step)
        most = max(most, pair.energy() / energy)
    return {
        "momentum_error": float(np.abs(pair.momentum() - momentum).max() / np.linalg.norm(momentum)),
        "angular_momentum_error": float(np.abs(pair.angular_momentum() - spin).max() / np.linalg.norm(spin)),
        "largest_energy": most,
    }


def _bars(rule: str, ratio: float) -> dict[str, float]:
    """Equal bars head on: relative speed after over before, and how long they touch over 2 L / c."""
    length, young, speed = 1.0, 1e6, 0.5
    bar = {"size": (length, 0.1, 0.1), "cells": (20, 2, 2), "youngs_modulus": young, "poissons_ratio": 0.0}
    # The paper's grid acts at a distance, so the bars start three cells apart.
    bars = _start(_boxes(bar, {**bar, "transform": placed((length + 0.25, 0.0, 0.0))}), rule, ratio)
    bars.velocity[bars.nodes(0), 0], bars.velocity[bars.nodes(1), 0] = speed / 2, -speed / 2
    step, period, mass = bars.wave_step(0.5), 2.0 * length / np.sqrt(young / 1000.0), bars.layout.mass
    first, second = bars.nodes(0), bars.nodes(1)
    times, speeds = [], []
    while bars.time < 0.25 / speed + 2.5 * period:
        bars.step(step)
        times.append(bars.time)
        speeds.append(np.average(bars.velocity[second, 0], weights=mass[second]))
    change = np.abs(np.diff(speeds))
    # While momentum passes from one to the other, but for the last thousandth on either side.
    passed = np.cumsum(change) / max(change.sum(), 1e-300)
    touching = np.flatnonzero((passed > 1e-3) & (passed < 1.0 - 1e-3))
    after = speeds[-1] - np.average(bars.velocity[first, 0], weights=mass[first])
    return {"rebound": after / speed, "contact_time": len(touching) * step / period}


def _resting(rule: str, ratio: float) -> dict[str, float]:
    """A soft block on a held one: the least and the largest gap of its underside, in cells."""
    held = np.ones(5**3 + 4**3, dtype=bool)
    scene = _boxes(
        {**CUBE, "youngs_modulus": 3e4, "transform": placed((0.012, 0.1005, 0.007))},
        {**CUBE, "size": (0.14, 0.1, 0.14), "pinned": held},
        gravity=9.81,
    )
    pair = _start(scene, rule, ratio, damping=20.0)
    block, step = pair.nodes(0), pair.wave_step(0.5)
    low = np.isclose(pair.layout.rest[block, 1], pair.layout.rest[block, 1].min())
    while pair.time < 0.6:
        pair.step(step)
        if not np.isfinite(pair.position).all() or np.abs(pair.position).max() > 10.0:
            return {"diverged_after": pair.time}
    gap = (pair.position[block][low, 1] - 0.05) / pair.contact.cell_size
    return {"least_gap": float(gap.min()), "largest_gap": float(gap.max())}


def measure() -> dict[str, Any]:
    """All scenes under all rules."""
    rows = []
    for rule in RULES:
        row: dict[str, Any] = {"rule": rule, "spin": _lone(rule, "spin"), "vibration": _lone(rule, "vibration")}
        if rule != "none":
            row["oblique"] = _oblique(rule)
            row["bars"] = {str(ratio): _bars(rule, ratio) for ratio in (0.25, 0.5, 1.0, 2.0)}
            row["resting"] = {str(ratio): _resting(rule, ratio) for ratio in (0.5, 2.0)}
        rows.append(row)
    return {"rows": rows}


def table(held: dict[str, Any]) -> list[str]:
    """Lines of Markdown, of what `measure` found, under the key 'contact'."""
    rows = {row["rule"]: row for row in held["contact"]["rows"]}
    paper, default = rows["paper"], rows["pairwise"]

    def line(what: str, *cells: str) -> str:
        return f"| {what} | " + " | ".join(cells) + " |"

    def each(what: str, cell: Any) -> str:
        return line(what, "", cell(paper), cell(default))

    lines = [
        "| one scene under each contact rule | no contact | Han 2019 (20)-(25) | pairwise, the default |",
        "|---|---|---|---|",
        line(
            f"lone bar spinning, {LONE_STEPS} steps: energy, angular momentum left",
            *(f"{row['spin']['energy']:.4f}, {row['spin']['angular_momentum']:.4f}" for row in rows.values()),
        ),
        line("lone bar vibrating: energy left", *(f"{row['vibration']['energy']:.4f}" for row in rows.values())),
        each("oblique impact: error of momentum", lambda row: f"{row['oblique']['momentum_error']:.1e}"),
        each("of angular momentum", lambda row: f"{row['oblique']['angular_momentum_error']:.1e}"),
        each("largest energy over that before", lambda row: f"{row['oblique']['largest_energy']:.3f}"),
    ]
    for ratio in paper["bars"]:
        lines.append(
            each(
                f"equal bars, dx = {ratio} h: rebound; contact time over 2L/c",
                lambda row, ratio=ratio: "{rebound:.3f}; {contact_time:.2f}".format(**row["bars"][ratio]),
            )
        )
    for ratio in paper["resting"]:
        lines.append(
            each(
                f"soft block at rest, dx = {ratio} h: gap in cells",
                lambda row, ratio=ratio: _gap(row["resting"][ratio]),
            )
        )
    return lines


def _gap(found: dict[str, float]) -> str:
    if "diverged_after" in found:
        return f"explodes after {found['diverged_after']:.2f} s"
    return "{least_gap:.2f} to {largest_gap:.2f}".format(**found)


if __name__ == "__main__":
    print("\n".join(table({"contact": measure()})))
