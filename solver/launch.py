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
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from typing import Any

import warp as wp

from plait.solver.diagnostics import NoSuchDevice
from plait.solver.warp_start import start_warp

# Handing work to a thread and waiting for it takes some 50 us, that of 3000 skinned points, the unit of work.
MIN_WORK_A_THREAD = 4000


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
        ways = self._ways(count, work_per_item)
        if ways == 1:
            wp.launch(kernel, count, [0, *inputs], list(outputs), device=self.device)
            return
        self._load(kernel)

        def run(first: int, last: int) -> None:
            wp.launch(kernel, last - first, [first, *inputs], list(outputs), device=self.device)

        edges = [count * i // ways for i in range(ways + 1)]
        self._share([partial(run, first, last) for first, last in itertools.pairwise(edges)])

    def prepare(
        self,
        kernel: wp.Kernel,
        count: int,
        inputs: Sequence[Any],
        outputs: Sequence[Any] = (),
        *,
        work_per_item: int = 1,
    ) -> Callable[[], None]:
        """`launch` recorded once, to be run often: what is left of a launch's cost then is a fifth.

        Inputs are taken as they are now; arrays keep their places.
        """
        if count == 0:
            return lambda: None
        self._load(kernel)
        ways = self._ways(count, work_per_item)
        edges = [count * i // ways for i in range(ways + 1)]
        commands = [
            wp.launch(
                kernel, last - first, [first, *inputs], list(outputs), device=self.device, record_cmd=True
            ).launch
            for first, last in itertools.pairwise(edges)
        ]
        held = (inputs, outputs)  # a recorded launch knows only addresses

        def run(_held: Any = held) -> None:
            self.launches[self._stage] += 1
            self._share(commands)

        return run

    def _ways(self, count: int, work_per_item: int) -> int:
        return min(self.threads, count, max(1, count * work_per_item // MIN_WORK_A_THREAD))

    def _load(self, kernel: wp.Kernel) -> None:
        """Loads the kernel's module once, before threads could race for it."""
        if kernel.module not in self._loaded:
            wp.load_module(kernel.module, device=self.device)
            self._loaded.add(kernel.module)

    def _share(self, parts: Sequence[Callable[[], None]]) -> None:
        """Runs the parts, the last one here, the others each on a thread."""
        others = [self._pool.submit(part) for part in parts[:-1]]
        parts[-1]()
        for other in others:
            other.result()

    def close(self) -> None:
        if self._pool is not None:
            self._pool.shutdown()
