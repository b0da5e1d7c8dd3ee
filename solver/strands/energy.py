"""Discrete elastic rods: energy, gradient and Hessian of one joint (Bergou et al. 2008, 2010).

Variables of the joint between edges a (before) and b (after): the edge vectors and the turns of the two directors
about their own edge, in the chart centred on the current shape: an edge e + de carries the director
R(t', turn) P(t -> t') m, with P the parallel transport. No angle or reference frame is stored, so the derivatives
are those at the centre.

Energy of a joint, with c = ta . tb, curvature binormal kb = 2 ta x tb / (1 + c) and the rest curvature b carried
by the directors, b = 1/2 sum over both edges of (k1 m2 - k2 m1):
    bend  1/2 B (f(c) - 2 kb . b + |k|^2),  f = |kb|^2 - (1 - c)^2 / 4,  |kb|^2 = 8 / (1 + c) - 4
          with B = EI / Voronoi length
    twist 1/2 G (twist - rest twist)^2
For equal bending stiffness in both directions this is the usual 1/2 B |kappa - k|^2 with edge-averaged directors,
up to terms of the order of the discretisation's error; its Hessian needs one contracted second derivative of the
curvature instead of two. Rest curvatures come from the balance of forces in the drawn shape (`rest.py`).
"""

from functools import cache, partial
from types import SimpleNamespace

import warp as wp

from plait.solver.strands.types import LEAST_FOLD, rod_types

# The tangent's measure of a turn phi, 4 tan^2(phi / 2) = phi^2 + phi^4 / 6 + ..., is too stiff, the angle's own a
# little too soft for the elastica of few segments; this much of (1 - cos phi)^2 less lies between.
SOFTENING = 0.25


@cache
def joint_functions(real: type) -> SimpleNamespace:
    """Device functions of a joint for `real`: `Joint`, `joint`, `joint_energy`, `signed_twist`, `turned`."""
    types = rod_types(real)
    vec2, vec3, mat33, module = types.vec2, types.vec3, types.mat33, types.module
    Scratch = types.Scratch
    structure = partial(wp.struct, module=module)

    @structure
    class Joint:
        """Derivatives of a joint's energy; (e, t): edge vector and turn, (a, b): edge before and after."""

        gradient_ea: vec3
        gradient_eb: vec3
        gradient_ta: real
        gradient_tb: real
        ea_ea: mat33
        eb_ea: mat33  # row eb, column ea
        eb_eb: mat33
        ea_ta: vec3
        ea_tb: vec3
        eb_ta: vec3
        eb_tb: vec3
        ta_ta: real
        tb_ta: real
        tb_tb: real

    @wp.func(module=module)
    def symmetric_outer(a: vec3, b: vec3):
        ab = wp.outer(a, b)
        return ab + wp.transpose(ab)

    @wp.func(module=module)
    def joint(
        ta: vec3,
        inverse_a: real,
        tb: vec3,
        inverse_b: real,
        ma: vec3,
        mb: vec3,
        twist: real,
        bend_stiffness: real,
        twist_stiffness: real,
        rest_curvature: vec2,
        rest_twist: real,
        beta: real,
    ):
        """Gradient and Hessian; beta scales the geometric part (1: exact, 0: Gauss-Newton, semi-definite).

        ta, tb: unit tangents; inverse_a, inverse_b: over the edges' lengths; ma, mb: directors.
        """
        one = real(1.0)
        half = real(0.5)
        identity = wp.identity(n=3, dtype=real)
        c = wp.dot(ta, tb)
        chi = wp.max(one + c, real(LEAST_FOLD))
        over = one / chi
        kb = (real(2.0) * over) * wp.cross(ta, tb)
        tt = over * (ta + tb)
        na = wp.cross(ta, ma)
        nb = wp.cross(tb, mb)
        k1 = rest_curvature[0]
        k2 = rest_curvature[1]
        # Rest curvature binormal carried by each edge, and its derivative by that edge's turn.
        ba = k1 * na - k2 * ma
        bb = k1 * nb - k2 * mb
        ca = -k1 * ma - k2 * na
        cb = -k1 * mb - k2 * nb
        bt = over * (ba + bb)
        s = half * wp.dot(kb, ba + bb)
        w = wp.cross(tb, bt)
        z = wp.cross(ta, bt)
        kca = half * wp.dot(kb, ca)
        kcb = half * wp.dot(kb, cb)
        # f1, f2: derivatives of f / 2 by c, whose gradients by the edges are (tb - c ta) / |ea| and so on.
        f1 = -real(4.0) * over * over + real(SOFTENING) * (one - c)
        f2 = real(8.0) * over * over * over - real(SOFTENING)
        ua = tb - c * ta
        ub = ta - c * tb
        stretch_twist = twist_stiffness * (twist - rest_twist)
        out = Joint()
        out.gradient_ea = inverse_a * (bend_stiffness * (f1 * ua + s * tt - w) + (half * stretch_twist) * kb)
        out.gradient_eb = inverse_b * (bend_stiffness * (f1 * ub + s * tt + z) + (half * stretch_twist) * kb)
        out.gradient_ta = -bend_stiffness * kca - stretch_twist
        out.gradient_tb = -bend_stiffness * kcb + stretch_twist

        # The Hessian as few outer products: terms that share a vector are added up first.
        e = bend_stiffness * beta
        g = twist_stiffness * real(0.25)
        h = stretch_twist * beta * real(0.25)
        sc = s * over
        turn_a = h * (ta + tt) + (real(0.25) * e) * ba - (half * g) * kb
        turn_b = h * (tb + tt) + (real(0.25) * e) * bb - (half * g) * kb
        radial = half * e * (sc - f1 * c)
        bent_a = e * (w - s * tt)
        bent_b = e * (z + s * tt)
        haa = (
            symmetric_outer((half * e * f2) * ua, ua)
            - symmetric_outer((e * f1) * ua + radial * ta, ta)
            + symmetric_outer(bent_a, tt)
            - symmetric_outer(turn_a, kb)
            + (real(2.0) * radial) * identity
        )
        hbb = (
            symmetric_outer((half * e * f2) * ub, ub)
            - symmetric_outer((e * f1) * ub + radial * tb, tb)
            - symmetric_outer(bent_b, tt)
            - symmetric_outer(turn_b, kb)
            + (real(2.0) * radial) * identity
        )
        hba = (
            wp.outer((e * f2) * ub, ua)
            + wp.outer(tb, (e * (c * f1 + sc)) * ta - (e * f1) * tb)
            - wp.outer((e * f1) * ta, ta)
            + wp.outer(tt, bent_a - (real(2.0) * h) * kb)
            - wp.outer(bent_b, tt)
            + wp.outer(g * kb, kb)
            + (e * (f1 + sc)) * identity
            - wp.skew(e * bt + (real(4.0) * h * over) * ta)
        )
        out.ea_ta = inverse_a * (e * (kca * tt - over * wp.cross(tb, ca)) - (half * twist_stiffness) * kb)
        out.ea_tb = inverse_a * (e * (kcb * tt - over * wp.cross(tb, cb)) + (half * twist_stiffness) * kb)
        out.eb_ta = inverse_b * (e * (kca * tt + over * wp.cross(ta, ca)) - (half * twist_stiffness) * kb)
        out.eb_tb = inverse_b * (e * (kcb * tt + over * wp.cross(ta, cb)) + (half * twist_stiffness) * kb)
        out.ta_ta = twist_stiffness + e * half * wp.dot(kb, ba)
        out.tb_ta = -twist_stiffness
        out.tb_tb = twist_stiffness + e * half * wp.dot(kb, bb)
        if beta < one:
            # Gauss-Newton of 1/2 B |kappa - k|^2, both components of the edge-averaged curvature.
            q = bend_stiffness * (one - beta)
            for component in range(2):
                da = na
                db = nb
                ra = -ma
                rb = -mb
                if component == 1:
                    da = -ma
                    db = -mb
                    ra = -na
                    rb = -nb
                kappa = half * wp.dot(kb, da + db)
                dt = over * (da + db)
                ja = wp.cross(tb, dt) - kappa * tt
                jb = -wp.cross(ta, dt) - kappa * tt
                ya = half * wp.dot(kb, ra)
                yb = half * wp.dot(kb, rb)
                haa += q * wp.outer(ja, ja)
                hba += q * wp.outer(jb, ja)
                hbb += q * wp.outer(jb, jb)
                out.ea_ta += (inverse_a * q * ya) * ja
                out.ea_tb += (inverse_a * q * yb) * ja
                out.eb_ta += (inverse_b * q * ya) * jb
                out.eb_tb += (inverse_b * q * yb) * jb
                out.ta_ta += q * ya * ya
                out.tb_ta += q * ya * yb
                out.tb_tb += q * yb * yb
        out.ea_ea = (inverse_a * inverse_a) * haa
        out.eb_ea = (inverse_a * inverse_b) * hba
        out.eb_eb = (inverse_b * inverse_b) * hbb
        return out

    @wp.func(module=module)
    def joint_energy(
        ta: vec3,
        tb: vec3,
        ma: vec3,
        mb: vec3,
        twist: real,
        bend_stiffness: real,
        twist_stiffness: real,
        rest_curvature: vec2,
        rest_twist: real,
    ):
        """Bend and twist energy of a joint [J]."""
        chi = wp.max(real(1.0) + wp.dot(ta, tb), real(LEAST_FOLD))
        kb = (real(2.0) / chi) * wp.cross(ta, tb)
        b = rest_curvature[0] * wp.cross(ta, ma) - rest_curvature[1] * ma
        b += rest_curvature[0] * wp.cross(tb, mb) - rest_curvature[1] * mb
        straight = real(1.0) - wp.dot(ta, tb)
        squared = real(8.0) / chi - real(4.0) - real(SOFTENING) * straight * straight
        squared += wp.dot(rest_curvature, rest_curvature) - wp.dot(kb, b)
        turn = twist - rest_twist
        return real(0.5) * (bend_stiffness * squared + twist_stiffness * turn * turn)

    @wp.func(module=module)
    def transport(t: vec3, to: vec3, v: vec3):
        """Parallel transport of v, perpendicular to t, onto the plane perpendicular to `to`."""
        chi = wp.max(real(1.0) + wp.dot(t, to), real(LEAST_FOLD))
        return v - (wp.dot(v, to) / chi) * (t + to)

    @wp.func(module=module)
    def signed_twist(ta: vec3, tb: vec3, ma: vec3, mb: vec3, before: real):
        """Angle from the transported director ma to mb about tb, unwrapped next to the angle `before` [rad]."""
        carried = transport(ta, tb, ma)
        sine = wp.dot(wp.cross(carried, mb), tb)
        cosine = wp.dot(carried, mb)
        angle = real(0.0)
        if wp.abs(sine) < real(0.1) * cosine:
            # The series of the arc tangent, to 1e-14: most joints are hardly twisted.
            r = sine / cosine
            q = r * r
            angle = real(1.0 / 7.0) - q * (real(1.0 / 9.0) - q * (real(1.0 / 11.0) - q * real(1.0 / 13.0)))
            angle = r * (real(1.0) - q * (real(1.0 / 3.0) - q * (real(0.2) - q * angle)))
        else:
            angle = wp.atan2(sine, cosine)
        turn = real(6.283185307179586)
        return angle + turn * wp.round((before - angle) * real(0.15915494309189535))

    @wp.func(module=module)
    def turned(scratch: Scratch, slot: int, stride: int):
        """[rad] by which an edge has turned about itself since the piece's start."""
        before = wp.normalize(scratch.start[slot + stride] - scratch.start[slot])
        return signed_twist(
            before, scratch.tangent[slot], scratch.start_director[slot], scratch.director[slot],
            scratch.turn_target[slot],
        )  # fmt: skip

    return SimpleNamespace(
        Joint=Joint,
        joint=joint,
        joint_energy=joint_energy,
        transport=transport,
        signed_twist=signed_twist,
        turned=turned,
    )
