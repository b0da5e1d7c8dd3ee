"""Nodes of granular matter against moving triangle surfaces: Coulomb friction, and nothing that pulls."""

from functools import cache, partial
from types import SimpleNamespace

import warp as wp

from plait.solver.contact.geometry_kernels import (
    ZERO,
    closest_point,
    get_triangle,
    interpolate,
    unit_normal,
)
from plait.solver.contact.meeting_kernels import to_float
from plait.solver.granular.exchange_kernels import Heights, Moment, touches
from plait.solver.granular.types import granular_types

wp.set_module_options({"enable_backward": False})

# A node this near a surface, in cells, takes its normal from the triangle.
AT_SURFACE = wp.constant(wp.float64(1.0e-4))
APART = wp.constant(wp.float64(1.0e30))


@wp.struct
class MovingSurface:
    """One surface at the start and the end of a substep; see `Colliders` for the points."""

    mesh: wp.uint64  # at the start
    first_triangle: int
    triangles: wp.array(dtype=wp.vec3i)
    rim: wp.array(dtype=wp.int32)  # bit f set: feature f of the triangle lies on the surface's open border
    points_start: wp.array(dtype=wp.vec3d)
    points_end: wp.array(dtype=wp.vec3d)
    length: wp.float64  # [s] of the substep


@wp.kernel
def find_depths(
    first: int,
    surface: MovingSurface,
    points: wp.array(dtype=wp.vec3d),
    rounding: wp.float64,
    reach: wp.float64,
    height_out: wp.array(dtype=wp.float64),
    normal_out: wp.array(dtype=wp.vec3d),
    velocity_out: wp.array(dtype=wp.vec3d),
    triangle_out: wp.array(dtype=wp.int32),
    weights_out: wp.array(dtype=wp.vec3d),
):
    """Signed distance [m] of points to a surface, its normal there, velocity [m/s], and where on it that is.

    One point an item. APART where the surface is further than `reach`, and beside its open border, where nothing
    is behind it. rounding: [m] a point this near takes its normal from the triangle.
    """
    item = first + wp.tid()
    x = points[item]
    height_out[item] = APART
    query = wp.mesh_query_point_sign_normal(surface.mesh, to_float(x), float(reach))
    if query.result:
        index = surface.first_triangle + query.face
        triangle = get_triangle(surface.triangles, surface.points_start, index)
        nearest = closest_point(triangle, x)
        place = interpolate(triangle, nearest.weights)
        distance = wp.length(x - place)
        behind = query.sign < 0.0
        if not behind or (surface.rim[index] >> nearest.feature) & 1 == 0:
            normal = unit_normal(triangle)
            if distance > rounding:
                normal = (x - place) / distance
                if behind:
                    normal = -normal
            height_out[item] = wp.where(behind, -distance, distance)
            normal_out[item] = normal
            triangle_out[item] = index
            weights_out[item] = nearest.weights
            if surface.length > ZERO:
                after = interpolate(get_triangle(surface.triangles, surface.points_end, index), nearest.weights)
                velocity_out[item] = (after - place) / surface.length


@cache
def contact_kernels(real: type) -> SimpleNamespace:
    """`Contacts` and the kernel `act` for `real` (wp.float32 or wp.float64)."""
    module = f"plait_granular_contact_{real.__name__}"
    types = granular_types(real)
    vec3, vec4 = types.vec3, types.vec4

    @partial(wp.struct, module=module)
    class Contacts:
        """Surfaces at nodes: contact k of node node[i], first[i] <= k < first[i + 1]."""

        first: wp.array(dtype=wp.int32)
        node: wp.array(dtype=wp.int32)
        friction: wp.array(dtype=real)  # Coulomb coefficient
        impulse: wp.array(dtype=wp.vec3d)  # [kg m/s] on the matter since found

    @wp.kernel(module=module, enable_backward=False)
    def act(
        first: int,
        contacts: Contacts,
        heights: Heights,
        moment: wp.array(dtype=Moment),
        velocity: wp.array(dtype=vec4),
    ):
        """Takes from a node what goes into a surface, and what friction stops; one node in contact an item.

        Only where matter touches, and only while it goes further in: what goes out is let go freely.
        """
        i = first + wp.tid()
        node = contacts.node[i]
        held = velocity[node]
        mass = held[3]
        if mass > real(0.0):
            before = vec3(held[0], held[1], held[2])
            v = before
            for k in range(contacts.first[i], contacts.first[i + 1]):
                n = vec3(heights.normal[k])
                surface = vec3(heights.velocity[k])
                relative = v - surface
                along = wp.dot(relative, n)
                if along < real(0.0) and touches(heights, k, moment[0].since):
                    across = relative - along * n
                    speed = wp.length(across)
                    stopped = -contacts.friction[k] * along
                    if speed > stopped:
                        across = ((speed - stopped) / speed) * across
                    else:
                        across = vec3()
                    change = surface + across - v
                    v += change
                    contacts.impulse[k] = contacts.impulse[k] + wp.float64(mass) * wp.vec3d(
                        wp.float64(change[0]), wp.float64(change[1]), wp.float64(change[2])
                    )
            velocity[node] = vec4(v[0], v[1], v[2], mass)

    return SimpleNamespace(Contacts=Contacts, act=act)
