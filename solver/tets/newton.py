"""Newton's method for one body's implicit step: minimise sum of weight |x - target|^2 / 2 plus elastic energy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from plait.solver.launch import Launcher
from plait.solver.linear.block_rows import BlockRows
from plait.solver.linear.chunks import chunk_size, reader
from plait.solver.linear.coarse import CoarseCorrection
from plait.solver.linear.conjugate_gradients import ConjugateGradients
from plait.solver.tets import elements as tet_elements
from plait.solver.tets.body_kernels import body_kernels
from plait.solver.tets.damping import StiffnessDamping
from plait.solver.tets.elements import body_elements, element_kernels, element_types
from plait.solver.tets.layout import TetLayout
from plait.solver.tets.rest_material import rest_material

if TYPE_CHECKING:
    from plait.solver.contact.obstacle_forces import ObstacleForces

# Sufficient decrease; and the part of the slope that may remain where rounding hides the decrease.
ARMIJO, CURVATURE = 1e-4, 0.9
MAX_BACKTRACKS = 20
# How exactly linear solves are made; see `_forcing`.
LOOSE, ENOUGH, TIGHT = 0.1, 0.3, 0.001
MAX_LINEAR_ITERATIONS = 400
# Beyond so many iterations, or with a tet squeezed to this part of its volume, the Hessian is projected exactly.
CHEAP_ITERATIONS, SQUEEZED = 6, 0.2
# A projected Hessian that leaves more than this part of the residual gives way to the exact one: near a minimum in
# which tets are tangled, that alone converges (Longva et al. 2023, 'Pitfalls of projection').
SLOW = 0.5
# Conjugate gradients are given the coarse correction where a step's square root of stiffness over inertia is above
# this: without it they take about 3.5 times that number of iterations.
FAR = 3.0
# No displacement is worth another iteration below this part of the body's diagonal.
STILL = {wp.float32: 1e-7, wp.float64: 1e-13}
# A residual of so many times what rounding alone may leave is none.
ROUNDING = 0.5
FORCE_WORK, GATHER_WORK = tet_elements.FORCE_WORK, 12


@dataclass
class Outcome:
    """Of one minimisation. residual: [N] 2-norm that is left."""

    converged: bool
    iterations: int
    linear_iterations: int
    residual: float


@dataclass(frozen=True)
class Evaluation:
    """At one place.

    residual: [N] 2-norm, and of it, rounding: what the arithmetic may leave.  quadratic: [J].
    work: [J] of the forces along the direction last found.  least_volume: smallest J of the tets.
    """

    residual: float
    rounding: float
    quadratic: float
    work: float
    least_volume: float


class Newton:
    """Works on the unknowns of one body; `position` holds the place it is at, all nodes of the scene.

    unknowns: struct `Unknowns` of `body_kernels`, whose weight and target say what to minimise.
    rows: the matrix of the unknowns.
    damping: by the stiffness, or None.
    obstacles: what surfaces in the body's way add to its energy, forces and stiffness; None for nothing.
    """

    def __init__(
        self,
        layout: TetLayout,
        body: int,
        node: np.ndarray,
        position: wp.array,
        launcher: Launcher,
        real: type,
    ) -> None:
        """node: (unknown_count,) int32, the free nodes, into all nodes."""
        self._launcher, self.real, self._position = launcher, real, position
        self._kernels, device = body_kernels(real), launcher.device
        self._law = element_kernels(layout.bodies[body].law, real)
        self.elements = body_elements(layout, body, real, device)
        unknown = np.full(layout.node_count, -1, dtype=np.int64)
        unknown[node] = np.arange(len(node))
        tets = layout.tets[layout.first_tet[body] : layout.first_tet[body + 1]]
        self.rows = BlockRows(unknown[tets], len(node), launcher, real)
        self.gradients = ConjugateGradients(self.rows, launcher, real)
        self.tet_count, count = len(tets), len(node)
        self.unknowns = self._kernels.types.Unknowns()
        vec3 = element_types(real).vec3
        self.unknowns.node = wp.array(node, dtype=wp.int32, device=device)
        self.unknowns.weight = wp.zeros(count, dtype=real, device=device)
        self.unknowns.target = wp.zeros(count, dtype=wp.vec3d, device=device)
        self.unknowns.residual = wp.zeros(count, dtype=vec3, device=device)
        self._start = wp.zeros(count, dtype=wp.vec3d, device=device)
        nodes = layout.rest[layout.nodes(body)]
        self._still = STILL[real] * float(np.linalg.norm(np.ptp(nodes, axis=0)))
        self._rounding = ROUNDING * float(np.finfo(np.float32 if real == wp.float32 else np.float64).eps)
        self.obstacles: ObstacleForces | None = None
        coefficient = layout.bodies[body].stiffness_damping
        self.damping = StiffnessDamping(self.elements, coefficient, launcher, real) if coefficient > 0.0 else None
        self._material = rest_material(layout, body, node)
        self._mean_stiffness = float(self._material.stiffness.mean())
        self._mean_mass = float(layout.mass[node].mean())
        self._reach = 0.0
        self._prepare()

    def _prepare(self) -> None:
        """The launches that are repeated, and their arrays."""
        launcher, kernels, law = self._launcher, self._kernels, self._law
        device, prepare, vec3 = launcher.device, launcher.prepare, element_types(self.real).vec3
        tets, unknowns, position = self.tet_count, self.unknowns, self._position
        count = self.rows.count
        self._force = wp.zeros(4 * tets, dtype=vec3, device=device)
        self._dilation = wp.zeros(tets, dtype=self.real, device=device)
        chunk, tet_chunk = chunk_size(count, device), chunk_size(tets, device)
        chunks, tet_chunks = -(-count // chunk), -(-tets // tet_chunk)
        self._sums = wp.zeros((chunks, 4), dtype=wp.float64, device=device)
        self._direction_sums = wp.zeros((chunks, 2), dtype=wp.float64, device=device)
        self._force_sums = wp.zeros(chunks, dtype=wp.float64, device=device)
        self._least = wp.zeros(tet_chunks, dtype=self.real, device=device)
        self._read_sums, self._read_direction_sums = reader(self._sums), reader(self._direction_sums)
        self._read_least = reader(self._least)
        direction = self.gradients.krylov.solution
        forces = [self._force, self._dilation]
        self._find_forces = prepare(law.force, tets, [self.elements, position], forces, work_per_item=FORCE_WORK)
        self._find_least = prepare(
            kernels.least, tet_chunks, [tet_chunk, self._dilation], [self._least], work_per_item=tet_chunk // 16
        )
        self._find_residual = prepare(
            kernels.residual,
            chunks,
            [chunk, self.rows.incidence, self._force, position, direction],
            [unknowns, self._sums],
            work_per_item=GATHER_WORK * chunk,
        )
        self._examine_direction = prepare(
            kernels.examine_direction, chunks, [chunk, unknowns, direction], [self._direction_sums],
            work_per_item=chunk,
        )  # fmt: skip
        self._find_blocks: dict[str, Callable[[], None]] = {}
        self._take_start = prepare(kernels.take, count, [unknowns, position], [self._start])

    def force_size(self, step: Any, motion: Any) -> float:
        """[N] 2-norm of the forces where last evaluated, the start of a step: what its end is to balance.

        Not so the residual there, which also holds what would stop every node; that grows as steps get shorter,
        and a solve to a part of it would leave the velocities to chance.
        """
        sums = self._force_sums
        chunk = chunk_size(self.rows.count, self._launcher.device)
        self._launcher.launch(self._kernels.weigh_forces, len(sums), [chunk, step, motion, self.unknowns], [sums])
        return float(np.sqrt(sums.numpy().sum()))

    def start_from(self, guess: wp.array, here: Evaluation) -> Evaluation:
        """Takes `position` to `guess`, (node_count,) vec3d, if that is the better place to begin than `here`.

        A guess must have the lower residual in a body nowhere squeezed, or the lower energy: a blind guess of a
        stretched bar may be its mirror image.
        """
        self._take_start()
        count = self.rows.count
        self._launcher.launch(self._kernels.put, count, [self.unknowns, guess], [self._position])
        there = self.evaluate()
        calm = min(here.least_volume, there.least_volume) > SQUEEZED
        if calm and there.residual <= here.residual:
            return there
        energy = self._potential() + there.quadratic
        self._advance(0.0)
        if energy <= self._potential() + here.quadratic:
            self._launcher.launch(self._kernels.put, count, [self.unknowns, guess], [self._position])
            return self.evaluate()
        return self.evaluate()

    # -- the parts of an iteration ---------------------------------------------------------------------------

    def find_forces(self) -> wp.array:
        """(4 tet_count,) vec3 [N]: the elastic force at `position` on corner a of tet t, at 4 t + a."""
        self._find_forces()
        return self._force

    def evaluate(self) -> Evaluation:
        """Forces at `position`."""
        self._find_forces()
        if self.damping is not None:
            self.damping.add_forces(self._position, self._force)
        if self.obstacles is not None:
            self.obstacles.add_forces(self._position, self._force)
        self._find_least()
        self._find_residual()
        square, quadratic, work, forces = (float(value) for value in self._read_sums().sum(axis=0))
        rounding = self._rounding * np.sqrt(forces)
        return Evaluation(np.sqrt(square), rounding, quadratic, work, float(self._read_least().min()))

    def elastic_energy(self) -> float:
        """[J] at `position`."""
        self._find_energy()
        return self._sum_energy()

    def _find_energy(self) -> None:
        inputs = [self.elements, self._position]
        self._launcher.launch(
            self._law.energy, self.tet_count, inputs, [self._energy], work_per_item=tet_elements.ENERGY_WORK
        )

    def _sum_energy(self) -> float:
        chunk, parts = chunk_size(self.tet_count, self._launcher.device), self._energy_parts
        self._launcher.launch(self._kernels.total, len(parts), [chunk, self._energy], [parts])
        return float(parts.numpy().sum())

    def _potential(self) -> float:
        """[J] at `position`: what is minimised beside the quadratic; elasticity, damping and obstacles."""
        self._find_energy()
        if self.damping is not None:
            self.damping.add_energy(self._position, self._energy)
        of_obstacles = self.obstacles.energy(self._position) if self.obstacles is not None else 0.0
        return self._sum_energy() + of_obstacles

    def volumes(self) -> np.ndarray:
        """(tet_count,) J of each tet at `position`: its volume over that at rest."""
        self._find_forces()
        return self._dilation.numpy()

    @cached_property
    def _energy(self) -> wp.array:
        return wp.zeros(self.tet_count, dtype=wp.float64, device=self._launcher.device)

    @cached_property
    def _energy_parts(self) -> wp.array:
        chunks = -(-self.tet_count // chunk_size(self.tet_count, self._launcher.device))
        return wp.zeros(chunks, dtype=wp.float64, device=self._launcher.device)

    @cached_property
    def _gradient(self) -> wp.array:
        mat33 = element_types(self.real).mat33
        return wp.zeros(self.tet_count, dtype=mat33, device=self._launcher.device)

    @cached_property
    def _tet_blocks(self) -> wp.array:
        mat33 = element_types(self.real).mat33
        return wp.zeros(10 * self.tet_count, dtype=mat33, device=self._launcher.device)

    def assemble(self, hessian: str) -> None:
        """The matrix at `position` from one of the Hessians of `element_kernels`: 'semi_definite', 'projected' or
        'exact', only the last of which may be indefinite."""
        if hessian not in self._find_blocks:
            work = tet_elements.SEMI_DEFINITE_WORK if hessian == "semi_definite" else tet_elements.PROJECTED_WORK
            inputs, outputs = [self.elements, self._position], [self._tet_blocks]
            self._find_blocks[hessian] = self._launcher.prepare(
                getattr(self._law, hessian), self.tet_count, inputs, outputs, work_per_item=work
            )
        self._find_blocks[hessian]()
        if self.damping is not None:
            self.damping.add_stiffness(self._tet_blocks)
        if self.obstacles is not None:
            self.obstacles.add_stiffness(self._tet_blocks)
        gives_way = self.obstacles is not None and self.obstacles.gives_way
        self.gradients.reduction = self.obstacles.yielding if gives_way else None
        self.rows.assemble(self._tet_blocks, self.unknowns.weight)

    def _advance(self, fraction: float) -> None:
        self._launcher.launch(
            self._kernels.advance,
            self.rows.count,
            [self.unknowns, self._start, self.gradients.krylov.solution, fraction],
            [self._position],
        )

    # -- the method ------------------------------------------------------------------------------------------

    def minimise(
        self, here: Evaluation, reference: float, tolerance: float, max_iterations: int, reach: float
    ) -> Outcome:
        """From `position`, evaluated as `here`, until the residual is `tolerance` of `reference` [N].

        reach: [s] of the step; the same reach means the same weights.
        """
        goal = tolerance * reference
        correction = self.choose_correction(reach)
        linear_iterations, hessian = 0, "semi_definite"
        for iteration in range(max_iterations):
            if here.residual <= max(goal, here.rounding):
                return Outcome(True, iteration, linear_iterations, here.residual)
            if hessian == "semi_definite" and (iteration >= CHEAP_ITERATIONS or here.least_volume < SQUEEZED):
                hessian = "projected"
            taken, definite = self._find_direction(hessian, _forcing(here.residual, reference, goal), correction)
            linear_iterations += taken
            self._examine_direction()
            sums = self._read_direction_sums()
            longest, slope = float(np.sqrt(sums[:, 0].max())), float(sums[:, 1].sum())
            self._take_start()
            found = self._search(here, slope)
            if found is None:
                self._advance(0.0)
                return Outcome(False, iteration + 1, linear_iterations, here.residual)
            slow = found.residual > SLOW * here.residual
            here = found
            if longest <= self._still:
                return Outcome(True, iteration + 1, linear_iterations, here.residual)
            if slow and hessian == "projected":
                hessian = "exact"
            elif not definite:
                hessian = "projected"
        return Outcome(here.residual <= max(goal, here.rounding), max_iterations, linear_iterations, here.residual)

    @cached_property
    def _coarse(self) -> CoarseCorrection:
        return CoarseCorrection(self._material, self.gradients, self.rows, self._launcher, self.real)

    def choose_correction(self, reach: float) -> CoarseCorrection | None:
        """The coarse correction, brought up to date, if forces reach across many tets in a step of `reach` [s]."""
        if reach * np.sqrt(self._mean_stiffness / self._mean_mass) < FAR:
            return None
        inputs = [self.elements, self._position]
        self._launcher.launch(self._law.deformation, self.tet_count, inputs, [self._gradient], work_per_item=2)
        self._coarse.turn_with(self.elements.volume, self._gradient)
        if reach != self._reach:
            self._coarse.weigh(self.unknowns.weight)
            self._reach = reach
        return self._coarse

    def _find_direction(
        self, hessian: str, forcing: float, correction: CoarseCorrection | None
    ) -> tuple[int, bool]:
        """The displacement to try, into `krylov.solution`; iterations, and whether the matrix was definite."""
        krylov = self.gradients.krylov
        self.assemble(hessian)
        wp.copy(krylov.residual, self.unknowns.residual)
        taken = self.gradients.solve(forcing, MAX_LINEAR_ITERATIONS, correction)
        if self.gradients.definite or taken > 1 or hessian == "projected":
            return taken, self.gradients.definite
        return taken + self._find_direction("projected", forcing, correction)[0], False

    def _search(self, here: Evaluation, slope: float) -> Evaluation | None:
        """Steps along the direction as far as energy falls enough; None if it falls nowhere.

        A whole step that leaves a smaller residual in a body nowhere squeezed needs no energies; with obstacles,
        which come and go, it might lead in a circle. Where the decrease is lost in rounding, the slope decides
        (Hager and Zhang 2005, 'approximate Wolfe').
        """
        fraction, energy = 1.0, None
        for _ in range(MAX_BACKTRACKS):
            self._advance(fraction)
            there = self.evaluate()
            calm = self.obstacles is None and min(here.least_volume, there.least_volume) > SQUEEZED
            if fraction == 1.0 and calm and there.residual <= here.residual:
                return there
            if energy is None:
                self._advance(0.0)
                energy = self._potential() + here.quadratic
                self._advance(fraction)
            change = self._potential() + there.quadratic - energy
            if change <= -ARMIJO * fraction * slope:
                return there
            lost = abs(change) <= 1e-12 * abs(energy)
            if lost and abs(there.work) <= CURVATURE * slope:
                return there
            fraction *= 0.5
        return None


def _forcing(residual: float, reference: float, goal: float) -> float:
    """The part of the residual that a linear solve may leave.

    As much as Newton's method gains by itself, LOOSE sqrt(r / r0); but where one solve can end the iteration, it
    is to leave no more than ENOUGH of the goal: its iterations are cheap beside one of Newton's.
    """
    last = ENOUGH * goal / residual
    usual = LOOSE * np.sqrt(min(1.0, residual / reference)) if reference > 0.0 else LOOSE
    return min(usual, last) if last >= TIGHT else usual
