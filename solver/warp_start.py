"""Starts Warp quietly: no banner, and no word on a machine that simply has no CUDA."""

from __future__ import annotations

import os
import sys
import tempfile

import warp as wp

_NO_CUDA = b"Could not find or load the NVIDIA CUDA driver"


def start_warp() -> None:
    """Initialises Warp once. What it prints meanwhile is passed on, but for the line on absent CUDA."""
    wp.config.log_level = wp.LOG_WARNING
    sys.stderr.flush()
    kept = os.dup(2)
    try:
        with tempfile.TemporaryFile() as caught:
            os.dup2(caught.fileno(), 2)
            try:
                wp.init()
            finally:
                os.dup2(kept, 2)
                caught.seek(0)
                lines = [line for line in caught if _NO_CUDA not in line]
        os.write(2, b"".join(lines))
    finally:
        os.close(kept)
