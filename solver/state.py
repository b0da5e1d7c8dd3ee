"""All that changes during a run, and nothing else: what a checkpoint holds."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import warp as wp


@dataclass
class State:
    """Time and the stages' device arrays, by name ('strands/position').

    Stages allocate here in `build` and keep no other memory from one substep to the next, so that a saved state,
    loaded again, continues the run bit for bit on the same device and thread count.
    """

    time: float = 0.0
    arrays: dict[str, wp.array] = field(default_factory=dict)

    def to_numpy(self) -> dict[str, np.ndarray]:
        """A copy on the host, `time` included."""
        held = {name: array.numpy().copy() for name, array in self.arrays.items()}
        return held | {"time": np.float64(self.time)}

    def restore(self, held: dict[str, np.ndarray]) -> None:
        """Takes up what `to_numpy` gave; raises KeyError or ValueError if it is of another scene."""
        missing = self.arrays.keys() - held.keys()
        if missing:
            raise KeyError(f"the checkpoint lacks {', '.join(sorted(missing))}")
        for name, array in self.arrays.items():
            if array.numpy().shape != held[name].shape:
                raise ValueError(f"{name}: {held[name].shape} in the checkpoint, {array.shape} in the scene")
        for name, array in self.arrays.items():
            array.assign(held[name])
        self.time = float(held["time"])
