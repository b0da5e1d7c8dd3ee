"""What one tet gives: energy, forces on its corners, and the blocks of its stiffness.

A tet's deformation gradient is F = [x1 - x0, x2 - x0, x3 - x0] B with B the inverse of the same matrix at rest,
whose rows are the shape gradients g_1, g_2, g_3 (g_0 is minus their sum). With volume V, corner a feels -V P g_a.
Energy and forces are computed in float64, whatever `real` the rest is in: strains are small differences, which
float32 leaves wrong by 1e-6 of the modulus, more than a body at rest may feel.
"""

from functools import cache, partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import warp as wp

from plait.solver.materials.laws import LAWS
from plait.solver.materials.principal import principal_functions
from plait.solver.scene import ElasticLaw
from plait.solver.tets.layout import TetLayout

# The blocks (a, b) of a tet's stiffness that are stored, in order; the others are their transposes.
PAIRS = ((0, 0), (1, 1), (2, 2), (3, 3), (0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))
# Cost of a tet in units of `Launcher.launch`.
ENERGY_WORK, FORCE_WORK, SEMI_DEFINITE_WORK, PROJECTED_WORK = 5, 5, 10, 40


def module_name(law: ElasticLaw, real: type) -> str:
    """The Warp module of one law's elements in one precision."""
    return f"plait_tets_{law.replace('-', '_')}_{real.__name__}"


@cache
def element_types(real: type) -> SimpleNamespace:
    """`vec3`, `mat33` and the struct `Elements` for `real`."""
    mat33 = wp.types.matrix((3, 3), real)

    @partial(wp.struct, module=f"plait_tets_{real.__name__}")
    class Elements:
        """A body's tets; constant."""

        nodes: wp.array(dtype=wp.vec4i)  # (tet_count,) into all nodes
        inverse_rest: wp.array(dtype=wp.mat33d)  # (tet_count,) [1/m] B
        volume: wp.array(dtype=real)  # (tet_count,) [m3] at rest
        mu: wp.array(dtype=real)  # (tet_count,) [Pa] Lame's second parameter
        lam: wp.array(dtype=real)  # (tet_count,) [Pa] Lame's first parameter

    return SimpleNamespace(vec3=wp.types.vector(3, real), mat33=mat33, Elements=Elements)


def body_elements(layout: TetLayout, body: int, real: type, device: Any) -> Any:
    """`Elements` of one body on `device`."""
    types = element_types(real)
    tets = slice(int(layout.first_tet[body]), int(layout.first_tet[body + 1]))
    corners = layout.rest[layout.tets[tets]]
    edges = (corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)
    mu, lam = lame_parameters(layout.bodies[body].youngs_modulus, layout.bodies[body].poissons_ratio)
    out = types.Elements()
    out.nodes = wp.array(layout.tets[tets], dtype=wp.vec4i, device=device)
    out.inverse_rest = wp.array(np.linalg.inv(edges), dtype=wp.mat33d, device=device)
    for name, values in (("volume", layout.volume[tets]), ("mu", mu), ("lam", lam)):
        values = np.broadcast_to(values, len(corners))
        setattr(out, name, wp.array(np.ascontiguousarray(values), dtype=real, device=device))
    return out


def lame_parameters(youngs_modulus: Any, poissons_ratio: Any) -> tuple[np.ndarray, np.ndarray]:
    """mu, lambda [Pa]."""
    young, nu = np.asarray(youngs_modulus, dtype=np.float64), np.asarray(poissons_ratio, dtype=np.float64)
    return young / (2.0 * (1.0 + nu)), young * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))


@cache
def element_kernels(law: ElasticLaw, real: type) -> SimpleNamespace:
    """Kernels over the tets of a body, each item `first + tid` one tet of `Elements` (see `element_types`).

    energy(elements, position -> energy_out): (tet_count,) float64 [J].
    force(elements, position -> force_out, dilation_out): (4 tet_count,) vec3 [N], on corner a of tet t at 4 t + a,
        and (tet_count,) J.
    semi_definite, projected(elements, position -> block_out): (10 tet_count,) mat33 [N/m], of pair k of `PAIRS` of
        tet t at 10 t + k, of a positive semi-definite stiffness: the cheap one of the law, or, also where it has
        none, the exact one with its negative eigenvalues made zero.
    exact(elements, position -> block_out): the same, not projected: it may be indefinite.
    deformation(elements, position -> gradient_out): (tet_count,) mat33, F.
    `position`: (node_count,) vec3d [m].
    """
    types, functions = element_types(real), LAWS[law](real)
    vec3, mat33, Elements = types.vec3, types.mat33, types.Elements
    in_double = LAWS[law](wp.float64)
    energy_density, first_piola = in_double.energy_density, in_double.first_piola
    module = module_name(law, real)
    kernel = partial(wp.kernel, enable_backward=False)

    @wp.func(module=module)
    def deformation_gradient(elements: Elements, position: wp.array(dtype=wp.vec3d), t: int):
        nodes = elements.nodes[t]
        x0 = position[nodes[0]]
        edges = wp.matrix_from_cols(position[nodes[1]] - x0, position[nodes[2]] - x0, position[nodes[3]] - x0)
        return edges * elements.inverse_rest[t]

    @kernel(module=module)
    def energy(
        first: int,
        elements: Elements,
        position: wp.array(dtype=wp.vec3d),
        energy_out: wp.array(dtype=wp.float64),
    ):
        t = first + wp.tid()
        F = deformation_gradient(elements, position, t)
        density = energy_density(F, wp.float64(elements.mu[t]), wp.float64(elements.lam[t]))
        energy_out[t] = wp.float64(elements.volume[t]) * density

    @kernel(module=module)
    def force(
        first: int,
        elements: Elements,
        position: wp.array(dtype=wp.vec3d),
        force_out: wp.array(dtype=vec3),
        dilation_out: wp.array(dtype=real),
    ):
        t = first + wp.tid()
        F = deformation_gradient(elements, position, t)
        P = first_piola(F, wp.float64(elements.mu[t]), wp.float64(elements.lam[t]))
        forces = -wp.float64(elements.volume[t]) * elements.inverse_rest[t] * wp.transpose(P)
        force_out[4 * t] = -vec3(forces[0] + forces[1] + forces[2])
        force_out[4 * t + 1] = vec3(forces[0])
        force_out[4 * t + 2] = vec3(forces[1])
        force_out[4 * t + 3] = vec3(forces[2])
        dilation_out[t] = real(wp.determinant(F))

    @kernel(module=module)
    def deformation(
        first: int,
        elements: Elements,
        position: wp.array(dtype=wp.vec3d),
        gradient_out: wp.array(dtype=mat33),
    ):
        t = first + wp.tid()
        gradient_out[t] = mat33(deformation_gradient(elements, position, t))

    projected = semi_definite = _principal_stiffness(law, real, deformation_gradient, projected=True)
    if functions.semi_definite is not None:
        semi_definite = _cheap_stiffness(law, real, deformation_gradient)
    return SimpleNamespace(
        energy=energy,
        force=force,
        deformation=deformation,
        semi_definite=semi_definite,
        projected=projected,
        exact=_principal_stiffness(law, real, deformation_gradient, projected=False),
    )


def _block_writer(real: type, module: str) -> wp.Function:
    """Stores a tet's ten blocks, given the six of its last three corners: rows and columns sum to zero."""
    mat33 = element_types(real).mat33

    @wp.func(module=module)
    def write_blocks(
        k11: mat33,
        k22: mat33,
        k33: mat33,
        k12: mat33,
        k13: mat33,
        k23: mat33,
        at: int,
        block_out: wp.array(dtype=mat33),
    ):
        k01 = -(k11 + wp.transpose(k12) + wp.transpose(k13))
        k02 = -(k12 + k22 + wp.transpose(k23))
        k03 = -(k13 + k23 + k33)
        block_out[at] = -(k01 + k02 + k03)
        block_out[at + 1] = k11
        block_out[at + 2] = k22
        block_out[at + 3] = k33
        block_out[at + 4] = k01
        block_out[at + 5] = k02
        block_out[at + 6] = k03
        block_out[at + 7] = k12
        block_out[at + 8] = k13
        block_out[at + 9] = k23

    return write_blocks


def _cheap_stiffness(law: ElasticLaw, real: type, deformation_gradient: wp.Function) -> wp.Kernel:
    types, module = element_types(real), module_name(law, real)
    vec3, mat33, Elements = types.vec3, types.mat33, types.Elements
    approximation = LAWS[law](real).semi_definite
    write_blocks = _block_writer(real, module)

    @wp.func(module=module)
    def cheap_block(qa: vec3, qb: vec3, wa: vec3, wb: vec3):
        """From Q g and W g of the corners."""
        return wp.dot(qa, qb) * wp.identity(n=3, dtype=real) + wp.outer(qb, qa) + wp.outer(wa, wb)

    @wp.kernel(enable_backward=False, module=module)
    def semi_definite(
        first: int,
        elements: Elements,
        position: wp.array(dtype=wp.vec3d),
        block_out: wp.array(dtype=mat33),
    ):
        t = first + wp.tid()
        F = mat33(deformation_gradient(elements, position, t))
        Q, W = approximation(F, elements.mu[t], elements.lam[t])
        gradients = wp.sqrt(elements.volume[t]) * mat33(elements.inverse_rest[t])
        q = gradients * wp.transpose(Q)
        w = gradients * wp.transpose(W)
        write_blocks(
            cheap_block(q[0], q[0], w[0], w[0]),
            cheap_block(q[1], q[1], w[1], w[1]),
            cheap_block(q[2], q[2], w[2], w[2]),
            cheap_block(q[0], q[1], w[0], w[1]),
            cheap_block(q[0], q[2], w[0], w[2]),
            cheap_block(q[1], q[2], w[1], w[2]),
            10 * t,
            block_out,
        )

    return semi_definite


def _principal_stiffness(
    law: ElasticLaw, real: type, deformation_gradient: wp.Function, *, projected: bool
) -> wp.Kernel:
    """In a module of its own: many a run does not need it."""
    types, principal = element_types(real), principal_functions(real)
    mat33, Elements = types.mat33, types.Elements
    principal_hessian, decompose, block = LAWS[law](real).principal_hessian, principal.decompose, principal.block
    at_least = principal.at_least
    module = f"{module_name(law, real)}_{'projected' if projected else 'exact'}"
    write_blocks = _block_writer(real, module)

    @wp.kernel(enable_backward=False, module=module)
    def stiffness(
        first: int,
        elements: Elements,
        position: wp.array(dtype=wp.vec3d),
        block_out: wp.array(dtype=mat33),
    ):
        t = first + wp.tid()
        U, s, V = decompose(mat33(deformation_gradient(elements, position, t)))
        hessian = principal_hessian(s, elements.mu[t], elements.lam[t])
        if wp.static(projected):
            hessian = at_least(hessian, real(0.0))
        g = wp.sqrt(elements.volume[t]) * mat33(elements.inverse_rest[t]) * V
        write_blocks(
            block(hessian, U, g[0], g[0]),
            block(hessian, U, g[1], g[1]),
            block(hessian, U, g[2], g[2]),
            block(hessian, U, g[0], g[1]),
            block(hessian, U, g[0], g[2]),
            block(hessian, U, g[1], g[2]),
            10 * t,
            block_out,
        )

    return stiffness
