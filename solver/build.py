"""From a scene to the stages that run it. The order of the tuple is the order of a substep."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from plait.solver.scene import Scene
from plait.solver.settings import Settings

if TYPE_CHECKING:
    from plait.solver.step import Simulation

# Each module offers `build(model, state) -> Stage | None`; it is imported only when its test holds, so that a
# feature the scene lacks costs nothing: no arrays, no kernel compiled, no launch.
FEATURES = (
    (
        "kinematics",
        "plait.solver.kinematics.stage",
        lambda scene: bool(scene.strands or scene.bodies or scene.rigid_bodies or scene.granular),
    ),
    ("rigid", "plait.solver.rigid.stage", lambda scene: bool(scene.rigid_bodies)),
    ("tets", "plait.solver.tets.stage", lambda scene: bool(scene.bodies)),
    (
        "carried",
        "plait.solver.kinematics.carried",
        lambda scene: bool((scene.bodies or scene.rigid_bodies) and (scene.strands or scene.granular)),
    ),
    ("strands", "plait.solver.strands.stage", lambda scene: bool(scene.strands)),
    ("granular", "plait.solver.granular.stage", lambda scene: bool(scene.granular)),
)


def build(scene: Scene, settings: Settings | None = None, start_time: float = 0.0) -> Simulation:
    """A simulation of `scene`, at rest at `start_time` [s] in the animation's pose of that time.

    Raises `Refused` for a scene that cannot be simulated.
    """
    # Here, so that asking which features a scene needs does not load Warp.
    from plait.solver.launch import Launcher
    from plait.solver.model import Model
    from plait.solver.state import State
    from plait.solver.step import Simulation

    settings = settings or Settings()
    model = Model(scene, settings, Launcher(settings.device, settings.threads), start_time)
    state = State(time=start_time)
    for name, module, needed in FEATURES:
        if needed(scene):
            stage = import_module(module).build(model, state)
            if stage is not None:
                model.parts[name] = stage
    return Simulation(model, state)
