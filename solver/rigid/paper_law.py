"""The potential of contact of Han 2019 (34) and its return mapping (35), (36), on a rigid surface.

F = d D^-1 has in its columns what has become of a triangle's two edges and of its unit normal. With D in the axes
of the triangle, the third along its normal, and F = Q R with R upper triangular, Q's first two columns span the
triangle and its third is the normal n. A rigid triangle's edges only turn, so the upper left of R stays one, and
with d for the third column, the director,

    r_33 = d . n,  (r_13, r_23) = the part of d across n, in the triangle's axes.

So no factors need be computed: energy and return mapping are functions of d and n, whatever the triangle, and the
edges, which never change in length, pull on nothing. dpsi/dd = f'(r_33) n + gamma (d - r_33 n).
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

ONE = wp.constant(wp.float64(1.0))
# gamma over k^c: the most that k^c does in the other direction, 2 (1 - r) r^2 at r = 2/3; see `longest_step`.
SHEAR = wp.constant(wp.float64(8.0 / 27.0))


def longest_step(surface_density: float, cell_size: float, stiffness: float) -> float:
    """[s] below which a step is stable.

    surface_density: the least that a body has for its surface [kg/m2].  cell_size: dx [m].  stiffness: k^c [Pa].

    A particle's director changes at the rate sum_i v_i (grad w_iq . d), and by Cauchy and Schwarz the square of
    that is at most sum_i w_iq v_i^2 times sum_i (grad w_iq . d)^2 / w_iq, the latter at most 6 |d|^2 / dx^2 for
    quadratic B-splines. With V_q = dx A_q, m_q = density A_q, and psi'' |d|^2 at most 8/27 k^c across the surface
    and along it, the frequency squared is at most 6 V_q psi'' |d|^2 / (m_q dx^2) = 16/9 k^c / (density dx). Bodies
    weigh more than what of them the grid sees, and are slower yet. Symplectic Euler is stable up to 2 over it.
    """
    return 1.5 * (surface_density * cell_size / stiffness) ** 0.5


@wp.func
def energy_of(director: wp.vec3d, normal: wp.vec3d, stiffness: wp.float64) -> wp.float64:
    """psi [J/m3]: k^c (1 - r_33)^3 / 3 where r_33 < 1, and gamma (r_13^2 + r_23^2) / 2 (34)."""
    along = wp.dot(director, normal)
    across = director - along * normal
    pressed = wp.max(ONE - along, wp.float64(0.0))
    shear = wp.float64(0.5) * SHEAR * stiffness * wp.length_sq(across)
    return stiffness / wp.float64(3.0) * pressed * pressed * pressed + shear


@wp.func
def traction_of(director: wp.vec3d, normal: wp.vec3d, stiffness: wp.float64) -> wp.vec3d:
    """dpsi/dd [Pa], the gradient of (34)."""
    along = wp.dot(director, normal)
    across = director - along * normal
    pressed = wp.max(ONE - along, wp.float64(0.0))
    return SHEAR * stiffness * across - stiffness * pressed * pressed * normal


@wp.func
def returned(director: wp.vec3d, normal: wp.vec3d, friction: wp.float64) -> wp.vec3d:
    """What of a director is elastic (35), (36): not stretched, and sheared within Coulomb's cone.

    The traction is -k^c (1 - r_33)^2 along the normal and gamma (r_13, r_23) across: Coulomb's law
    |gamma r_t| <= c_F k^c (1 - r_33)^2 with the coefficient of friction for c_F is the bound of (36).
    """
    along = wp.dot(director, normal)
    across = director - along * normal
    along = wp.min(along, ONE)
    pressed = ONE - along
    bound = friction * pressed * pressed / SHEAR
    size = wp.length(across)
    if size > bound:
        across = bound / size * across
    return along * normal + across
