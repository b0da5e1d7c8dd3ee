"""What a law knows of the matter it is applied to."""

from functools import cache, partial
from types import SimpleNamespace

import numpy as np
import warp as wp

from plait.solver.materials.rotation import module_name
from plait.solver.scene import Granular


@cache
def material_type(real: type) -> SimpleNamespace:
    """The struct `Material` for `real` (wp.float32 or wp.float64), one entry a `Granular`."""

    @partial(wp.struct, module=module_name(real))
    class Material:
        law: wp.int32  # which of the laws in use
        density: real  # [kg/m3] at rest
        mu: real  # [Pa] Lame's parameters at rest
        lam: real
        own: wp.types.vector(4, real)  # what the law alone knows, see its `parameters`

    return SimpleNamespace(Material=Material)


def lame(granular: Granular) -> tuple[float, float]:
    """mu, lambda [Pa]."""
    E, nu = granular.youngs_modulus, granular.poissons_ratio
    return E / (2.0 * (1.0 + nu)), E * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))


def set_material(material: object, granular: Granular, law: int, own: tuple[float, ...]) -> None:
    """Fills a struct `Material`."""
    material.law, material.density = law, granular.density
    material.mu, material.lam = lame(granular)
    material.own = np.pad(np.array(own, dtype=float), (0, 4 - len(own)))
