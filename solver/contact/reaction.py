"""Strands push back on the elastic and rigid bodies that hold them up."""

from __future__ import annotations

import numpy as np
import warp as wp

from plait.solver.contact.reaction_kernels import find_feet
from plait.solver.contact.surfaces import SurfaceContact
from plait.solver.model import Model


class SkinReaction:
    """Gives bodies the impulses their skins gave strands, reversed: momentum passes from one to the other exactly.

    A strand sees a skin where its body has just moved; the body feels the strand in its next substep. That lag is
    stable where the strand is lighter than the flesh about its contact, as hair is.
    """

    def __init__(self, model: Model) -> None:
        self._launcher = model.launcher
        self._tets, self._rigid = model.parts.get("tets"), model.parts.get("rigid")
        self._kinematics = model.parts["kinematics"]
        colliders = self._kinematics.colliders
        count = len(colliders.points[0])
        # The tet each collider point lies in; points that no elastic body carries have no weight.
        self._nodes, self._weights = np.zeros((count, 4), dtype=np.int32), np.zeros((count, 4))
        for collider in colliders.items:
            body = collider.surface.body
            if body is not None:
                layout = self._tets.layout
                self._nodes[collider.points] = layout.skin_nodes(body)
                self._weights[collider.points] = layout.bodies[body].embedding.barycentric

    def give(self, contact: SurfaceContact, position: wp.array, reaction: wp.array, length: float) -> None:
        """Adds the impulses of a substep of `length` [s] to the bodies' impulses from others.

        position: (node_count,) vec3d [m] of the strands' nodes at its end.  reaction: (plane_count,) vec3d [N].
        """
        forces = reaction.numpy()
        body = contact.plane_body.numpy()
        near = self._kinematics.in_reach
        carried = np.array([collider.carried for collider in near] + [False])  # the last for 'no body', -1
        pushed = np.flatnonzero(np.any(forces != 0.0, axis=1) & carried[body])
        if not len(pushed):
            return
        device = self._launcher.device
        vertices = wp.empty(len(pushed), dtype=wp.vec3i, device=device)
        weights = wp.empty(len(pushed), dtype=wp.vec3d, device=device)
        planes = wp.array(pushed, dtype=wp.int32, device=device)
        inputs = [planes, contact.plane_body, contact.bodies, position]
        self._launcher.launch(find_feet, len(pushed), inputs, [vertices, weights])
        corners, shares = vertices.numpy(), weights.numpy()[:, :, None]
        impulses = -length * forces[pushed]
        if self._tets is not None:
            self._give_to_nodes(corners, shares, impulses)
        if self._rigid is not None:
            rigid = np.array([-1 if c.surface.rigid is None else c.surface.rigid for c in near])[body[pushed]]
            feet = (shares * contact.bodies.points_end.numpy()[corners]).sum(axis=1)
            self._rigid.push(rigid[rigid >= 0], feet[rigid >= 0], impulses[rigid >= 0])

    def _give_to_nodes(self, corners: np.ndarray, shares: np.ndarray, impulses: np.ndarray) -> None:
        """To elastic bodies: corners (n, 3) with shares (n, 3, 1), impulses (n, 3) [kg m/s]."""
        shares = shares * self._weights[corners]
        nodes = self._nodes[corners].reshape(-1)
        given = self._tets.external_impulse.numpy()
        for axis in range(3):
            parts = (shares * impulses[:, axis, None, None]).reshape(-1)
            given[:, axis] += np.bincount(nodes, parts, minlength=len(given))
        self._tets.external_impulse.assign(given)
