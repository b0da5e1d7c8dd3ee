"""Particles of sand and snow, and how they step: the method without the scene around it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from plait.solver.granular.activity import Activity
from plait.solver.granular.block_grid import BlockGrid
from plait.solver.granular.energy_kernels import energy_kernels
from plait.solver.granular.laws import LAWS
from plait.solver.granular.lead_kernels import lead_kernels
from plait.solver.granular.material import set_material
from plait.solver.granular.middle_kernels import middle_kernels
from plait.solver.granular.transfer_kernels import LOST, transfer_kernels
from plait.solver.granular.types import BLOCK_NODES, granular_types
from plait.solver.launch import Launcher
from plait.solver.scene import Granular

# Sorted particles may go so far [cells] along an axis before they are sorted again; the tiles allow for one.
DRIFT = 0.9
# What has been at rest for the time of a fall through so many cells sleeps; over as long the mean is taken.
REST_FALL = 16.0
# Sound goes no further than this part of a cell in a step.
SOUND = 0.4
# Costs in units of `Launcher.launch`.
PARTICLE_WORK, NODE_WORK = 4, 1


class Matter:
    """All granular matter of a scene on one grid.

    A step of `length` [s]:

        matter.to_grid(length)           `grid.node` holds momentum, internal forces included, and mass
        matter.to_velocities()           `grid.velocity` after gravity; whoever acts on it does so now
        matter.to_particles()

    What has for some time moved, in the mean, slower than `still` times sqrt(g dx) sleeps, unless what is awake
    comes near: it costs nothing then and stands. The mean, as sand under load goes on
    swinging in place by its elasticity long after it has come to lie.

    particles: struct `Particles`, room for `capacity`, of which the first `count` are.
    sound: [m/s] the fastest in any particle.  speed: [m/s] the largest part of any velocity along an axis.
    cohesive: whether any of it hangs together.
    disturbed: boxes (2, 3) [m] within which nothing sleeps.  awake: how many blocks of cells do not.
    """

    def __init__(
        self, granular: Sequence[Granular], capacity: int, cell_size: float, gravity: np.ndarray, real: type,
        launcher: Launcher, still: float = 0.0,
    ) -> None:  # fmt: skip
        self.types, self._launcher, self._real = granular_types(real), launcher, real
        laws = tuple(sorted({g.law for g in granular}))
        self.cohesive = any(LAWS[law].cohesive for law in laws)
        self.kernels, self._laws, self._gravity = transfer_kernels(laws, real), laws, np.asarray(gravity)
        self.grid = BlockGrid(cell_size, real, launcher)
        device = launcher.device
        materials = []
        for g in granular:
            material = self.types.Material()
            set_material(material, g, laws.index(g.law), LAWS[g.law].parameters(g))
            materials.append(material)
        self.materials = wp.array(materials, dtype=self.types.Material, device=device)
        self._sound_at_rest = [np.sqrt((2.0 * m.mu + m.lam) / m.density) for m in materials]
        self.particles = self.types.Particles()
        for name, held in self.types.Particles.vars.items():
            setattr(self.particles, name, wp.zeros(capacity, dtype=held.type.dtype, device=device))
        self._step = self.types.Step()
        self._step.cell_size, self._step.cells = cell_size, 1.0 / cell_size
        self._step.gravity = self.types.vec3(*gravity)
        fall = float(np.linalg.norm(gravity))
        self._step.still = still * np.sqrt(fall * cell_size)
        self._rest = np.sqrt(2.0 * REST_FALL * cell_size / fall) if fall > 0.0 else np.inf
        self._activity, self.disturbed, self.awake = Activity(self.grid), [], 0
        self.count, self.speed, self.sound = 0, 0.0, 0.0
        self._stale, self._drift, self.sorts = True, 0.0, 0

    def add(self, material: int, positions: np.ndarray, velocities: np.ndarray, volumes: np.ndarray) -> None:
        """Appends particles of one of the `granular`, at rest in themselves, numbered on.

        positions, velocities: (n, 3) [m], [m/s].  volumes: (n,) [m3].
        """
        n, start = len(positions), self.count
        fields = {"position": positions, "velocity": velocities, "volume": volumes}
        fields |= {"material": np.full(n, material), "number": np.arange(start, start + n)}
        for name, values in fields.items():
            array = getattr(self.particles, name)
            held = wp.array(values, dtype=array.dtype, device=array.device)
            wp.copy(array, held, dest_offset=start, count=n)
        self.count += n
        self._stale = True
        self.speed = float(np.maximum(self.speed, np.abs(velocities).max(initial=0.0)))
        self.sound = max(self.sound, self._sound_at_rest[material])

    def stable_length(self, cfl: float) -> float:
        """[s] of a step in which nothing goes further than `cfl` cells, and sound no further than is stable."""
        fastest = max(self.speed / cfl, self.sound / SOUND)
        return self.grid.cell_size / fastest if fastest > 0.0 else np.inf

    def sort(self) -> None:
        """Puts the particles in cell order now."""
        self.grid.sort(self.particles, self.count)
        self._stale, self._drift = False, 0.0
        self.sorts += 1
        self._activity.forget()
        told = np.zeros((self.grid.block_count, 3))
        told[:, 1] = self.sound
        first = self.grid.data.first.numpy()[:-1]
        told[:, 2] = np.minimum.reduceat(self.particles.rest.numpy()[: self.count], first)
        self._told = wp.array(told, dtype=wp.vec3d, device=self._launcher.device)
        self._work = PARTICLE_WORK * max(1, self.count // self.grid.block_count)

    def wake(self) -> bool:
        """Finds what sleeps in the next step; whether anything is awake."""
        if self._stale or self._drift > DRIFT:
            self.sort()
        awake = self._told.numpy()[:, 2] < self._rest
        if self.disturbed and not awake.all():
            awake |= self._activity.within(self.disturbed)
        if self._activity.choose(awake):
            stopped, inputs = self._activity.stopped, [self._activity.stopped, self.particles, self.grid.data]
            self._launcher.launch(self.kernels.stop, len(stopped), inputs, work_per_item=self._work)
        self.awake = int(awake.sum())
        return self.awake > 0

    def to_grid(self, length: float) -> None:
        """Fills `grid.node` for a step of `length` [s]."""
        self.wake()
        grid, launch, activity = self.grid, self._launcher.launch, self._activity
        self._step.length, self._step.mean_part = length, -np.expm1(-length / self._rest)
        inputs = [activity.scatters, self.particles, grid.data, self.materials, self._step]
        launch(self.kernels.to_tiles, len(activity.scatters), inputs, [grid.tile], work_per_item=self._work)
        self._to_nodes(activity.nodes)

    def _to_nodes(self, nodes: wp.array) -> None:
        grid, work = self.grid, NODE_WORK * BLOCK_NODES
        inputs = [nodes, grid.data, grid.tile]
        self._launcher.launch(self.kernels.to_nodes, len(nodes), inputs, [grid.node_rows], work_per_item=work)

    def to_velocities(self) -> None:
        """Fills `grid.velocity`."""
        grid, nodes, launch = self.grid, self._activity.nodes, self._launcher.launch
        inputs, work = [nodes, grid.node, self._step], NODE_WORK * BLOCK_NODES
        launch(self.kernels.to_velocities, len(nodes), inputs, [grid.velocity], work_per_item=work)

    def middles(self) -> np.ndarray:
        """(node_count, 3) [m] from each node to the middle of the matter that it carries; not a number if none.

        After `to_velocities`: uses up `grid.node`.
        """
        grid, launch, kernel = self.grid, self._launcher.launch, middle_kernels(self._real).add_middles
        inputs = [self.particles, grid.data, self.materials, self._step]
        launch(kernel, grid.block_count, inputs, [grid.tile_nodes], work_per_item=self._work)
        self._to_nodes(self._activity.every_node())
        held = grid.node.numpy()[: grid.node_block_count * BLOCK_NODES].astype(np.float64)
        mass = held[:, 3:]
        return np.divide(held[:, :3], mass, out=np.full((len(held), 3), np.nan), where=mass > 0.0)

    def to_particles(self) -> bool:
        """Moves and deforms the particles; False where one is lost, no longer finite."""
        grid, gathers, launch = self.grid, self._activity.gathers, self._launcher.launch
        inputs = [gathers, self.particles, grid.data, self.materials, self._step, grid.velocity_rows, grid.tile]
        launch(self.kernels.to_particles, len(gathers), inputs, [self._told], work_per_item=self._work)
        self.speed, self.sound = self._told.numpy()[:, :2].max(axis=0).tolist()
        self._drift += self.speed * self._step.length / grid.cell_size
        return self.speed < LOST

    def lead_out(self, speed: wp.array, fastest: float, blocks: wp.array) -> None:
        """Moves the particles of some blocks of cells, (n,) int32, on for the step, their velocities untouched.

        After `to_particles`. speed: (node_count,) vec3d [m/s] of the nodes, none above `fastest`.
        """
        inputs = [blocks, self.grid.data, self._step.cells, self._step.length, speed]
        kernel = lead_kernels(self._real).lead_out
        self._launcher.launch(kernel, len(blocks), inputs, [self.particles], work_per_item=4 * self._work)
        self._drift += fastest * self._step.length / self.grid.cell_size

    def energies(self) -> tuple[float, float, float]:
        """[J] of motion, of strain, and in gravity, of which the zero is at the scene's origin."""
        grid, kernel = self.grid, energy_kernels(self._laws, self._real).measure_energies
        energy = wp.zeros(grid.block_count, dtype=wp.vec3d, device=self._launcher.device)
        inputs = [self.particles, grid.data, self.materials, wp.vec3d(*self._gravity)]
        self._launcher.launch(kernel, grid.block_count, inputs, [energy], work_per_item=self._work)
        return tuple(energy.numpy().sum(axis=0).tolist())
