"""How sums over many items are divided, so that their bits depend on nothing but the number of items."""

from __future__ import annotations

import warp as wp

LEAST, LEAST_CUDA = 256, 8
MOST_CHUNKS, MOST_CHUNKS_CUDA = 64, 1024


def chunk_size(count: int, device: wp.Device) -> int:
    """Items a chunk: few enough chunks that adding up their sums costs nothing, enough to share among threads."""
    if device.is_cuda:
        return max(LEAST_CUDA, -(-count // MOST_CHUNKS_CUDA))
    return max(LEAST, -(-count // MOST_CHUNKS))
