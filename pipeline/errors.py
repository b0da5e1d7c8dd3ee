"""What a user is told when something is wrong: one line, and an exit code."""

from __future__ import annotations

from pathlib import Path

EXIT_DONE, EXIT_USAGE, EXIT_FAILED, EXIT_DIFFERS, EXIT_BAD_INPUT, EXIT_STOPPED = 0, 2, 3, 4, 5, 143


class PlaitError(Exception):
    """An error that ends a command with one line on stderr and `exit_code`."""

    exit_code = EXIT_FAILED


class UsageError(PlaitError):
    """A flag, a configuration key or a value that cannot be right."""

    exit_code = EXIT_USAGE


class InputError(PlaitError):
    """Bad input. Names the file, the prim path and the attribute, and what would mend it."""

    exit_code = EXIT_BAD_INPUT

    def __init__(
        self, problem: str, *, file: str | Path, prim: str = "", attribute: str = "", mend: str = ""
    ) -> None:
        place = f"{file}" + (f" <{prim}>" if prim else "") + (f" {attribute}" if attribute else "")
        super().__init__(f"{place}: {problem}" + (f"; {mend}" if mend else ""))
        self.file, self.prim, self.attribute = str(file), prim, attribute
