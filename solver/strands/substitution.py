"""A strand's factored matrix, kept such that it is solved with again and again in little time.

M = L D L^T with unit diagonal blocks in L, and D kept by the inverses of its blocks (block L D L^T; Golub and Van
Loan, Matrix Computations, 4.2): then no triangular solve lies on the way from a segment to the next, only the
product of one block with a vector.
"""

from functools import cache, partial
from types import SimpleNamespace

import warp as wp

from plait.solver.strands.types import coupled_module_name, rod_types


@cache
def substitution(real: type) -> SimpleNamespace:
    """Device functions `invert`, `divide_unit`, `divide_unit_end`, `solve`; factors are those of `blocks.py`."""
    types = rod_types(real)
    vec4, mat43, mat44 = types.vec4, types.mat43, types.mat44
    Rods, Scratch = types.Rods, types.Scratch
    module = coupled_module_name(real)

    @partial(wp.struct, module=module)
    class Krylov:
        """Of conjugate gradients, entry k of a strand its segment k: (turn, displacement of node k + 1)."""

        direction: wp.array(dtype=vec4)
        image: wp.array(dtype=vec4)  # the direction's, under the matrix of all strands
        step: wp.array(dtype=vec4)

    @wp.func(module=module)
    def invert(factor: mat44):
        """L^-T D^-1 L^-1."""
        u10 = -factor[1, 0]
        u21 = -factor[2, 1]
        u32 = -factor[3, 2]
        u20 = -factor[2, 0] - factor[2, 1] * u10
        u31 = -factor[3, 1] - factor[3, 2] * u21
        u30 = -factor[3, 0] - factor[3, 1] * u10 - factor[3, 2] * u20
        v10 = factor[1, 1] * u10
        v20 = factor[2, 2] * u20
        v21 = factor[2, 2] * u21
        v30 = factor[3, 3] * u30
        v31 = factor[3, 3] * u31
        v32 = factor[3, 3] * u32
        x10 = v10 + v20 * u21 + v30 * u31
        x20 = v20 + v30 * u32
        x21 = v21 + v31 * u32
        return mat44(
            factor[0, 0] + v10 * u10 + v20 * u20 + v30 * u30, x10, x20, v30,
            x10, factor[1, 1] + v21 * u21 + v31 * u31, x21, v31,
            x20, x21, factor[2, 2] + v32 * u32, v32,
            v30, v31, v32, factor[3, 3],
        )  # fmt: skip

    @wp.func(module=module)
    def divide_unit(a: mat44, factor: mat44):
        """a L^-1."""
        for r in range(4):
            a[r, 2] -= a[r, 3] * factor[3, 2]
            a[r, 1] -= a[r, 3] * factor[3, 1] + a[r, 2] * factor[2, 1]
            a[r, 0] -= a[r, 3] * factor[3, 0] + a[r, 2] * factor[2, 0] + a[r, 1] * factor[1, 0]
        return a

    @wp.func(module=module)
    def divide_unit_end(a: mat43, factor: mat44):
        """(0, a) L^-1."""
        x = mat44()
        for r in range(4):
            x[r, 1] = a[r, 0]
            x[r, 2] = a[r, 1]
            x[r, 3] = a[r, 2]
        return divide_unit(x, factor)

    @wp.func(module=module)
    def times(m: mat44, v: vec4):
        """m v; sums in pairs, which wait for each other less."""
        return vec4(
            (m[0, 0] * v[0] + m[0, 1] * v[1]) + (m[0, 2] * v[2] + m[0, 3] * v[3]),
            (m[1, 0] * v[0] + m[1, 1] * v[1]) + (m[1, 2] * v[2] + m[1, 3] * v[3]),
            (m[2, 0] * v[0] + m[2, 1] * v[1]) + (m[2, 2] * v[2] + m[2, 3] * v[3]),
            (m[3, 0] * v[0] + m[3, 1] * v[1]) + (m[3, 2] * v[2] + m[3, 3] * v[3]),
        )

    @wp.func(module=module)
    def times_transposed(m: mat44, v: vec4):
        """m^T v, likewise."""
        return (m[0] * v[0] + m[1] * v[1]) + (m[2] * v[2] + m[3] * v[3])

    @wp.func(module=module)
    def solve(rods: Rods, scratch: Scratch, krylov: Krylov, strand: int, alpha: real):
        """Goes `alpha` along the direction and solves M z = r for what is left; the product r . z."""
        begin = rods.first_node[strand] + 1 - rods.free[strand]
        end = rods.first_node[strand + 1] - 1
        product = wp.float64(0.0)
        y1 = vec4()
        y2 = vec4()
        for slot in range(begin, end):
            krylov.step[slot] = krylov.step[slot] + alpha * krylov.direction[slot]
            r = scratch.right[slot] - alpha * krylov.image[slot]
            scratch.right[slot] = r
            y = r - times(scratch.left2[slot], y2) - times(scratch.left1[slot], y1)
            z = times(scratch.inverse[slot], y)
            scratch.solution[slot] = z
            product += wp.float64(wp.dot(y, z))
            y2 = y1
            y1 = y
        known = vec4()
        known_before = vec4()
        for i in range(end - begin):
            slot = end - 1 - i
            z = scratch.solution[slot] - known
            scratch.solution[slot] = z
            known = known_before + times_transposed(scratch.left1[slot], z)
            known_before = times_transposed(scratch.left2[slot], z)
        return product

    return SimpleNamespace(
        Krylov=Krylov, invert=invert, divide_unit=divide_unit, divide_unit_end=divide_unit_end, solve=solve
    )
