"""Bodies that touch each other or are joined, gathered."""

from __future__ import annotations

import warp as wp

from plait.solver.rigid.joint_pose_kernels import Joints
from plait.solver.rigid.types import Contacts, Geoms

wp.set_module_options({"enable_backward": False})


@wp.struct
class Islands:
    """Bodies that touch each other or are joined, under the one of least index."""

    root: wp.array(dtype=wp.int32)  # (body_count,)
    body_begin: wp.array(dtype=wp.int32)  # (body_count + 1,), by root
    body: wp.array(dtype=wp.int32)
    contact_begin: wp.array(dtype=wp.int32)
    contact: wp.array(dtype=wp.int32)
    joint_begin: wp.array(dtype=wp.int32)
    joint: wp.array(dtype=wp.int32)


@wp.func
def find_root(root: wp.array(dtype=wp.int32), b: int) -> int:
    r = b
    while root[r] != r:
        root[r] = root[root[r]]
        r = root[r]
    return r


@wp.func
def unite(root: wp.array(dtype=wp.int32), a: int, b: int):
    p = find_root(root, a)
    q = find_root(root, b)
    if p < q:
        root[q] = p
    else:
        root[p] = q


@wp.func
def one_of(pair: wp.vec2i) -> int:
    return wp.where(pair[0] >= 0, pair[0], pair[1])


@wp.func
def sum_up(begin: wp.array(dtype=wp.int32), count: int):
    """Counts become where each run begins; see `take_place`."""
    total = wp.int32(0)
    for b in range(count + 1):
        here = begin[b]
        begin[b] = total
        total += here


@wp.func
def take_place(begin: wp.array(dtype=wp.int32), r: int) -> int:
    """The next of a run, whose beginning moves on, in the end to its end: the beginning of the next."""
    at = begin[r]
    begin[r] = at + 1
    return at


@wp.func
def unite_all(root: wp.array(dtype=wp.int32), geoms: Geoms, contacts: Contacts, joints: Joints, joint_count: int):
    """Bodies that touch or are joined have one root, from each being its own."""
    for a in range(geoms.count):
        for k in range(geoms.first_slot[a], geoms.first_slot[a] + contacts.count[a]):
            pair = contacts.body[k]
            if pair[0] >= 0 and pair[1] >= 0:
                unite(root, pair[0], pair[1])
    for j in range(joint_count):
        pair = joints.body[j]
        if pair[0] >= 0 and pair[1] >= 0:
            unite(root, pair[0], pair[1])


@wp.kernel
def find_islands(
    first: int,
    geoms: Geoms,
    contacts: Contacts,
    joints: Joints,
    joint_count: int,
    body_count: int,
    islands: Islands,
):
    """One item in all: passes over bodies, contacts and joints that are short beside the solve."""
    if first + wp.tid() > 0:
        return
    root = islands.root
    for b in range(body_count + 1):
        islands.body_begin[b] = 0
        islands.contact_begin[b] = 0
        islands.joint_begin[b] = 0
    for b in range(body_count):
        root[b] = b
    unite_all(root, geoms, contacts, joints, joint_count)
    for b in range(body_count):
        root[b] = find_root(root, b)
        islands.body_begin[root[b]] += 1
    for a in range(geoms.count):
        for k in range(geoms.first_slot[a], geoms.first_slot[a] + contacts.count[a]):
            islands.contact_begin[root[one_of(contacts.body[k])]] += 1
    for j in range(joint_count):
        islands.joint_begin[root[one_of(joints.body[j])]] += 1
    sum_up(islands.body_begin, body_count)
    sum_up(islands.contact_begin, body_count)
    sum_up(islands.joint_begin, body_count)
    for b in range(body_count):
        islands.body[take_place(islands.body_begin, root[b])] = b
    for a in range(geoms.count):
        for k in range(geoms.first_slot[a], geoms.first_slot[a] + contacts.count[a]):
            islands.contact[take_place(islands.contact_begin, root[one_of(contacts.body[k])])] = k
    for j in range(joint_count):
        islands.joint[take_place(islands.joint_begin, root[one_of(joints.body[j])])] = j


@wp.func
def begin_of(end: wp.array(dtype=wp.int32), r: int) -> int:
    """Where a run begins: where the one before it ends."""
    if r == 0:
        return 0
    return end[r - 1]
