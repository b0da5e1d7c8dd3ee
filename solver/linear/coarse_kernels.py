"""Kernels of `coarse.py`: matrices on grids, and one multigrid cycle over them."""

from functools import cache, partial
from types import SimpleNamespace

import warp as wp

from plait.solver.linear.block_kernels import block_kernels
from plait.solver.materials.rotation import rotation_functions


@cache
def coarse_kernels(real: type) -> SimpleNamespace:
    """Kernels in `real` (wp.float32 or wp.float64)."""
    module = f"plait_coarse_{real.__name__}"
    structure = partial(wp.struct, module=module)
    kernel = partial(wp.kernel, module=module, enable_backward=False)
    vec3 = wp.types.vector(3, real)
    mat33 = wp.types.matrix((3, 3), real)
    vec8i = wp.types.vector(8, wp.int32)
    vec8 = wp.types.vector(8, real)
    Krylov, Incidence = block_kernels(real).types.Krylov, block_kernels(real).types.Incidence
    rotation = rotation_functions(real).rotation

    @structure
    class Level:
        """One grid: its matrix, and how it hangs together with the next finer level."""

        first_block: wp.array(dtype=wp.int32)  # (count + 1,)
        column: wp.array(dtype=wp.int32)  # (block_count,)
        block: wp.array(dtype=mat33)  # (block_count,) stiffness at rest, constant
        weight: wp.array(dtype=real)  # (count,) what a step adds on the diagonal
        smoother: wp.array(dtype=mat33)  # (count,) damped inverse of the diagonal blocks
        damping: wp.array(dtype=real)  # (1,) of the smoother
        first_child: wp.array(dtype=wp.int32)  # (count + 1,)
        child: wp.array(dtype=wp.int32)  # of the finer level
        child_weight: wp.array(dtype=real)
        parent: wp.array(dtype=vec8i)  # (finer_count,) of this level
        parent_weight: wp.array(dtype=vec8)
        residual: wp.array(dtype=vec3)  # (count,)
        solution: wp.array(dtype=vec3)  # (count,)
        spare: wp.array(dtype=vec3)  # (count,) what is left of the residual; then the smoothed solution

    @structure
    class Cells:
        """Tets by the cell of the finest grid that their centre lies in."""

        cell: wp.array2d(dtype=wp.int32)  # (count, 8) the cell whose corner c the node is, or -1
        slot: wp.array2d(dtype=wp.int32)  # (count, 27) the row's block for each neighbour, or -1
        first_tet: wp.array(dtype=wp.int32)  # (cell_count + 1,)
        place: wp.array(dtype=vec3)  # (tet_count,) of the centre within its cell, 0 to 1
        mu: wp.array(dtype=real)  # (tet_count,) [N/m] volume times mu over the spacing squared
        lam: wp.array(dtype=real)

    @wp.func(module=module)
    def slope(corner: int, place: vec3):
        """Gradient of the trilinear function of a cell's corner, per cell."""
        x = place[0]
        y = place[1]
        z = place[2]
        dx = real(1.0)
        dy = real(1.0)
        dz = real(1.0)
        if corner / 4 == 0:
            x = real(1.0) - x
            dx = real(-1.0)
        if (corner / 2) % 2 == 0:
            y = real(1.0) - y
            dy = real(-1.0)
        if corner % 2 == 0:
            z = real(1.0) - z
            dz = real(-1.0)
        return vec3(dx * y * z, x * dy * z, x * y * dz)

    @kernel
    def assemble_cells(first: int, cells: Cells, penalty: wp.array(dtype=real), level_out: Level):
        """Linear elasticity of the tets' material, one quadrature point a tet; `penalty` on the diagonal."""
        i = first + wp.tid()
        corners = wp.int32(8)  # a variable: unrolled, this takes long to compile
        for k in range(level_out.first_block[i], level_out.first_block[i + 1]):
            level_out.block[k] = mat33()
        for c in range(corners):
            cell = cells.cell[i, c]
            if cell >= 0:
                for t in range(cells.first_tet[cell], cells.first_tet[cell + 1]):
                    g = slope(c, cells.place[t])
                    for d in range(corners):
                        apart = 9 * (d / 4 - c / 4) + 3 * ((d / 2) % 2 - (c / 2) % 2) + d % 2 - c % 2
                        s = cells.slot[i, 13 + apart]
                        # No node there: no point depends on it.
                        if s >= 0:
                            f = slope(d, cells.place[t])
                            block = cells.mu[t] * (wp.dot(g, f) * wp.identity(n=3, dtype=real) + wp.outer(f, g))
                            level_out.block[s] = level_out.block[s] + block + cells.lam[t] * wp.outer(g, f)
        s = cells.slot[i, 13]
        level_out.block[s] = level_out.block[s] + penalty[i] * wp.identity(n=3, dtype=real)

    @kernel
    def assemble_coarser(first: int, slot: wp.array2d(dtype=wp.int32), place: wp.array(dtype=wp.vec3i),
                         finer: Level, level_out: Level):  # fmt: skip
        """The Galerkin product of the finer level's matrix with the weights."""
        i = first + wp.tid()
        corners = wp.int32(8)  # a variable: unrolled, this takes long to compile
        for k in range(level_out.first_block[i], level_out.first_block[i + 1]):
            level_out.block[k] = mat33()
        for e in range(level_out.first_child[i], level_out.first_child[i + 1]):
            child = level_out.child[e]
            for k in range(finer.first_block[child], finer.first_block[child + 1]):
                other = finer.column[k]
                parents = level_out.parent[other]
                weights = level_out.parent_weight[other]
                for p in range(corners):
                    if weights[p] > real(0.0):
                        apart = place[parents[p]] - place[i]
                        s = slot[i, 13 + 9 * apart[0] + 3 * apart[1] + apart[2]]
                        factor = level_out.child_weight[e] * weights[p]
                        level_out.block[s] = level_out.block[s] + factor * finer.block[k]

    @kernel
    def restrict_weight(first: int, finer_weight: wp.array(dtype=real), level_out: Level):
        i = first + wp.tid()
        weight = real(0.0)
        for e in range(level_out.first_child[i], level_out.first_child[i + 1]):
            weight += level_out.child_weight[e] * finer_weight[level_out.child[e]]
        level_out.weight[i] = weight

    @kernel
    def prepare_smoother(first: int, level_out: Level):
        i = first + wp.tid()
        for k in range(level_out.first_block[i], level_out.first_block[i + 1]):
            if level_out.column[k] == i:
                diagonal = level_out.block[k] + level_out.weight[i] * wp.identity(n=3, dtype=real)
                level_out.smoother[i] = level_out.damping[0] * wp.inverse(diagonal)

    @wp.func(module=module)
    def product(level: Level, i: int, x: wp.array(dtype=vec3)):
        y = level.weight[i] * x[i]
        for k in range(level.first_block[i], level.first_block[i + 1]):
            y += level.block[k] * x[level.column[k]]
        return y

    @kernel
    def turn_nodes(first: int, incidence: Incidence, volume: wp.array(dtype=real), gradient: wp.array(dtype=mat33),
                   rotation_out: wp.array(dtype=mat33)):  # fmt: skip
        """How the material around each unknown has turned."""
        u = first + wp.tid()
        F = mat33()
        for k in range(incidence.first[u], incidence.first[u + 1]):
            t = incidence.corner[k] / 4
            F += volume[t] * gradient[t]
        rotation_out[u] = rotation(F)

    @kernel
    def restrict_turned(first: int, residual: wp.array(dtype=vec3), turn: wp.array(dtype=mat33), level_out: Level):
        """To the finest grid, turned back to rest; and the first smoothing there."""
        i = first + wp.tid()
        r = vec3()
        for e in range(level_out.first_child[i], level_out.first_child[i + 1]):
            u = level_out.child[e]
            r += level_out.child_weight[e] * (wp.transpose(turn[u]) * residual[u])
        level_out.residual[i] = r
        level_out.solution[i] = level_out.smoother[i] * r

    @kernel
    def restrict(first: int, finer: Level, level_out: Level):
        i = first + wp.tid()
        r = vec3()
        for e in range(level_out.first_child[i], level_out.first_child[i + 1]):
            r += level_out.child_weight[e] * finer.spare[level_out.child[e]]
        level_out.residual[i] = r
        level_out.solution[i] = level_out.smoother[i] * r

    @kernel
    def find_rest(first: int, level_out: Level):
        """What the first smoothing leaves of the residual."""
        i = first + wp.tid()
        level_out.spare[i] = level_out.residual[i] - product(level_out, i, level_out.solution)

    @kernel
    def solve_coarsest(first: int, inverse: wp.array(dtype=real), level_out: Level):
        i = first + wp.tid()
        count = level_out.residual.shape[0]
        x = vec3()
        for j in range(count):
            r = level_out.residual[j]
            for a in range(3):
                row = (3 * i + a) * 3 * count + 3 * j
                x[a] = x[a] + inverse[row] * r[0] + inverse[row + 1] * r[1] + inverse[row + 2] * r[2]
        level_out.spare[i] = x

    @kernel
    def prolong(first: int, coarser: Level, level_out: Level):
        i = first + wp.tid()
        parents = coarser.parent[i]
        weights = coarser.parent_weight[i]
        x = level_out.solution[i]
        for p in range(8):
            x += weights[p] * coarser.spare[parents[p]]
        level_out.solution[i] = x

    @kernel
    def smooth(first: int, level_out: Level):
        i = first + wp.tid()
        left = level_out.residual[i] - product(level_out, i, level_out.solution)
        level_out.spare[i] = level_out.solution[i] + level_out.smoother[i] * left

    @kernel
    def prolong_turned(first: int, level: Level, turn: wp.array(dtype=mat33), parity: int, krylov_out: Krylov):
        """Adds the correction to z, and r . z anew."""
        c = first + wp.tid()
        count = krylov_out.residual.shape[0]
        descent = wp.float64(0.0)
        for u in range(c * krylov_out.chunk, wp.min((c + 1) * krylov_out.chunk, count)):
            parents = level.parent[u]
            weights = level.parent_weight[u]
            x = vec3()
            for p in range(8):
                x += weights[p] * level.spare[parents[p]]
            z = krylov_out.preconditioned[u] + turn[u] * x
            krylov_out.preconditioned[u] = z
            descent += wp.float64(wp.dot(krylov_out.residual[u], z))
        krylov_out.descent[parity, c] = descent

    types = SimpleNamespace(vec3=vec3, mat33=mat33, vec8i=vec8i, vec8=vec8, Level=Level, Cells=Cells)
    return SimpleNamespace(
        assemble_cells=assemble_cells,
        assemble_coarser=assemble_coarser,
        restrict_weight=restrict_weight,
        prepare_smoother=prepare_smoother,
        turn_nodes=turn_nodes,
        restrict_turned=restrict_turned,
        restrict=restrict,
        find_rest=find_rest,
        solve_coarsest=solve_coarsest,
        prolong=prolong,
        smooth=smooth,
        prolong_turned=prolong_turned,
        types=types,
    )
