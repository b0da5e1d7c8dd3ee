"""Every parameter a prim can carry: one table, from which reading is driven and the README's table is made."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from plait.pipeline.read.source import Source

STRANDS, COLLIDER, FLESH, RIGID, SAND, SNOW = "strands", "collider", "flesh", "rigid", "sand", "snow"


@dataclass(frozen=True)
class Parameter:
    """One parameter. On a prim or its physics material it is `plait:NAME`; in the configuration NAME.

    Where roles differ in what a name means to them, or in its default or range, it has a row for each.

    unit: SI; the configuration is in SI, what is authored in a stage is in the stage's own units.
    default: None where it follows from others, as `default_text` says.
    low, high: range in SI, `low` itself only if `low_allowed`.
    authored: other attribute names it is read from, weakest first: UsdPhysics', then the deformable proposal's.
    kilograms, meters: powers of the stage's units in it (seconds are seconds everywhere).
    zero_means_unset: in the other names, as UsdPhysics has it, zero asks for the default.
    choices: words, one of which it is.  file: it is a path.  flag: it is true or false, and does not change.
    vector: it is three numbers, each of a size in the range.  whole: it is a whole number.
    painted: `primvars:plait:NAME` may give a value for each of these, and comes before one for all.
    """

    name: str
    unit: str
    meaning: str
    roles: tuple[str, ...] = (STRANDS,)
    default: float | str | bool | None = None
    default_text: str = ""
    low: float = 0.0
    high: float = math.inf
    low_allowed: bool = False
    authored: tuple[str, ...] = ()
    kilograms: int = 0
    meters: int = 0
    zero_means_unset: bool = False
    choices: tuple[str, ...] = ()
    file: bool = False
    flag: bool = False
    vector: bool = False
    whole: bool = False
    painted: Literal["", "points", "curves"] = ""

    @property
    def range_text(self) -> str:
        if self.choices:
            return ", ".join(self.choices)
        if self.file:
            return "a path"
        if self.flag:
            return "true or false"
        if self.vector:
            return f"three numbers, each from {-self.high:g} to {self.high:g}"
        kind = "whole, " if self.whole else ""
        return f"{kind}{'from' if self.low_allowed else 'above'} {self.low:g} to {self.high:g}"

    def stage_unit(self, source: Source) -> float:
        """SI value of one of the stage's units of this parameter."""
        units = source.units
        return units.kilograms_per_unit**self.kilograms * units.meters_per_unit**self.meters


PARAMETERS = (
    Parameter(
        "density", "kg/m3", "mass over volume of the strand's material",
        default=1300.0, low=0.01, high=1e6, low_allowed=True,
        authored=("physics:density",), kilograms=1, meters=-3, zero_means_unset=True,
    ),
    Parameter(
        "density", "kg/m3", "mass over volume of the flesh", roles=(FLESH,),
        default=1000.0, low=0.01, high=1e6, low_allowed=True,
        authored=("physics:density",), kilograms=1, meters=-3, zero_means_unset=True,
    ),
    Parameter(
        "density", "kg/m3", "mass over volume of the rigid body, where no mass is authored", roles=(RIGID,),
        default=1000.0, low=0.01, high=1e9, low_allowed=True,
        authored=("physics:density",), kilograms=1, meters=-3, zero_means_unset=True,
    ),
    Parameter(
        "thickness", "m", "diameter; over the drawn `widths`",
        default_text="the drawn width, 8e-5 where none is drawn", low=0.0, high=10.0,
        authored=("physics:curvesThickness",), meters=1, zero_means_unset=True,
    ),
    Parameter(
        "youngsModulus", "Pa", "stiffness of the material; hair has 2e9 to 5e9",
        default=4e9, low=1.0, high=1e13, low_allowed=True,
        authored=("physics:youngsModulus",), kilograms=1, meters=-1, zero_means_unset=True,
    ),
    Parameter(
        "youngsModulus", "Pa", "stiffness of the flesh; jelly has 1e3 to 1e4, fat and relaxed muscle 1e4 to 1e5, "
        "rubber 1e6 to 1e7", roles=(FLESH,),
        default=5e4, low=1.0, high=1e13, low_allowed=True,
        authored=("physics:youngsModulus",), kilograms=1, meters=-1, zero_means_unset=True,
    ),
    Parameter(
        "poissonsRatio", "1", "sideways over lengthwise strain; sets twist against bend",
        default=0.35, low=-1.0, high=0.5, authored=("physics:poissonsRatio",),
    ),
    Parameter(
        "poissonsRatio", "1", "sideways over lengthwise strain; towards 0.5 the volume is kept", roles=(FLESH,),
        default=0.45, low=-1.0, high=0.495, authored=("physics:poissonsRatio",),
    ),
    Parameter(
        "stretchStiffness", "N", "EA, force over stretch",
        default_text="from youngsModulus and thickness", high=1e15,
        authored=("physics:curvesStretchStiffness",), kilograms=1, meters=1, zero_means_unset=True,
    ),
    Parameter(
        "bendStiffness", "N m2", "EI, moment over curvature",
        default_text="from youngsModulus and thickness; strands drawn thicker than any hair, with no stiffness "
        "authored, get one in proportion to their length and weight",
        high=1e12, authored=("physics:curvesBendStiffness",), kilograms=1, meters=3, zero_means_unset=True,
    ),
    Parameter(
        "twistStiffness", "N m2", "GJ, moment over twist",
        default_text="bendStiffness / (1 + poissonsRatio)",
        high=1e12, authored=("physics:curvesTwistStiffness",), kilograms=1, meters=3, zero_means_unset=True,
    ),
    Parameter(
        "damping", "1/s", "rate at which motion against the root dies out, air and neighbours together",
        default_text="2 + 8 (8e-5 / thickness)², the latter air's drag: 10 for a human hair",
        low=0.0, high=1e5, low_allowed=True,
    ),
    Parameter(
        "damping", "1/s", "rate at which all motion dies out, falling too; see stiffnessDamping", roles=(FLESH,),
        default=0.0, low=0.0, high=1e5, low_allowed=True,
    ),
    Parameter(
        "stiffnessDamping", "s", "damps what deforms and leaves what moves as a whole alone: a swing of "
        "frequency f is damped by the part pi f stiffnessDamping of critically", roles=(FLESH,),
        default=0.005, low=0.0, high=100.0, low_allowed=True,
    ),
    Parameter(
        "friction", "1", "Coulomb coefficient; a body's own comes before the strand's, of two strands the mean "
        "counts",
        roles=(STRANDS, COLLIDER), default=0.3, low=0.0, high=100.0, low_allowed=True,
        authored=("physics:staticFriction", "physics:dynamicFriction"),
    ),
    Parameter(
        "friction", "1", "Coulomb coefficient; of a pair the mean counts", roles=(FLESH, RIGID),
        default_text="0.5 among bodies; for hair on it the hair's own", low=0.0, high=100.0, low_allowed=True,
        authored=("physics:staticFriction", "physics:dynamicFriction"),
    ),
    Parameter(
        "restitution", "1", "speed after over speed before an impact; of a pair the larger counts",
        roles=(COLLIDER, FLESH, RIGID),
        default=0.0, low=0.0, high=1.0, low_allowed=True, authored=("physics:restitution",),
    ),
    Parameter(
        "clearance", "m", "distance kept between strands beside their radii; of a pair the larger counts",
        default=0.0, low=0.0, high=1.0, low_allowed=True, meters=1,
    ),
    Parameter(
        "clearance", "m", "distance kept from this body beside the strand's radius",
        roles=(COLLIDER, FLESH, RIGID), default=0.0, low=0.0, high=1.0, low_allowed=True, meters=1,
    ),
    Parameter(
        "picFraction", "1", "of `solver.strand_contact.method=paper`: part of the grid's velocity that is taken "
        "over",
        default=0.05, low=0.0, high=1.0, low_allowed=True,
    ),
    Parameter(
        "free", "", "nothing holds the strand at its root: cut hair, ropes; see Ties, clamps and free strands",
        default=False, flag=True, painted="curves",
    ),
    Parameter(
        "restShape", "", "sagfree: at rest under gravity as drawn; authored: stress-free as drawn",
        default="sagfree", choices=("sagfree", "authored"),
    ),
    Parameter(
        "law", "", "how stress follows from strain", roles=(FLESH,),
        default="fixed-corotated", choices=("fixed-corotated", "neo-hookean", "stvk"),
    ),
    Parameter(
        "tetEdge", "m", "mean edge of the tets that fill the mesh", roles=(FLESH,),
        default_text="as tetBudget asks", low=0.0, high=1e3, meters=1,
    ),
    Parameter(
        "tetBudget", "1", "how many tets fill the mesh, roughly, where no tetEdge is given", roles=(FLESH,),
        default=20000.0, low=1.0, high=1e8, low_allowed=True,
    ),
    Parameter(
        "tetMesh", "", "file with the tets to use, of any kind that meshio reads, in the prim's own space",
        roles=(FLESH,), default_text="none: the mesh is filled", file=True,
    ),
    Parameter(
        "coreDepth", "1", "part of the way from a bone to the skin that moves with the bone", roles=(FLESH,),
        default=0.5, low=0.0, high=1.0, low_allowed=True, painted="points",
    ),
    Parameter(
        "attachStiffness", "N/m4", "spring to the animated place, a volume of flesh; over the density it is the "
        "square of the angular frequency at which flesh alone would swing about that place", roles=(FLESH,),
        default=0.0, low=0.0, high=1e15, low_allowed=True, kilograms=1, meters=-3, painted="points",
    ),
    Parameter(
        "density", "kg/m3", "mass over volume of the sand with its pores", roles=(SAND,),
        default=1600.0, low=0.01, high=1e6, low_allowed=True,
        authored=("physics:density",), kilograms=1, meters=-3, zero_means_unset=True,
    ),
    Parameter(
        "density", "kg/m3", "mass over volume of the snow with its pores; fresh 100, packed 400", roles=(SNOW,),
        default=400.0, low=0.01, high=1e6, low_allowed=True,
        authored=("physics:density",), kilograms=1, meters=-3, zero_means_unset=True,
    ),
    Parameter(
        "youngsModulus", "Pa", "stiffness under pressure; its root sets how short steps must be", roles=(SAND,),
        default=3.5e5, low=1.0, high=1e13, low_allowed=True,
        authored=("physics:youngsModulus",), kilograms=1, meters=-1, zero_means_unset=True,
    ),
    Parameter(
        "youngsModulus", "Pa", "stiffness before it hardens; its root sets how short steps must be",
        roles=(SNOW,), default=1.4e5, low=1.0, high=1e13, low_allowed=True,
        authored=("physics:youngsModulus",), kilograms=1, meters=-1, zero_means_unset=True,
    ),
    Parameter(
        "poissonsRatio", "1", "sideways over lengthwise strain", roles=(SAND,),
        default=0.3, low=0.0, high=0.495, low_allowed=True, authored=("physics:poissonsRatio",),
    ),
    Parameter(
        "poissonsRatio", "1", "sideways over lengthwise strain", roles=(SNOW,),
        default=0.2, low=0.0, high=0.495, low_allowed=True, authored=("physics:poissonsRatio",),
    ),
    Parameter(
        "friction", "1", "Coulomb coefficient against what tells none of its own; the first prim that has any "
        "grains says it for all", roles=(SAND, SNOW), default=0.5, low=0.0, high=100.0, low_allowed=True,
        authored=("physics:staticFriction", "physics:dynamicFriction"),
    ),
    Parameter(
        "frictionAngle", "degrees", "slope down which the sand flows", roles=(SAND,),
        default=34.0, low=0.0, high=80.0, low_allowed=True,
    ),
    Parameter(
        "criticalCompression", "1", "strain under pressure at which snow yields", roles=(SNOW,),
        default=0.025, low=0.0, high=0.9,
    ),
    Parameter(
        "criticalStretch", "1", "strain under tension at which snow breaks; larger holds together longer",
        roles=(SNOW,), default=0.0075, low=0.0, high=0.9,
    ),
    Parameter(
        "hardening", "1", "how fast snow stiffens as it is packed", roles=(SNOW,),
        default=10.0, low=0.0, high=100.0, low_allowed=True,
    ),
    Parameter(
        "spacing", "m", "distance between grains that fill a mesh or are poured in; its cube is the room of each",
        roles=(SAND, SNOW), default_text="of meshes as grainBudget asks, alike in all; of emitters theirs, in a "
        "shot without any so that the stream is as dense as at rest; of Points what lies between them",
        low=0.0, high=1e3, meters=1,
    ),
    Parameter(
        "grainBudget", "1", "about how many grains fill a mesh, at most, where no spacing is given; the widest "
        "spacing that a mesh needs, or that Points have, is that of all", roles=(SAND, SNOW),
        default=100000.0, low=1.0, high=1e9, low_allowed=True,
    ),
    Parameter(
        "width", "m", "diameter that grains are drawn with; they act by their spacing", roles=(SAND, SNOW),
        default_text="authored `widths`, else the spacing", low=0.0, high=1e3, meters=1,
    ),
    Parameter(
        "velocity", "m/s", "along the prim's own axes, whatever its scale: of what an emitter pours, and at the "
        "start of what fills a mesh, or of Points without `velocities`", roles=(SAND, SNOW),
        default_text="0 0 0", high=1e4, low_allowed=True, meters=1, vector=True,
    ),
    Parameter(
        "rate", "1/s", "grains poured in a second; makes a mesh or shape an emitter", roles=(SAND, SNOW),
        default_text="none: no emitter", low=0.0, high=1e9,
    ),
    Parameter(
        "limit", "1", "grains that an emitter pours at most", roles=(SAND, SNOW),
        default_text="what its rate gives until the last frame", low=1.0, high=1e9, low_allowed=True,
    ),
    Parameter(
        "seed", "1", "of the places of grains", roles=(SAND, SNOW),
        default=0.0, low=0.0, high=1e9, low_allowed=True, whole=True,
    ),
    Parameter(
        "surface", "", "a mesh about the grains is written, and drawn in their place", roles=(SAND, SNOW),
        default=False, flag=True,
    ),
    Parameter(
        "surfaceCell", "m", "size of the cells that the mesh is made in", roles=(SAND, SNOW),
        default_text="1.5 spacing", low=0.0, high=1e3, meters=1,
    ),
)  # fmt: skip

NAMES = tuple(dict.fromkeys(parameter.name for parameter in PARAMETERS))


def of_role(role: str) -> dict[str, Parameter]:
    """The parameters that a role knows, by name."""
    return {parameter.name: parameter for parameter in PARAMETERS if role in parameter.roles}


def as_markdown() -> str:
    """The table for people: a row a parameter."""
    lines = [
        "| `plait:` | of | also read from | unit (SI) | default | range | meaning |",
        "|---|---|---|---|---|---|---|",
    ]
    for p in PARAMETERS:
        default = p.default_text or (f"{p.default:g}" if isinstance(p.default, float) else str(p.default).lower())
        names = [*reversed(p.authored), *([f"primvars:plait:{p.name}"] if p.painted else [])]
        also, roles = ", ".join(f"`{name}`" for name in names), ", ".join(p.roles)
        lines.append(f"| `{p.name}` | {roles} | {also} | {p.unit} | {default} | {p.range_text} | {p.meaning} |")
    return "\n".join(lines) + "\n"
