"""Inelastic impulses between edges close together (Bridson et al. 2002; Han 2019, 5.3); float64."""

import warp as wp

from plait.solver.strand_contact.crossing_kernels import closest_on_edges

wp.set_module_options({"enable_backward": False})

ZERO = wp.constant(wp.float64(0.0))
ONE = wp.constant(wp.float64(1.0))


@wp.struct
class Edges:
    """The strands' nodes; edge k joins nodes k and k + 1. Constant, (node_count,) each."""

    inverse_mass: wp.array(dtype=wp.float64)  # [1/kg]; zero where a node goes where it is told
    radius: wp.array(dtype=wp.float64)  # [m]
    thickness: wp.array(dtype=wp.float64)  # [m] kept besides; the larger of two counts
    friction: wp.array(dtype=wp.float64)  # Coulomb coefficient; a pair's is the mean of both


@wp.struct
class Pairs:
    """Pairs of edges that may be close, (pair_count,) each."""

    edges: wp.array(dtype=wp.vec2i)  # a, b
    place: wp.array(dtype=wp.vec2d)  # of the nearest points, on a and on b, 0 to 1
    distance: wp.array(dtype=wp.float64)  # [m] of those
    normal: wp.array(dtype=wp.vec3d)  # from b to a
    mass: wp.array(dtype=wp.float64)  # [kg] that an impulse there meets; zero: not close
    impulse: wp.array(dtype=wp.vec3d)  # [kg m/s] on a
    approach: wp.array(dtype=wp.float64)  # [m/s], zero where they do not approach


@wp.struct
class Incidence:
    """The pairs of each edge, ascending."""

    first: wp.array(dtype=wp.int32)  # (node_count + 1,)
    entry: wp.array(dtype=wp.int32)  # 2 * pair, and one more where the edge is the pair's second


@wp.func
def give_of(edges: Edges, pair: wp.vec2i, place: wp.vec2d, count: wp.vec4d) -> wp.float64:
    """[1/kg] by which an impulse there changes the pair's velocity; nodes have 1 / count of their masses."""
    a = pair[0]
    b = pair[1]
    s = place[0]
    t = place[1]
    give = (ONE - s) * (ONE - s) * count[0] * edges.inverse_mass[a] + s * s * count[1] * edges.inverse_mass[a + 1]
    give += (ONE - t) * (ONE - t) * count[2] * edges.inverse_mass[b]
    return give + t * t * count[3] * edges.inverse_mass[b + 1]


@wp.func
def part_of_node(pairs: Pairs, entry: int, end: int) -> wp.float64:
    """The weight of an edge's node, its first or second, in the nearest point; negative on the second edge."""
    place = pairs.place[entry / 2]
    s = wp.where(entry % 2 == 0, place[0], place[1])
    weight = wp.where(end == 0, ONE - s, s)
    return wp.where(entry % 2 == 0, weight, -weight)


@wp.kernel
def find_close(first: int, edges: Edges, start: wp.array(dtype=wp.vec3d), pairs_out: Pairs):
    """Nearest points where the substep starts, and whether they are close; one pair an item.

    Midlines that touch have no direction between them: no impulse then.
    """
    item = first + wp.tid()
    a = pairs_out.edges[item][0]
    b = pairs_out.edges[item][1]
    place = closest_on_edges(start[a], start[a + 1], start[b], start[b + 1])
    s = place[0]
    t = place[1]
    apart = (ONE - s) * start[a] + s * start[a + 1] - (ONE - t) * start[b] - t * start[b + 1]
    distance = wp.length(apart)
    close = (ONE - s) * edges.radius[a] + s * edges.radius[a + 1]
    close += (ONE - t) * edges.radius[b] + t * edges.radius[b + 1]
    close += wp.max(edges.thickness[a], edges.thickness[b])
    give = give_of(edges, pairs_out.edges[item], place, wp.vec4d(ONE, ONE, ONE, ONE))
    mass = ZERO
    normal = wp.vec3d()
    if distance < close and distance > ZERO and give > ZERO:
        mass = ONE / give
        normal = apart / distance
    pairs_out.place[item] = place
    pairs_out.distance[item] = distance
    pairs_out.normal[item] = normal
    pairs_out.mass[item] = mass


@wp.kernel
def evaluate(first: int, edges: Edges, velocity: wp.array(dtype=wp.vec3d), pairs_out: Pairs):
    """The impulse that ends the approach of a pair alone, with Coulomb friction; one pair an item."""
    item = first + wp.tid()
    impulse = wp.vec3d()
    approach = ZERO
    mass = pairs_out.mass[item]
    if mass > ZERO:
        a = pairs_out.edges[item][0]
        b = pairs_out.edges[item][1]
        s = pairs_out.place[item][0]
        t = pairs_out.place[item][1]
        n = pairs_out.normal[item]
        relative = (ONE - s) * velocity[a] + s * velocity[a + 1] - (ONE - t) * velocity[b] - t * velocity[b + 1]
        approach = wp.max(-wp.dot(relative, n), ZERO)
        if approach > ZERO:
            across = relative + approach * n
            slip = wp.length(across)
            impulse = mass * approach * n
            if slip > ZERO:
                held = wp.float64(0.5) * (edges.friction[a] + edges.friction[b]) * approach
                impulse -= mass * wp.min(held / slip, ONE) * across
    pairs_out.impulse[item] = impulse
    pairs_out.approach[item] = approach


@wp.kernel
def count_impulses(
    first: int,
    incidence: Incidence,
    pairs: Pairs,
    count_out: wp.array(dtype=wp.int32),
):
    """How many impulses a node receives, through the edge before it and its own; one node an item."""
    node = first + wp.tid()
    count = wp.int32(0)
    for edge in range(wp.max(node - 1, 0), node + 1):
        for at in range(incidence.first[edge], incidence.first[edge + 1]):
            if pairs.approach[incidence.entry[at] / 2] > ZERO:
                count += 1
    count_out[node] = count


@wp.kernel
def divide(first: int, edges: Edges, count: wp.array(dtype=wp.int32), pairs_out: Pairs):
    """The impulses as if each node's mass were shared equally by those that it receives; one pair an item."""
    item = first + wp.tid()
    if pairs_out.approach[item] > ZERO:
        pair = pairs_out.edges[item]
        a = pair[0]
        b = pair[1]
        counts = wp.vec4d(
            wp.float64(count[a]), wp.float64(count[a + 1]), wp.float64(count[b]), wp.float64(count[b + 1])
        )
        give = give_of(edges, pair, pairs_out.place[item], counts)
        pairs_out.impulse[item] = pairs_out.impulse[item] / (give * pairs_out.mass[item])


@wp.kernel
def apply(
    first: int,
    edges: Edges,
    incidence: Incidence,
    pairs: Pairs,
    velocity_out: wp.array(dtype=wp.vec3d),
):
    """Adds to a node what it receives through the edge before it and its own; one node an item."""
    node = first + wp.tid()
    total = wp.vec3d()
    for end in range(2):
        edge = node - end
        if edge >= 0:
            for at in range(incidence.first[edge], incidence.first[edge + 1]):
                entry = incidence.entry[at]
                total += part_of_node(pairs, entry, end) * pairs.impulse[entry / 2]
    velocity_out[node] = velocity_out[node] + edges.inverse_mass[node] * total


@wp.kernel
def advance(
    first: int,
    step: wp.float64,
    velocity_before: wp.array(dtype=wp.vec3d),
    velocity: wp.array(dtype=wp.vec3d),
    position_out: wp.array(dtype=wp.vec3d),
):
    """x + h (v - v before): x = x_n + h v (29), where x = x_n + h v before; one node an item."""
    node = first + wp.tid()
    position_out[node] = position_out[node] + step * (velocity[node] - velocity_before[node])
