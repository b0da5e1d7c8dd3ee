"""Lists of the contacts that act, edge by edge."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.kernel
def count_acting(
    first: int,
    incident_first: wp.array(dtype=wp.int32),
    incident: wp.array(dtype=wp.int32),
    acts: wp.array(dtype=wp.int32),
    count_out: wp.array(dtype=wp.int32),
):
    """How many of an edge's pairs act; one edge an item."""
    edge = first + wp.tid()
    count = wp.int32(0)
    for at in range(incident_first[edge], incident_first[edge + 1]):
        count += acts[incident[at] / 2]
    count_out[edge] = count


@wp.kernel
def list_acting(
    first: int,
    incident_first: wp.array(dtype=wp.int32),
    incident: wp.array(dtype=wp.int32),
    acts: wp.array(dtype=wp.int32),
    acting_first: wp.array(dtype=wp.int32),
    acting_out: wp.array(dtype=wp.int32),
):
    """Each edge's pairs that act, in the order of `incident`; one edge an item."""
    edge = first + wp.tid()
    slot = acting_first[edge]
    if slot == acting_first[edge + 1]:
        return
    for at in range(incident_first[edge], incident_first[edge + 1]):
        if acts[incident[at] / 2] != 0:
            acting_out[slot] = incident[at]
            slot += 1
