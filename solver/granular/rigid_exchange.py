"""Grains against rigid bodies: host side."""

from __future__ import annotations

import numpy as np
import warp as wp

from plait.solver.granular.exchange_kernels import follow_kernels
from plait.solver.granular.impulses import Memory
from plait.solver.granular.matter import Matter
from plait.solver.granular.near_surfaces import NearSurfaces
from plait.solver.granular.rigid_exchange_kernels import Bodies, Contacts, mat66d, rigid_exchange_kernels, vec6d
from plait.solver.model import Interval, Model
from plait.solver.rigid.mobility import mobility
from plait.solver.state import State


def build(model: Model, state: State, matter: Matter, surfaces: NearSurfaces, real: type) -> RigidExchange:
    return RigidExchange(model, state, matter, surfaces, real)


class RigidExchange:
    """An `Exchange` with rigid bodies, which within a substep give way as their joints let them.

    What other forces took up of the last substep's impulses they are expected to take up again: those of what a
    body lies on, which can push and not pull, are not known beforehand. So a free body moves by what it is given,
    as in an inelastic collision, and a pile at rest on one that is supported stays at rest.

    State arrays: granular/given_rigid: (body_count, 6) impulse and moment of the last substep;
    granular/momenta_rigid: (body_count, 6) momentum and angular momentum at the end of the substep before.
    """

    def __init__(self, model: Model, state: State, matter: Matter, surfaces: NearSurfaces, real: type) -> None:
        self._launcher, self._matter, self._surfaces = model.launcher, matter, surfaces
        self._follow = follow_kernels(real).follow
        self._kernels, self._stage, self._scene = rigid_exchange_kernels(real), model.parts["rigid"], model.scene
        count, device = len(model.scene.rigid_bodies), model.launcher.device
        bodies = Bodies()
        bodies.mobility = wp.zeros(count, dtype=mat66d, device=device)
        bodies.given, bodies.expected = (wp.zeros(count, dtype=vec6d, device=device) for _ in range(2))
        self._bodies, self.speed = bodies, 0.0
        self._momenta_before = wp.zeros((count, 6), dtype=wp.float64, device=device)
        self._mass = np.array([body.mass for body in model.scene.rigid_bodies])
        state.arrays["granular/given_rigid"] = bodies.given
        state.arrays["granular/momenta_rigid"] = self._momenta_before
        self.begin_frame()

    def begin_frame(self) -> None:
        self._memory, self._count = Memory(), 0

    def begin_substep(self, substep: Interval) -> None:
        self.speed = self._surfaces.speed("rigid")
        near = {self._scene.surfaces[c.index].rigid for c in self._surfaces.near} - {None}
        bodies, of_near = self._bodies, np.array(sorted(near), dtype=np.int64)
        matrix, expected = np.zeros((len(self._mass), 6, 6)), np.zeros((len(self._mass), 6))
        matrix[of_near] = mobility(self._stage, of_near, supports=False)
        expected[of_near] = self._expect(matrix, substep.length)[of_near]
        bodies.mobility.assign(matrix)
        bodies.expected.assign(expected)
        bodies.given.zero_()

    def _expect(self, matrix: np.ndarray, length: float) -> np.ndarray:
        """(body_count, 6) what will be borne of impulses like those of the last substep; see `expect`.

        Compared by what they would move, W the mobility: the part -R . W J / J . W J of J.
        """
        momentum = self._mass[:, None] * self._stage.velocity.numpy()
        now = np.concatenate([momentum, self._stage.angular_momentum.numpy()], axis=1)
        weight = length * self._mass[:, None] * np.append(self._scene.gravity, np.zeros(3))
        given = self._bodies.given.numpy()
        others = now - self._momenta_before.numpy() - weight - given
        self._momenta_before.assign(now)
        moves = np.einsum("nij,nj->ni", matrix, given)
        energy, against = np.einsum("ni,ni->n", given, moves), -np.einsum("ni,ni->n", others, moves)
        part = np.divide(against, energy, out=np.zeros(len(given)), where=energy > 0.0)
        return np.clip(part, 0.0, 1.0)[:, None] * given

    def find(self, since: float) -> None:
        if self._count:
            self._memory.keep(self._cells, self._touched, self._contacts.impulse.numpy())
        grid, found = self._matter.grid, self._surfaces.carried("rigid")
        body = np.array([self._scene.surfaces[s].rigid for s in found.surface], dtype=np.int64)
        self._cells, self._touched, self._count = grid.node_cells(found.node), found.surface, len(found.node)
        values = {"node": found.node, "friction": found.friction, "body": body}
        values["lever"] = self._cells * grid.cell_size - self._stage.position.numpy()[body]
        values["impulse"] = self._memory.recall(self._cells, self._touched)
        contacts, device = Contacts(), self._launcher.device
        for name, held in Contacts.vars.items():
            setattr(contacts, name, wp.array(values[name], dtype=held.type.dtype, device=device))
        self._contacts, self._heights = contacts, found.heights(device)

    def act(self, moment: wp.array, passes: int) -> None:
        launch, velocity = self._launcher.launch, self._matter.grid.velocity
        inputs = [self._contacts, self._heights, self._count, self._bodies, moment, passes, velocity]
        launch(self._kernels.exchange, min(1, self._count), inputs)
        launch(self._follow, self._count, [self._heights, self._contacts.node, moment, velocity])

    def end_substep(self) -> None:
        given = self._bodies.given.numpy()
        self._stage.impulse.assign(self._stage.impulse.numpy() + given[:, :3])
        self._stage.angular_impulse.assign(self._stage.angular_impulse.numpy() + given[:, 3:])
