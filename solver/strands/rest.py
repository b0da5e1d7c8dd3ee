"""Rest shapes: frames along the drawn shape, and the curvature, twist and lengths that keep it as drawn.

'authored': the drawn shape is free of force. 'sagfree': it is in equilibrium with gravity and loads. All of a
rod's energy but a constant is linear in its rest curvature and twist, so the inverse problem is a linear one of
three unknowns a vertex, solved from the free tip to the root: with F the sum of the forces beyond edge k,

    tension t_k + dE_k/de_k + dE_(k+1)/de_k = F      (two components across the edge, one along)
    dE_k/dturn_k + dE_(k+1)/dturn_k = 0
"""

import warp as wp

from plait.solver.contact.planes import ContactPlanes
from plait.solver.strands.energy import SOFTENING, joint_functions
from plait.solver.strands.newton import newton_functions
from plait.solver.strands.types import LEAST_FOLD, rod_types

REAL = wp.float64
MODULE = "plait_strands_rest"  # apart, so that a float32 run does not compile the float64 solve
_types, _functions = rod_types(REAL), joint_functions(REAL)
vec2, vec3 = _types.vec2, _types.vec3
Rods, Scratch = _types.Rods, _types.Scratch
joint, transport = _functions.joint, _functions.transport
eliminate, measure_edges = newton_functions(REAL).eliminate, newton_functions(REAL).measure_edges


@wp.kernel(enable_backward=False, module=MODULE)
def transport_frames(
    first: int,
    first_node: wp.array(dtype=wp.int32),
    position: wp.array(dtype=wp.vec3d),  # [m] rest space
    director_out: wp.array(dtype=wp.vec3d),
):
    """A twist-free director on every edge."""
    strand = first + wp.tid()
    begin = first_node[strand]
    end = first_node[strand + 1]
    t = wp.normalize(position[begin + 1] - position[begin])
    axis = wp.vec3d(1.0, 0.0, 0.0)
    if wp.abs(t[0]) > REAL(0.7):
        axis = wp.vec3d(0.0, 1.0, 0.0)
    m = wp.normalize(wp.cross(t, axis))
    director_out[begin] = m
    for k in range(begin + 1, end - 1):
        t_next = wp.normalize(position[k + 1] - position[k])
        m = transport(t, t_next, m)
        m = wp.normalize(m - wp.dot(m, t_next) * t_next)
        t = t_next
        director_out[k] = m


@wp.kernel(enable_backward=False, module=MODULE)
def balance(
    first: int,
    strands: wp.array(dtype=wp.int32),  # those to treat
    first_node: wp.array(dtype=wp.int32),
    position: wp.array(dtype=wp.vec3d),
    director: wp.array(dtype=wp.vec3d),
    force: wp.array(dtype=wp.vec3d),  # [N] rest space
    bend: wp.array(dtype=REAL),  # [N m] EI over Voronoi length
    twist: wp.array(dtype=REAL),
    rest_curvature_out: wp.array(dtype=vec2),
    rest_twist_out: wp.array(dtype=REAL),
    tension_out: wp.array(dtype=REAL),
):
    """Rest curvature, rest twist and tension that balance `force` in the drawn shape."""
    strand = strands[first + wp.tid()]
    begin = first_node[strand]
    count = first_node[strand + 1] - begin
    one = REAL(1.0)
    half = REAL(0.5)
    beyond = wp.vec3d()
    gradient_ea = wp.vec3d()
    gradient_ta = REAL(0.0)
    for i in range(count - 2):
        k = begin + count - 2 - i
        beyond += force[k + 1]
        a = position[k] - position[k - 1]
        b = position[k + 1] - position[k]
        inverse_a = one / wp.length(a)
        inverse_b = one / wp.length(b)
        ta = inverse_a * a
        tb = inverse_b * b
        ma = director[k - 1]
        mb = director[k]
        na = wp.cross(ta, ma)
        nb = wp.cross(tb, mb)
        over = one / wp.max(one + wp.dot(ta, tb), REAL(LEAST_FOLD))
        kb = (REAL(2.0) * over) * wp.cross(ta, tb)
        tt = over * (ta + tb)
        stiffness = bend[k] * inverse_b
        wanted = beyond - gradient_ea
        tension_out[k] = wp.dot(wanted, tb)
        # dE/deb is affine in rest curvature (k1, k2) and twist moment; see `joint`.
        b1 = na + nb
        b2 = -ma - mb
        by_k1 = stiffness * (half * wp.dot(kb, b1) * tt + over * wp.cross(ta, b1))
        by_k2 = stiffness * (half * wp.dot(kb, b2) * tt + over * wp.cross(ta, b2))
        by_moment = (half * inverse_b) * kb
        constant = ((-REAL(4.0) * over * over + REAL(SOFTENING) * (one - wp.dot(ta, tb))) * stiffness) * (
            ta - wp.dot(ta, tb) * tb
        )
        right = wanted - constant
        matrix = wp.mat33d(
            wp.dot(by_k1, mb), wp.dot(by_k2, mb), wp.dot(by_moment, mb),
            wp.dot(by_k1, nb), wp.dot(by_k2, nb), wp.dot(by_moment, nb),
            half * bend[k] * wp.dot(kb, mb), half * bend[k] * wp.dot(kb, nb), one,
        )  # fmt: skip
        solved = wp.inverse(matrix) * wp.vec3d(wp.dot(right, mb), wp.dot(right, nb), -gradient_ta)
        rest_curvature_out[k] = vec2(solved[0], solved[1])
        rest_twist_out[k] = -solved[2] / twist[k]
        balanced = joint(
            ta, inverse_a, tb, inverse_b, ma, mb, REAL(0.0), bend[k], twist[k], rest_curvature_out[k],
            rest_twist_out[k], one,
        )  # fmt: skip
        gradient_ea = balanced.gradient_ea
        gradient_ta = balanced.gradient_ta


@wp.kernel(enable_backward=False, module=MODULE)
def find_stable(
    first: int,
    strands: wp.array(dtype=wp.int32),  # those to judge
    chunk_count: int,
    rods: Rods,
    no_planes: ContactPlanes,
    scratch: Scratch,
    position: wp.array(dtype=wp.vec3d),
    director: wp.array(dtype=wp.vec3d),
    tension: wp.array(dtype=REAL),
    stable_out: wp.array(dtype=wp.int32),  # by the place in `strands`
):
    """Whether the drawn shape is a minimum of the energy: whether its exact static Hessian is definite."""
    chunk = first + wp.tid()
    base = chunk * scratch.chunk_stride
    stride = scratch.node_stride
    zero = REAL(0.0)
    for i in range(chunk, strands.shape[0], chunk_count):
        strand = strands[i]
        begin = rods.first_node[strand]
        for node in range(begin, rods.first_node[strand + 1]):
            slot = base + (node - begin) * stride
            scratch.position[slot] = position[node] - position[begin + 1]
            scratch.target[slot] = vec3()
            scratch.director[slot] = director[node]
            scratch.twist[slot] = zero
            scratch.tension[slot] = tension[node]
        measure_edges(scratch, rods.first_node[strand + 1] - begin, base, stride)
        definite = eliminate(
            rods, scratch, no_planes, False, wp.vec3d(), zero, strand, base, stride, zero, REAL(1.0)
        )
        stable_out[i] = wp.where(definite, 1, 0)
