"""Rigid bodies that flesh pushes: how they give way while it is solved, and what that takes off its stiffness.

A body's velocity and spin differ from those it had alone by L w, where L L^T is its mobility, and in the substep
its surface goes h S L w further, with S w the motion of a place. What is minimised is

    |w - w0|^2 / 2 + sum of the contacts' energies at y - h S L w

first in w, six numbers a body, for every position of the flesh. The gradient in that position is as it was; the
Hessian K becomes K - K S L h D^-1 h L^T S^T K, D = 1 + h^2 L^T S^T K S L (static condensation).
"""

from functools import cache, partial
from types import SimpleNamespace

import warp as wp

from plait.solver.contact.geometry_kernels import ONE
from plait.solver.contact.meeting_kernels import HALF
from plait.solver.contact.obstacle_force_kernels import push, stiffness_of
from plait.solver.contact.obstacle_search_kernels import SLOTS, ObstaclePlanes, SkinPoints, point_at
from plait.solver.linear.block_kernels import block_kernels
from plait.solver.rigid.joint_kernels import inverted
from plait.solver.rigid.joint_pose_kernels import mat66d, vec6d

# Unrolled, the loops over six rows would be most of the code.
wp.set_module_options({"enable_backward": False, "max_unroll": 1})

# Newton's method in six unknowns: iterations at most, halvings of a step at most, and the part of the way that the
# last step may be.
MAX_ITERATIONS = wp.constant(40)
MAX_HALVINGS = wp.constant(30)
CONVERGED = wp.constant(wp.float64(1e-13))


@wp.struct
class Carriers:
    """The rigid bodies that a flesh body may push, one entry each."""

    length: wp.float64  # [s] of the substep
    root: wp.array(dtype=mat66d)  # L
    aim: wp.array(dtype=vec6d)  # w0 [sqrt J]: less what the body was given beforehand, with what others push it
    held: wp.array(dtype=mat66d)  # H, p: other flesh bodies add w . H w / 2 - p . w
    pull: wp.array(dtype=vec6d)
    way: wp.array(dtype=vec6d)  # w
    inverse: wp.array(dtype=mat66d)  # D^-1
    energy: wp.array(dtype=wp.float64)  # [J] of w - w0 and of other flesh bodies
    wrench: wp.array(dtype=vec6d)  # [N], [N m] of all contacts on the flesh


@wp.struct
class Links:
    """Planes that rigid bodies hold, those of carrier c from first[c] on."""

    first: wp.array(dtype=wp.int32)  # (carrier_count + 1,)
    slot: wp.array(dtype=wp.int32)  # of the plane
    lever: wp.array(dtype=wp.vec3d)  # [m] from the body's centre of mass
    stiffness: wp.array(dtype=wp.mat33d)  # [N/m]


@wp.func
def motion_at(wrench: vec6d, lever: wp.vec3d) -> wp.vec3d:
    """S w: of a place of what moves by velocity and spin."""
    velocity = wp.vec3d(wrench[0], wrench[1], wrench[2])
    return velocity + wp.cross(wp.vec3d(wrench[3], wrench[4], wrench[5]), lever)


@wp.func
def wrench_of(force: wp.vec3d, lever: wp.vec3d) -> vec6d:
    """S^T f."""
    moment = wp.cross(lever, force)
    return vec6d(force[0], force[1], force[2], moment[0], moment[1], moment[2])


@wp.func
def spread(stiffness: wp.mat33d, lever: wp.vec3d) -> mat66d:
    """S^T K S."""
    s = wp.skew(lever)
    off = -(stiffness * s)
    low = -(s * off)
    out = mat66d()
    for i in range(3):
        for j in range(3):
            out[i, j] = stiffness[i, j]
            out[i, 3 + j] = off[i, j]
            out[3 + j, i] = off[i, j]
            out[3 + i, 3 + j] = -low[i, j]
    return out


@wp.func
def own_energy(carriers: Carriers, c: int, way: vec6d) -> wp.float64:
    off = way - carriers.aim[c]
    return HALF * wp.dot(off, off) + HALF * wp.dot(way, carriers.held[c] * way) - wp.dot(carriers.pull[c], way)


@wp.struct
class Settled:
    """Of one carrier, at one w."""

    energy: wp.float64
    gradient: vec6d
    curvature: mat66d


@wp.func
def look(
    points: SkinPoints,
    planes: ObstaclePlanes,
    inertia: wp.float64,
    x: wp.array(dtype=wp.vec3d),
    carriers: Carriers,
    links: Links,
    c: int,
    way: vec6d,
) -> Settled:
    """Leaves the planes of the links where they then are."""
    out = Settled()
    root = carriers.root[c]
    motion = carriers.length * (root * way)
    total = vec6d()
    stiffness = mat66d()
    off = way - carriers.aim[c]
    resisted = carriers.held[c] * way
    out.energy = own_energy(carriers, c, way)
    for i in range(links.first[c], links.first[c + 1]):
        slot = links.slot[i]
        q = slot / SLOTS
        planes.shift[slot] = motion_at(motion, links.lever[i])
        one = push(planes, slot, stiffness_of(points, q, inertia), point_at(points, q, x))
        out.energy += one.energy
        total += wrench_of(one.pressure * planes.normal[slot] + one.traction, links.lever[i])
        stiffness += spread(one.stiffness, links.lever[i])
        links.stiffness[i] = one.stiffness
    turned = wp.transpose(root)
    out.gradient = off + resisted - carriers.pull[c] + carriers.length * (turned * total)
    out.curvature = carriers.held[c] + carriers.length * carriers.length * (turned * stiffness * root)
    for i in range(6):
        out.curvature[i, i] = out.curvature[i, i] + ONE
    carriers.wrench[c] = total
    return out


@wp.kernel
def settle(
    first: int,
    points: SkinPoints,
    planes: ObstaclePlanes,
    inertia: wp.float64,
    x: wp.array(dtype=wp.vec3d),
    carriers: Carriers,
    links: Links,
):
    """Finds how the rigid bodies give way with the nodes at x, (node_count,) [m]; one carrier an item."""
    c = first + wp.tid()
    way = carriers.way[c]
    here = look(points, planes, inertia, x, carriers, links, c, way)
    for _ in range(MAX_ITERATIONS):
        step = inverted(here.curvature) * here.gradient
        # No step is worth taking that rounding has most of.
        if wp.length(step) <= CONVERGED * (wp.length(way) + wp.length(carriers.aim[c]) + wp.length(step)):
            break
        part = wp.float64(1.0)
        slope = wp.dot(step, here.gradient)
        found = wp.int32(0)
        there = here
        for _halving in range(MAX_HALVINGS):
            there = look(points, planes, inertia, x, carriers, links, c, way - part * step)
            if there.energy <= here.energy - wp.float64(1e-4) * part * slope:
                found = 1
                break
            # Where rounding hides the decrease, the slope at the end tells.
            lost = wp.abs(there.energy - here.energy) <= wp.float64(1e-12) * wp.abs(here.energy)
            if lost and wp.abs(wp.dot(there.gradient, step)) <= wp.float64(0.9) * slope:
                found = 1
                break
            part *= HALF
        if found == 0:
            here = look(points, planes, inertia, x, carriers, links, c, way)
            break
        way = way - part * step
        here = there
    carriers.way[c] = way
    carriers.inverse[c] = inverted(here.curvature)
    carriers.energy[c] = own_energy(carriers, c, way)


@cache
def coupling_kernels(real: type) -> SimpleNamespace:
    """Kernels `project`, `subtract`: what giving way takes off the product of the matrix with a vector, in `real`.

    And struct `Touched`.
    """
    module = f"plait_carriers_{real.__name__}"
    structure = partial(wp.struct, module=module)
    kernel = partial(wp.kernel, module=module, enable_backward=False)
    Krylov = block_kernels(real).types.Krylov
    vec3 = wp.types.vector(3, real)

    @structure
    class Touched:
        """Unknowns that links act on, and the links of each; of each link, its point's four unknowns."""

        unknown: wp.array(dtype=wp.int32)  # (touched_count,)
        first: wp.array(dtype=wp.int32)  # (touched_count + 1,)
        link: wp.array(dtype=wp.int32)
        weight: wp.array(dtype=wp.float64)
        corner: wp.array(dtype=wp.vec4i)  # (link_count,) -1: pinned
        share: wp.array(dtype=wp.vec4d)  # (link_count,)
        carrier: wp.array(dtype=wp.int32)  # (link_count,)
        answer: wp.array(dtype=vec6d)  # (carrier_count,) h L D^-1 h L^T S^T K z

    @kernel
    def project(first: int, carriers: Carriers, links: Links, touched: Touched, krylov: Krylov):
        """One item in all: the answers of all carriers, taken off z . A z."""
        if first + wp.tid() > 0:
            return
        taken = wp.float64(0.0)
        for c in range(carriers.root.shape[0]):
            total = vec6d()
            for i in range(links.first[c], links.first[c + 1]):
                z = wp.vec3d()
                corner = touched.corner[i]
                for a in range(4):
                    if corner[a] >= 0:
                        z += touched.share[i][a] * wp.vec3d(krylov.preconditioned[corner[a]])
                total += wrench_of(links.stiffness[i] * z, links.lever[i])
            held = carriers.length * (wp.transpose(carriers.root[c]) * total)
            answer = carriers.inverse[c] * held
            taken += wp.dot(held, answer)
            touched.answer[c] = carriers.length * (carriers.root[c] * answer)
        krylov.curvature[0] = krylov.curvature[0] - taken

    @kernel
    def subtract(first: int, links: Links, touched: Touched, krylov: Krylov):
        """From the product, one touched unknown an item."""
        item = first + wp.tid()
        total = wp.vec3d()
        for k in range(touched.first[item], touched.first[item + 1]):
            i = touched.link[k]
            motion = motion_at(touched.answer[touched.carrier[i]], links.lever[i])
            total += touched.weight[k] * (links.stiffness[i] * motion)
        at = touched.unknown[item]
        krylov.product[at] = krylov.product[at] - vec3(total)

    return SimpleNamespace(project=project, subtract=subtract, Touched=Touched)
