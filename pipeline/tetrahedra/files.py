"""Meshes of tets that users bring, in whatever format meshio reads."""

from __future__ import annotations

import io
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import numpy as np

from plait.pipeline.errors import InputError
from plait.pipeline.tetrahedra.mesh import Lattice, volumes


def read_tet_mesh(path: str | Path) -> Lattice:
    """The tets of a .msh, .vtk, .vtu, .mesh, ... file; corners alone of curved ones; nodes of no tet are dropped.

    Raises `InputError`: no such file, not a mesh, without tets, or with a tet of no volume.
    """
    import meshio

    path = Path(path)
    if not path.is_file():
        raise InputError("no such file", file=path)
    printed = io.StringIO()  # meshio tells its errors itself, then exits
    try:
        with redirect_stdout(printed), redirect_stderr(printed):
            mesh = meshio.read(path)
    except (Exception, SystemExit) as error:
        told = " ".join((printed.getvalue() or str(error)).split()) or type(error).__name__
        raise InputError(
            f"cannot be read as a mesh ({told})", file=path, mend="save it as .msh or .vtu"
        ) from error
    cells = [block.data[:, :4] for block in mesh.cells if block.type.startswith("tetra")]
    if not cells or not sum(len(block) for block in cells):
        raise InputError("holds no tetrahedra", file=path, mend="export the volume mesh, not its surface")
    tets = np.concatenate(cells).astype(np.int64)
    points = np.zeros((len(mesh.points), 3))
    points[:, : mesh.points.shape[1]] = mesh.points
    if tets.min() < 0 or tets.max() >= len(points):
        raise InputError(f"a tet names node {tets.max()} of {len(points)}", file=path, mend="export it again")
    if not np.isfinite(points[tets]).all():
        raise InputError("has nodes that are not finite", file=path, mend="export it again")
    used, inverse = np.unique(tets, return_inverse=True)
    tets = inverse.reshape(-1, 4).astype(np.int32)
    nodes = points[used]
    volume = volumes(Lattice(nodes, tets))
    flat = np.abs(volume) <= 1e-12 * np.ptp(nodes, axis=0).max() ** 3 / len(tets)
    if flat.any():
        raise InputError(
            f"tet {int(np.argmax(flat))} has no volume", file=path, mend="mesh it again without slivers"
        )
    turned = volume < 0.0
    tets[turned] = tets[turned][:, [0, 1, 3, 2]]
    return Lattice(nodes, tets)
