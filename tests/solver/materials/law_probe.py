"""The laws' device functions at many deformation gradients at once, in float64, and these in numpy's arrays."""

from functools import cache

import numpy as np
import warp as wp

from plait.solver.materials.hencky import hencky
from plait.solver.materials.laws import LAWS
from plait.solver.materials.principal import principal_functions
from plait.solver.materials.rotation import rotation_functions

MU, LAM = 0.8, 1.7


@cache
def _state_kernel(law: str) -> wp.Kernel:
    functions = (LAWS | {"hencky": hencky})[law](wp.float64)
    energy_density, first_piola = functions.energy_density, functions.first_piola

    @wp.kernel(enable_backward=False, module=f"tests_{law}")
    def state(
        F: wp.array(dtype=wp.mat33d),
        mu: wp.array(dtype=wp.float64),
        lam: wp.array(dtype=wp.float64),
        energy: wp.array(dtype=wp.float64),
        stress: wp.array(dtype=wp.mat33d),
    ):
        i = wp.tid()
        energy[i] = energy_density(F[i], mu[i], lam[i])
        stress[i] = first_piola(F[i], mu[i], lam[i])

    return state


@cache
def _principal_kernel(law: str) -> wp.Kernel:
    principal_hessian = LAWS[law](wp.float64).principal_hessian
    at_least = principal_functions(wp.float64).at_least

    @wp.kernel(enable_backward=False, module=f"tests_{law}")
    def principal(
        s: wp.array(dtype=wp.vec3d),
        mu: wp.float64,
        lam: wp.float64,
        floor: wp.float64,
        normal: wp.array(dtype=wp.mat33d),
        pairs: wp.array2d(dtype=wp.vec3d),
    ):
        i = wp.tid()
        hessian = at_least(principal_hessian(s[i], mu, lam), floor)
        normal[i] = hessian.normal
        pairs[i, 0] = hessian.symmetric
        pairs[i, 1] = hessian.twist

    return principal


def energy_and_stress(law: str, F: np.ndarray, mu: np.ndarray = MU, lam: np.ndarray = LAM):
    """psi (n,), P (n, 3, 3) at F (n, 3, 3)."""
    count = len(F)
    energy, stress = (
        wp.zeros(count, dtype=wp.float64, device="cpu"),
        wp.zeros(count, dtype=wp.mat33d, device="cpu"),
    )
    lame = [wp.array(np.broadcast_to(v, count).astype(float), dtype=wp.float64, device="cpu") for v in (mu, lam)]
    inputs = [wp.array(F, dtype=wp.mat33d, device="cpu"), *lame]
    wp.launch(_state_kernel(law), count, inputs, [energy, stress], device="cpu")
    return energy.numpy(), stress.numpy()


def hessian(law: str, F: np.ndarray, floor: float = -np.inf) -> np.ndarray:
    """d P / d F, (n, 9, 9) by row-major entries, from the law's entries in the principal frame by numpy's SVD."""
    U, s, V = proper_svd(F)
    count = len(F)
    normal = wp.zeros(count, dtype=wp.mat33d, device="cpu")
    pairs = wp.zeros((count, 2), dtype=wp.vec3d, device="cpu")
    inputs = [wp.array(s, dtype=wp.vec3d, device="cpu"), MU, LAM, floor]
    wp.launch(_principal_kernel(law), count, inputs, [normal, pairs], device="cpu")
    in_frame = np.zeros((count, 3, 3, 3, 3))
    for i in range(3):
        for j in range(3):
            in_frame[:, i, i, j, j] = normal.numpy()[:, i, j]
            if i != j:
                symmetric, twist = pairs.numpy()[:, 0, 3 - i - j], pairs.numpy()[:, 1, 3 - i - j]
                in_frame[:, i, j, i, j] = 0.5 * (symmetric + twist)
                in_frame[:, i, j, j, i] = 0.5 * (symmetric - twist)
    return np.einsum("nai,nbj,nijkl,nck,ndl->nabcd", U, V, in_frame, U, V, optimize=True).reshape(count, 9, 9)


def proper_svd(F: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """U, s, V with rotations U, V, the sign of det F on the least of s."""
    U, s, Vt = np.linalg.svd(F)
    U[:, :, 2] *= np.linalg.det(U)[:, None]
    turned = np.linalg.det(Vt)
    Vt[:, 2] *= turned[:, None]
    s[:, 2] *= np.sign(np.linalg.det(F))
    return U, s, Vt.transpose(0, 2, 1)


def rotations(F: np.ndarray, real: type) -> np.ndarray:
    """R of F = R S, (n, 3, 3), as computed in `real`."""
    functions = rotation_functions(real)
    mat33, rotation = functions.mat33, functions.rotation

    @wp.kernel(enable_backward=False, module=f"tests_rotation_{real.__name__}")
    def rotate(F: wp.array(dtype=mat33), R: wp.array(dtype=mat33)):
        R[wp.tid()] = rotation(F[wp.tid()])

    out = wp.zeros(len(F), dtype=mat33, device="cpu")
    wp.launch(rotate, len(F), [wp.array(F, dtype=mat33, device="cpu")], [out], device="cpu")
    return out.numpy()


def random_rotations(count: int, seed: int) -> np.ndarray:
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(count, 3, 3)))
    q *= np.sign(np.einsum("nii->ni", r))[:, None]
    q[:, :, 0] *= np.linalg.det(q)[:, None]
    return q


def with_stretches(stretches: np.ndarray, seed: int) -> np.ndarray:
    """U diag(s) V^T with random rotations."""
    U, V = random_rotations(len(stretches), seed), random_rotations(len(stretches), seed + 1)
    return np.einsum("nij,nj,nkj->nik", U, stretches, V)


def states(seed: int = 0) -> np.ndarray:
    """(n, 3, 3): mild, strong, flat, nearly flat, mirrored, rod-like and rigid states, arbitrarily turned.

    The nearest rotation is unique in all of them, by a fair margin: elsewhere no derivative exists.
    """
    rng = np.random.default_rng(seed)
    mild = 1.0 + 0.1 * rng.uniform(-1, 1, (40, 3))
    strong = rng.uniform(0.3, 2.5, (40, 3))
    flat = np.c_[rng.uniform(0.5, 1.5, (20, 2)), np.zeros(20)]
    near = np.c_[rng.uniform(0.5, 1.5, (40, 2)), rng.uniform(-1e-3, 1e-3, 40)]
    mirrored = np.c_[rng.uniform(0.7, 1.5, (40, 2)), -rng.uniform(0.05, 0.4, 40)]
    thin = np.c_[rng.uniform(0.5, 2.0, 20), rng.uniform(0.15, 0.3, 20), rng.uniform(-0.02, 0.02, 20)]
    rigid = np.ones((10, 3))
    return with_stretches(np.concatenate([mild, strong, flat, near, mirrored, thin, rigid]), seed)
