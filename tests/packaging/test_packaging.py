"""The wheel holds every package, imports go one way, and nothing heavy is loaded before it is needed."""

from __future__ import annotations

import ast
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("pipeline", "solver", "assets")
TOP_LEVEL = {
    "pyproject.toml",
    "pipeline",
    "solver",
    "assets",
    "tests",
    "examples",
    "README.md",
    "LICENSE",
    "CHANGELOG.md",
}


def sources(folder: str) -> list[Path]:
    return sorted((ROOT / folder).rglob("*.py"))


def test_package_list_is_what_is_on_disk():
    """A subpackage missing from pyproject works when editable and vanishes from the wheel."""
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]
    found = {
        "plait." + ".".join(path.parent.relative_to(ROOT).parts) for folder in FOLDERS for path in sources(folder)
    }
    assert set(listed) == found


def test_every_package_folder_has_an_init():
    for folder in FOLDERS:
        for path in sources(folder):
            assert (path.parent / "__init__.py").is_file(), path


def test_top_level_holds_what_was_agreed():
    """The layout of the top level is fixed; only dotfiles, a licence and a change log join it."""
    tracked = subprocess.run(
        ["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False
    ).stdout.splitlines()
    if not tracked:
        pytest.skip("not a git checkout")
    names = {line.split("/")[0] for line in tracked}
    assert {name for name in names if not name.startswith(".")} <= TOP_LEVEL


def imported(path: Path) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return names


@pytest.mark.parametrize("path", sources("solver"), ids=lambda path: path.relative_to(ROOT).as_posix())
def test_solver_knows_neither_usd_nor_the_pipeline(path):
    """pipeline -> solver, never back; only the pipeline imports pxr."""
    forbidden = {
        name for name in imported(path) if name.split(".")[0] == "pxr" or name.startswith("plait.pipeline")
    }
    assert not forbidden


@pytest.mark.parametrize(
    "path", [p for f in FOLDERS for p in sources(f)], ids=lambda p: p.relative_to(ROOT).as_posix()
)
def test_no_import_by_the_folder_s_bare_name(path):
    """`import solver` would make a second copy of every Warp module."""
    assert not {name for name in imported(path) if name.split(".")[0] in FOLDERS}


def test_help_imports_nothing_heavy():
    """`plait --help` answers in a fifth of a second because it loads neither USD nor Warp nor numpy."""
    code = (
        "import sys\n"
        "from plait.pipeline.cli import main\n"
        "try: main(['--help'])\n"
        "except SystemExit: pass\n"
        "print(sorted({name.split('.')[0] for name in sys.modules}), file=sys.stderr)"
    )
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stderr
    for heavy in ("pxr", "warp", "numpy", "pyvista", "msgspec", "rich", "trimesh"):
        assert f"'{heavy}'" not in loaded


def test_building_a_scene_without_strands_loads_no_feature():
    """A feature the scene lacks costs nothing: its modules are not even imported."""
    code = (
        "import sys\n"
        "from plait.solver.build import build\n"
        "from plait.solver.scene import Scene\n"
        "simulation = build(Scene())\n"
        "metrics = simulation.advance_frame(1.0)\n"
        "assert not metrics['launches'], metrics\n"
        "loaded = [n for n in sys.modules if n.startswith(('plait.solver.strands', 'plait.solver.contact',"
        " 'plait.solver.kinematics'))]\n"
        "assert not loaded, loaded\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
