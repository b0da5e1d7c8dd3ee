"""Contacts of strands that go past a node: the pair of edges beyond goes on with the forces that they had."""

from __future__ import annotations

import warp as wp

from plait.solver.strand_contact.meeting_kernels import Meetings

wp.set_module_options({"enable_backward": False})

ZERO = wp.constant(wp.float64(0.0))
ONE = wp.constant(wp.float64(1.0))


@wp.func
def find_pair(
    a: int,
    b: int,
    incident_first: wp.array(dtype=wp.int32),
    incident: wp.array(dtype=wp.int32),
    meetings: Meetings,
):
    """The pair of edges a and b, a first; -1 if there is none."""
    low = incident_first[a]
    high = incident_first[a + 1]
    while low < high:
        middle = (low + high) / 2
        edges = meetings.edges[incident[middle] / 2]
        if edges[1 - incident[middle] % 2] < b:
            low = middle + 1
        else:
            high = middle
    found = wp.int32(-1)
    if low < incident_first[a + 1]:
        pair = incident[low] / 2
        if meetings.edges[pair] == wp.vec2i(a, b):
            found = pair
    return found


@wp.func
def beyond(place: wp.float64):
    """Towards which neighbour of an edge its closest point is at its end: -1, 1; 0: neither."""
    return wp.where(place == ZERO, -1, wp.where(place == ONE, 1, 0))


@wp.kernel
def pass_on(
    first: int,
    incident_first: wp.array(dtype=wp.int32),
    incident: wp.array(dtype=wp.int32),
    meetings: Meetings,
):
    """A contact that has gone past a node leaves the forces held to the pair of edges beyond; one pair an item.

    It has where the closest point is at an edge's end, not touching, and edges that go on from there are nearer.
    """
    item = first + wp.tid()
    meetings.heir[item] = -1
    least = meetings.gap[item]
    if meetings.pressure[item] == ZERO or least <= ZERO:
        return
    edges = meetings.edges[item]
    of_a = beyond(meetings.place[item][0])
    of_b = beyond(meetings.place[item][1])
    heir = wp.int32(-1)
    for i in range(3):
        a = edges[0] + wp.where(i == 1, 0, of_a)
        b = edges[1] + wp.where(i == 0, 0, of_b)
        if a != edges[0] or b != edges[1]:
            pair = find_pair(a, b, incident_first, incident, meetings)
            if pair >= 0:
                near = meetings.gap[pair] <= meetings.slack[pair]
                if near and meetings.stiffness[pair] > ZERO and meetings.gap[pair] < least:
                    heir = pair
                    least = meetings.gap[pair]
    if heir >= 0:
        meetings.heir[item] = heir
        meetings.passed_pressure[item] = meetings.pressure[item]
        meetings.passed_traction[item] = meetings.traction[item]
        meetings.pressure[item] = ZERO
        meetings.traction[item] = wp.vec3d()


@wp.kernel
def inherit(
    first: int,
    incident_first: wp.array(dtype=wp.int32),
    incident: wp.array(dtype=wp.int32),
    meetings: Meetings,
):
    """Takes what neighbours have passed on; one pair an item."""
    item = first + wp.tid()
    if meetings.stiffness[item] == ZERO or meetings.gap[item] > meetings.slack[item]:
        return
    edges = meetings.edges[item]
    pressure = meetings.pressure[item]
    traction = meetings.traction[item]
    for i in range(9):
        if i != 4:
            pair = find_pair(edges[0] + i / 3 - 1, edges[1] + i % 3 - 1, incident_first, incident, meetings)
            if pair >= 0:
                if meetings.heir[pair] == item:
                    pressure += meetings.passed_pressure[pair]
                    traction += meetings.passed_traction[pair]
    meetings.pressure[item] = pressure
    meetings.traction[item] = traction
