"""Tension of an edge. In float32 the true EA would drown a hair's weight in the rounding of its positions.

Positions about the root carry rounding of 1e-7 of the strand's length, some 1e-6 of a segment; times the EA of
hair that is several times its weight. So in float32 EA is softened until the strand's own weight stretches it by a
thousandth, and is itself again beyond a strain of half a per cent, which bounds the stretch of fast motion.
"""

from functools import cache
from types import SimpleNamespace

import numpy as np
import warp as wp

from plait.solver.strands.layout import Layout
from plait.solver.strands.types import module_name

STRAIN_UNDER_WEIGHT = 1.0e-3
BOUNDED_STRAIN = 5.0e-3
STANDARD_GRAVITY = 9.81


def softened_stretch(layout: Layout, real: type) -> np.ndarray:
    """(strand_count,) EA [N] of small strains: the strands' own in float64, in float32 as above.

    Never so soft that a segment would rather stretch than bend.
    """
    if real == wp.float64:
        return layout.stretch
    load = np.linalg.norm(layout.force, axis=1) + STANDARD_GRAVITY * layout.mass
    weight = np.add.reduceat(load, layout.first_node[:-1])
    least = np.maximum(weight / STRAIN_UNDER_WEIGHT, 100.0 * layout.bend / layout.mean_segment**2)
    return np.minimum(layout.stretch, least)


@cache
def stretch_functions(real: type) -> SimpleNamespace:
    """Device functions `tension` and `stretch_energy` for `real`."""

    @wp.func(module=module_name(real))
    def tension(strain: real, stretch: real, stretch_beyond: real):
        """Tension [N] of an edge, and its derivative by the strain [N]."""
        bound = real(BOUNDED_STRAIN)
        beyond = strain - wp.clamp(strain, -bound, bound)
        stiffness = stretch + wp.where(beyond == real(0.0), real(0.0), stretch_beyond)
        return stretch * strain + stretch_beyond * beyond, stiffness

    @wp.func(module=module_name(real))
    def stretch_energy(strain: real, stretch: real, stretch_beyond: real):
        """Energy [J/m] over an edge's rest length."""
        beyond = strain - wp.clamp(strain, -real(BOUNDED_STRAIN), real(BOUNDED_STRAIN))
        return real(0.5) * (stretch * strain * strain + stretch_beyond * beyond * beyond)

    return SimpleNamespace(tension=tension, stretch_energy=stretch_energy)
