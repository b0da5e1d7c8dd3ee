"""Kernels of `rpic.py`; float64 whatever the working precision."""

import warp as wp

from plait.solver.grid.transfer_kernels import Grid, value_at

wp.set_module_options({"enable_backward": False})

# A star of tets flatter than this part of its size squared has no gradient across.
FLAT = wp.constant(wp.float64(1.0e-6))


@wp.struct
class Star:
    """The tets around each node of a body, all in the body's own numbers."""

    first: wp.array(dtype=wp.int32)  # (node_count + 1,)
    corner: wp.array(dtype=wp.int32)  # 4 t + a: the node is corner a of tet t
    tet: wp.array(dtype=wp.vec4i)  # (tet_count,)


@wp.kernel
def fit_gradient(
    first: int,
    star: Star,
    damping: wp.float64,
    mass: wp.array(dtype=wp.float64),
    position: wp.array(dtype=wp.vec3d),
    velocity: wp.array(dtype=wp.vec3d),
    gradient_out: wp.array(dtype=wp.mat33d),
):
    """C of least squares over the nodes of the star, damped; zero for a flat star."""
    q = first + wp.tid()
    spread = wp.mat33d()
    change = wp.mat33d()
    for k in range(star.first[q], star.first[q + 1]):
        tet = star.tet[star.corner[k] / 4]
        for a in range(4):
            p = tet[a]
            arm = position[p] - position[q]
            spread += wp.outer(mass[p] * arm, arm)
            change += wp.outer(mass[p] * (velocity[p] - velocity[q]), arm)
    size = wp.trace(spread)
    C = wp.mat33d()
    if wp.determinant(spread) > FLAT * size * size * size:
        C = change * wp.inverse(spread)
    skew = wp.float64(0.5) * (C - wp.transpose(C))
    gradient_out[q] = (wp.float64(1.0) - damping) * C + damping * skew


@wp.kernel
def from_grid_to_free(
    first: int,
    grid: Grid,
    node_velocity: wp.array(dtype=wp.vec3d),
    pinned: wp.array(dtype=wp.int32),
    velocity_out: wp.array(dtype=wp.vec3d),
):
    """v_q of the nodes that are not pinned."""
    q = first + wp.tid()
    if pinned[q] == 0:
        velocity_out[q] = value_at(grid, q, node_velocity)
