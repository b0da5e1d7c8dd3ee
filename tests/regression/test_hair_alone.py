"""What a scene lacks costs nothing: a shot of hair launches and loads what it did when there was nothing else."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from plait.assets.small_scene import FOLDER, SETTINGS, SHOT

# Of the small shot, taken before elastic bodies existed. Their counts were the same as well, but a machine that
# rounds otherwise may look for contact once more.
KERNELS = {
    "plait.solver.contact.geometry_kernels": {"bound_groups"},
    "plait.solver.contact.inside_kernels": {"find_inside", "measure_roots", "note_drawn"},
    "plait.solver.contact.surface_kernels": {"find_planes", "project_out"},
    "plait.solver.kinematics.linear_kernels": {"skin_linear"},
    "plait.solver.kinematics.root_kernels": {"place_roots"},
    "plait_strands_float64": {"measure", "solve"},
    "plait_strands_rest": {"balance", "find_stable", "transport_frames"},
}
OTHERS = ("tets", "materials", "linear", "grid", "rigid", "granular")

RUN = """
import json, sys
from collections import Counter
from pathlib import Path
from plait.pipeline import config, driver
from plait.solver.launch import Launcher

counts, launch = Counter(), Launcher.launch
def counted(self, kernel, count, *args, **options):
    if count:
        counts[kernel.module.name + " " + kernel.key.split("__")[-1].split(".")[-1]] += 1
    launch(self, kernel, count, *args, **options)
Launcher.launch = counted
driver.simulate(Path(sys.argv[1]), Path(sys.argv[2]), config.load(None, sys.argv[3:]))
modules = [name for name in sys.modules if name.startswith("plait.solver.")]
print(json.dumps({"launches": counts, "modules": modules}))
"""


def test_same_launches_same_modules(tmp_path: Path) -> None:
    command = [sys.executable, "-c", RUN, str(FOLDER / SHOT), str(tmp_path / "out.usda"), *SETTINGS]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=tmp_path)
    seen = json.loads(done.stdout.splitlines()[-1])
    kernels: dict[str, set[str]] = {}
    for name in seen["launches"]:
        module, kernel = name.split()
        kernels.setdefault(module, set()).add(kernel)
    assert kernels == KERNELS
    # Mass properties are plain numpy, of whoever reads rigid bodies.
    loaded = set(seen["modules"]) - {"plait.solver.rigid", "plait.solver.rigid.mass_properties"}
    assert not [name for name in loaded if name.split(".")[2] in OTHERS]
