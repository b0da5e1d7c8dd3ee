"""From the scene's strands to one run of nodes: layout, masses, stiffnesses. Checks what it is given."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plait.solver.diagnostics import Refused
from plait.solver.scene import Scene, Strands

# Points closer together than this part of their strand's length are one node: they have no direction.
COINCIDENT = 1.0e-7
# A strand drawn straight back onto itself has no curvature there: within this angle [rad] of it, the next point is
# moved aside by this part of the segment, which opens the fold.
LEAST_OPENING = 0.1


@dataclass(frozen=True)
class Layout:
    """All strands of a scene, concatenated; node arrays begin each strand with its ghost node.

    first_node: (strand_count + 1,) int32.  point_node: (point_count,) int32, the node of each artist's point.
    prim_strands: (prim_count + 1,) int32, strands of each prim.  node_strand: (node_count,) int32.
    position: (node_count, 3) float64 [m], rest space.  edge_length: (node_count,) [m], as drawn; 1 where unused.
    voronoi: (node_count,) [m] of the vertex at the node; 1 at ghosts and tips, which have none.
    mass: (node_count,) [kg].  radius: (node_count,) [m].
    density [kg/m3], stretch [N], bend, twist [N m2], damping [1/s], friction: (strand_count,).
    force: (node_count, 3) [N] weight and dead loads, world.
    rest_rotation: (strand_count, 3, 3), rest space to world where the artist drew.
    sagfree, free: (strand_count,) bool; free strands are as drawn without force.
    """

    names: tuple[str, ...]
    prim_strands: np.ndarray
    prim_points: np.ndarray
    first_node: np.ndarray
    point_node: np.ndarray
    node_strand: np.ndarray
    position: np.ndarray
    edge_length: np.ndarray
    voronoi: np.ndarray
    mass: np.ndarray
    radius: np.ndarray
    density: np.ndarray
    stretch: np.ndarray
    bend: np.ndarray
    twist: np.ndarray
    damping: np.ndarray
    friction: np.ndarray
    force: np.ndarray
    rest_rotation: np.ndarray
    sagfree: np.ndarray
    free: np.ndarray

    @property
    def mean_segment(self) -> np.ndarray:
        """(strand_count,) [m] mean length of a strand's edges, the ghost's apart."""
        ghosts = self.first_node[:-1]
        # A strand's slots hold the ghost's edge, its own edges, and a one for the unused slot.
        length = np.add.reduceat(self.edge_length, ghosts) - self.edge_length[ghosts] - 1.0
        return length / (np.diff(self.first_node) - 2)

    @property
    def turn_correction(self) -> np.ndarray:
        """(node_count,) by which bending stiffness falls at a joint that is drawn with a turn phi: cos^4(phi / 2).

        The measure 2 tan(phi / 2) changes with phi as 1 / cos^2(phi / 2); with this factor a drawn turn is as
        stiff to changes of its angle as a straight joint, however sharp.
        """
        edges = np.diff(self.position, axis=0)
        edges /= np.maximum(np.linalg.norm(edges, axis=1, keepdims=True), np.finfo(float).tiny)
        correction = np.ones(self.node_count)
        correction[1:-1] = (0.5 + 0.5 * np.einsum("ni,ni->n", edges[:-1], edges[1:])) ** 2
        correction[self.first_node[:-1]] = correction[self.first_node[1:] - 1] = 1.0
        return correction

    def vertex_stiffness(self, stiffening: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(node_count,) each: vertices' bending and twisting stiffness [N m], the strands' times `stiffening`."""
        bend, twist = ((stiffening * k)[self.node_strand] / self.voronoi for k in (self.bend, self.twist))
        return self.turn_correction * bend, twist

    def rest_length(self, tension: np.ndarray, stretch: np.ndarray) -> np.ndarray:
        """(node_count,) [m] of edges that have the drawn length under `tension` [N]; stretch: strands' EA [N]."""
        return self.edge_length / (1.0 + tension / stretch[self.node_strand])

    @property
    def prescribed(self) -> np.ndarray:
        """(node_count,) bool: nodes that no force moves, ghosts and roots that something holds."""
        ghosts, prescribed = self.first_node[:-1], np.zeros(self.node_count, dtype=bool)
        prescribed[ghosts] = True
        prescribed[ghosts + 1] = ~self.free
        return prescribed

    @property
    def turn_inertia(self) -> np.ndarray:
        """(node_count,) [kg m2] of edges about themselves, m r^2 / 2; a ghost's as the first edge's."""
        radius = self.radius.copy()
        radius[:-1] = 0.5 * (radius[:-1] + radius[1:])
        density = self.density[self.node_strand]
        inertia = 0.5 * np.pi * density * radius**4 * self.edge_length
        ghosts = self.first_node[:-1]
        inertia[ghosts] = inertia[ghosts + 1]
        return inertia

    @property
    def strand_count(self) -> int:
        return len(self.first_node) - 1

    @property
    def node_count(self) -> int:
        return int(self.first_node[-1])

    def where(self, strand: int) -> str:
        """'<prim> strand <index in it>', for messages."""
        prim = int(np.searchsorted(self.prim_strands, strand, side="right")) - 1
        return f"{self.names[prim]} strand {strand - int(self.prim_strands[prim])}"


def build_layout(scene: Scene) -> Layout:
    """Concatenates the scene's strands; raises `Refused` naming prim and strand for what cannot be a rod."""
    for strands in scene.strands:
        _check(strands)
    offsets = _concatenate_offsets([s.offsets for s in scene.strands])
    points = np.concatenate([s.points for s in scene.strands])
    radius = np.concatenate([s.radius for s in scene.strands])
    strand_of_point = np.repeat(np.arange(len(offsets) - 1), np.diff(offsets))
    prim_strands = np.concatenate([[0], np.cumsum([s.strand_count for s in scene.strands])]).astype(np.int32)
    prim_points = np.concatenate([[0], np.cumsum([len(s.points) for s in scene.strands])]).astype(np.int32)

    kept = _distinct(points, offsets, strand_of_point)
    kept_count = np.add.reduceat(kept, offsets[:-1])
    for strand in np.flatnonzero(kept_count < 2):
        prim = int(np.searchsorted(prim_strands, strand, side="right")) - 1
        raise Refused(
            f"{scene.strands[prim].name} strand {strand - prim_strands[prim]}: all its points coincide; remove it"
        )
    first_node = np.concatenate([[0], np.cumsum(kept_count + 1)]).astype(np.int32)
    node_strand = np.repeat(np.arange(len(kept_count)), kept_count + 1).astype(np.int32)
    # A kept point's node: points kept so far, and one ghost for each strand up to its own.
    point_node = (np.cumsum(kept) - 1 + strand_of_point + 1).astype(np.int32)
    count = int(first_node[-1])
    ghosts, roots, tips = first_node[:-1], first_node[:-1] + 1, first_node[1:] - 1

    position = np.zeros((count, 3))
    position[point_node[kept]] = points[kept]
    position[ghosts] = 2.0 * position[roots] - position[roots + 1]
    _open_folds(position, ghosts)
    node_radius = np.ones(count)
    node_radius[point_node[kept]] = radius[kept]
    node_radius[ghosts] = node_radius[roots]

    edge_length = np.ones(count)
    edge_length[:-1] = np.linalg.norm(np.diff(position, axis=0), axis=1)
    edge_length[tips] = 1.0
    voronoi = np.ones(count)
    voronoi[1:] = 0.5 * (edge_length[:-1] + edge_length[1:])
    voronoi[roots] = 0.5 * edge_length[roots]
    voronoi[tips] = 1.0
    voronoi[ghosts] = 1.0

    def per_strand(name: str) -> np.ndarray:
        return np.concatenate([getattr(s, name) for s in scene.strands]).astype(float)

    mass = _lumped_mass(edge_length, node_radius, per_strand("density")[node_strand], ghosts, tips)
    force = mass[:, None] * scene.gravity
    loads = [np.zeros_like(s.points) if s.loads is None else s.loads for s in scene.strands]
    np.add.at(force, point_node, np.concatenate(loads))
    counts = [s.strand_count for s in scene.strands]
    free = [np.zeros(s.strand_count, dtype=bool) if s.free is None else s.free for s in scene.strands]
    free = np.concatenate(free).astype(bool)
    return Layout(
        names=tuple(s.name for s in scene.strands),
        prim_strands=prim_strands,
        prim_points=prim_points,
        first_node=first_node,
        point_node=point_node,
        node_strand=node_strand,
        position=position,
        edge_length=edge_length,
        voronoi=voronoi,
        mass=mass,
        radius=node_radius,
        density=per_strand("density"),
        stretch=per_strand("stretch_stiffness"),
        bend=per_strand("bend_stiffness"),
        twist=per_strand("twist_stiffness"),
        damping=per_strand("damping"),
        friction=per_strand("friction"),
        force=force,
        rest_rotation=np.repeat([_rotation(s.rest_transform) for s in scene.strands], counts, axis=0),
        sagfree=np.repeat([s.rest_shape == "sagfree" for s in scene.strands], counts) & ~free,
        free=free,
    )


def _concatenate_offsets(offsets: list[np.ndarray]) -> np.ndarray:
    lengths = np.concatenate([np.diff(o) for o in offsets])
    return np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)


def _distinct(points: np.ndarray, offsets: np.ndarray, strand_of_point: np.ndarray) -> np.ndarray:
    """(point_count,) bool: false where a point lies on the one before it in its strand."""
    gap = np.zeros(len(points))
    gap[1:] = np.linalg.norm(np.diff(points, axis=0), axis=1)
    gap[offsets[:-1]] = 0.0
    length = np.add.reduceat(gap, offsets[:-1])
    kept = gap > COINCIDENT * length[strand_of_point]
    kept[offsets[:-1]] = True
    return kept


def _open_folds(position: np.ndarray, ghosts: np.ndarray) -> None:
    """Where a strand turns back onto itself, moves the point after the turn a little aside, in place."""
    tips = np.append(ghosts[1:], len(position)) - 1
    edges = np.diff(position, axis=0)
    edges[tips[:-1]] = 1.0  # from one strand's tip to the next one's ghost
    tangents = edges / np.linalg.norm(edges, axis=1, keepdims=True)
    joined = np.ones(len(position), dtype=bool)  # nodes between two edges of one strand
    joined[ghosts] = joined[tips] = False
    opening = np.linalg.norm(tangents[:-1] + tangents[1:], axis=1)
    for node in 1 + np.flatnonzero(joined[1:-1] & (opening < LEAST_OPENING)):
        back = position[node + 1] - position[node]
        aside = np.cross(back, np.eye(3)[np.argmin(np.abs(back))])
        position[node + 1] += LEAST_OPENING * np.linalg.norm(back) * aside / np.linalg.norm(aside)


def _lumped_mass(
    edge_length: np.ndarray, radius: np.ndarray, density: np.ndarray, ghosts: np.ndarray, tips: np.ndarray
) -> np.ndarray:
    """Half of each neighbouring edge's mass, a frustum's; the ghost edge has none."""
    after = np.append(radius[1:], radius[-1])
    edge_mass = density * np.pi / 3.0 * (radius**2 + radius * after + after**2) * edge_length
    edge_mass[ghosts] = 0.0
    edge_mass[tips] = 0.0
    mass = 0.5 * edge_mass
    mass[1:] += 0.5 * edge_mass[:-1]
    return mass


def _rotation(transform: np.ndarray) -> np.ndarray:
    """The rotation nearest a transform's upper 3 x 3."""
    u, _, vt = np.linalg.svd(transform[:3, :3])
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt


def _check(strands: Strands) -> None:
    """Raises `Refused` for counts, values or lengths no rod can have."""
    counts = np.diff(strands.offsets)
    if np.any(counts < 2):
        strand = int(np.argmax(counts < 2))
        raise Refused(f"{strands.name} strand {strand}: {counts[strand]} point; a strand needs two or more")
    point_strand = np.repeat(np.arange(strands.strand_count), counts)
    by_point = {"points": strands.points, "radius": strands.radius, "loads": strands.loads}
    by_strand = ("density", "stretch_stiffness", "bend_stiffness", "twist_stiffness", "damping", "friction")
    by_strand = {name: getattr(strands, name) for name in by_strand}
    for name, values in (by_point | by_strand).items():
        if values is None:
            continue
        bad = ~np.isfinite(values)
        wanted = "finite"
        if name in ("radius", "density", "stretch_stiffness", "bend_stiffness", "twist_stiffness"):
            bad |= values <= 0.0
            wanted = "positive"
        elif name in ("damping", "friction"):
            bad |= values < 0.0
            wanted = "zero or more"
        if np.any(bad):
            row = int(np.argmax(bad.reshape(len(values), -1).any(axis=1)))
            strand = row if name in by_strand else int(point_strand[row])
            raise Refused(f"{strands.name} strand {strand}: {name} is {values[row]}; it must be {wanted}")
