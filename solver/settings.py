"""Every number of the solver that a user may set, its unit, range and default. Checked on entry."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

# Above any physical value, below infinity: what is not finite is refused.
FINITE = 1e300
Count = Annotated[int, msgspec.Meta(ge=1)]
Positive = Annotated[float, msgspec.Meta(gt=0.0, lt=FINITE)]


class StrandSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """[strands]: the rod solve.

    integrator: 'backward-euler' (default, damps) or 'sdirk2' (second order, twice the solves).
    tolerance: Newton stops when no node moves further than this part of a segment's length.
    max_iterations: Newton iterations before a strand's step is subdivided.
    precision: 'auto' is float64 on the CPU, float32 about the root on a GPU.
    """

    integrator: Literal["backward-euler", "sdirk2"] = "backward-euler"
    tolerance: Positive = 3e-2
    max_iterations: Count = 60
    precision: Literal["auto", "float32", "float64"] = "auto"


class ContactSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """[contact]: strands against bodies.

    passes: detection and solve are alternated at most this often in a substep.
    exit_speed: [m/s] a point that starts inside a body is led out no faster than this.
    """

    passes: Count = 4
    exit_speed: Positive = 0.5


class StrandContactSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """[strand_contact]: strands against strands.

    method: 'implicit' (default) solves contact with the strands and lets none through; 'none' lets strands pass
        through each other; 'paper' is Han 2019, 5.2 and 5.3, for comparison.
    passes: Newton passes of the strands in contact in a substep, before it is asked to be halved; one of some of
        them counts for their part.
    geometric_passes: of 'paper', how often geometric impulses are applied in a substep.
    """

    method: Literal["implicit", "paper", "none"] = "implicit"
    passes: Count = 16
    geometric_passes: Count = 5


class FleshSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """[flesh]: the solve of elastic bodies.

    integrator: 'bdf2' (default, second order), 'backward-euler' (damps), 'symplectic-euler' (explicit).
    tolerance: Newton stops when what is left of the forces is this part of those at the substep's start.
    max_iterations: Newton iterations before a substep is asked to be halved.
    rpic_damping: of 'symplectic-euler', by a grid (Han 2019 4.2): 0 for none, else which part of what is not
        rotation the transfers drop.
    """

    integrator: Literal["bdf2", "backward-euler", "symplectic-euler"] = "bdf2"
    tolerance: Positive = 1e-2
    max_iterations: Count = 40
    rpic_damping: Annotated[float, msgspec.Meta(ge=0.0, le=1.0)] = 0.0


class RigidSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """[rigid]: the solve of rigid bodies.

    method: 'exact' (default) solves contacts and joints together, with Coulomb's exact cone; 'paper' is Han 2019,
        6, for comparison: contacts by a potential on the grid of `GridSettings`, its cells a tenth of the smallest
        body's size where none is told; without joints, restitution and filtered pairs.
    stiffness: [Pa] of 'paper', k^c of (34): the pressure that would press the potential's layer flat.
    tolerance: a solve stops when it changes no speed by more than this part of the fastest body's, or of what
        gravity gives in a substep.
    iterations: sweeps over an island's contacts and joints, at most.  passes: how often what turning adds is found
        anew, at most.
    friction: Coulomb coefficient where neither of two bodies tells.
    exit_speed: [m/s] what overlaps, or is drawn apart at a joint, is led back no faster than this.
    """

    method: Literal["exact", "paper"] = "exact"
    stiffness: Positive = 2e6
    tolerance: Positive = 1e-6
    iterations: Count = 200
    passes: Count = 10
    friction: Annotated[float, msgspec.Meta(ge=0.0, lt=FINITE)] = 0.5
    exit_speed: Positive = 0.5


class GridSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """[grid]: contact of elastic bodies through the grid.

    cell_size: [m]; 0 takes the mean edge of the bodies' tets, see `RigidSettings` for rigid ones.
    rule: 'pairwise' (default), or 'paper', Han 2019 (20)-(25) to the letter, for comparison.
    iterations: sweeps over the contacts in a pass.  passes: elastic solve and contact alternate so often.
    cfl: nothing near a contact moves further than this part of a cell in a substep.
    """

    cell_size: Annotated[float, msgspec.Meta(ge=0.0, lt=FINITE)] = 0.0
    rule: Literal["pairwise", "paper"] = "pairwise"
    iterations: Count = 5
    passes: Count = 3
    cfl: Positive = 0.5


class GranularSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """[granular]: sand and snow on a grid.

    cell_size: [m]; 0 takes eight particles to a cell.
    cfl: no particle moves further than this part of a cell in a step of the matter.
    still: grains that have for some time moved slower, in the mean, than this times sqrt(g dx), the speed of a
        fall through half a cell, sleep until what moves comes near; 0: none do.
    """

    cell_size: Annotated[float, msgspec.Meta(ge=0.0, lt=FINITE)] = 0.0
    cfl: Positive = 0.3
    still: Annotated[float, msgspec.Meta(ge=0.0, lt=FINITE)] = 0.02


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where and how finely to solve.

    device: 'cpu' or 'cuda:N'.  threads: CPU threads that share each launch; 0: all cores.
    precision: 'float32' is the working precision (mixed, see README); 'float64' is that throughout.
    substeps: substeps a frame.
    """

    device: str = "cpu"
    threads: Annotated[int, msgspec.Meta(ge=0)] = 0
    precision: Literal["float32", "float64"] = "float32"
    substeps: Count = 8
    strands: StrandSettings = StrandSettings()
    contact: ContactSettings = ContactSettings()
    strand_contact: StrandContactSettings = StrandContactSettings()
    flesh: FleshSettings = FleshSettings()
    grid: GridSettings = GridSettings()
    rigid: RigidSettings = RigidSettings()
    granular: GranularSettings = GranularSettings()
