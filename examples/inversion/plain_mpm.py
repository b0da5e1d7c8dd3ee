"""What the method is compared with: an elastic mesh moved by the material point method alone.

The nodes of the tets are the particles (Jiang 2015, 'The affine particle-in-cell method', with the elastic forces
of a Lagrangian mesh): in every step mass, momentum and elastic forces go to the grid by quadratic B-splines, the
grid moves, and velocities come back. A deformation that the grid does not see is not undone. Explicit, float64.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from plait.solver.scene import TetBody
from plait.solver.tets.elements import body_elements, element_kernels
from plait.solver.tets.layout import TetLayout

REACH = 3  # grid nodes that a quadratic spline touches, each way


@wp.func
def first_node(place: wp.vec3d):
    """Of the 3 x 3 x 3 nodes around a place, in cells."""
    half = wp.float64(0.5)
    return wp.vec3i(int(place[0] - half), int(place[1] - half), int(place[2] - half))


@wp.func
def as_real(node: wp.vec3i):
    return wp.vec3d(wp.float64(node[0]), wp.float64(node[1]), wp.float64(node[2]))


@wp.func
def spline(x: wp.float64):
    """Weights of the three nodes around a particle `x` cells past the first of them."""
    half = wp.float64(0.5)
    a, b = wp.float64(1.5) - x, x - half
    return wp.vec3d(half * a * a, wp.float64(0.75) - (x - wp.float64(1.0)) * (x - wp.float64(1.0)), half * b * b)


@wp.kernel(enable_backward=False, module="example_plain_mpm")
def to_grid(
    position: wp.array(dtype=wp.vec3d),
    velocity: wp.array(dtype=wp.vec3d),
    affine: wp.array(dtype=wp.mat33d),
    mass: wp.array(dtype=wp.float64),
    corner_offsets: wp.array(dtype=int),
    corners: wp.array(dtype=int),
    corner_force: wp.array(dtype=wp.vec3d),
    origin: wp.vec3d,
    cell: wp.float64,
    step: wp.float64,
    grid_mass: wp.array3d(dtype=wp.float64),
    grid_momentum: wp.array3d(dtype=wp.vec3d),
):
    p = wp.tid()
    force = wp.vec3d()
    for k in range(corner_offsets[p], corner_offsets[p + 1]):
        force += corner_force[corners[k]]
    place = (position[p] - origin) / cell
    base = first_node(place)
    offset = place - as_real(base)
    wx, wy, wz = spline(offset[0]), spline(offset[1]), spline(offset[2])
    for i in range(REACH):
        for j in range(REACH):
            for k in range(REACH):
                weight = wx[i] * wy[j] * wz[k]
                arm = cell * (as_real(wp.vec3i(i, j, k)) - offset)
                momentum = mass[p] * (velocity[p] + affine[p] * arm) + step * force
                wp.atomic_add(grid_mass, base[0] + i, base[1] + j, base[2] + k, weight * mass[p])
                wp.atomic_add(grid_momentum, base[0] + i, base[1] + j, base[2] + k, weight * momentum)


@wp.kernel(enable_backward=False, module="example_plain_mpm")
def from_grid(
    grid_mass: wp.array3d(dtype=wp.float64),
    grid_momentum: wp.array3d(dtype=wp.vec3d),
    origin: wp.vec3d,
    cell: wp.float64,
    step: wp.float64,
    kept: wp.float64,
    position: wp.array(dtype=wp.vec3d),
    velocity: wp.array(dtype=wp.vec3d),
    affine: wp.array(dtype=wp.mat33d),
):
    p = wp.tid()
    place = (position[p] - origin) / cell
    base = first_node(place)
    offset = place - as_real(base)
    wx, wy, wz = spline(offset[0]), spline(offset[1]), spline(offset[2])
    v, c = wp.vec3d(), wp.mat33d()
    for i in range(REACH):
        for j in range(REACH):
            for k in range(REACH):
                weight = wx[i] * wy[j] * wz[k]
                at_node = grid_mass[base[0] + i, base[1] + j, base[2] + k]
                if at_node > wp.float64(0.0):
                    arm = cell * (as_real(wp.vec3i(i, j, k)) - offset)
                    share = grid_momentum[base[0] + i, base[1] + j, base[2] + k] * (weight / at_node)
                    v += share
                    c += wp.outer(share, arm)
    velocity[p] = kept * v
    affine[p] = kept * c * (wp.float64(4.0) / (cell * cell))
    position[p] = position[p] + step * v


def recover(layout: TetLayout, start: np.ndarray, cell: float, seconds: float, damping: float) -> np.ndarray:
    """(node_count, 3) [m] where the nodes of the layout's only body are after `seconds`, from rest at `start`.

    cell: [m] of the grid.  damping: [1/s], of all motion.
    """
    body, device = layout.bodies[0], wp.get_device("cpu")
    elements = body_elements(layout, 0, wp.float64, device)
    kernels = element_kernels(body.law, wp.float64)
    step = _stable_step(body, start, layout.tets)
    reach = np.maximum(np.ptp(start, axis=0).max(), np.linalg.norm(np.ptp(body.nodes, axis=0))) + 4.0 * cell
    low, high = start.mean(axis=0) - reach, start.mean(axis=0) + reach
    shape = tuple(int(n) for n in np.ceil((high - low) / cell) + 1)
    order = np.argsort(layout.tets.ravel(), kind="stable").astype(np.int32)
    counts = np.bincount(layout.tets.ravel(), minlength=layout.node_count)

    def array(values: np.ndarray, dtype: type) -> wp.array:
        return wp.array(values, dtype=dtype, device=device)

    position, mass = array(start, wp.vec3d), array(layout.mass, wp.float64)
    velocity, affine = wp.zeros_like(position), wp.zeros(len(start), dtype=wp.mat33d, device=device)
    offsets = array(np.concatenate([[0], np.cumsum(counts)]).astype(np.int32), int)
    corners, corner_force = array(order, int), wp.zeros(4 * len(layout.tets), dtype=wp.vec3d, device=device)
    dilation = wp.zeros(len(layout.tets), dtype=wp.float64, device=device)
    grid_mass = wp.zeros(shape, dtype=wp.float64, device=device)
    grid_momentum = wp.zeros(shape, dtype=wp.vec3d, device=device)
    origin, kept = wp.vec3d(*low), float(np.exp(-damping * step))
    for _ in range(int(np.ceil(seconds / step))):
        here = position.numpy()
        if not (np.all(here > low + cell) and np.all(here < high - 2.0 * cell)):
            raise FloatingPointError("the material left the grid")
        wp.launch(
            kernels.force, len(layout.tets), [0, elements, position], [corner_force, dilation], device=device
        )
        grid_mass.zero_()
        grid_momentum.zero_()
        wp.launch(
            to_grid,
            len(start),
            [position, velocity, affine, mass, offsets, corners, corner_force, origin, cell, step],
            [grid_mass, grid_momentum],
            device=device,
        )
        wp.launch(
            from_grid,
            len(start),
            [grid_mass, grid_momentum, origin, cell, step, kept],
            [position, velocity, affine],
            device=device,
        )
    return position.numpy()


def _stable_step(body: TetBody, start: np.ndarray, tets: np.ndarray) -> float:
    """[s] a part of the time in which sound crosses the lowest tet, as stretched as it starts."""
    rest, now = body.nodes[tets], start[tets]
    rest, now = (np.swapaxes(x[:, 1:] - x[:, :1], 1, 2) for x in (rest, now))
    inverse = np.linalg.inv(rest)
    stretch = max(1.0, float(np.linalg.norm(now @ inverse, axis=(1, 2)).max() / np.sqrt(3.0)))
    height = 1.0 / np.linalg.norm(inverse, axis=2).max()
    young, nu = np.max(body.youngs_modulus), np.max(body.poissons_ratio)
    sound = np.sqrt(young * (1.0 - nu) / ((1.0 + nu) * (1.0 - 2.0 * nu)) / np.max(body.density))
    return 0.1 * height / (sound * stretch**2)
