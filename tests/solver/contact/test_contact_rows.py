"""Rows of contacts between points of tets and triangles whose nodes they share."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from plait.solver.contact.contact_rows import ContactRows, Contacts
from plait.solver.launch import Launcher

NODES, ROWS = 40, 60


def tangle(random: np.random.Generator, flatness: float) -> Contacts:
    """Rows between random places, that just touch; the first lies by `flatness` in weights from the second."""
    nodes = np.array([random.choice(NODES, 8, replace=False) for _ in range(ROWS)]).astype(np.int32)
    own, theirs = random.dirichlet(np.ones(4), ROWS), random.dirichlet(np.ones(4), ROWS)
    shift = flatness * random.uniform(-1.0, 1.0, (ROWS, 4))
    shift -= shift.mean(axis=1, keepdims=True)
    normal = random.normal(size=(ROWS, 3))
    return Contacts(
        nodes,
        np.concatenate([own, -theirs], axis=1),
        np.concatenate([own + shift, -theirs], axis=1),
        normal / np.linalg.norm(normal, axis=1, keepdims=True),
        target=np.zeros(ROWS),
        friction=np.zeros(ROWS),
        restitution=np.zeros(ROWS),
        share=random.uniform(0.5, 2.0, ROWS),
    )


@pytest.mark.parametrize("flatness", [0.0, 0.1, 1.0])
def test_stopping_what_closes_takes_energy_away(flatness):
    """Rows that touch where the step starts, without friction, do no more than stop what closes: impulses J >= 0
    that lower J A J / 2 + J U, the change of the kinetic energy, in every sweep. So it never ends above that of
    the start, however far outside of its tet a row acts; and there is some to take away.
    """
    random = np.random.default_rng(0)
    step, mass = 1e-3, random.uniform(0.5, 2.0, NODES)
    for _ in range(5):
        contacts = tangle(random, flatness)
        position, velocity = random.normal(size=(2, NODES, 3))

        def between(weights: np.ndarray, of_nodes: np.ndarray, contacts: Contacts = contacts) -> np.ndarray:
            return np.einsum("ck,ckd,cd->c", weights, of_nodes[contacts.nodes], contacts.normal)

        contacts.target[:] = between(contacts.weights, position) - step * between(
            contacts.common_weights, velocity
        )
        rows = ContactRows(np.ones(NODES, dtype=bool), Launcher("cpu", 1))
        rows.build(contacts)
        position, velocity = (wp.array(x, dtype=wp.vec3d, device="cpu") for x in (position, velocity))
        rows.begin_pass(position, velocity, wp.array(1.0 / mass, device="cpu"))
        energies = [0.5 * mass @ np.square(velocity.numpy()).sum(axis=1)]
        for _ in range(20):
            rows.sweep(velocity, step)
            energies.append(0.5 * mass @ np.square(velocity.numpy()).sum(axis=1))
        assert np.diff(energies).max() <= 1e-12 * energies[0]
        assert energies[-1] < 0.9 * energies[0]
