"""Room for the solve's working sets."""

from __future__ import annotations

from typing import Any

import warp as wp

from plait.solver.contact.planes import PLANES_A_NODE
from plait.solver.launch import Launcher
from plait.solver.strands.layout import Layout
from plait.solver.strands.types import rod_types

# Chunks of strands a thread works through, one strand's scratch each: a few, so that threads end together.
CHUNKS_A_THREAD = 8


def count_chunks(strand_count: int, launcher: Launcher) -> int:
    """Into how many chunks to divide so many strands: one a thread on a GPU, a few a thread on a CPU."""
    return strand_count if launcher.device.is_cuda else min(strand_count, CHUNKS_A_THREAD * launcher.threads)


def allocate_scratch(real: type, layout: Layout, chunks: int, device: wp.Device) -> Any:
    """`Scratch` for `chunks` strands at a time, each as long as the longest."""
    longest = int((layout.first_node[1:] - layout.first_node[:-1]).max())
    size = longest * chunks
    scratch = _allocate(real, size, device)
    types = rod_types(real)
    for name, dtype in (("factor", types.mat44), ("lower1", types.mat44), ("lower2", types.mat43)):
        setattr(scratch, name, wp.zeros(size, dtype=dtype, device=device))
    # On a GPU, neighbouring threads read neighbouring entries; on a CPU a strand is one run.
    scratch.chunk_stride, scratch.node_stride = (1, chunks) if device.is_cuda else (longest, 1)
    return scratch


def allocate_coupled_scratch(real: type, node_count: int, device: wp.Device) -> Any:
    """`Scratch` that holds all strands at once, entry k of a strand at its node k, and what meetings need."""
    types = rod_types(real)
    scratch = _allocate(real, node_count, device)
    for name, dtype in (
        ("right", types.vec4),
        ("inverse", types.mat44),
        ("left1", types.mat44),
        ("left2", types.mat44),
        ("meeting_block", types.mat33),
        ("meeting_lower", types.mat33),
        ("meeting_gradient", types.vec3),
    ):
        setattr(scratch, name, wp.zeros(node_count, dtype=dtype, device=device))
    return scratch


def _allocate(real: type, size: int, device: wp.Device) -> Any:
    types = rod_types(real)
    scratch = types.Scratch()
    vectors = ("start", "start_velocity", "stage_velocity", "start_of_stage", "target", "start_director")
    turns = ("start_spin", "stage_spin", "turn_of_stage", "turn_target")
    fields = {
        types.vec3: (*vectors, "position", "director", "tangent"),
        real: ("length", "inverse_length", "twist", "tension", *turns),
        types.vec4: ("solution",),
    }
    for dtype, names in fields.items():
        for name in names:
            setattr(scratch, name, wp.zeros(size, dtype=dtype, device=device))
    scratch.pressure = wp.zeros(size * PLANES_A_NODE, dtype=real, device=device)
    return scratch
