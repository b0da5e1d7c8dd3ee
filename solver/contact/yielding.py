"""The rigid bodies that one flesh body pushes, as its solve sees them: host side."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from plait.solver.contact.carrier_kernels import Carriers, Links, coupling_kernels, settle
from plait.solver.contact.carriers import RigidCarriers, links_of
from plait.solver.contact.obstacle_force_kernels import STIFFER
from plait.solver.contact.obstacle_search_kernels import SLOTS
from plait.solver.rigid.joint_pose_kernels import mat66d, vec6d

if TYPE_CHECKING:
    from plait.solver.contact.obstacles import Obstacles

# Costs of a link in units of `Launcher.launch`.
LINK_WORK, SUBTRACT_WORK = 100, 4


class Yielding:
    """Planes that give way with the rigid bodies which hold them, as part of the energy of one flesh body.

    count: how many such planes there are.
    """

    def __init__(self, obstacles: Obstacles, body: int) -> None:
        self._shared, self._body, self._launcher = obstacles, body, obstacles.launcher
        self._kernels = coupling_kernels(obstacles.real)
        layout = obstacles.particles.layout
        free = np.flatnonzero(~layout.pinned[layout.nodes(body)]) + layout.nodes(body).start
        self._unknown = np.full(layout.node_count, -1, dtype=np.int64)
        self._unknown[free] = np.arange(len(free))
        self._near = np.zeros(0, dtype=int)
        self.count = self._faced = 0

    @property
    def _rigid(self) -> RigidCarriers:
        return self._shared.carriers

    def take(self, slots: slice) -> None:
        """Looks at the planes of the body's particles anew."""
        held = self._shared.planes.surface.numpy()[slots]
        found, entry = links_of(held, self._rigid)
        self.count = len(found)
        if not self.count:
            return
        self._slots = found + slots.start
        self._bodies = self._rigid.near[entry]
        self._lay_out_carriers()
        self._lay_out_links(entry)
        self._lay_out_touched(entry)

    def settle(self, position: wp.array, inertia: float) -> None:
        """Moves the planes to where the rigid bodies have them, with the nodes, (node_count,) vec3d, there."""
        shared = self._shared
        inputs = [shared.points, shared.planes, inertia, position, self.carriers, self.links]
        work = LINK_WORK * self.count
        self._launcher.launch(settle, len(self._near), inputs, work_per_item=work)

    def energy(self) -> float:
        """[J] of the rigid bodies' motion, where last settled."""
        return float(self.carriers.energy.numpy().sum())

    def subtract(self, krylov: Any) -> None:
        """Takes off the matrix's product with the vector of `krylov` what giving way, where last settled, does."""
        inputs = [self.carriers, self.links, self.touched]
        self._launcher.launch(self._kernels.project, 1, inputs, [krylov], work_per_item=self.count)
        count = len(self.touched.unknown)
        inputs = [self.links, self.touched]
        self._launcher.launch(self._kernels.subtract, count, inputs, [krylov], work_per_item=SUBTRACT_WORK)

    def note(self, base: wp.array, pushes: bool) -> None:
        """Tells the rigid bodies what the planes hold now.

        base: (node_count,) vec3d [m] where impulses act.  pushes: whether the flesh has felt any of it.
        """
        planes, rigid = self._shared.planes, self._rigid
        near = len(rigid.near)
        if not (self.count and pushes):
            nothing = np.zeros(0, int), *np.zeros((2, 0, 3)), np.zeros((near, 6)), np.zeros((near, 6, 6))
            rigid.note(self._body, *nothing)
            return
        pressure = planes.pressure.numpy()[self._slots, None]
        forces = pressure * planes.normal.numpy()[self._slots] + planes.traction.numpy()[self._slots]
        places = self._shared.particles.evaluate_positions(base).numpy()[self._slots // int(SLOTS)]
        way = self.carriers.way.numpy().copy()
        rigid.note(self._body, self._bodies, places, forces, way, self._stiffness(near))

    def _stiffness(self, near: int) -> np.ndarray:
        """(near_count, 6, 6) about how the flesh behind the planes resists their motion, over the substep."""
        lever = self.links.lever.numpy()
        across = np.zeros((self.count, 3, 3))
        for k in range(3):
            across[:, :, k] = np.cross(np.eye(3)[k], lever)
        place = np.concatenate([np.broadcast_to(np.eye(3), across.shape), across], axis=2)
        held = place.transpose(0, 2, 1) @ self.links.stiffness.numpy() @ place
        out = np.zeros((near, 6, 6))
        np.add.at(out, np.searchsorted(self._near, self._bodies), held)
        return self._rigid.length**2 / float(STIFFER) * out

    # -- set-up --------------------------------------------------------------------------------------------

    def _hold(self, values: np.ndarray, dtype: type) -> wp.array:
        return wp.array(np.ascontiguousarray(values), dtype=dtype, device=self._launcher.device)

    def _lay_out_carriers(self) -> None:
        rigid, device = self._rigid, self._launcher.device
        count, aim = len(rigid.near), rigid.aim(self._body)
        way = self.carriers.way if self._faced == rigid.faced else self._hold(aim, vec6d)
        self.carriers, self._faced = Carriers(), rigid.faced
        self.carriers.length = rigid.length
        self.carriers.root = self._hold(rigid.root, mat66d)
        matrix, force = rigid.hold(self._body)
        self.carriers.held, self.carriers.pull = self._hold(matrix, mat66d), self._hold(force, vec6d)
        self.carriers.aim, self.carriers.way = self._hold(aim, vec6d), way
        self.carriers.inverse = wp.zeros(count, dtype=mat66d, device=device)
        self.carriers.energy = wp.zeros(count, dtype=wp.float64, device=device)
        self.carriers.wrench = wp.zeros(count, dtype=vec6d, device=device)
        self._near = rigid.near

    def _lay_out_links(self, entry: np.ndarray) -> None:
        anchor = self._shared.planes.anchor.numpy()[self._slots]
        self.links = Links()
        self.links.first = self._hold(np.searchsorted(entry, np.arange(len(self._near) + 1)), wp.int32)
        self.links.slot = self._hold(self._slots, wp.int32)
        self.links.lever = self._hold(anchor - self._rigid.centre[entry], wp.vec3d)
        self.links.stiffness = wp.zeros(self.count, dtype=wp.mat33d, device=self._launcher.device)

    def _lay_out_touched(self, entry: np.ndarray) -> None:
        particles, points = self._shared.particles, self._slots // int(SLOTS)
        corner, share = self._unknown[particles.nodes[points]], particles.weights[points]
        acts = np.flatnonzero(corner.ravel() >= 0)
        acts = acts[np.argsort(corner.ravel()[acts], kind="stable")]
        unknown, first = np.unique(corner.ravel()[acts], return_index=True)
        self.touched = self._kernels.Touched()
        self.touched.unknown = self._hold(unknown, wp.int32)
        self.touched.first = self._hold(np.append(first, len(acts)), wp.int32)
        self.touched.link, self.touched.weight = (
            self._hold(acts // 4, wp.int32),
            self._hold(share.ravel()[acts], wp.float64),
        )
        self.touched.corner, self.touched.share = self._hold(corner, wp.vec4i), self._hold(share, wp.vec4d)
        self.touched.carrier = self._hold(entry, wp.int32)
        self.touched.answer = wp.zeros(len(self._near), dtype=vec6d, device=self._launcher.device)
