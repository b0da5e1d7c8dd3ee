"""Points of strands that are held: forces, and their part in the coupled solve.

A tie asks for c = x_a - target = 0, or c = x_a - x_b - target = 0 between strands. A spring pulls with -k c; what
holds exactly, with lambda - k c, which becomes the next lambda after each pass (Hestenes 1969; Powell 1969).
"""

from functools import cache, partial
from types import SimpleNamespace

import warp as wp

from plait.solver.strand_contact.coupled_kernels import coupled_kernels
from plait.solver.strand_contact.meeting_kernels import Meetings
from plait.solver.strands.types import rod_types


@cache
def attachment_kernels(real: type) -> SimpleNamespace:
    """Kernels `stiffen`, `measure`, `hold`, `gather`, `image`, `exempt`, and the structs `Ties`, `Ends`."""
    types = rod_types(real)
    Scratch, Krylov = types.Scratch, coupled_kernels(real).Krylov
    vec3, vec4 = types.vec3, types.vec4
    module = f"plait_attachments_{real.__name__}"
    kernel = partial(wp.kernel, module=module, enable_backward=False)
    structure = partial(wp.struct, module=module)
    # Stiffness of what holds exactly, over that of a node and that of a segment to stretch. A surface concerns one
    # node, whose own block takes any stiffness; between strands, conjugate gradients see it.
    to_surface = 1.0e4 if real == wp.float64 else 1.0e2
    to_strand = 1.0

    @structure
    class Ties:
        """Attachments that are on, (tie_count,) each."""

        a: wp.array(dtype=wp.int32)  # node
        b: wp.array(dtype=wp.int32)  # node; -1: a surface
        exact: wp.array(dtype=wp.int32)  # 1: held exactly
        target: wp.array(dtype=wp.vec3d)  # [m] where a is to be, or how far from b
        stiffness: wp.array(dtype=wp.float64)  # [N/m] k
        force: wp.array(dtype=wp.vec3d)  # [N] lambda, held so far
        gap: wp.array(dtype=wp.vec3d)  # [m] c

    @structure
    class Ends:
        """The nodes that ties move, (end_count,), and the ties of each."""

        node: wp.array(dtype=wp.int32)
        first: wp.array(dtype=wp.int32)  # (end_count + 1,) into `tie`
        tie: wp.array(dtype=wp.int32)
        side: wp.array(dtype=wp.int32)  # 0: the node is its tie's a, 1: its b

    @kernel
    def stiffen(first: int, across: wp.array(dtype=wp.float64), along: wp.array(dtype=wp.float64), ties: Ties):
        """Stiffness of ties that are exact, by that of their nodes; one tie an item.

        across, along: (node_count,) [N/m] what a node resists a point load by, what a segment there stretches by.
        """
        i = first + wp.tid()
        if ties.exact[i] != 0:
            of_a = across[ties.a[i]] + along[ties.a[i]]
            if ties.b[i] < 0:
                ties.stiffness[i] = wp.float64(to_surface) * of_a
            else:
                of_b = across[ties.b[i]] + along[ties.b[i]]
                ties.stiffness[i] = wp.float64(to_strand) * of_a * of_b / (of_a + of_b)

    @wp.func(module=module)
    def gap(ties: Ties, i: int, x: wp.array(dtype=wp.vec3d)):
        c = x[ties.a[i]] - ties.target[i]
        if ties.b[i] >= 0:
            c = c - x[ties.b[i]]
        return c

    @kernel
    def measure(first: int, x: wp.array(dtype=wp.vec3d), ties: Ties):
        """How far ties are from what they ask for; one an item."""
        i = first + wp.tid()
        ties.gap[i] = gap(ties, i, x)

    @kernel
    def hold(first: int, x: wp.array(dtype=wp.vec3d), ties: Ties):
        """Holds the forces of exact ties at x from now on; one tie an item."""
        i = first + wp.tid()
        if ties.exact[i] != 0:
            ties.force[i] = ties.force[i] - ties.stiffness[i] * gap(ties, i, x)

    @kernel
    def gather(first: int, ties: Ties, ends: Ends, scratch: Scratch):
        """What ties do to a node's own row; one node an item."""
        item = first + wp.tid()
        node = ends.node[item]
        force = wp.vec3d()
        stiffness = wp.float64(0.0)
        for at in range(ends.first[item], ends.first[item + 1]):
            tie = ends.tie[at]
            pull = ties.force[tie] - ties.stiffness[tie] * ties.gap[tie]
            force += wp.where(ends.side[at] == 0, pull, -pull)
            stiffness += ties.stiffness[tie]
        block = real(stiffness) * wp.identity(n=3, dtype=real)
        scratch.meeting_block[node] = scratch.meeting_block[node] + block
        scratch.meeting_gradient[node] = scratch.meeting_gradient[node] - vec3(force)

    @kernel
    def image(
        first: int,
        ties: Ties,
        ends: Ends,
        scratch: Scratch,
        krylov: Krylov,
        product_out: wp.array(dtype=wp.float64),
    ):
        """Adds what ties do between strands, by what is new in the direction, to its image; the product of both,
        one entry a node."""
        item = first + wp.tid()
        node = ends.node[item]
        pull = wp.vec3d()
        for at in range(ends.first[item], ends.first[item + 1]):
            tie = ends.tie[at]
            if ties.b[tie] >= 0:
                other = wp.where(ends.side[at] == 0, ties.b[tie], ties.a[tie])
                d = scratch.solution[other - 1]
                pull += ties.stiffness[tie] * wp.vec3d(vec3(d[1], d[2], d[3]))
        added = -vec4(real(0.0), real(pull[0]), real(pull[1]), real(pull[2]))
        krylov.image[node - 1] = krylov.image[node - 1] + added
        product_out[item] = wp.float64(wp.dot(krylov.direction[node - 1], added))

    @kernel
    def exempt(first: int, pairs: wp.array(dtype=wp.int32), meetings: Meetings):
        """Takes pairs of edges beside a tie out of contact; one pair an item."""
        pair = pairs[first + wp.tid()]
        meetings.stiffness[pair] = wp.float64(0.0)
        meetings.fault[pair] = 0
        meetings.gap[pair] = wp.float64(0.0)

    return SimpleNamespace(
        Ties=Ties,
        Ends=Ends,
        stiffen=stiffen,
        measure=measure,
        hold=hold,
        gather=gather,
        image=image,
        exempt=exempt,
    )
