"""Kernel launches: split over threads on the CPU, counted, timed by stage.

`wp.launch` on a CPU is one serial loop that releases the GIL, so two Python threads on disjoint items run
nearly twice as fast. Every kernel launched here therefore takes `first: int` as its first argument and works on
item `first + wp.tid()`; items must not share what they write.
"""

from __future__ import annotations

import itertools
import os
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import warp as wp

from plait.solver.diagnostics import NoSuchDevice
from plait.solver.warp_start import start_warp

# Handing work to a thread and waiting for it takes 30 to 60 us, that of 2500 skinned points, the unit of work.
MIN_WORK_A_THREAD = 2500


class Launcher:
    """Issues kernels on one device; the only place that calls `wp.launch`.

    Raises NoSuchDevice. Attributes: `launches` and `seconds`, counters keyed by stage name.
    """

    def __init__(self, device: str = "cpu", threads: int = 0) -> None:
        start_warp()
        try:
            self.device = wp.get_device(device)
        except ValueError as error:
            there = ", ".join(found.alias for found in wp.get_devices())
            raise NoSuchDevice(f"device {device}: not on this machine, which has {there}") from error
        self.threads = (threads or os.cpu_count() or 1) if self.device.is_cpu else 1
        self.launches: Counter[str] = Counter()
        self.seconds: Counter[str] = Counter()
        self._stage = "build"
        self._loaded: set[wp.Module] = set()
        self._pool = ThreadPoolExecutor(self.threads - 1) if self.threads > 1 else None

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Charges the launches and seconds within to `name`."""
        outer, self._stage = self._stage, name
        started = time.perf_counter()
        try:
            yield
            if self.device.is_cuda:
                wp.synchronize_device(self.device)
        finally:
            self.seconds[name] += time.perf_counter() - started
            self._stage = outer

    def launch(
        self,
        kernel: wp.Kernel,
        count: int,
        inputs: Sequence[Any],
        outputs: Sequence[Any] = (),
        *,
        work_per_item: int = 1,
    ) -> None:
        """Runs `kernel` for items 0 to count - 1; nothing at all when count is 0.

        work_per_item: rough cost of one item in units of a skinned point's, about 15 ns; with less than
        `MIN_WORK_A_THREAD` for each thread, splitting costs more than it gains.
        """
        if count == 0:
            return
        self.launches[self._stage] += 1
        ways = min(self.threads, count, max(1, count * work_per_item // MIN_WORK_A_THREAD))
        if ways == 1:
            wp.launch(kernel, count, [0, *inputs], list(outputs), device=self.device)
            return
        if kernel.module not in self._loaded:  # once, before threads could race for it
            wp.load_module(kernel.module, device=self.device)
            self._loaded.add(kernel.module)
        edges = [count * i // ways for i in range(ways + 1)]

        def run(first: int, last: int) -> None:
            wp.launch(kernel, last - first, [first, *inputs], list(outputs), device=self.device)

        others = [self._pool.submit(run, first, last) for first, last in itertools.pairwise(edges[:-1])]
        run(*edges[-2:])
        for other in others:
            other.result()

    def close(self) -> None:
        if self._pool is not None:
            self._pool.shutdown()
