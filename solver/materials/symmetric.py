"""Functions of symmetric matrices, near zero without eigenvectors.

A symmetric matrix is a vector (xx, yy, zz, yz, xz, xy). By Cayley and Hamilton A^3 = I1 A^2 - I2 A + I3, so that
any power series in A is c0 + c1 A + c2 A^2 with three numbers that Horner's scheme finds, whatever its length.
Where A is too large for few terms, the function is taken of the eigenvalues.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from plait.solver.materials.principal import principal_functions
from plait.solver.materials.rotation import module_name

# Series serve up to this |A|, with so many terms: what is left out is less than rounding, relative to A.
LARGEST = 0.1
TERMS = {wp.float32: 7, wp.float64: 15}


@cache
def symmetric_functions(real: type) -> SimpleNamespace:
    """`sym`, the type, and device functions on it for `real` (wp.float32 or wp.float64)."""
    module = module_name(real)
    sym = wp.types.vector(6, real)
    vec3, mat33 = wp.types.vector(3, real), wp.types.matrix((3, 3), real)
    eigen = principal_functions(real).eigen
    largest_squared, terms, further = LARGEST**2, TERMS[real], TERMS[real] - 1

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
    def exp_minus_one(a: sym):
        """exp A - 1."""
        if size_squared(a) <= real(largest_squared):
            squared = square(a)
            I = invariants(a, squared)  # noqa: E741
            c = vec3(real(1.0), real(0.0), real(0.0))
            for k in range(further):
                c = times(c, I) * real(wp.static(1.0 / (terms - k)))
                c[0] = c[0] + real(1.0)
            return polynomial(a, squared, times(c, I))
        s, V = eigen(to_matrix(a))
        return compose(V, vec3(wp.exp(s[0]) - real(1.0), wp.exp(s[1]) - real(1.0), wp.exp(s[2]) - real(1.0)))

    @wp.func(module=module)
    def log_one_plus(a: sym):
        """ln(1 + A); NaN where that is not positive definite."""
        if size_squared(a) <= real(largest_squared):
            squared = square(a)
            I = invariants(a, squared)  # noqa: E741
            c = vec3(real(wp.static(1.0 / terms)), real(0.0), real(0.0))
            for k in range(further):
                c = -times(c, I)
                c[0] = c[0] + real(wp.static(1.0 / (terms - 1 - k)))
            return polynomial(a, squared, times(c, I))
        s, V = eigen(to_matrix(a))
        return compose(V, vec3(wp.log(real(1.0) + s[0]), wp.log(real(1.0) + s[1]), wp.log(real(1.0) + s[2])))

    @wp.func(module=module)
    def deform(strain: sym, G: mat33):
        """Hencky's strain ln(V) of F = V R after a further (1 + G) F: ln((1 + G) exp(2 e) (1 + G)^T) / 2."""
        P = G + (wp.identity(n=3, dtype=real) + G) * to_matrix(exp_minus_one(real(2.0) * strain))
        Q = wp.transpose(G)
        return real(0.5) * log_one_plus(from_matrix(P + Q + P * Q))

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
        log_one_plus=log_one_plus,
        deform=deform,
    )
