"""What is simulated: the one contract between the pipeline and the solver.

Everything here is plain numpy in SI units (metres, kilograms, seconds, radians), in one world frame whose
origin is `Scene.origin` metres away from the shot's own (so that float32 keeps its digits in a shot a
kilometre from zero). A scene is readable without knowing USD or Warp, and can be built by hand:

    ground = Surface("ground", points, triangles)
    scalp = Surface("scalp", points, triangles, motion=KeyedMotion(times, transforms))
    hair = Strands("hair", points, offsets, roots=RootBinding(1, triangle, barycentric), radius=40e-6)
    scene = Scene(surfaces=(ground, scalp), strands=(hair,))
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np

RestShape = Literal["sagfree", "authored"]
SkinningMethod = Literal["linear", "dual-quaternion"]
ElasticLaw = Literal["fixed-corotated", "neo-hookean", "stvk"]
ShapeKind = Literal["sphere", "capsule", "cylinder", "cone", "box"]
JointKind = Literal["fixed", "revolute", "spherical", "prismatic", "distance"]
GranularLaw = Literal["sand", "snow", "elastic"]


@dataclass(frozen=True)
class Pose:
    """Where a surface's drivers are at one instant; the device turns it into points.

    joint_transforms: (joint_count, 4, 4) float64, column vectors (x' = M x), from the surface's rest points to
        world; a rigid surface has one, a static one is the identity.
    blend_weights: (shape_count,) float64, weights of `BlendShapes`, in their order.
    points: (point_count, 3) float64 [m], world; given only by surfaces whose points are themselves animated (a
        point cache), and then the rest points, the blend shapes and the joints play no part.
    """

    joint_transforms: np.ndarray
    blend_weights: np.ndarray = field(default_factory=lambda: np.zeros(0))
    points: np.ndarray | None = None


class Motion(Protocol):
    """A surface's animation, evaluated at any time: substeps ask for sub-frame poses."""

    @property
    def animated(self) -> bool:
        """False when `pose` gives the same at all times; such a surface is placed once."""

    def pose(self, time: float) -> Pose:
        """The pose at `time` [s], shot time (time code over time codes per second)."""


@dataclass(frozen=True)
class StaticMotion:
    """A surface that stays where its rest points are, or where one transform puts them."""

    transform: np.ndarray = field(default_factory=lambda: np.eye(4))
    animated: bool = False

    def pose(self, time: float) -> Pose:
        return Pose(self.transform[None])


@dataclass(frozen=True)
class KeyedMotion:
    """Transforms at given times, (key_count, joint_count, 4, 4); held outside, interpolated within.

    Rotations interpolate linearly in the matrix entries and are then made orthonormal again, which is exact for
    translations and, for keys a few degrees apart, indistinguishable from a slerp.
    """

    times: np.ndarray
    transforms: np.ndarray
    animated: bool = True

    def pose(self, time: float) -> Pose:
        upper = int(np.clip(np.searchsorted(self.times, time), 1, len(self.times) - 1))
        start, end = self.times[upper - 1], self.times[upper]
        weight = float(np.clip((time - start) / (end - start), 0.0, 1.0))
        mixed = (1.0 - weight) * self.transforms[upper - 1] + weight * self.transforms[upper]
        u, _, vt = np.linalg.svd(mixed[:, :3, :3])
        mixed[:, :3, :3] = u @ vt
        return Pose(mixed)


@dataclass(frozen=True)
class Skinning:
    """How joints move points (linear blend or dual quaternion), geomBindTransform already applied.

    joint_indices: (point_count, influence_count) int32 into `Pose.joint_transforms`.
    joint_weights: (point_count, influence_count) float64, rows sum to one.
    method: as UsdSkel names them.
    """

    joint_indices: np.ndarray
    joint_weights: np.ndarray
    method: SkinningMethod = "linear"


@dataclass(frozen=True)
class BlendShapes:
    """Sparse point offsets, added to the rest points before skinning, one run a shape.

    shape_offsets: (shape_count + 1,) int32; shape s holds entries shape_offsets[s]:shape_offsets[s + 1].
    point_indices: (entry_count,) int32.  point_offsets: (entry_count, 3) float64 [m].
    """

    shape_offsets: np.ndarray
    point_indices: np.ndarray
    point_offsets: np.ndarray


@dataclass(frozen=True)
class Shape:
    """The shape that a surface's triangles approximate: rigid bodies touch it instead of the triangles.

    size: (3,) float64 [m]: of a 'sphere' the radius first, the others unused; of a 'capsule', 'cylinder' and
        'cone' the radius and half the height (of a capsule that between the centres of its caps), along z, the
        cone's apex at +z; of a 'box' half its edges.
    frame: (4, 4) float64, rigid, from the shape's own space to that of the surface's rest points.
    """

    kind: ShapeKind
    size: np.ndarray
    frame: np.ndarray = field(default_factory=lambda: np.eye(4))


@dataclass(frozen=True)
class Surface:
    """A triangle surface moved by the animation or by a body: a collider, what strands grow on, or both.

    points: (point_count, 3) float64 [m], rest; joint transforms map them to world.
    triangles: (triangle_count, 3) int32, counter-clockwise seen from outside.
    collides: False for a surface that only carries roots.
    thickness: [m] distance kept from this surface beside a strand's own radius.
    friction: Coulomb coefficient; None leaves it to what touches it.
    restitution: of impacts on it, 0 to 1, where no body carries it; of a pair the larger counts.
    body: index into `Scene.bodies` of the elastic body whose skin this is: its points then go where that body
        takes them, and `motion`, `skinning` and `blend_shapes` only say where it starts.
    rigid: index into `Scene.rigid_bodies` of the rigid body that carries this surface, in the same way.
    shape: of a surface that a rigid body carries; None where the triangles are what is meant.
    """

    name: str
    points: np.ndarray
    triangles: np.ndarray
    motion: Motion = field(default_factory=StaticMotion)
    skinning: Skinning | None = None
    blend_shapes: BlendShapes | None = None
    collides: bool = True
    thickness: float = 0.0
    friction: float | None = None
    restitution: float = 0.0
    body: int | None = None
    rigid: int | None = None
    shape: Shape | None = None


@dataclass(frozen=True)
class Embedding:
    """Where points lie in a body's tets, at rest.

    tet: (point_count,) int32 into `TetBody.tets`.  barycentric: (point_count, 4) float64, rows sum to one;
        negative entries are extrapolation, for points a little outside the lattice.
    """

    tet: np.ndarray
    barycentric: np.ndarray


@dataclass(frozen=True)
class TetBody:
    """An elastic body of tetrahedra: flesh over a skeleton, or a soft prop without one.

    nodes: (node_count, 3) float64 [m], rest, in the space of the rest points of its surface: joint transforms map
        them to world as they do those.
    tets: (tet_count, 4) int32 into nodes, positive volume: (x1 - x0) . ((x2 - x0) x (x3 - x0)) > 0.
    surface: index into `Scene.surfaces` of its skin, whose `body` is this one: what is seen, what touches, what
        strands grow on.  embedding: of the points of that surface.
    motion, skinning, blend_shapes: as of a `Surface`, for the nodes: where the animation alone would take them.
    pinned: (node_count,) bool, nodes that go exactly there: bone.
    attachment: (node_count,) float64 [N/m], a spring from each node to there; zero for free flesh.
    density [kg/m3], youngs_modulus [Pa], poissons_ratio: (tet_count,) float64.
    mass_damping: [1/s], stiffness_damping: [s], Rayleigh: C = mass_damping M + stiffness_damping K.
    restitution: of its impacts, 0 to 1.
    """

    name: str
    nodes: np.ndarray
    tets: np.ndarray
    surface: int
    embedding: Embedding
    density: np.ndarray
    youngs_modulus: np.ndarray
    poissons_ratio: np.ndarray
    pinned: np.ndarray
    attachment: np.ndarray
    motion: Motion = field(default_factory=StaticMotion)
    skinning: Skinning | None = None
    blend_shapes: BlendShapes | None = None
    law: ElasticLaw = "fixed-corotated"
    mass_damping: float = 0.0
    stiffness_damping: float = 0.0
    restitution: float = 0.0


@dataclass(frozen=True)
class RigidBody:
    """A body that moves without deforming: a prop.

    surfaces: indices into `Scene.surfaces` of all that is seen of it and touches, each with `rigid` this body;
        their rest points lie in one space, the body's rest space. Friction is told by each surface.
    mass: [kg].  center_of_mass: (3,) float64 [m], in rest space.
    inertia: (3, 3) float64 [kg m2], about the centre of mass, along the axes of rest space.
    motion: rest space to world, rigid; it says where the body is until `Scene.rigid_start`, or at the start of the
        simulation where that is later.
    velocity: (3,) float64 [m/s], of the centre of mass, and angular_velocity: (3,) float64 [rad/s], world, with
        which it is then released.
    restitution: of its impacts, 0 to 1; of a pair the larger counts.
    """

    name: str
    surfaces: tuple[int, ...]
    mass: float
    center_of_mass: np.ndarray
    inertia: np.ndarray
    motion: Motion = field(default_factory=StaticMotion)
    velocity: np.ndarray = field(default_factory=lambda: np.zeros(3))
    angular_velocity: np.ndarray = field(default_factory=lambda: np.zeros(3))
    restitution: float = 0.0


@dataclass(frozen=True)
class Drive:
    """Draws a joint to a target: the force is stiffness (target - x) + damping (target_velocity - v).

    x: what the joint leaves free, as in `Joint.limits`: [rad] or [m], and so are the targets [rad/s], [m/s].
    stiffness [N m/rad] or [N/m].  damping [N m s/rad] or [N s/m].  most: the force is no larger [N m] or [N].
    per_inertia: stiffness and damping are for a mass or an inertia of one, and multiplied by what is moved.
    """

    stiffness: float = 0.0
    damping: float = 0.0
    target: float = 0.0
    target_velocity: float = 0.0
    most: float = np.inf
    per_inertia: bool = False


@dataclass(frozen=True)
class Joint:
    """Holds two rigid bodies to each other, or one to a place.

    bodies: indices into `Scene.rigid_bodies`; None for the world, at most once.
    frames: of each side the joint's frame, (4, 4) float64, rigid, in that body's rest space; for the world in that
        of `motion`. What is held together: of 'fixed' the whole frames; of 'revolute' origins and z axes, turning
        about z; of 'spherical' origins; of 'prismatic' all but the way along z; of 'distance' nothing.
    limits: lower and upper, of the second frame against the first: of 'revolute' the turn about z, within half a
        turn [rad]; of 'prismatic' the way along z, of 'distance' that between the origins [m]. None: no limits.
    drive: of 'revolute' and 'prismatic'.
    cone: of 'spherical', how far the second z axis may lean from the first [rad], above 0; None: any way.
    motion: carries the world's frame.
    collide: whether the two bodies touch each other besides.
    """

    name: str
    kind: JointKind
    bodies: tuple[int | None, int | None]
    frames: tuple[np.ndarray, np.ndarray]
    limits: tuple[float, float] | None = None
    cone: float | None = None
    drive: Drive | None = None
    motion: Motion = field(default_factory=StaticMotion)
    collide: bool = False


@dataclass(frozen=True)
class RootBinding:
    """Where strands grow: a place on a triangle of a surface, whose frame carries root and direction.

    surface: index into `Scene.surfaces`.  triangle: (strand_count,) int32.
    barycentric: (strand_count, 3) float64, rows sum to one; the root's offset from that place at rest is kept in
        the triangle's frame, so a root need not lie on the surface exactly.
    A strand bound to no skin has a surface of its own (`collides=False`), one triangle a strand.
    """

    surface: int
    triangle: np.ndarray
    barycentric: np.ndarray


@dataclass(frozen=True)
class Strands:
    """Hair, fur, ropes: elastic rods clamped at their roots. One prim's worth.

    points: (point_count, 3) float64 [m]: the artist's shape beside the rest points of the surface bound to, in
        the same space, i.e. as it lies when every joint transform of that surface is `rest_transform`.
    offsets: (strand_count + 1,) int32; strand s owns points offsets[s]:offsets[s + 1], root first, two or more.
    radius: (point_count,) float64 [m].
    density [kg/m3], stretch_stiffness EA [N], bend_stiffness EI [N m2], twist_stiffness GJ [N m2],
    damping [1/s], friction: (strand_count,) float64 each.
    rest_shape: 'sagfree': at rest under gravity as drawn; 'authored': stress-free as drawn.
    rest_transform: (4, 4) float64, the rest points to world where the artist drew them (gives gravity's
        direction for 'sagfree').
    thickness: [m] distance kept between strands beside their radii; the larger of two strands' counts.
    pic_fraction: of 'paper' strand contact: the part of the grid's velocity taken over (Han 2019 (33), xi).
    free: (strand_count,) bool, strands that nothing holds at their roots: cut hair, ropes; None for none.
    loads: (point_count, 3) float64 [N], dead loads in world; None for none. For validation scenes.
    """

    name: str
    points: np.ndarray
    offsets: np.ndarray
    roots: RootBinding
    radius: np.ndarray
    density: np.ndarray
    stretch_stiffness: np.ndarray
    bend_stiffness: np.ndarray
    twist_stiffness: np.ndarray
    damping: np.ndarray
    friction: np.ndarray
    rest_shape: RestShape = "sagfree"
    rest_transform: np.ndarray = field(default_factory=lambda: np.eye(4))
    loads: np.ndarray | None = None
    thickness: float = 0.0
    pic_fraction: float = 0.05
    free: np.ndarray | None = None

    @property
    def strand_count(self) -> int:
        return len(self.offsets) - 1


class Switch(Protocol):
    """Whether something animated is on."""

    def on(self, time: float) -> bool:
        """At `time` [s], shot time."""


@dataclass(frozen=True)
class AlwaysOn:
    """A switch that is never off."""

    def on(self, time: float) -> bool:
        return True


@dataclass(frozen=True)
class Attachment:
    """Points of strands held to places on a surface or to points of strands: ties, clamps, braids' ends.

    The offset between the two when the attachment comes on is kept: on a surface in the triangle's frame, between
    strands in world. A clamp moved by an animated prim is held to a surface of its own (`collides=False`).

    strands: index into `Scene.strands`.  point: (n,) int32, points of it.
    surface: index into `Scene.surfaces`, with triangle (n,) int32 and barycentric (n, 3); or None and
    other: index into `Scene.strands`, with other_point (n,) int32.
    stiffness: [N/m] of each; infinity holds exactly.
    """

    name: str
    strands: int
    point: np.ndarray
    surface: int | None = None
    triangle: np.ndarray | None = None
    barycentric: np.ndarray | None = None
    other: int | None = None
    other_point: np.ndarray | None = None
    stiffness: float = np.inf
    switch: Switch = field(default_factory=AlwaysOn)


@dataclass(frozen=True)
class Emitter:
    """Pours particles of a `Granular` in, at random places of a box, while it is on.

    rate: [1/s] particles.  limit: particles in all.  seed: of the places in the box, which depend on nothing else.
    lower, upper: (3,) float64 [m], corners of the box, in a space of its own.
    velocity: (3,) float64 [m/s], out of the box, along its own axes.
    motion: that space to world, one joint; what is poured in has its velocity too.
    volume: [m3] of each.  width: [m] of each.
    """

    rate: float
    limit: int
    lower: np.ndarray
    upper: np.ndarray
    velocity: np.ndarray
    volume: float
    width: float
    seed: int = 0
    switch: Switch = field(default_factory=AlwaysOn)
    motion: Motion = field(default_factory=StaticMotion)


@dataclass(frozen=True)
class Granular:
    """Matter that flows, breaks and piles up: sand, snow. One prim's worth of particles, unstrained as given.

    positions: (particle_count, 3) float64 [m], world.  velocities: (particle_count, 3) float64 [m/s], world.
    volumes: (particle_count,) float64 [m3], the room each fills at rest; its mass is density times that.
    widths: (particle_count,) float64 [m], diameters to be drawn; they play no part in the physics.
    ids: (particle_count,) int64, kept through the run; those emitted are numbered on from the largest.
    density: [kg/m3] of the matter with its pores.  youngs_modulus: [Pa].  poissons_ratio.
    friction_angle: [radians] of 'sand', the slope down which it flows.
    critical_compression, critical_stretch: of 'snow', the singular values of F that it yields at are 1 less the
        first and 1 plus the second.  hardening: of 'snow', the exponent xi (Stomakhin et al. 2013, table 2).
    friction: Coulomb coefficient against surfaces that tell none; of several Granular the first that are there
        say it for all.
    """

    name: str
    law: GranularLaw
    positions: np.ndarray
    velocities: np.ndarray
    volumes: np.ndarray
    widths: np.ndarray
    ids: np.ndarray
    density: float = 1600.0
    youngs_modulus: float = 3.5e5
    poissons_ratio: float = 0.3
    friction_angle: float = 0.6
    critical_compression: float = 2.5e-2
    critical_stretch: float = 7.5e-3
    hardening: float = 10.0
    friction: float = 0.5
    emitter: Emitter | None = None


@dataclass(frozen=True)
class Scene:
    """All that a run needs to know of a shot.

    gravity: (3,) float64 [m/s2], world.  origin: (3,) float64 [m]: shot world = scene world + origin.
    filtered: pairs of indices into `surfaces`, at least one carried by a rigid body, that do not touch each other.
    granular_start: [s] until which granular matter stays as given, and none is poured in; to the nearest substep.
    rigid_start: [s] until which rigid bodies go where their motions take them; to the nearest substep.
    """

    surfaces: tuple[Surface, ...] = ()
    strands: tuple[Strands, ...] = ()
    gravity: np.ndarray = field(default_factory=lambda: np.array([0.0, -9.81, 0.0]))
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))
    bodies: tuple[TetBody, ...] = ()
    attachments: tuple[Attachment, ...] = ()
    rigid_bodies: tuple[RigidBody, ...] = ()
    joints: tuple[Joint, ...] = ()
    filtered: tuple[tuple[int, int], ...] = ()
    granular: tuple[Granular, ...] = ()
    granular_start: float = -np.inf
    rigid_start: float = -np.inf

    def restitution(self, surface: Surface) -> float:
        """Of impacts on one of the surfaces: its own, or that of the body that carries it."""
        if surface.rigid is not None:
            return self.rigid_bodies[surface.rigid].restitution
        if surface.body is not None:
            return self.bodies[surface.body].restitution
        return surface.restitution
