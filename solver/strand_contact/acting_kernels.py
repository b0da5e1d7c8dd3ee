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
    all_out: wp.array(dtype=wp.int32),
    leading_out: wp.array(dtype=wp.int32),
):
    """How many of an edge's pairs act, and of those in which it is the first; one edge an item."""
    edge = first + wp.tid()
    count = wp.int32(0)
    leading = wp.int32(0)
    for at in range(incident_first[edge], incident_first[edge + 1]):
        if acts[incident[at] / 2] != 0:
            count += 1
            leading += 1 - incident[at] % 2
    all_out[edge] = count
    leading_out[edge] = leading


@wp.kernel
def list_acting(
    first: int,
    incident_first: wp.array(dtype=wp.int32),
    incident: wp.array(dtype=wp.int32),
    acts: wp.array(dtype=wp.int32),
    all_first: wp.array(dtype=wp.int32),
    leading_first: wp.array(dtype=wp.int32),
    acting_out: wp.array(dtype=wp.int32),
    pairs_out: wp.array(dtype=wp.int32),
):
    """The pairs that act, by their first edges; and each edge's, in the order of `incident`; one edge an item."""
    edge = first + wp.tid()
    slot = all_first[edge]
    leading = leading_first[edge]
    for at in range(incident_first[edge], incident_first[edge + 1]):
        if acts[incident[at] / 2] != 0:
            acting_out[slot] = incident[at]
            slot += 1
            if incident[at] % 2 == 0:
                pairs_out[leading] = incident[at] / 2
                leading += 1
