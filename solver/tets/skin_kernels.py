"""Kernels of `skin.py`."""

from functools import cache, partial
from types import SimpleNamespace

import warp as wp


@cache
def skin_kernels(real: type) -> SimpleNamespace:
    """average_gradient and place_points with gradients in `real` (wp.float32 or wp.float64), positions float64."""
    module = f"plait_tet_skin_{real.__name__}"
    vec3 = wp.types.vector(3, real)
    mat33 = wp.types.matrix((3, 3), real)

    @partial(wp.struct, module=module)
    class SkinData:
        """What is constant: `node`, the corners that the skin uses, and the tets around those."""

        node: wp.array(dtype=wp.int32)  # (corner_count,) into all nodes
        first_tet: wp.array(dtype=wp.int32)  # (corner_count + 1,) into tet_of
        tet_of: wp.array(dtype=wp.int32)  # into the four arrays below
        tets: wp.array(dtype=wp.vec4i)  # (tet_count,) into all nodes
        inverse_edges: wp.array(dtype=mat33)  # (tet_count,) [1/m] of the rest edges from corner 0, as columns
        volume: wp.array(dtype=real)  # (tet_count,) [m3]
        corner: wp.array(dtype=wp.vec4i)  # (point_count,) into `node`
        barycentric: wp.array(dtype=wp.vec4d)  # (point_count,)
        arm: wp.array(dtype=vec3)  # (4 point_count,) [m] half b_a (X - X_a)

    @wp.kernel(module=module, enable_backward=False)
    def average_gradient(first: int, skin: SkinData, position: wp.array(dtype=wp.vec3d),
                         gradient_out: wp.array(dtype=mat33)):  # fmt: skip
        """Volume average of the deformation gradient around each corner node."""
        i = first + wp.tid()
        total = mat33()
        volume = real(0.0)
        for k in range(skin.first_tet[i], skin.first_tet[i + 1]):
            t = skin.tet_of[k]
            tet = skin.tets[t]
            origin = position[tet[0]]
            edges = wp.matrix_from_cols(
                vec3(position[tet[1]] - origin), vec3(position[tet[2]] - origin), vec3(position[tet[3]] - origin)
            )
            total += skin.volume[t] * (edges * skin.inverse_edges[t])
            volume += skin.volume[t]
        gradient_out[i] = total / volume

    @wp.kernel(module=module, enable_backward=False)
    def place_points(first: int, skin: SkinData, position: wp.array(dtype=wp.vec3d),
                     gradient: wp.array(dtype=mat33), points_out: wp.array(dtype=wp.vec3d),
                     query_points_out: wp.array(dtype=wp.vec3f)):  # fmt: skip
        p = first + wp.tid()
        corner = skin.corner[p]
        weights = skin.barycentric[p]
        x = wp.vec3d()
        for a in range(4):
            c = corner[a]
            x += weights[a] * position[skin.node[c]] + wp.vec3d(gradient[c] * skin.arm[4 * p + a])
        points_out[p] = x
        if query_points_out.shape[0] > 0:
            query_points_out[p] = wp.vec3f(x)

    types = SimpleNamespace(vec3=vec3, mat33=mat33, SkinData=SkinData)
    return SimpleNamespace(average_gradient=average_gradient, place_points=place_points, types=types)
