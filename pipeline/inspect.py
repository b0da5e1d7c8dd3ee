"""What each prim of a shot will be, how that was recognised, how large it is, what is skipped and why."""

from __future__ import annotations

import json
import sys
from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import Any

from plait.pipeline.config import Config
from plait.pipeline.read import read_shot
from plait.pipeline.read.roles import SIMULATED
from plait.pipeline.shot import INTERPOLATED, PrimReport, Shot
from plait.solver.build import FEATURES


def show(path: Path, config: Config, as_json: bool = False) -> None:
    """Prints the report. Nothing is compiled, filled or simulated. Raises as `read_shot` does."""
    shot = read_shot(path, config, fill=False)
    if as_json:
        json.dump(as_data(shot), sys.stdout, indent=2)
        sys.stdout.write("\n")
    else:
        _print(shot)


def as_data(shot: Shot) -> dict[str, Any]:
    """The report as JSON-ready data."""
    info, scene = shot.info, shot.scene
    return {
        "file": str(info.path),
        "meters_per_unit": info.meters_per_unit,
        "up_axis": info.up_axis,
        "time_codes_per_second": info.time_codes_per_second,
        "start": info.start,
        "end": info.end,
        "gravity": [float(g) for g in scene.gravity],
        "stages": stages(shot),
        "sizes": totals(shot),
        "prims": [asdict(prim) for prim in shot.prims],
        "warnings": list(shot.warnings),
    }


def stages(shot: Shot) -> list[str]:
    """What `sim` will run, in order; nothing for a shot of which nothing is simulated."""
    return [name for name, _, needed in FEATURES if needed(shot.scene)]


def totals(shot: Shot) -> dict[str, int]:
    """Sizes of the scene."""
    scene = shot.scene
    return {
        "strands": sum(strands.strand_count for strands in scene.strands),
        "strand points": sum(len(strands.points) for strands in scene.strands),
        "interpolated strands": sum(len(o.followers.strands) for o in shot.curves if o.followers is not None),
        "attached points": sum(len(attachment.point) for attachment in scene.attachments),
        "bodies of flesh": len(scene.bodies),
        "rigid bodies": len(scene.rigid_bodies),
        "joints": len(scene.joints),
        "grains": sum(count for prim in shot.prims for name, count in prim.sizes.items() if "grains" in name),
        "colliders": sum(surface.collides for surface in scene.surfaces),
        "collider triangles": sum(len(s.triangles) for s in scene.surfaces if s.collides),
        "moving colliders": sum(s.collides and s.motion.animated for s in scene.surfaces),
    }


def _print(shot: Shot) -> None:
    from rich.console import Console
    from rich.markup import escape

    console = Console(highlight=False, soft_wrap=True)
    info = shot.info
    console.print(f"[bold]{escape(str(info.path))}[/]")
    console.print(
        f"{info.start:g} to {info.end:g} at {info.time_codes_per_second:g} per second, "
        f"{info.meters_per_unit:g} m per unit, {info.up_axis} up"
    )
    width = max((len(prim.role) for prim in shot.prims), default=0)
    for prim in shot.prims:
        colour = (
            {"skipped": "dim", **dict.fromkeys((*SIMULATED, INTERPOLATED), "green")}.get(prim.role, "cyan")
            if prim.supported
            else "red"
        )
        console.print(f"  [{colour}]{prim.role:{width}}[/]  {escape(prim.path)}  [dim]{escape(_size(prim))}[/]")
        console.print(f"  {'':{width}}    {escape(_why(prim))}")
    roles = ", ".join(f"{count} {role}" for role, count in Counter(p.role for p in shot.prims).most_common())
    console.print(f"prims: {roles or 'none that could take part'}")
    console.print(f"scene: {', '.join(f'{count} {name}' for name, count in totals(shot).items())}")
    console.print(f"stages: {', '.join(stages(shot)) or 'none, there is nothing to simulate'}")
    for warning in shot.warnings:
        console.print(f"[yellow]warning:[/] {escape(warning)}")


def _size(prim: PrimReport) -> str:
    sizes = ", ".join(f"{count} {name}" for name, count in prim.sizes.items())
    return f"{prim.type_name}, {sizes}" if sizes else prim.type_name


def _why(prim: PrimReport) -> str:
    """How it was recognised, where its strands grow, what holds them, why it is skipped or will be refused."""
    refused = "" if prim.supported else "sim refuses it without --skip-unsupported"
    roots = f"roots: {prim.roots}" if prim.roots else ""
    held = [f"attached: {words}" for words in prim.attachments]
    guides = f"guides: {prim.guides}" if prim.guides else ""
    return "; ".join(part for part in (prim.recognised, roots, guides, *held, prim.reason, refused) if part)
