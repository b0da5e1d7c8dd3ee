"""Every benchmark case there is; a new physics adds its own here."""

from __future__ import annotations

from plait.pipeline.benchmarks import flesh, rods, strand_contact
from plait.pipeline.benchmarks.case import Case

CASES: tuple[Case, ...] = (*rods.CASES, *flesh.CASES, *strand_contact.CASES)
