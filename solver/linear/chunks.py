"""How sums over many items are divided, so that their bits depend on nothing but the number of items."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import warp as wp

LEAST, LEAST_CUDA = 256, 8
MOST_CHUNKS, MOST_CHUNKS_CUDA = 64, 1024


def chunk_size(count: int, device: wp.Device) -> int:
    """Items a chunk: few enough chunks that adding up their sums costs nothing, enough to share among threads."""
    if device.is_cuda:
        return max(LEAST_CUDA, -(-count // MOST_CHUNKS_CUDA))
    return max(LEAST, -(-count // MOST_CHUNKS))


def reader(array: wp.array) -> Callable[[], np.ndarray]:
    """What gives the array's present values on the host, asked often: on a CPU at no cost."""
    if array.device.is_cuda:
        return array.numpy
    view = array.numpy()
    return lambda: view
