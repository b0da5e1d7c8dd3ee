"""Contact of strands with strands as impulses after their own solve (Han 2019, 5.2 and 5.3): a comparison variant.

First the strands' nodes, as particles, press on each other through a grid: St. Venant-Kirchhoff-Hencky stress with
Coulomb's return mapping, from which strands take over the change of velocity. Then pairs of edges close together
lose their approach by inelastic impulses. Neither can promise that no strand passes through another, and impulses
after an implicit solve stretch strands: see `coupled.py` for what is used otherwise.

Where the printed text is not followed:
- xi of (33) is the weight of the PIC part, as the text has it and as McAdams et al. 2009; .05 unless told.
- Gravity acts in the strands' solve, and not again in (31).
- The text gives no Lame parameters. They are the largest that the explicit update (alpha = 0) bears.
- Of the n impulses that a node receives each acts on 1/n of its mass (mass splitting, Tonge et al. 2012), on both
  edges alike. Divided for each node by its own n, as the text has it, what two edges receive is not opposite, and
  momentum is not conserved.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from plait.solver.grid.sparse_grid import SparseGrid
from plait.solver.materials.drucker_prager import cone_slope
from plait.solver.model import Model
from plait.solver.state import State
from plait.solver.strand_contact.edge_pairs import EdgePairs
from plait.solver.strand_contact.paper_grid_kernels import (
    Law,
    Matter,
    MatterState,
    change_nodes,
    evaluate_impulses,
    return_to_strands,
)
from plait.solver.strand_contact.paper_impulse_kernels import (
    Edges,
    Incidence,
    Pairs,
    advance,
    apply,
    count_impulses,
    divide,
    evaluate,
    find_close,
)
from plait.solver.strands.layout import Layout

# lambda over mu, that of Poisson's ratio .3.
LAMBDA_OVER_MU = 1.5
# The largest omega dt of the explicit update, of which 2 is the limit of stability.
COURANT = 1.0
# A pair still approaches when a substep takes it nearer by more than this part of its distance.
STILL = 1.0e-3
# Cost of an item in units of `Launcher.launch`.
PARTICLE_WORK, NODE_WORK, PAIR_WORK = 60, 30, 10
MATTER_ARRAYS = {"affine": wp.mat33d, "elastic": wp.mat33d, "gained": wp.float64}
PAIR_ARRAYS = {
    "place": wp.vec2d,
    "distance": wp.float64,
    "normal": wp.vec3d,
    "mass": wp.float64,
    "impulse": wp.vec3d,
    "approach": wp.float64,
}


class PaperStrandContact:
    """The variant's two steps, applied to strands that have been solved as if they were alone.

    State arrays, (node_count,): strand_paper/affine mat33d [1/s], C of APIC; strand_paper/elastic mat33d, F^E of
    phi^d; strand_paper/gained float64, ln of the volume gained under tension, the plastic state.
    """

    def __init__(self, model: Model, state: State, layout: Layout, prescribed: np.ndarray) -> None:
        """prescribed: (node_count,) bool, nodes that go where they are told; no impulse moves them."""
        self._launcher, self._count = model.launcher, layout.node_count
        self._passes = model.settings.strand_contact.geometric_passes
        self._cell_size = float(np.average(layout.mean_segment, weights=np.diff(layout.first_node)))
        self._grid = SparseGrid(self._cell_size, model.launcher)
        self._hold_constants(model, layout, prescribed)
        self._held, self._kept = MatterState(), MatterState()
        for name, dtype in MATTER_ARRAYS.items():
            for matter in (self._held, self._kept):
                setattr(matter, name, self._zeros(dtype))
            state.arrays[f"strand_paper/{name}"] = getattr(self._held, name)
        self._held.elastic.assign(np.tile(np.eye(3), (self._count, 1, 1)))
        self._stress_impulse, self._velocity_before = self._zeros(wp.mat33d), self._zeros(wp.vec3d)
        self._overturned, self._impulses = (self._zeros(wp.int32) for _ in range(2))
        self._pairs, self._room = Pairs(), 0
        self._tally = {"overturned": 0, "close_pairs": 0, "still_approaching": 0}

    def _hold_constants(self, model: Model, layout: Layout, prescribed: np.ndarray) -> None:
        per_strand = [
            np.repeat([[strands.thickness, strands.pic_fraction]], strands.strand_count, axis=0)
            for strands in model.scene.strands
        ]
        thickness, pic_fraction = np.concatenate(per_strand)[layout.node_strand].T
        friction = layout.friction[layout.node_strand]

        def hold(values: np.ndarray, dtype: type = wp.float64) -> wp.array:
            return wp.array(values, dtype=dtype, device=self._launcher.device)

        self._matter = matter = Matter()
        matter.mass, matter.cone = hold(layout.mass), hold(cone_slope(friction))
        matter.pic_fraction, matter.prescribed = hold(pic_fraction), hold(prescribed, wp.int32)
        self._edges = edges = Edges()
        mobile = ~prescribed & (layout.mass > 0.0)
        edges.inverse_mass = hold(np.divide(1.0, layout.mass, out=np.zeros(self._count), where=mobile))
        edges.radius, edges.thickness, edges.friction = hold(layout.radius), hold(thickness), hold(friction)
        self._finder = EdgePairs(model.launcher, layout, layout.radius + thickness, prescribed)

    # -- a substep -----------------------------------------------------------------------------------------

    def apply(self, start: wp.array, position: wp.array, velocity: wp.array, step: float) -> None:
        """Changes what the strands' solve gave, in place.

        start: positions at the substep's start, position and velocity: those at its end, (node_count,) vec3d
        [m], [m/s], world.  step: the substep's length [s].
        """
        for name in MATTER_ARRAYS:
            wp.copy(getattr(self._kept, name), getattr(self._held, name))
        wp.copy(self._velocity_before, velocity)
        self._press_through_grid(start, velocity, step)
        self._apply_impulses(start, velocity, step)
        inputs = [step, self._velocity_before, velocity]
        self._launcher.launch(advance, self._count, inputs, [position])

    def retract(self) -> None:
        """Undoes what the last `apply` did to the state."""
        for name in MATTER_ARRAYS:
            wp.copy(getattr(self._held, name), getattr(self._kept, name))

    def end_frame(self) -> dict[str, Any]:
        """The frame's counts over its substeps.

        overturned: nodes at which the grid turned over, for a substep too long for its cells.  close_pairs: of
        edges.  still_approaching: those that still approached each other after the last pass.
        """
        tally = self._tally
        self._tally = dict.fromkeys(tally, 0)
        return tally

    def law(self, step: float) -> Law:
        """Lame parameters over the density with (omega dt)^2 <= `COURANT`^2 at the unstrained state.

        One particle resists at most as 3 lambda + 2 mu, and of quadratic splines sum_i |dw_ip/dx|^2 / w_ip <= 6 a
        direction; no mode of all the particles is faster than the fastest of one with its own share of the nodes'
        masses: omega^2 <= 6 (3 lambda + 2 mu) / (rho dx^2).
        """
        law = Law()
        law.step, law.cell_size = step, self._cell_size
        law.mu = (COURANT * self._cell_size / step) ** 2 / (6.0 * (3.0 * LAMBDA_OVER_MU + 2.0))
        law.lam = LAMBDA_OVER_MU * law.mu
        return law

    def _press_through_grid(self, start: wp.array, velocity: wp.array, step: float) -> None:
        """Han 2019, 5.2 and (33): particles at `start` with the velocities that the strands' solve has given."""
        grid, law, held, launch = self._grid, self.law(step), self._held, self._launcher.launch
        mass, impulse = self._matter.mass, self._stress_impulse
        grid.place(start.numpy())
        grid.to_grid_affine(mass, velocity, held.affine)
        launch(evaluate_impulses, self._count, [law, mass, held.elastic], [impulse], work_per_item=PARTICLE_WORK)
        change = wp.zeros_like(grid.velocity)
        inputs = [grid.data, grid.cell_size, grid.mass, impulse]
        launch(change_nodes, grid.node_count, inputs, [change], work_per_item=NODE_WORK)
        inputs = [grid.data, law, self._matter, grid.velocity, change]
        outputs = [velocity, held, self._overturned]
        launch(return_to_strands, self._count, inputs, outputs, work_per_item=PARTICLE_WORK)
        self._tally["overturned"] += int(self._overturned.numpy().sum())

    def _apply_impulses(self, start: wp.array, velocity: wp.array, step: float) -> None:
        """Han 2019, 5.3: Jacobi passes over the pairs that are close at `start`."""
        if not self._finder.find(start, start):
            return
        launch, edges, pairs, count = self._launcher.launch, self._edges, self._hold_pairs(), self._finder.count
        incidence = Incidence()
        incidence.first, incidence.entry = self._finder.first, self._finder.incident
        launch(find_close, count, [edges, start], [pairs], work_per_item=PAIR_WORK)
        for _ in range(self._passes):
            launch(evaluate, count, [edges, velocity], [pairs], work_per_item=PAIR_WORK)
            launch(count_impulses, self._count, [incidence, pairs], [self._impulses])
            launch(divide, count, [edges, self._impulses], [pairs], work_per_item=PAIR_WORK)
            launch(apply, self._count, [edges, incidence, pairs], [velocity], work_per_item=PAIR_WORK)
        launch(evaluate, count, [edges, velocity], [pairs], work_per_item=PAIR_WORK)
        distance, approach = pairs.distance.numpy()[:count], pairs.approach.numpy()[:count]
        self._tally["close_pairs"] += int((pairs.mass.numpy()[:count] > 0.0).sum())
        self._tally["still_approaching"] += int((step * approach > STILL * distance).sum())

    def _hold_pairs(self) -> Pairs:
        """Room for as many pairs as there are."""
        count = self._finder.count
        if count > self._room:
            self._room = 5 * count // 4
            for name, dtype in PAIR_ARRAYS.items():
                setattr(self._pairs, name, wp.zeros(self._room, dtype=dtype, device=self._launcher.device))
        self._pairs.edges = self._finder.pairs
        return self._pairs

    def _zeros(self, dtype: type) -> wp.array:
        return wp.zeros(self._count, dtype=dtype, device=self._launcher.device)
