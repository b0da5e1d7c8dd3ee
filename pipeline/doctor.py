"""Checks of the machine, so that a farm's worker can be judged before a shot fails on it."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path

from plait.pipeline.provenance import versions


def show() -> bool:
    """Prints a line a check; returns False if simulating would not work here."""
    for name, text in versions().items():
        print(f"      {name} {text}")
    checks: tuple[tuple[str, Callable[[], str], bool], ...] = (
        ("USD reads and writes", _usd, True),
        ("kernels compile and run", _kernels, True),
        ("CUDA devices", _cuda, False),
        ("pictures off screen", _drawing, False),
        ("cores and memory", _machine, False),
    )
    fine = True
    for name, check, needed in checks:
        try:
            print(f"ok    {name}: {check()}")
        except Exception as error:
            print(f"{'FAIL' if needed else 'none'}  {name}: {error}".replace("\n", " "))
            fine = fine and not needed
    return fine


def _usd() -> str:
    from pxr import Usd, UsdGeom

    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder) / "probe.usdc")
        stage = Usd.Stage.CreateNew(path)
        UsdGeom.BasisCurves.Define(stage, "/probe")
        stage.Save()
        opened = Usd.Stage.Open(path)
        if not opened.GetPrimAtPath("/probe"):
            raise RuntimeError("a saved prim is gone on opening")
    return ".".join(str(part) for part in Usd.GetVersion()[1:])


def _kernels() -> str:
    import warp as wp

    from plait.solver.warp_start import start_warp

    start_warp()

    @wp.kernel(enable_backward=False, module="plait_doctor")
    def double(values: wp.array(dtype=float)):
        values[wp.tid()] *= 2.0

    values = wp.ones(4, dtype=float, device="cpu")
    wp.launch(double, 4, [values], device="cpu")
    if values.numpy().sum() != 8.0:
        raise RuntimeError("a kernel gave a wrong answer")
    return f"cache in {wp.config.kernel_cache_dir}"


def _cuda() -> str:
    import warp as wp

    names = [f"{device.alias} {device.name}" for device in wp.get_cuda_devices()]
    if not names:
        raise RuntimeError("none; the CPU is used")
    return ", ".join(names)


def _drawing() -> str:
    from plait.pipeline import preview

    return preview.probe()


def _machine() -> str:
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    return f"{os.cpu_count()} cores, {memory:.0f} GiB"
