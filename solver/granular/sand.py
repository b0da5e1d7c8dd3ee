"""Dry sand: elastic under pressure, sliding by Coulomb's law, apart without resistance (Klar et al. 2016).

The Kirchhoff stress is tau = 2 mu e + lambda tr e of Hencky's strain e = ln(F F^T)/2. Admissible is
    tr e <= 0  and  |dev e| + alpha (3 lambda + 2 mu) / (2 mu) tr e <= 0    (their (27))
and what is not goes back along dev e, which takes no eigenvectors; under tension, to no strain at all. What volume
is gained there, ln of it, is remembered and given back when the matter is pressed together again (Tampubolon et
al. 2017, section 4.3.4): else sand that has come apart and back would swell.

alpha = sqrt(2)/3 tan phi, so that |dev tau| = sqrt(2) tan phi p: matter that flows down a slope does so at the
friction angle phi (Jop, Forterre and Pouliquen 2006, (2)). Klar's alpha is that of triaxial compression, by which
such a slope holds up to 34.7 degrees for phi = 30.
"""

from functools import cache
from types import SimpleNamespace

import numpy as np
import warp as wp

from plait.solver.granular.elastic import elastic
from plait.solver.granular.material import material_type
from plait.solver.materials.rotation import module_name
from plait.solver.materials.symmetric import symmetric_functions
from plait.solver.scene import Granular


def parameters(granular: Granular) -> tuple[float, ...]:
    """alpha."""
    return (float(np.sqrt(2.0) / 3.0 * np.tan(granular.friction_angle)),)


@cache
def sand(real: type) -> SimpleNamespace:
    """The law for `real`; see `laws.py` for the interface. memory: ln of the volume gained apart."""
    module = module_name(real)
    functions = symmetric_functions(real)
    sym, Material = functions.sym, material_type(real).Material
    trace_of, size_squared, plus_isotropic = functions.trace_of, functions.size_squared, functions.plus_isotropic

    @wp.func(module=module)
    def sand_return(strain: sym, memory: real, m: Material):
        e = plus_isotropic(strain, memory / real(3.0))
        dilation = trace_of(e)
        if dilation >= real(0.0):
            return sym(), dilation
        mean = dilation / real(3.0)
        shear = plus_isotropic(e, -mean)
        size = wp.sqrt(size_squared(shear))
        admissible = -m.own[0] * (real(3.0) * m.lam + real(2.0) * m.mu) / (real(2.0) * m.mu) * dilation
        if size <= admissible:
            return e, real(0.0)
        return plus_isotropic((admissible / size) * shear, mean), real(0.0)

    own = elastic(real)
    return SimpleNamespace(
        energy_density=own.energy_density,
        kirchhoff=own.kirchhoff,
        return_map=sand_return,
        wave_modulus=own.wave_modulus,
    )
