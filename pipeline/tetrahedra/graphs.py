"""Connected components of a graph, in numpy alone."""

from __future__ import annotations

import numpy as np


def components(count: int, pairs: np.ndarray) -> np.ndarray:
    """(count,) int64: for each vertex the number of its component, in the order of their first vertices.

    pairs: (n, 2), edges. Labels are lowered along edges and shortened to their roots in turn, which takes a number
    of rounds about the logarithm of the longest path (Shiloach & Vishkin 1982).
    """
    parent = np.arange(count)
    a, b = (np.asarray(pairs, dtype=np.int64).reshape(-1, 2)).T
    while len(a):
        low, high = np.minimum(parent[a], parent[b]), np.maximum(parent[a], parent[b])
        np.minimum.at(parent, high, low)
        while True:
            shorter = parent[parent]
            if np.array_equal(shorter, parent):
                break
            parent = shorter
        apart = parent[a] != parent[b]
        a, b = a[apart], b[apart]
    _, labels = np.unique(parent, return_inverse=True)
    return labels


def chains(group: np.ndarray, member: np.ndarray) -> np.ndarray:
    """Pairs (n, 2) that chain the members of each group together."""
    order = np.argsort(group, kind="stable")
    group, member = group[order], member[order]
    alike = group[1:] == group[:-1]
    return np.stack([member[:-1][alike], member[1:][alike]], axis=1)
