"""Characters as they come: limbs, heads of many shells, open bodies, hats and capes, unprepared."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom

from plait.pipeline.flesh import embed, fill_anew, fractions, volumes
from plait.pipeline.read.triangles import triangulate
from plait.pipeline.tetrahedra.skin import Inside, prepare, shell_volumes

CHARACTERS = ("Barbarian_Running_A", "Mage_Walking_A")


def meshes(path: Path) -> list[tuple[str, np.ndarray, np.ndarray]]:
    stage = Usd.Stage.Open(str(path))
    found = []
    for prim in stage.Traverse():
        if prim.IsA(UsdGeom.Mesh):
            mesh = UsdGeom.Mesh(prim)
            points = np.array(mesh.GetPointsAttr().Get(), dtype=float)
            counts = np.array(mesh.GetFaceVertexCountsAttr().Get())
            indices = np.array(mesh.GetFaceVertexIndicesAttr().Get())
            found.append((prim.GetName(), points, triangulate(points, counts, indices)[0]))
    return found


@pytest.mark.parametrize("character", CHARACTERS)
def test_every_mesh_of_a_character(character, shared):
    """No tet inverted at rest; every point of the skin held, exactly; closed shells weigh what they enclose."""
    found = meshes(shared / "samples" / "converted" / f"{character}.usdc")
    assert len(found) >= 11
    weighed = 0
    for name, points, triangles in found:
        lattice = fill_anew(points, triangles, budget=3000)
        size = np.linalg.norm(np.ptp(points, axis=0))
        assert volumes(lattice).min() > 0.0, name
        embedding, report = embed(points, lattice)
        assert report.count == 0, name
        back = np.einsum("nk,nkd->nd", embedding.barycentric, lattice.nodes[lattice.tets[embedding.tet]])
        assert np.abs(back - points).max() <= 1e-12 * size, name
        part = fractions(lattice, points, triangles)
        assert 0.0 < part.min() and part.max() <= 1.0, name
        weight, expected = np.sum(part * volumes(lattice)), enclosed(points, triangles)
        # The volume of closed shells that lie apart is known; of others no more than bounds.
        if expected is not None:
            assert weight == pytest.approx(expected, rel=0.02), name
            weighed += 1
    assert weighed >= 4


def enclosed(points: np.ndarray, triangles: np.ndarray) -> float | None:
    """Of a single closed shell."""
    skin = prepare(points, triangles)
    shell = np.zeros(len(skin.triangles), dtype=int)
    volume, _, closed = shell_volumes(skin.points, skin.triangles, shell)
    inside = Inside.of(skin).query(skin.points[skin.triangles].mean(axis=1) + 1e-3 * skin.normals)[0] < 0.0
    return None if not closed[0] or inside.any() else float(volume[0])
