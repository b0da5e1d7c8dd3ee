"""Every number the user can set is checked on entry, and named when it is wrong."""

from __future__ import annotations

import pytest

from plait.pipeline.config import Config, load
from plait.pipeline.errors import InputError, UsageError


def test_defaults_then_file_then_set_then_flags(tmp_path):
    """Each layer wins over the one before it."""
    path = tmp_path / "sim.toml"
    path.write_text("preroll = 1\n[solver]\nsubsteps = 2\nthreads = 3\n[solver.strands]\ntolerance = 0.5\n")
    config = load(path, ["solver.substeps=4", "solver.strands.integrator=sdirk2"], {"solver.threads": 5})
    assert (config.preroll, config.solver.substeps, config.solver.threads) == (1, 4, 5)
    assert (config.solver.strands.tolerance, config.solver.strands.integrator) == (0.5, "sdirk2")
    assert load(None, []) == Config()


def test_paths_are_quoted_as_in_toml():
    """Prim paths hold slashes and stars, and so stand in quotes, in the file as in `--set`."""
    config = load(
        None, ['prim."/World/hair*".damping=3.0', "parameters.restShape=authored", "output.shutter=[0.5]"]
    )
    assert config.prim == {"/World/hair*": {"damping": 3.0}}
    assert config.parameters == {"restShape": "authored"} and config.output.shutter == (0.5,)


@pytest.mark.parametrize(
    ("assignment", "named"),
    [
        ("solver.substeps=0", "substeps"),
        ("solver.substeps=2.5", "substeps"),
        ("solver.strands.tolerance=-1", "tolerance"),
        ("solver.strands.tolerance=nan", "tolerance"),
        ("solver.strands.tolerance=inf", "tolerance"),
        ("solver.strands.integrator=euler", "integrator"),
        ("solver.contact.exit_speed=-0.1", "exit_speed"),
        ("solver.contact.exit_speed=inf", "exit_speed"),
        ("solver.nonsense=1", "nonsense"),
        ("output.chunk=0", "chunk"),
        ("output.shutter=[2.0]", "shutter"),
        ("preroll=-1", "preroll"),
        ("preroll.deep=1", "preroll"),
        ("solver", "key=value"),
        ("=3", "key=value"),
    ],
)
def test_bad_assignments_name_the_key(assignment, named):
    with pytest.raises(UsageError, match=named):
        load(None, [assignment])


@pytest.mark.parametrize("text", ["preroll = ", "preroll = -1", "[solver]\nsubsteps = 'x'", "unknown = 1"])
def test_a_bad_file_is_bad_input_and_named(tmp_path, text):
    path = tmp_path / "sim.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=r"sim\.toml"):
        load(path, [])


def test_a_missing_file_is_bad_input(tmp_path):
    with pytest.raises(InputError, match=r"none\.toml"):
        load(tmp_path / "none.toml", [])
