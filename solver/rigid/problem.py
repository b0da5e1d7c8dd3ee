"""What the impulses of rigid bodies are found from: all that the kernels of a solve share."""

from __future__ import annotations

import warp as wp

from plait.solver.rigid.island_kernels import Islands, begin_of
from plait.solver.rigid.joint_pose_kernels import Joints
from plait.solver.rigid.motion_kernels import Masses, Motion
from plait.solver.rigid.row_kernels import Rows, Work
from plait.solver.rigid.types import Contacts, Geoms, Start, Step


@wp.struct
class Effort:
    """How exactly to solve."""

    tolerance: wp.float64  # part of the speeds
    sweeps: int
    passes: int
    exit_speed: wp.float64  # [m/s]


@wp.struct
class Problem:
    """Of all islands."""

    step: wp.array(dtype=Step)  # (1,)
    effort: Effort
    geoms: Geoms
    islands: Islands
    contacts: Contacts
    rows: Rows
    joints: Joints
    masses: Masses
    motion: Motion
    start: Start
    work: Work


@wp.struct
class Island:
    """One island's places in `Islands`, and what its solve goes by."""

    root: int
    body_begin: int
    body_end: int
    contact_begin: int
    contact_end: int
    joint_begin: int
    joint_end: int
    length: wp.float64  # [s] of the substep
    bound: wp.float64  # [m/s] what changes no speed by more is solved
    exit_distance: wp.float64  # [m] by which what overlaps or is drawn apart is led back, at most


@wp.func
def island_of(p: Problem, root: int) -> Island:
    """But for the bound."""
    at = Island()
    at.root = root
    at.body_begin = begin_of(p.islands.body_begin, root)
    at.body_end = p.islands.body_begin[root]
    at.contact_begin = begin_of(p.islands.contact_begin, root)
    at.contact_end = p.islands.contact_begin[root]
    at.joint_begin = begin_of(p.islands.joint_begin, root)
    at.joint_end = p.islands.joint_begin[root]
    at.length = p.step[0].length
    at.exit_distance = p.effort.exit_speed * at.length
    return at
