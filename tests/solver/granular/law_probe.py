"""The granular laws' device functions at many strains at once, with numpy's arrays in and out."""

from functools import cache
from types import SimpleNamespace

import numpy as np
import warp as wp

from plait.solver.granular.laws import LAWS, law_functions
from plait.solver.granular.material import material_type, set_material
from plait.solver.materials.symmetric import symmetric_functions
from plait.solver.scene import Granular

NONE = np.zeros((0, 3))
PLACES = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])


def matter(law: str, **values) -> Granular:
    return Granular(law, law, NONE, NONE, NONE[:, 0], NONE[:, 0], NONE[:, 0].astype(np.int64), **values)


def packed(A: np.ndarray) -> np.ndarray:
    """(n, 6) of symmetric (n, 3, 3)."""
    return np.stack([A[:, 0, 0], A[:, 1, 1], A[:, 2, 2], A[:, 1, 2], A[:, 0, 2], A[:, 0, 1]], axis=1)


def unpacked(a: np.ndarray) -> np.ndarray:
    return a[:, PLACES]


@cache
def _kernels(laws: tuple[str, ...], real: type) -> SimpleNamespace:
    law, functions = law_functions(laws, real), symmetric_functions(real)
    energy_density, kirchhoff, return_map = law.energy_density, law.kirchhoff, law.return_map
    deform, sym, Material = functions.deform, functions.sym, material_type(real).Material
    mat33 = wp.types.matrix((3, 3), real)
    module = f"tests_granular_{'_'.join(laws)}_{real.__name__}"

    @wp.kernel(enable_backward=False, module=module)
    def state(e: wp.array(dtype=sym), memory: wp.array(dtype=real), m: Material, energy: wp.array(dtype=real),
              stress: wp.array(dtype=sym)):  # fmt: skip
        i = wp.tid()
        energy[i] = energy_density(e[i], memory[i], m)
        stress[i] = kirchhoff(e[i], memory[i], m)

    @wp.kernel(enable_backward=False, module=module)
    def back(e: wp.array(dtype=sym), memory: wp.array(dtype=real), m: Material):
        i = wp.tid()
        strain, more = return_map(e[i], memory[i], m)
        e[i] = strain
        memory[i] = more

    @wp.kernel(enable_backward=False, module=module)
    def further(e: wp.array(dtype=sym), G: wp.array(dtype=mat33)):
        i = wp.tid()
        e[i] = deform(e[i], G[i])

    return SimpleNamespace(state=state, back=back, further=further, sym=sym, mat33=mat33, Material=Material)


class Probe:
    """One law, alone or `among` others, in `real`."""

    def __init__(self, granular: Granular, real: type = wp.float64, among: tuple[str, ...] = ()) -> None:
        laws = among or (granular.law,)
        self._kernels, self._real = _kernels(laws, real), real
        self._material = self._kernels.Material()
        set_material(self._material, granular, laws.index(granular.law), LAWS[granular.law].parameters(granular))

    def _hold(self, strain: np.ndarray, memory: float | np.ndarray) -> tuple[wp.array, wp.array]:
        kept = np.broadcast_to(memory, len(strain)).astype(float)
        return (
            wp.array(packed(strain), dtype=self._kernels.sym, device="cpu"),
            wp.array(kept, dtype=self._real, device="cpu"),
        )

    def state(self, strain: np.ndarray, memory: float | np.ndarray = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """psi (n,), tau (n, 3, 3) at strains (n, 3, 3)."""
        e, kept = self._hold(strain, memory)
        energy, stress = wp.zeros_like(kept), wp.zeros_like(e)
        wp.launch(self._kernels.state, len(strain), [e, kept, self._material, energy, stress], device="cpu")
        return energy.numpy(), unpacked(stress.numpy())

    def return_map(self, strain: np.ndarray, memory: float | np.ndarray = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Strain (n, 3, 3) and memory (n,) after the return mapping."""
        e, kept = self._hold(strain, memory)
        wp.launch(self._kernels.back, len(strain), [e, kept, self._material], device="cpu")
        return unpacked(e.numpy()), kept.numpy()

    def deform(self, strain: np.ndarray, gradient: np.ndarray) -> np.ndarray:
        """Strain (n, 3, 3) after a further deformation 1 + gradient."""
        e, _ = self._hold(strain, 0.0)
        G = wp.array(gradient, dtype=self._kernels.mat33, device="cpu")
        wp.launch(self._kernels.further, len(strain), [e, G], device="cpu")
        return unpacked(e.numpy())
