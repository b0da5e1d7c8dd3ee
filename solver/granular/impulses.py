"""What a contact bore in the last step, for the next one to begin with."""

from __future__ import annotations

import numpy as np

# Cells are numbered by 21 bits a direction, from the middle.
BITS = 21


class Memory:
    """Impulses at nodes of the grid, through the renumbering of its nodes.

    Entries are told apart by their cell and by what they touch.
    """

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        self._held: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    def keep(self, cells: np.ndarray, touched: np.ndarray, impulses: np.ndarray) -> None:
        """cells: (n, 3) int.  touched: (n,) int.  impulses: (n, 3) [kg m/s]."""
        self.forget()
        keys = _keys(cells)
        for other in np.unique(touched):
            own = np.flatnonzero(touched == other)
            own = own[np.argsort(keys[own])]
            self._held[int(other)] = keys[own], impulses[own]

    def recall(self, cells: np.ndarray, touched: np.ndarray) -> np.ndarray:
        """(n, 3) [kg m/s]; zero for what is new."""
        keys, recalled = _keys(cells), np.zeros((len(cells), 3))
        for other in np.unique(touched):
            if int(other) in self._held:
                own = np.flatnonzero(touched == other)
                held, impulses = self._held[int(other)]
                at = np.minimum(np.searchsorted(held, keys[own]), len(held) - 1)
                known = held[at] == keys[own]
                recalled[own[known]] = impulses[at[known]]
        return recalled


def _keys(cells: np.ndarray) -> np.ndarray:
    shifted = cells.astype(np.int64) + (1 << (BITS - 1))
    return (shifted[:, 0] << (2 * BITS)) + (shifted[:, 1] << BITS) + shifted[:, 2]
