"""Kernels of `momentum.py`; float64 whatever the working precision."""

import warp as wp

MODULE = "plait_tets_momentum"


@wp.kernel(module=MODULE, enable_backward=False)
def sum_moments(first: int, first_node: int, count: int, chunk: int, weight: wp.array(dtype=wp.float64),
                a: wp.array(dtype=wp.vec3d), b: wp.array(dtype=wp.vec3d),
                sums_out: wp.array2d(dtype=wp.float64)):  # fmt: skip
    """Per chunk: sums of w a, w b, w a b^T and w, about the body's first node."""
    c = first + wp.tid()
    sum_a = wp.vec3d()
    sum_b = wp.vec3d()
    product = wp.mat33d()
    total = wp.float64(0.0)
    for k in range(c * chunk, wp.min((c + 1) * chunk, count)):
        i = first_node + k
        off_a = a[i] - a[first_node]
        off_b = b[i] - b[first_node]
        sum_a += weight[i] * off_a
        sum_b += weight[i] * off_b
        product += wp.outer(weight[i] * off_a, off_b)
        total += weight[i]
    sums_out[c, 15] = total
    for i in range(3):
        sums_out[c, i] = sum_a[i]
        sums_out[c, 3 + i] = sum_b[i]
        for j in range(3):
            sums_out[c, 6 + 3 * i + j] = product[i, j]


@wp.kernel(module=MODULE, enable_backward=False)
def move(first: int, first_node: int, centre: wp.vec3d, turn: wp.mat33d, way: wp.vec3d,
         position_out: wp.array(dtype=wp.vec3d)):  # fmt: skip
    """turn: the rotation less the identity, which keeps the digits of small ones."""
    i = first_node + first + wp.tid()
    x = position_out[i]
    position_out[i] = x + (turn * (x - centre) + way)
