"""Block Cholesky pieces for 4 x 4 blocks: a segment's turn and its end node's displacement."""

from functools import cache
from types import SimpleNamespace

import warp as wp

from plait.solver.strands.types import rod_types


@cache
def block_functions(real: type) -> SimpleNamespace:
    """Device functions `cholesky`, `divide`, `forward`, `backward` for `real`.

    A factor L is lower triangular with the reciprocals of its diagonal in the diagonal's place.
    """
    types = rod_types(real)
    vec4, mat43, mat44, module = types.vec4, types.mat43, types.mat44, types.module

    @wp.func(module=module)
    def cholesky(a: mat44):
        """Factor of symmetric a (lower triangle read), and the smallest pivot: positive if a is definite."""
        zero = real(0.0)
        one = real(1.0)
        p0 = a[0, 0]
        r0 = one / wp.sqrt(wp.max(p0, zero))
        l10 = a[1, 0] * r0
        l20 = a[2, 0] * r0
        l30 = a[3, 0] * r0
        p1 = a[1, 1] - l10 * l10
        r1 = one / wp.sqrt(wp.max(p1, zero))
        l21 = (a[2, 1] - l20 * l10) * r1
        l31 = (a[3, 1] - l30 * l10) * r1
        p2 = a[2, 2] - l20 * l20 - l21 * l21
        r2 = one / wp.sqrt(wp.max(p2, zero))
        l32 = (a[3, 2] - l30 * l20 - l31 * l21) * r2
        p3 = a[3, 3] - l30 * l30 - l31 * l31 - l32 * l32
        r3 = one / wp.sqrt(wp.max(p3, zero))
        factor = mat44(
            r0, zero, zero, zero,
            l10, r1, zero, zero,
            l20, l21, r2, zero,
            l30, l31, l32, r3,
        )  # fmt: skip
        return factor, wp.min(wp.min(p0, p1), wp.min(p2, p3))

    @wp.func(module=module)
    def divide(a: mat44, factor: mat44):
        """x with x L^T = a."""
        x = mat44()
        for r in range(4):
            x0 = a[r, 0] * factor[0, 0]
            x1 = (a[r, 1] - x0 * factor[1, 0]) * factor[1, 1]
            x2 = (a[r, 2] - x0 * factor[2, 0] - x1 * factor[2, 1]) * factor[2, 2]
            x3 = (a[r, 3] - x0 * factor[3, 0] - x1 * factor[3, 1] - x2 * factor[3, 2]) * factor[3, 3]
            x[r, 0] = x0
            x[r, 1] = x1
            x[r, 2] = x2
            x[r, 3] = x3
        return x

    @wp.func(module=module)
    def divide_end(a: mat43, factor: mat44):
        """The last three columns of x with x L^T = (0, a); the first is zero."""
        x = mat43()
        for r in range(4):
            x1 = a[r, 0] * factor[1, 1]
            x2 = (a[r, 1] - x1 * factor[2, 1]) * factor[2, 2]
            x[r, 0] = x1
            x[r, 1] = x2
            x[r, 2] = (a[r, 2] - x1 * factor[3, 1] - x2 * factor[3, 2]) * factor[3, 3]
        return x

    @wp.func(module=module)
    def subtract_square_end(a: mat44, x: mat43):
        """a - x x^T, lower triangle."""
        for r in range(4):
            for c in range(r + 1):
                a[r, c] -= x[r, 0] * x[c, 0] + x[r, 1] * x[c, 1] + x[r, 2] * x[c, 2]
        return a

    @wp.func(module=module)
    def subtract_square(a: mat44, x: mat44):
        """a - x x^T, lower triangle."""
        for r in range(4):
            for c in range(r + 1):
                a[r, c] -= x[r, 0] * x[c, 0] + x[r, 1] * x[c, 1] + x[r, 2] * x[c, 2] + x[r, 3] * x[c, 3]
        return a

    @wp.func(module=module)
    def subtract_product(a: mat44, x: mat43, y: mat44):
        """a - (0, x) y^T."""
        for r in range(4):
            for c in range(4):
                a[r, c] -= x[r, 0] * y[c, 1] + x[r, 1] * y[c, 2] + x[r, 2] * y[c, 3]
        return a

    @wp.func(module=module)
    def forward(factor: mat44, b: vec4):
        """L^-1 b."""
        y0 = b[0] * factor[0, 0]
        y1 = (b[1] - factor[1, 0] * y0) * factor[1, 1]
        y2 = (b[2] - factor[2, 0] * y0 - factor[2, 1] * y1) * factor[2, 2]
        y3 = (b[3] - factor[3, 0] * y0 - factor[3, 1] * y1 - factor[3, 2] * y2) * factor[3, 3]
        return vec4(y0, y1, y2, y3)

    @wp.func(module=module)
    def backward(factor: mat44, y: vec4):
        """L^-T y."""
        x3 = y[3] * factor[3, 3]
        x2 = (y[2] - factor[3, 2] * x3) * factor[2, 2]
        x1 = (y[1] - factor[2, 1] * x2 - factor[3, 1] * x3) * factor[1, 1]
        x0 = (y[0] - factor[1, 0] * x1 - factor[2, 0] * x2 - factor[3, 0] * x3) * factor[0, 0]
        return vec4(x0, x1, x2, x3)

    return SimpleNamespace(
        cholesky=cholesky,
        divide=divide,
        divide_end=divide_end,
        subtract_square=subtract_square,
        subtract_square_end=subtract_square_end,
        subtract_product=subtract_product,
        forward=forward,
        backward=backward,
    )
