"""The skins of elastic bodies: smooth points between the nodes."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from plait.solver.launch import Launcher
from plait.solver.tets.layout import TetLayout
from plait.solver.tets.skin_kernels import skin_kernels


class Skin:
    """One body's skin: x = sum_a b_a (x_a + 1/2 F_a (X - X_a)), F_a the volume average over the tets around a.

    Exact for affine deformations, and continuous in slope to the order of the mesh where plain barycentric
    interpolation has a kink at each face of a tet.
    """

    def __init__(self, layout: TetLayout, body: int, launcher: Launcher, real: type) -> None:
        self._launcher, self._kernels = launcher, skin_kernels(real)
        embedding = layout.bodies[body].embedding
        corners = layout.skin_nodes(body)
        nodes, inverse = np.unique(corners, return_inverse=True)
        first, last = int(layout.first_tet[body]), int(layout.first_tet[body + 1])
        tets, volume = layout.tets[first:last], layout.volume[first:last]
        offsets, around = _tets_around(tets, nodes)
        held = layout.rest[tets]
        edges = np.swapaxes(held[:, 1:] - held[:, :1], 1, 2)
        barycentric = np.asarray(embedding.barycentric, dtype=np.float64)
        rest = np.einsum("pa,pai->pi", barycentric, layout.rest[corners])
        types = self._kernels.types
        data = types.SkinData()
        device = launcher.device

        def hold(values: np.ndarray, dtype: Any) -> wp.array:
            return wp.array(np.ascontiguousarray(values), dtype=dtype, device=device)

        data.node = hold(nodes, wp.int32)
        data.first_tet, data.tet_of = hold(offsets, wp.int32), hold(around, wp.int32)
        used, local = np.unique(around, return_inverse=True)
        data.tet_of = hold(local, wp.int32)
        data.tets = hold(tets[used], wp.vec4i)
        data.inverse_edges = hold(np.linalg.inv(edges[used]), types.mat33)
        data.volume = hold(volume[used], real)
        data.corner = hold(inverse.reshape(corners.shape), wp.vec4i)
        data.barycentric = hold(barycentric, wp.vec4d)
        arms = 0.5 * barycentric[:, :, None] * (rest[:, None] - layout.rest[corners])
        data.arm = hold(arms.reshape(-1, 3), types.vec3)
        self._data = data
        self._gradient = wp.zeros(len(nodes), dtype=types.mat33, device=device)
        self._no_query_points = wp.empty(0, dtype=wp.vec3f, device=device)
        self.count = len(corners)

    def place(self, position: wp.array, points_out: wp.array, query_points_out: wp.array | None = None) -> None:
        """position: (node_count,) vec3d of all nodes.  points_out: (point_count,) vec3d; and rounded to vec3f."""
        launch = self._launcher.launch
        query = self._no_query_points if query_points_out is None else query_points_out
        nodes = self._gradient
        launch(self._kernels.average_gradient, len(nodes), [self._data, position], [nodes], work_per_item=24)
        launch(self._kernels.place_points, self.count, [self._data, position, nodes], [points_out, query])


def _tets_around(tets: np.ndarray, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of each of `nodes` (sorted) the tets it is a corner of: offsets and tets."""
    row = np.searchsorted(nodes, tets.ravel())
    row[row == len(nodes)] = 0
    known = nodes[row] == tets.ravel()
    row, tet = row[known], np.repeat(np.arange(len(tets)), 4)[known]
    order = np.argsort(row, kind="stable")
    return np.searchsorted(row[order], np.arange(len(nodes) + 1)), tet[order]
