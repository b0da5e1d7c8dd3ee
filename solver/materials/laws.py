"""The laws there are, behind one interface.

A law is a factory of device functions for wp.float32 or wp.float64. With F the deformation gradient, mu and lam
the Lame parameters [Pa]:

energy_density(F, mu, lam) -> psi [J/m3], zero at rest.
first_piola(F, mu, lam) -> P = d psi / dF [Pa].
principal_hessian(s, mu, lam) -> `principal.PrincipalHessian` at the principal stretches s, not projected.
semi_definite: None, or a function (F, mu, lam) -> Q, W of a cheap approximation of the Hessian,
    (|Q^T dF|^2 + tr (Q^T dF)^2) + (W : dF)^2, which never is indefinite and serves where strains are mild.
"""

from collections.abc import Callable
from types import SimpleNamespace

from plait.solver.materials.fixed_corotated import fixed_corotated
from plait.solver.materials.neo_hookean import neo_hookean
from plait.solver.materials.stvk import stvk
from plait.solver.scene import ElasticLaw

LAWS: dict[ElasticLaw, Callable[[type], SimpleNamespace]] = {
    "fixed-corotated": fixed_corotated,
    "neo-hookean": neo_hookean,
    "stvk": stvk,
}
