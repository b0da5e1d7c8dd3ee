"""Isotropic Coulomb friction of a continuum: the return mapping of Klar et al. 2016 on Hencky's strain.

Shear stress no larger than a part of the pressure: with e = ln s of the elastic principal stretches, tr e <= 0 and
    |dev e| + alpha (3 lambda + 2 mu) / (2 mu) tr e <= 0,
the cone of Drucker and Prager, whose alpha follows from the friction angle. What is outside goes back to it at
constant volume, what is under tension to the tip, unstrained. The volume gained there, ln of it, is kept and
given back when the matter is pressed together again (Tampubolon et al. 2017, section 4.3.4): else matter that
has come apart and back would swell.
"""

from functools import cache
from types import SimpleNamespace

import numpy as np
import warp as wp

from plait.solver.materials.hencky import hencky
from plait.solver.materials.principal import principal_functions
from plait.solver.materials.rotation import module_name, rotation_functions


def cone_slope(friction: np.ndarray) -> np.ndarray:
    """alpha = sqrt(2/3) 2 sin phi / (3 - sin phi) of the friction coefficients tan phi (Klar et al. 2016)."""
    sine = friction / np.sqrt(1.0 + friction**2)
    return np.sqrt(2.0 / 3.0) * 2.0 * sine / (3.0 - sine)


@cache
def drucker_prager(real: type) -> SimpleNamespace:
    """The device function `project` for `real`."""
    rotations = rotation_functions(real)
    mat33, vec3 = rotations.mat33, rotations.vec3
    decompose, strain = principal_functions(real).decompose, hencky(real).strain
    module = module_name(real)

    @wp.func(module=module)
    def return_to_cone(e: vec3, mu: real, lam: real, alpha: real):
        """The nearest admissible strain at the same volume; zero under tension."""
        dilation = e[0] + e[1] + e[2]
        if dilation >= real(0.0):
            return vec3()
        mean = dilation / real(3.0)
        shear = e - vec3(mean, mean, mean)
        size = wp.length(shear)
        admissible = -alpha * (real(3.0) * lam + real(2.0) * mu) / (real(2.0) * mu) * dilation
        if size <= admissible:
            return e
        return vec3(mean, mean, mean) + (admissible / size) * shear

    @wp.func(module=module)
    def project(F: mat33, gained: real, mu: real, lam: real, alpha: real):
        """F and `gained`, ln of the volume lost to tension so far, as they become; and whether F was one.

        F that mirrors, or is flat, is no deformation of matter: it comes back unstrained, with False.
        """
        U, s, V = decompose(F)
        if not wp.min(s) > real(0.0):
            return wp.identity(n=3, dtype=real), real(0.0), wp.bool(False)
        third = gained / real(3.0)
        e = strain(s) + vec3(third, third, third)
        back = return_to_cone(e, mu, lam, alpha)
        stretched = wp.diag(vec3(wp.exp(back[0]), wp.exp(back[1]), wp.exp(back[2])))
        return (
            U * stretched * wp.transpose(V),
            wp.max(e[0] + e[1] + e[2], real(0.0)),
            wp.bool(True),
        )

    return SimpleNamespace(project=project)
