"""What can go wrong while solving, said so that a user can act on it."""

from __future__ import annotations


class Diverged(RuntimeError):  # noqa: N818 - reads as what happened
    """A state that is not finite. Carries what, where and when; the frames before stand.

    what: a quantity ('position').  where: prim path and element ('/World/hair strand 12').  time: [s].
    """

    def __init__(self, what: str, where: str, time: float) -> None:
        super().__init__(f"{what} of {where} is not finite at {time:.6g} s")
        self.what, self.where, self.time = what, where, time


class Refused(ValueError):  # noqa: N818
    """A scene the solver cannot take, naming the prim and what would mend it."""


class NoSuchDevice(ValueError):  # noqa: N818
    """A device that this machine does not have, naming those it has."""
