"""Functions of symmetric matrices, near zero without eigenvectors.

A symmetric matrix is a vector (xx, yy, zz, yz, xz, xy). By Cayley and Hamilton A^3 = I1 A^2 - I2 A + I3, so that
any power series in A is c0 + c1 A + c2 A^2 with three numbers that Horner's scheme finds, whatever its length.
Where A is too large for few terms, the function is taken of the eigenvalues.
"""

import math
from functools import cache
from types import SimpleNamespace

import warp as wp

from plait.solver.materials.principal import principal_functions
from plait.solver.materials.rotation import module_name

# Series serve up to |A| of this, and shorter ones nearer zero; with so many terms (exp, ln) what is left out is
# less than rounding, relative to A.
LARGEST, NEAR = 0.1, 0.01
TERMS = {wp.float32: (5, 7), wp.float64: (10, 15)}
FEW_TERMS = {wp.float32: (3, 4), wp.float64: (7, 8)}


@cache
def symmetric_functions(real: type) -> SimpleNamespace:
    """`sym`, the type, and device functions on it for `real` (wp.float32 or wp.float64)."""
    module = module_name(real)
    sym = wp.types.vector(6, real)
    vec3, mat33 = wp.types.vector(3, real), wp.types.matrix((3, 3), real)
    eigen = principal_functions(real).eigen
    largest_squared, near_squared = LARGEST**2, NEAR**2
    exp_coefficients, log_coefficients = _coefficients(*TERMS[real], real)
    exp_few, log_few = _coefficients(*FEW_TERMS[real], real)
    exp_terms, log_terms = TERMS[real]
    exp_few_terms, log_few_terms = FEW_TERMS[real]

    @wp.func(module=module)
    def to_matrix(a: sym):
        return mat33(a[0], a[5], a[4], a[5], a[1], a[3], a[4], a[3], a[2])

    @wp.func(module=module)
    def from_matrix(A: mat33):
        """Of a symmetric matrix; its upper triangle is read."""
        return sym(A[0, 0], A[1, 1], A[2, 2], A[1, 2], A[0, 2], A[0, 1])

    @wp.func(module=module)
    def trace_of(a: sym):
        return a[0] + a[1] + a[2]

    @wp.func(module=module)
    def size_squared(a: sym):
        """A : A."""
        off = a[3] * a[3] + a[4] * a[4] + a[5] * a[5]
        return a[0] * a[0] + a[1] * a[1] + a[2] * a[2] + off + off

    @wp.func(module=module)
    def plus_isotropic(a: sym, p: real):
        """A + p I."""
        return sym(a[0] + p, a[1] + p, a[2] + p, a[3], a[4], a[5])

    @wp.func(module=module)
    def square(a: sym):
        yz = a[3] * a[3]
        xz = a[4] * a[4]
        xy = a[5] * a[5]
        return sym(
            a[0] * a[0] + xz + xy,
            a[1] * a[1] + yz + xy,
            a[2] * a[2] + yz + xz,
            a[3] * (a[1] + a[2]) + a[4] * a[5],
            a[4] * (a[0] + a[2]) + a[3] * a[5],
            a[5] * (a[0] + a[1]) + a[3] * a[4],
        )

    @wp.func(module=module)
    def invariants(a: sym, squared: sym):
        """I1, I2, I3 of the characteristic polynomial."""
        I1 = trace_of(a)
        I3 = (
            a[0] * (a[1] * a[2] - a[3] * a[3])
            - a[5] * (a[5] * a[2] - a[3] * a[4])
            + a[4] * (a[5] * a[3] - a[1] * a[4])
        )
        return vec3(I1, real(0.5) * (I1 * I1 - trace_of(squared)), I3)

    @wp.func(module=module)
    def times(c: vec3, I: vec3):  # noqa: E741 - the invariants
        """The coefficients of A (c0 + c1 A + c2 A^2)."""
        return vec3(I[2] * c[2], c[0] - I[1] * c[2], c[1] + I[0] * c[2])

    @wp.func(module=module)
    def polynomial(a: sym, squared: sym, c: vec3):
        return plus_isotropic(c[1] * a + c[2] * squared, c[0])

    @wp.func(module=module)
    def compose(V: mat33, s: vec3):
        """V diag(s) V^T."""
        return from_matrix(V * wp.diag(s) * wp.transpose(V))

    @wp.func(module=module)
    def exp_series(a: sym):
        """exp A - 1 where A is small."""
        squared = square(a)
        I = invariants(a, squared)  # noqa: E741
        c = vec3()
        if size_squared(a) <= real(near_squared):
            for k in range(exp_few_terms):
                c = times(vec3(c[0] + exp_few[k], c[1], c[2]), I)
        else:
            for k in range(exp_terms):
                c = times(vec3(c[0] + exp_coefficients[k], c[1], c[2]), I)
        return polynomial(a, squared, c)

    @wp.func(module=module)
    def log_series(a: sym):
        """ln(1 + A) where A is small."""
        squared = square(a)
        I = invariants(a, squared)  # noqa: E741
        c = vec3()
        if size_squared(a) <= real(near_squared):
            for k in range(log_few_terms):
                c = times(vec3(c[0] + log_few[k], c[1], c[2]), I)
        else:
            for k in range(log_terms):
                c = times(vec3(c[0] + log_coefficients[k], c[1], c[2]), I)
        return polynomial(a, squared, c)

    @wp.func(module=module)
    def is_small(a: sym):
        """Whether the series serve."""
        return size_squared(a) <= real(largest_squared)

    @wp.func(module=module)
    def exp_minus_one(a: sym):
        """exp A - 1."""
        if is_small(a):
            return exp_series(a)
        s, V = eigen(to_matrix(a))
        return compose(V, vec3(wp.exp(s[0]) - real(1.0), wp.exp(s[1]) - real(1.0), wp.exp(s[2]) - real(1.0)))

    @wp.func(module=module)
    def pushed(a: sym, G: mat33):
        """(1 + G) (1 + A) (1 + G)^T - 1."""
        P = G + (wp.identity(n=3, dtype=real) + G) * to_matrix(a)
        Q = wp.transpose(G)
        return from_matrix(P + Q + P * Q)

    @wp.func(module=module)
    def deform_far(strain: sym, G: mat33):
        """As `deform`, by eigenvalues: of the strain, and then of what the deformation makes of it."""
        a = real(2.0) * strain
        turn = wp.int32(0)
        while turn < 2:
            s, V = eigen(to_matrix(a))
            if turn == 0:
                grown = vec3(wp.exp(s[0]) - real(1.0), wp.exp(s[1]) - real(1.0), wp.exp(s[2]) - real(1.0))
                a = pushed(compose(V, grown), G)
            else:
                logs = vec3(wp.log(real(1.0) + s[0]), wp.log(real(1.0) + s[1]), wp.log(real(1.0) + s[2]))
                a = real(0.5) * compose(V, logs)
            turn += 1
        return a

    @wp.func(module=module)
    def deform(strain: sym, G: mat33):
        """Hencky's strain ln(F F^T)/2 after a further (1 + G) F: ln((1 + G) exp(2 e) (1 + G)^T)/2.

        NaN where 1 + G is no deformation.
        """
        a = real(2.0) * strain
        if is_small(a):
            a = pushed(exp_series(a), G)
            if is_small(a):
                return real(0.5) * log_series(a)
        return deform_far(strain, G)

    return SimpleNamespace(
        sym=sym,
        to_matrix=to_matrix,
        from_matrix=from_matrix,
        trace_of=trace_of,
        size_squared=size_squared,
        plus_isotropic=plus_isotropic,
        square=square,
        compose=compose,
        eigen=eigen,
        exp_minus_one=exp_minus_one,
        deform=deform,
    )


def _coefficients(exp_terms: int, log_terms: int, real: type) -> tuple[object, object]:
    """Of A in the series of exp A - 1 and ln(1 + A), the highest power first."""
    exp = [1.0 / math.factorial(n) for n in range(exp_terms, 0, -1)]
    log = [(-1.0) ** (n + 1) / n for n in range(log_terms, 0, -1)]
    return wp.types.vector(exp_terms, real)(*exp), wp.types.vector(log_terms, real)(*log)
