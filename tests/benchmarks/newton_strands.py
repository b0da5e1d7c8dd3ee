"""What Newton's cables (VBD) take for bundles that fall across each other, for comparison.

Needs `pip install plait[bench]`. The same strands, places, stiffnesses, weights and step as in
`strand_contact.py`. What differs: a segment is a rigid capsule, with six unknowns instead of four; strands keep no
distance beside their radii, which are therefore half a thickness larger; first segments are held whole, and so are
the last ones of strands that a load draws tight, as sweeps do not carry a load through so many light segments;
contact is a penalty with multipliers, in a set number of sweeps and in float32; on a CPU all is on one thread.
"""

from __future__ import annotations

import time
from importlib.metadata import version
from typing import Any

import numpy as np

from plait.solver.scene import Scene, Strands
from tests.solver.strand_contact.referee import MissedCollisions

# Millimetres and milligrams: of segments in metres and kilograms it takes the inertia for nothing.
LENGTH, MASS = 1e3, 1e6
FORCE = LENGTH * MASS
STEPS_A_SECOND = 192
CONTACT_STIFFNESS = 1e5  # [N/m]
SWEEPS = 10  # its default


def measure(scene: Scene, frames: int, *, judged: bool = True, sweeps: int = SWEEPS) -> dict[str, Any]:
    """By frame microseconds per segment and step, and contacts a segment.

    missed: collisions, in all, unless not `judged`.  joints_open: at the end, the widest joint, over a segment;
        not a number where the motion has lost all bounds.
    """
    import newton

    model, first = _model(scene)
    pipeline = newton.CollisionPipeline(
        model, contact_matching="latest", broad_phase="sap", contact_matching_pos_threshold=5e-4 * LENGTH
    )
    contacts = pipeline.contacts()
    solver = newton.solvers.SolverVBD(
        model, iterations=sweeps, rigid_contact_history=True, rigid_body_contact_buffer_size=256
    )
    now, then, control = model.state(), model.state(), model.control()
    half = LENGTH * np.concatenate([0.5 * _lengths(strands) for strands in scene.strands])
    judge = _judge(first)
    before, missed, rows = _ends(now, half), 0, []
    for _ in range(frames):
        taken = 0.0
        for _ in range(STEPS_A_SECOND // 24):
            started = time.perf_counter()
            pipeline.collide(now, contacts)
            solver.step(now, then, control, contacts, 1.0 / STEPS_A_SECOND)
            taken += time.perf_counter() - started
            now, then = then, now
            after = _ends(now, half)
            missed += len(judge(before, after)) if judged else 0
            before = after
        count = int(contacts.rigid_contact_count.numpy()[0])
        each = 1e6 * taken / (model.body_count * STEPS_A_SECOND / 24)
        rows.append({"us_per_segment_substep": each, "contacts_a_segment": count / model.body_count})
    joined = np.setdiff1d(np.arange(model.body_count - 1), np.array(first[1:]) - 1)
    open_ = np.linalg.norm(before[2 * joined + 2] - before[2 * joined + 1], axis=1) / (2.0 * half[joined])
    found: dict[str, Any] = {"segments": model.body_count}
    found |= {
        "missed": missed if judged else None,
        "joints_open": float(open_.max()),
        "sweeps": sweeps,
        "version": version("newton"),
    }
    return {"frames": rows, **found}


def _lengths(strands: Strands) -> np.ndarray:
    """(segment_count,) [m] of all strands."""
    return np.concatenate(
        [
            np.linalg.norm(np.diff(strands.points[first:last], axis=0), axis=1)
            for first, last in zip(strands.offsets[:-1], strands.offsets[1:], strict=True)
        ]
    )


def _model(scene: Scene) -> tuple[Any, list[int]]:
    """The model, and the first body of each strand and after the last."""
    import newton
    import warp as wp

    gravity = tuple(float(LENGTH * value) for value in scene.gravity)
    builder = newton.ModelBuilder(up_axis=newton.Axis.Y, gravity=gravity)
    builder.rigid_gap = 0.0
    first = []
    for strands in scene.strands:
        shape = newton.ModelBuilder.ShapeConfig(mu=float(strands.friction[0]), ke=MASS * CONTACT_STIFFNESS, kd=0.0)
        for k, (begin, end) in enumerate(zip(strands.offsets[:-1], strands.offsets[1:], strict=True)):
            radius = float(strands.radius[begin])
            # The capsule is thicker than the strand, and weighs as much.
            wide = radius + 0.5 * strands.thickness
            shape.density = float(strands.density[k]) * (radius / wide) ** 2 * MASS / LENGTH**3
            rod = newton.Rod(
                [wp.vec3(*point) for point in LENGTH * strands.points[begin:end]],
                radius=LENGTH * wide,
                stretch_rigidity=FORCE * float(strands.stretch_stiffness[k]),
                shear_rigidity=FORCE * float(strands.stretch_stiffness[k]),
                bend_rigidity=FORCE * LENGTH**2 * float(strands.bend_stiffness[k]),
                twist_rigidity=FORCE * LENGTH**2 * float(strands.twist_stiffness[k]),
            )
            bodies, _ = builder.add_rod(rod=rod, cfg=shape)
            first.append(bodies[0])
            for held in bodies[:1] if strands.loads is None else (bodies[0], bodies[-1]):
                builder.body_flags[held] = int(newton.BodyFlags.KINEMATIC)
    builder.color()
    model = builder.finalize(device="cpu")
    return model, [*first, model.body_count]


def _judge(first: list[int]) -> MissedCollisions:
    """Of capsules of different strands: the ends of capsule b are nodes 2 b and 2 b + 1."""
    strand = np.repeat(np.arange(len(first) - 1), np.diff(first))
    edges = 2 * np.arange(first[-1], dtype=np.int32)
    return MissedCollisions(edges, np.repeat(strand, 2), frozenset((int(i), int(i)) for i in np.unique(strand)))


def _ends(state: Any, half: np.ndarray) -> np.ndarray:
    """(2 body_count, 3) [m], of each capsule along its own z."""
    placed = state.body_q.numpy().astype(np.float64)
    x, y, z, w = placed[:, 3:].T
    along = half[:, None] * np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=1)
    return np.stack([placed[:, :3] - along, placed[:, :3] + along], axis=1).reshape(-1, 3)
