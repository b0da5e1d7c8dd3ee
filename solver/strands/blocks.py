"""Pieces of a block L D L^T factorisation for 4 x 4 blocks: a segment's turn and its end node's displacement."""

from functools import cache
from types import SimpleNamespace

import warp as wp

from plait.solver.strands.types import rod_types


@cache
def block_functions(real: type) -> SimpleNamespace:
    """Device functions for `real`; without square roots, whose latency would be a large part of the whole.

    A factor is unit lower triangular, L, with the reciprocals of D in the place of its diagonal.
    """
    types = rod_types(real)
    vec4, mat43, mat44, module = types.vec4, types.mat43, types.mat44, types.module

    @wp.func(module=module)
    def factorise(a: mat44):
        """Factor of symmetric a (lower triangle read), and whether a is positive definite."""
        zero = real(0.0)
        one = real(1.0)
        d0 = a[0, 0]
        r0 = one / d0
        l10 = a[1, 0] * r0
        l20 = a[2, 0] * r0
        l30 = a[3, 0] * r0
        d1 = a[1, 1] - a[1, 0] * l10
        r1 = one / d1
        u21 = a[2, 1] - a[2, 0] * l10
        u31 = a[3, 1] - a[3, 0] * l10
        l21 = u21 * r1
        l31 = u31 * r1
        d2 = a[2, 2] - a[2, 0] * l20 - u21 * l21
        r2 = one / d2
        u32 = a[3, 2] - a[3, 0] * l20 - u31 * l21
        l32 = u32 * r2
        d3 = a[3, 3] - a[3, 0] * l30 - u31 * l31 - u32 * l32
        r3 = one / d3
        factor = mat44(
            r0, zero, zero, zero,
            l10, r1, zero, zero,
            l20, l21, r2, zero,
            l30, l31, l32, r3,
        )  # fmt: skip
        return factor, d0 > zero and d1 > zero and d2 > zero and d3 > zero

    @wp.func(module=module)
    def divide(a: mat44, factor: mat44):
        """a L^-T and a L^-T D^-1."""
        w = mat44()
        x = mat44()
        for r in range(4):
            w0 = a[r, 0]
            w1 = a[r, 1] - w0 * factor[1, 0]
            w2 = a[r, 2] - w0 * factor[2, 0] - w1 * factor[2, 1]
            w3 = a[r, 3] - w0 * factor[3, 0] - w1 * factor[3, 1] - w2 * factor[3, 2]
            w[r, 0] = w0
            w[r, 1] = w1
            w[r, 2] = w2
            w[r, 3] = w3
            x[r, 0] = w0 * factor[0, 0]
            x[r, 1] = w1 * factor[1, 1]
            x[r, 2] = w2 * factor[2, 2]
            x[r, 3] = w3 * factor[3, 3]
        return w, x

    @wp.func(module=module)
    def divide_end(a: mat43, factor: mat44):
        """The last three columns of the same for (0, a); the first are zero."""
        w = mat43()
        x = mat43()
        for r in range(4):
            w1 = a[r, 0]
            w2 = a[r, 1] - w1 * factor[2, 1]
            w3 = a[r, 2] - w1 * factor[3, 1] - w2 * factor[3, 2]
            w[r, 0] = w1
            w[r, 1] = w2
            w[r, 2] = w3
            x[r, 0] = w1 * factor[1, 1]
            x[r, 1] = w2 * factor[2, 2]
            x[r, 2] = w3 * factor[3, 3]
        return w, x

    @wp.func(module=module)
    def subtract_square_end(a: mat44, x: mat43, w: mat43):
        """a - x w^T, lower triangle."""
        for r in range(4):
            for c in range(r + 1):
                a[r, c] -= x[r, 0] * w[c, 0] + x[r, 1] * w[c, 1] + x[r, 2] * w[c, 2]
        return a

    @wp.func(module=module)
    def subtract_square(a: mat44, x: mat44, w: mat44):
        """a - x w^T, lower triangle."""
        for r in range(4):
            for c in range(r + 1):
                a[r, c] -= x[r, 0] * w[c, 0] + x[r, 1] * w[c, 1] + x[r, 2] * w[c, 2] + x[r, 3] * w[c, 3]
        return a

    @wp.func(module=module)
    def subtract_product(a: mat44, x: mat43, w: mat44):
        """a - (0, x) w^T."""
        for r in range(4):
            for c in range(4):
                a[r, c] -= x[r, 0] * w[c, 1] + x[r, 1] * w[c, 2] + x[r, 2] * w[c, 3]
        return a

    @wp.func(module=module)
    def forward(factor: mat44, b: vec4):
        """L^-1 b."""
        y0 = b[0]
        y1 = b[1] - factor[1, 0] * y0
        y2 = b[2] - factor[2, 0] * y0 - factor[2, 1] * y1
        y3 = b[3] - factor[3, 0] * y0 - factor[3, 1] * y1 - factor[3, 2] * y2
        return vec4(y0, y1, y2, y3)

    @wp.func(module=module)
    def backward(factor: mat44, y: vec4, known: vec4):
        """L^-T (D^-1 y - known)."""
        x3 = y[3] * factor[3, 3] - known[3]
        x2 = y[2] * factor[2, 2] - known[2] - factor[3, 2] * x3
        x1 = y[1] * factor[1, 1] - known[1] - factor[2, 1] * x2 - factor[3, 1] * x3
        x0 = y[0] * factor[0, 0] - known[0] - factor[1, 0] * x1 - factor[2, 0] * x2 - factor[3, 0] * x3
        return vec4(x0, x1, x2, x3)

    return SimpleNamespace(
        factorise=factorise,
        divide=divide,
        divide_end=divide_end,
        subtract_square=subtract_square,
        subtract_square_end=subtract_square_end,
        subtract_product=subtract_product,
        forward=forward,
        backward=backward,
    )
