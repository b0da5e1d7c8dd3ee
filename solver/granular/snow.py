"""Snow: elastic up to a critical strain, harder where packed, softer where torn (Stomakhin et al. 2013).

psi = mu |F - R|^2 + lambda/2 (J - 1)^2 of the elastic F, with both parameters times exp(xi (1 - J_P)); the
singular values of F stay within [1 - theta_c, 1 + theta_s], the rest becomes plastic, of which only the volume
J_P matters to what follows. It is kept within [.6, 20], as in the code that Hu et al.
(2018) published beside their paper: without bound a hard blow packs snow until it is hundreds of times as stiff,
and takes steps as much shorter as sound is faster.
"""

from functools import cache
from types import SimpleNamespace

import numpy as np
import warp as wp

from plait.solver.granular.material import material_type
from plait.solver.materials.rotation import module_name
from plait.solver.materials.symmetric import symmetric_functions
from plait.solver.scene import Granular

# ln J_P at the least and at most.
PACKED, TORN = float(np.log(0.6)), float(np.log(20.0))


def parameters(granular: Granular) -> tuple[float, ...]:
    """ln(1 - theta_c), ln(1 + theta_s), xi."""
    least, most = np.log1p(-granular.critical_compression), np.log1p(granular.critical_stretch)
    return float(least), float(most), granular.hardening


@cache
def snow(real: type) -> SimpleNamespace:
    """The law for `real`; see `laws.py` for the interface. memory: ln J_P."""
    module = module_name(real)
    functions = symmetric_functions(real)
    sym, Material = functions.sym, material_type(real).Material
    trace_of, size_squared, plus_isotropic = functions.trace_of, functions.size_squared, functions.plus_isotropic
    square, exp_minus_one, compose = functions.square, functions.exp_minus_one, functions.compose
    to_matrix, eigen, vec3 = functions.to_matrix, functions.eigen, wp.types.vector(3, real)

    @wp.func(module=module)
    def snow_hardness(memory: real, m: Material):
        return wp.exp(m.own[2] * (real(1.0) - wp.exp(memory)))

    @wp.func(module=module)
    def snow_energy(strain: sym, memory: real, m: Material):
        stretch = exp_minus_one(strain)
        dilation = wp.exp(trace_of(strain)) - real(1.0)
        at_rest = m.mu * size_squared(stretch) + real(0.5) * m.lam * dilation * dilation
        return snow_hardness(memory, m) * at_rest

    @wp.func(module=module)
    def snow_stress(strain: sym, memory: real, m: Material):
        """2 mu (V - 1) V + lambda (J - 1) J with V = exp e."""
        stretch = exp_minus_one(strain)
        J = wp.exp(trace_of(strain))
        shear = real(2.0) * m.mu * (stretch + square(stretch))
        return snow_hardness(memory, m) * plus_isotropic(shear, m.lam * (J - real(1.0)) * J)

    @wp.func(module=module)
    def snow_return(strain: sym, memory: real, m: Material):
        least = wp.min(m.own[1], -m.own[0])
        if size_squared(strain) <= least * least:
            return strain, memory
        s, V = eigen(to_matrix(strain))
        kept = vec3()
        for k in range(3):
            kept[k] = wp.clamp(s[k], m.own[0], m.own[1])
        flowed = memory + (s[0] + s[1] + s[2]) - (kept[0] + kept[1] + kept[2])
        return compose(V, kept), wp.clamp(flowed, real(PACKED), real(TORN))

    @wp.func(module=module)
    def snow_modulus(memory: real, m: Material):
        return snow_hardness(memory, m) * (m.lam + real(2.0) * m.mu)

    return SimpleNamespace(
        energy_density=snow_energy, kirchhoff=snow_stress, return_map=snow_return, wave_modulus=snow_modulus
    )
