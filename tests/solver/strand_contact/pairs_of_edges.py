"""Layouts and pairs of moving edges for the tests of the broad phase and the continuous tests."""

from __future__ import annotations

from types import SimpleNamespace

import ipctk
import numpy as np

# Its usual answers keep a part of the starting distance, 1 less the rescaling; here a touch is asked for.
TIGHT_INCLUSION = ipctk.TightInclusionCCD(conservative_rescaling=1.0 - 1e-6)


def layout_of(strands: list[np.ndarray]) -> SimpleNamespace:
    """What of a `Layout` concerns pairs, of strands given by their points (count, 3) [m]."""
    nodes = [np.vstack([2.0 * x[0] - x[1], x]) for x in strands]
    lengths = [np.append(np.linalg.norm(np.diff(x, axis=0), axis=1), 1.0) for x in nodes]
    first_node = np.cumsum([0] + [len(x) for x in nodes]).astype(np.int32)
    return SimpleNamespace(
        first_node=first_node,
        node_strand=np.repeat(np.arange(len(nodes)), np.diff(first_node)).astype(np.int32),
        position=np.concatenate(nodes),
        edge_length=np.concatenate(lengths),
        node_count=int(first_node[-1]),
        strand_count=len(nodes),
        radius=np.zeros(int(first_node[-1])),
    )


def random_motions(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Ends of pairs of edges about 1 long, (count, 4, 3) at start and end; slow, fast, far, thin and near ones."""
    random = np.random.default_rng(seed)
    start = random.uniform(-1.0, 1.0, (count, 4, 3))
    kind = np.arange(count) % 4
    thin = kind == 1  # nearly parallel edges
    start[thin, 3] = start[thin, 2] + start[thin, 1] - start[thin, 0]
    start[thin, 3] += 10.0 ** random.uniform(-8, -1, (thin.sum(), 1)) * random.standard_normal((thin.sum(), 3))
    end = start + 10.0 ** random.uniform(-3, 1.5, (count, 1, 1)) * random.standard_normal((count, 4, 3))
    through = kind == 2  # edge b moves as a whole, past the middle of a or through it
    way = np.diff(start[through].reshape(-1, 2, 2, 3).mean(axis=2), axis=1)
    way += 0.3 * random.standard_normal(way.shape)
    end[through, :2], end[through, 2:] = start[through, :2], start[through, 2:] - 2.0 * way
    together = kind == 3  # 20 segments a substep together, little apart
    end[together] = start[together] + 20.0 + 0.3 * random.standard_normal((together.sum(), 4, 3))
    return start, end


def tight_inclusion(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """(count,) bool: whether TightInclusion (Wang et al. 2021) finds that the edges touch.

    It misses none; edges about 1 long that come within about 1e-6 of each other may count.
    """
    return np.array([TIGHT_INCLUSION.edge_edge_ccd(*p, *q)[0] for p, q in zip(start, end, strict=True)])
