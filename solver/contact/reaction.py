"""Strands push back on the elastic bodies that hold them up."""

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
        self._launcher, self._tets = model.launcher, model.parts["tets"]
        colliders = model.parts["kinematics"].colliders
        layout = self._tets.layout
        count = len(colliders.points[0])
        self._kinematics = model.parts["kinematics"]
        # The tet each collider point lies in; points that no body carries have no weight.
        self._nodes, self._weights = np.zeros((count, 4), dtype=np.int32), np.zeros((count, 4))
        for collider in colliders.items:
            if collider.carried:
                body = collider.surface.body
                self._nodes[collider.points] = layout.skin_nodes(body)
                self._weights[collider.points] = layout.bodies[body].embedding.barycentric

    def give(self, contact: SurfaceContact, position: wp.array, reaction: wp.array, length: float) -> None:
        """Adds the impulses of a substep of `length` [s] to the bodies' `external_impulse`.

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
        corners = vertices.numpy()
        shares = weights.numpy()[:, :, None] * self._weights[corners]
        nodes, impulses = self._nodes[corners].reshape(-1), -length * forces[pushed]
        given = self._tets.external_impulse.numpy()
        for axis in range(3):
            parts = (shares * impulses[:, axis, None, None]).reshape(-1)
            given[:, axis] += np.bincount(nodes, parts, minlength=len(given))
        self._tets.external_impulse.assign(given)
