"""Hessians in the frame of the principal stretches, F = U diag(s) V^T, and their projection.

For an isotropic energy, with p_i = d psi / d s_i, the Hessian couples only the diagonal entries of U^T dF V among
themselves, by A_ij = d2 psi / ds_i ds_j, and each pair dF_ij, dF_ji, with the eigenvalues
(p_i - p_j) / (s_i - s_j) on their sum and (p_i + p_j) / (s_i + s_j) on their difference
(Stomakhin et al. 2012; Smith et al. 2019, 'Analytic eigensystems'). Pair k is that of the two axes other than k.
"""

from functools import cache, partial
from types import SimpleNamespace

import warp as wp

from plait.solver.materials.rotation import module_name, rotation_functions

SWEEPS = 8


@cache
def principal_functions(real: type) -> SimpleNamespace:
    """`PrincipalHessian` and device functions `eigen`, `decompose`, `at_least`, `block` for `real`."""
    rotations = rotation_functions(real)
    mat33, vec3, rotation = rotations.mat33, rotations.vec3, rotations.rotation
    module = module_name(real)
    negligible = 1.0e-14 if real == wp.float32 else 1.0e-31

    @partial(wp.struct, module=module)
    class PrincipalHessian:
        """The Hessian's entries in the principal frame."""

        normal: mat33  # A
        symmetric: vec3  # eigenvalue of pair k on dF_ij + dF_ji
        twist: vec3  # on dF_ij - dF_ji

    @wp.func(module=module)
    def eigen(S: mat33):
        """Eigenvalues and eigenvectors, in columns, a rotation, of a symmetric matrix: cyclic Jacobi."""
        A = S
        V = wp.identity(n=3, dtype=real)
        size = wp.ddot(S, S)
        sweep = wp.int32(0)
        off = A[0, 1] * A[0, 1] + A[0, 2] * A[0, 2] + A[1, 2] * A[1, 2]
        while sweep < SWEEPS and off > real(negligible) * size:
            for r in range(3):
                p = (r + 1) % 3
                q = (r + 2) % 3
                if A[p, q] != real(0.0):
                    theta = (A[q, q] - A[p, p]) / (real(2.0) * A[p, q])
                    t = real(1.0) / (wp.abs(theta) + wp.sqrt(theta * theta + real(1.0)))
                    if theta < real(0.0):
                        t = -t
                    c = real(1.0) / wp.sqrt(t * t + real(1.0))
                    s = t * c
                    A[p, p] = A[p, p] - t * A[p, q]
                    A[q, q] = A[q, q] + t * A[p, q]
                    A[p, q] = real(0.0)
                    A[q, p] = real(0.0)
                    rp = A[r, p]
                    rq = A[r, q]
                    A[r, p] = c * rp - s * rq
                    A[p, r] = A[r, p]
                    A[r, q] = s * rp + c * rq
                    A[q, r] = A[r, q]
                    for k in range(3):
                        vp = V[k, p]
                        vq = V[k, q]
                        V[k, p] = c * vp - s * vq
                        V[k, q] = s * vp + c * vq
            off = A[0, 1] * A[0, 1] + A[0, 2] * A[0, 2] + A[1, 2] * A[1, 2]
            sweep += 1
        return wp.get_diag(A), V

    @wp.func(module=module)
    def decompose(F: mat33):
        """U, s, V with proper rotations U and V; s sums to tr S and is in no particular order."""
        R = rotation(F)
        S = wp.transpose(R) * F
        s, V = eigen(real(0.5) * (S + wp.transpose(S)))
        return R * V, s, V

    @wp.func(module=module)
    def at_least(hessian: PrincipalHessian, floor: real):
        """Every eigenvalue raised to `floor`: the nearest such Hessian in the Frobenius norm."""
        out = PrincipalHessian()
        for k in range(3):
            out.symmetric[k] = wp.max(hessian.symmetric[k], floor)
            out.twist[k] = wp.max(hessian.twist[k], floor)
        out.normal = hessian.normal
        above = hessian.normal - floor * wp.identity(n=3, dtype=real)
        minor = above[0, 0] * above[1, 1] - above[0, 1] * above[1, 0]
        # Sylvester's criterion: mostly nothing is to be raised.
        if not (above[0, 0] > real(0.0) and minor > real(0.0) and wp.determinant(above) > real(0.0)):
            values, vectors = eigen(hessian.normal)
            raised = vec3()
            for k in range(3):
                raised[k] = wp.max(values[k], floor)
            out.normal = vectors * wp.diag(raised) * wp.transpose(vectors)
        return out

    @wp.func(module=module)
    def block(hessian: PrincipalHessian, U: mat33, a: vec3, b: vec3):
        """d2 psi / dx_a dx_b of two corners with the shape gradients V a and V b."""
        K = mat33()
        for i in range(3):
            for j in range(3):
                if i == j:
                    K[i, i] = K[i, i] + hessian.normal[i, i] * a[i] * b[i]
                else:
                    k = 3 - i - j
                    same = real(0.5) * (hessian.symmetric[k] + hessian.twist[k])
                    swapped = real(0.5) * (hessian.symmetric[k] - hessian.twist[k])
                    K[i, i] = K[i, i] + same * a[j] * b[j]
                    K[i, j] = hessian.normal[i, j] * a[i] * b[j] + swapped * a[j] * b[i]
        return U * K * wp.transpose(U)

    return SimpleNamespace(
        PrincipalHessian=PrincipalHessian, eigen=eigen, decompose=decompose, at_least=at_least, block=block
    )
