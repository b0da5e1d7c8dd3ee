"""Kernels of `block_rows.py` and of the conjugate gradients on such rows."""

from functools import cache, partial
from types import SimpleNamespace

import warp as wp


@cache
def block_kernels(real: type) -> SimpleNamespace:
    """Kernels for matrices and vectors in `real` (wp.float32 or wp.float64); sums are taken in float64."""
    module = f"plait_linear_{real.__name__}"
    structure = partial(wp.struct, module=module)
    kernel = partial(wp.kernel, module=module, enable_backward=False)
    vec3 = wp.types.vector(3, real)
    mat33 = wp.types.matrix((3, 3), real)

    @structure
    class Rows:
        """A matrix, rows of blocks."""

        first_block: wp.array(dtype=wp.int32)  # (count + 1,)
        column: wp.array(dtype=wp.int32)  # (block_count,)
        block: wp.array(dtype=mat33)  # (block_count,)
        inverse_diagonal: wp.array(dtype=mat33)  # (count,) of the diagonal blocks

    @structure
    class Incidence:
        """Which corners of tets an unknown sits at."""

        first: wp.array(dtype=wp.int32)  # (count + 1,)
        corner: wp.array(dtype=wp.int32)  # (incidence_count,) 4 t + a: corner a of tet t
        slot: wp.array(dtype=wp.vec4i)  # (incidence_count,) the row's block for each corner of the tet, or -1

    @structure
    class Krylov:
        """Vectors of the iteration, (count,), and its sums over chunks of unknowns."""

        chunk: wp.int32  # unknowns a chunk
        solution: wp.array(dtype=vec3)
        residual: wp.array(dtype=vec3)
        preconditioned: wp.array(dtype=vec3)  # z
        product: wp.array(dtype=vec3)  # A z
        direction: wp.array(dtype=vec3)
        direction_product: wp.array(dtype=vec3)
        descent: wp.array2d(dtype=wp.float64)  # (2, chunk_count) r . z, of even and of odd iterations
        curvature: wp.array(dtype=wp.float64)  # (chunk_count,) z . A z
        residual_square: wp.array(dtype=wp.float64)  # (chunk_count,)
        memory: wp.array2d(dtype=wp.float64)  # (2, 2) r . z and step length of the iteration before

    @wp.func(module=module)
    def pair(a: int, b: int):
        """Which of a tet's stored blocks couples corners a <= b."""
        if a == b:
            return a
        if a == 0:
            return 3 + b
        if a == 1:
            return 5 + b
        return wp.int32(9)

    @kernel
    def assemble(first: int, incidence: Incidence, tet_block: wp.array(dtype=mat33),
                 weight: wp.array(dtype=real), rows_out: Rows):  # fmt: skip
        i = first + wp.tid()
        for k in range(rows_out.first_block[i], rows_out.first_block[i + 1]):
            rows_out.block[k] = mat33()
        diagonal = wp.diag(vec3(weight[i], weight[i], weight[i]))
        own = wp.int32(0)
        for k in range(incidence.first[i], incidence.first[i + 1]):
            corner = incidence.corner[k]
            a = corner % 4
            base = 10 * (corner / 4)
            slot = incidence.slot[k]
            for b in range(4):
                s = slot[b]
                if b == a:
                    own = s
                    diagonal += tet_block[base + a]
                elif s >= 0:
                    if a < b:
                        rows_out.block[s] = rows_out.block[s] + tet_block[base + pair(a, b)]
                    else:
                        rows_out.block[s] = rows_out.block[s] + wp.transpose(tet_block[base + pair(b, a)])
        rows_out.block[own] = diagonal
        rows_out.inverse_diagonal[i] = wp.inverse(diagonal)

    @wp.func(module=module)
    def total(parts: wp.array(dtype=wp.float64)):
        value = wp.float64(0.0)
        for k in range(parts.shape[0]):
            value += parts[k]
        return value

    @kernel
    def begin(first: int, rows: Rows, krylov: Krylov):
        """From a zero solution: z = D^-1 r."""
        c = first + wp.tid()
        count = krylov.residual.shape[0]
        descent = wp.float64(0.0)
        square = wp.float64(0.0)
        for i in range(c * krylov.chunk, wp.min((c + 1) * krylov.chunk, count)):
            r = krylov.residual[i]
            z = rows.inverse_diagonal[i] * r
            krylov.solution[i] = vec3()
            krylov.direction[i] = vec3()
            krylov.direction_product[i] = vec3()
            krylov.preconditioned[i] = z
            descent += wp.float64(wp.dot(r, z))
            square += wp.float64(wp.dot(r, r))
        krylov.descent[0, c] = descent
        krylov.residual_square[c] = square
        if c == 0:
            krylov.memory[1, 0] = wp.float64(0.0)
            krylov.memory[1, 1] = wp.float64(0.0)

    @kernel
    def multiply(first: int, rows: Rows, krylov: Krylov):
        """A z, and its part of z . A z."""
        c = first + wp.tid()
        count = krylov.residual.shape[0]
        curvature = wp.float64(0.0)
        for i in range(c * krylov.chunk, wp.min((c + 1) * krylov.chunk, count)):
            y = vec3()
            for k in range(rows.first_block[i], rows.first_block[i + 1]):
                y += rows.block[k] * krylov.preconditioned[rows.column[k]]
            krylov.product[i] = y
            curvature += wp.float64(wp.dot(y, krylov.preconditioned[i]))
        krylov.curvature[c] = curvature

    @kernel
    def update(first: int, rows: Rows, krylov: Krylov, parity: int):
        """Step lengths, then solution, residual and z = D^-1 r."""
        c = first + wp.tid()
        count = krylov.residual.shape[0]
        descent = total(krylov.descent[parity])
        curvature = total(krylov.curvature)
        beta = wp.float64(0.0)
        alpha = wp.float64(0.0)
        if krylov.memory[1 - parity, 0] > wp.float64(0.0):
            beta = descent / krylov.memory[1 - parity, 0]
            curvature -= beta * descent / krylov.memory[1 - parity, 1]
        if descent > wp.float64(0.0) and curvature > wp.float64(0.0):
            alpha = descent / curvature
        if c == 0:
            krylov.memory[parity, 0] = descent
            krylov.memory[parity, 1] = alpha
        along = real(alpha)
        keep = real(beta)
        descent = wp.float64(0.0)
        square = wp.float64(0.0)
        for i in range(c * krylov.chunk, wp.min((c + 1) * krylov.chunk, count)):
            p = krylov.preconditioned[i] + keep * krylov.direction[i]
            q = krylov.product[i] + keep * krylov.direction_product[i]
            r = krylov.residual[i] - along * q
            z = rows.inverse_diagonal[i] * r
            krylov.direction[i] = p
            krylov.direction_product[i] = q
            krylov.solution[i] = krylov.solution[i] + along * p
            krylov.residual[i] = r
            krylov.preconditioned[i] = z
            descent += wp.float64(wp.dot(r, z))
            square += wp.float64(wp.dot(r, r))
        krylov.descent[1 - parity, c] = descent
        krylov.residual_square[c] = square

    types = SimpleNamespace(vec3=vec3, mat33=mat33, Rows=Rows, Incidence=Incidence, Krylov=Krylov)
    return SimpleNamespace(
        assemble=assemble, begin=begin, multiply=multiply, update=update, pair=pair, types=types
    )
