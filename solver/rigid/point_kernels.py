"""Contacts of points, round or not, with surfaces."""

from __future__ import annotations

import warp as wp

from plait.solver.rigid.motion_kernels import HALF, ZERO
from plait.solver.rigid.nearest_kernels import Side, nearest_on_geom
from plait.solver.rigid.put_kernels import Place, kept_at, least_margin, place_of, put_contact
from plait.solver.rigid.shape_kernels import MESH
from plait.solver.rigid.types import Finder

wp.set_module_options({"enable_backward": False})

# Two contacts of one point with one surface differ by more (cosine).
APART = wp.constant(wp.float64(0.9))
# [m] further than anything reaches.
FAR = wp.constant(wp.float64(1e6))
TWO = wp.constant(wp.float64(2.0))


@wp.func
def led_back(surface: Side, before: wp.vec3d) -> Side:
    """The way back of a point that went through something thin: it was on the other side in the substep before."""
    out = surface
    if wp.dot(surface.normal, before) < -HALF:
        out.normal = -surface.normal
        out.gap = -wp.abs(surface.gap)
    return out


@wp.func
def meet_further_walls(
    finder: Finder,
    a: int,
    b: int,
    feature: int,
    place: Place,
    nearest: Side,
    search: wp.float64,
):
    """A ball in a corner of a mesh touches up to three of its walls: they are sought further from those found."""
    away = nearest.normal
    for k in range(1, 3):
        shift = place.radius * away
        seen = nearest_on_geom(
            finder.geoms, finder.animated, finder.motion, b, place.x + shift, search + place.radius, place.x
        )
        if not seen.found:
            return
        if wp.dot(seen.normal, wp.normalize(away)) > APART or wp.dot(seen.normal, nearest.normal) > APART:
            return
        # The wall's foot beneath the ball itself.
        seen.gap = wp.dot(seen.normal, place.x - seen.foot) - finder.geoms.thickness[b] - place.radius
        slide = shift - wp.dot(seen.normal, shift) * seen.normal
        seen.foot = seen.foot - slide
        seen.core = seen.foot
        arm = -place.radius * seen.normal
        put_contact(finder, a, b, feature + k, place, arm, seen)
        away = away + seen.normal


@wp.func
def is_near_box(finder: Finder, b: int, x: wp.vec3d, search: wp.float64) -> bool:
    grown = wp.vec3d(search, search, search)
    room = wp.min(x - finder.boxes.lower[b] + grown, finder.boxes.upper[b] + grown - x)
    return wp.min(room) >= ZERO


@wp.func
def witness_of(finder: Finder, a: int, x: wp.vec3d, before: int) -> wp.vec3d:
    """A place on the side of an open surface where a point belongs: where it was in the substep before.

    What meets the surface for the first time belongs where its geom mostly is: a centre of mass may be anywhere.
    """
    if before >= 0:
        return x + FAR * finder.kept.normal[before]
    body = finder.geoms.body[a]
    if body < 0:
        return x
    return finder.motion.position[body] + wp.quat_rotate(finder.motion.orientation[body], finder.geoms.center[a])


@wp.func
def meet_point(finder: Finder, a: int, b: int, feature: int, place: Place, before: int, search: wp.float64):
    """The contact of a point of geom a with the surface of geom b, with walls about it where it is a ball."""
    x = place.x
    witness = witness_of(finder, a, x, before)
    rim = wp.length_sq(place.axis) > ZERO
    arm = wp.vec3d()
    # Looked for from a little within the point's own body, the side is told also where both bodies end.
    within = x + least_margin(finder.geoms, a, b) * place.inward
    surface = nearest_on_geom(
        finder.geoms, finder.animated, finder.motion, b, within, search + place.radius, witness
    )
    surface.gap -= wp.dot(surface.normal, within - x)
    if rim and surface.found:
        # The place of the rim that is nearest to the surface's tangent plane, found again from there.
        for _ in range(3):
            down = -surface.normal + wp.dot(surface.normal, place.axis) * place.axis
            length = wp.length(down)
            if length > wp.float64(1e-6) and surface.found:
                arm = (place.radius / length) * down
                surface = nearest_on_geom(
                    finder.geoms, finder.animated, finder.motion, b, x + arm, search, witness
                )
    elif surface.found:
        arm = -place.radius * surface.normal
        surface.gap -= place.radius
    if not surface.found:
        return
    if before >= 0:
        surface = led_back(surface, finder.kept.normal[before])
    put_contact(finder, a, b, feature, place, arm, surface)
    if place.radius > ZERO and not rim and finder.geoms.kind[b] == MESH:
        meet_further_walls(finder, a, b, feature, place, surface, search)


@wp.func
def meet_points(
    finder: Finder,
    a: int,
    b: int,
):
    """Contacts of the points of geom a with the surface of geom b."""
    travel = finder.boxes.travel[a] + finder.boxes.travel[b]
    reach = TWO * least_margin(finder.geoms, a, b) + finder.geoms.thickness[b] + travel
    for p in range(finder.geoms.first_point[a], finder.geoms.first_point[a + 1]):
        place = place_of(finder, a, p)
        feature = 4 * (p - finder.geoms.first_point[a])
        before = kept_at(finder.kept, finder.geoms.first_slot[a], finder.kept.count[a], b, feature)
        search = reach + place.radius
        if before >= 0:
            # However deep it has been left, it is led back.
            search += wp.max(finder.geoms.reach[a], finder.geoms.reach[b])
        if is_near_box(finder, b, place.x, search):
            meet_point(finder, a, b, feature, place, before, search)
