"""CUDA is honoured where there is none: every kernel module compiles for sm_90 without a GPU."""

from __future__ import annotations

import importlib
import pkgutil
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import warp as wp

import plait.solver
from plait.solver.contact.carrier_kernels import coupling_kernels
from plait.solver.contact.obstacle_force_kernels import tet_kernels
from plait.solver.granular.contact_kernels import contact_kernels
from plait.solver.granular.energy_kernels import energy_kernels
from plait.solver.granular.exchange_kernels import follow_kernels
from plait.solver.granular.flesh_exchange_kernels import flesh_exchange_kernels
from plait.solver.granular.laws import LAWS as GRANULAR_LAWS
from plait.solver.granular.lead_kernels import lead_kernels
from plait.solver.granular.middle_kernels import middle_kernels
from plait.solver.granular.rigid_exchange_kernels import rigid_exchange_kernels
from plait.solver.granular.strand_exchange_kernels import strand_exchange_kernels
from plait.solver.granular.transfer_kernels import transfer_kernels
from plait.solver.linear.block_kernels import block_kernels
from plait.solver.linear.coarse_kernels import coarse_kernels
from plait.solver.materials.laws import LAWS
from plait.solver.strand_contact.attachment_kernels import attachment_kernels
from plait.solver.strand_contact.coupled_kernels import coupled_kernels
from plait.solver.strands.kernels import strand_kernels
from plait.solver.tets.body_kernels import body_kernels
from plait.solver.tets.damping_kernels import damping_kernels
from plait.solver.tets.elements import element_kernels
from plait.solver.tets.explicit_kernels import explicit_kernels
from plait.solver.tets.skin_kernels import skin_kernels
from plait.solver.warp_start import start_warp

start_warp()
# Factories of kernels by precision.
MADE = (
    attachment_kernels,
    block_kernels,
    coarse_kernels,
    coupled_kernels,
    body_kernels,
    contact_kernels,
    coupling_kernels,
    damping_kernels,
    explicit_kernels,
    flesh_exchange_kernels,
    follow_kernels,
    lead_kernels,
    middle_kernels,
    rigid_exchange_kernels,
    skin_kernels,
    strand_exchange_kernels,
)


def kernels() -> Iterator[wp.Kernel]:
    """Every kernel of the solver: those of its Python modules and those made for each precision."""
    for found in pkgutil.walk_packages(plait.solver.__path__, "plait.solver."):
        yield from vars(importlib.import_module(found.name)).values()
    for real in (wp.float32, wp.float64):
        yield from vars(strand_kernels(real)).values()
        yield from vars(tet_kernels(real)).values()
        for made in MADE:
            yield from vars(made(real)).values()
        for made in (transfer_kernels, energy_kernels):
            yield from vars(made(tuple(GRANULAR_LAWS), real)).values()
        for law in LAWS:
            yield from vars(element_kernels(law, real)).values()


MODULES = {kernel.module.name: kernel.module for kernel in kernels() if isinstance(kernel, wp.Kernel)}


def test_no_kernel_is_left_out():
    """Each `@wp.kernel` in the sources belongs to a module that is compiled here."""
    text = "".join(path.read_text() for path in Path(plait.solver.__path__[0]).rglob("*.py"))
    written = set(re.findall(r"@wp\.kernel\([^)]*\)\s+def (\w+)\(", text))
    known = {kernel.key.split(".")[-1] for kernel in kernels() if isinstance(kernel, wp.Kernel)}
    assert written and not {name for name in written if not any(name in key for key in known)}


def _case(name: str) -> Any:
    """float64 is the same source with another type, and not what runs on a GPU unless asked for."""
    return pytest.param(name, marks=pytest.mark.slow if name.endswith("float64") else ())


@pytest.mark.parametrize("name", [_case(name) for name in sorted(MODULES)])
def test_compiles_for_sm_90(name, tmp_path):
    (binary,) = wp.compile_aot_module(MODULES[name], arch=90, module_dir=tmp_path)
    assert binary.stat().st_size > 0
