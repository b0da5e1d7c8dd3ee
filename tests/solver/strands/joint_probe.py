"""Kernels that show a joint's derivatives and energy to the tests."""

from __future__ import annotations

import numpy as np
import warp as wp

from plait.solver.strands.energy import joint_functions
from plait.solver.strands.types import rod_types

REAL = wp.float64
TYPES = rod_types(REAL)
FUNCTIONS = joint_functions(REAL)
JOINT, ENERGY, TWIST = FUNCTIONS.joint, FUNCTIONS.joint_energy, FUNCTIONS.signed_twist
vec2, vec3 = TYPES.vec2, TYPES.vec3


@wp.kernel(enable_backward=False, module="tests_joint")
def derivatives_kernel(
    edges: wp.array2d(dtype=vec3),
    directors: wp.array2d(dtype=vec3),
    twist: wp.array(dtype=REAL),
    bend: REAL,
    stiffness: REAL,
    curvature: vec2,
    rest_twist: REAL,
    beta: REAL,
    gradient_out: wp.array2d(dtype=REAL),
    hessian_out: wp.array3d(dtype=REAL),
):
    i = wp.tid()
    a = edges[i, 0]
    b = edges[i, 1]
    la = wp.length(a)
    lb = wp.length(b)
    j = JOINT(
        a / la, REAL(1.0) / la, b / lb, REAL(1.0) / lb, directors[i, 0], directors[i, 1], twist[i], bend,
        stiffness, curvature, rest_twist, beta,
    )  # fmt: skip
    for r in range(3):
        gradient_out[i, r] = j.gradient_ea[r]
        gradient_out[i, 3 + r] = j.gradient_eb[r]
        for c in range(3):
            hessian_out[i, r, c] = j.ea_ea[r, c]
            hessian_out[i, 3 + r, c] = j.eb_ea[r, c]
            hessian_out[i, c, 3 + r] = j.eb_ea[r, c]
            hessian_out[i, 3 + r, 3 + c] = j.eb_eb[r, c]
        hessian_out[i, r, 6] = j.ea_ta[r]
        hessian_out[i, 6, r] = j.ea_ta[r]
        hessian_out[i, r, 7] = j.ea_tb[r]
        hessian_out[i, 7, r] = j.ea_tb[r]
        hessian_out[i, 3 + r, 6] = j.eb_ta[r]
        hessian_out[i, 6, 3 + r] = j.eb_ta[r]
        hessian_out[i, 3 + r, 7] = j.eb_tb[r]
        hessian_out[i, 7, 3 + r] = j.eb_tb[r]
    gradient_out[i, 6] = j.gradient_ta
    gradient_out[i, 7] = j.gradient_tb
    hessian_out[i, 6, 6] = j.ta_ta
    hessian_out[i, 7, 7] = j.tb_tb
    hessian_out[i, 6, 7] = j.tb_ta
    hessian_out[i, 7, 6] = j.tb_ta


@wp.kernel(enable_backward=False, module="tests_joint")
def energies_kernel(
    edges: wp.array2d(dtype=vec3),
    directors: wp.array2d(dtype=vec3),
    twist: wp.array(dtype=REAL),
    bend: REAL,
    stiffness: REAL,
    curvature: vec2,
    rest_twist: REAL,
    energy_out: wp.array(dtype=REAL),
):
    i = wp.tid()
    energy_out[i] = ENERGY(
        wp.normalize(edges[i, 0]), wp.normalize(edges[i, 1]), directors[i, 0], directors[i, 1], twist[i], bend,
        stiffness, curvature, rest_twist,
    )  # fmt: skip


def joint_arrays(edges: np.ndarray, directors: np.ndarray, twist: np.ndarray) -> list[wp.array]:
    """edges, directors: (joint_count, 2, 3); twist: (joint_count,)."""
    return [
        wp.array(edges, dtype=vec3, device="cpu"),
        wp.array(directors, dtype=vec3, device="cpu"),
        wp.array(twist, dtype=REAL, device="cpu"),
    ]


def derivatives(
    edges: np.ndarray,
    directors: np.ndarray,
    twist: np.ndarray,
    bend: float,
    stiffness: float,
    curvature: np.ndarray,
    rest_twist: float,
    beta: float = 1.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Gradients (joint_count, 8) and Hessians (joint_count, 8, 8) by (edge a, edge b, turn a, turn b)."""
    count = len(edges)
    gradient = wp.zeros((count, 8), dtype=REAL, device="cpu")
    hessian = wp.zeros((count, 8, 8), dtype=REAL, device="cpu")
    inputs = [*joint_arrays(edges, directors, twist), bend, stiffness, vec2(*curvature), rest_twist, beta]
    wp.launch(derivatives_kernel, count, inputs, [gradient, hessian], device="cpu")
    return gradient.numpy(), hessian.numpy()


def energies(
    edges: np.ndarray,
    directors: np.ndarray,
    twist: np.ndarray,
    bend: float,
    stiffness: float,
    curvature: np.ndarray,
    rest_twist: float,
) -> np.ndarray:
    """(joint_count,) [J]."""
    out = wp.zeros(len(edges), dtype=REAL, device="cpu")
    inputs = [*joint_arrays(edges, directors, twist), bend, stiffness, vec2(*curvature), rest_twist]
    wp.launch(energies_kernel, len(edges), inputs, [out], device="cpu")
    return out.numpy()


def transport(t: np.ndarray, to: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Rodrigues' rotation that takes unit t to unit `to` the shortest way, applied to v."""
    axis, c = np.cross(t, to), t @ to
    return v + np.cross(axis, v) + np.cross(axis, np.cross(axis, v)) / (1.0 + c)
