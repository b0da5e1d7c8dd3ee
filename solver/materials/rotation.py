"""The rotation of a deformation gradient, F = R S, without a singular value decomposition in the common path.

R is the proper rotation nearest to F, so that of the principal stretches s1 >= s2 >= |s3| the last carries the
sign of det F. Their sum f = tr S is the largest root of (Lin et al. 2022, 'Isotropic ARAP energy using
Cauchy-Green invariants')
    q(f) = f^4 - 2 I1 f^2 - 8 J f + I1^2 - 4 I2,   I1 = |F|^2, I2 = |cof F|^2, J = det F,
and R = df/dF, by the implicit function theorem
    R = ((f^2 + I1) F - 2 F F^T F + 2 f cof F) / (f^3 - I1 f - 2 J).
The denominator is 2 (s1 + s2)(s2 + s3)(s3 + s1): it vanishes where the nearest rotation is not unique.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

MAX_ITERATIONS = 24
# Where the denominator over f^3 is less (it is .6 at rest), the formula is evaluated in float64, and with less
# again R comes from an SVD: R's error is that of rounding over this squared.
ILL_FLOAT32, ILL_FLOAT64 = 0.1, 3.0e-3


def module_name(real: type) -> str:
    """The Warp module of what the laws share in one precision."""
    return f"plait_materials_{real.__name__}"


@cache
def rotation_functions(real: type) -> SimpleNamespace:
    """Device functions `cofactor` and `rotation` for `real` (wp.float32 or wp.float64)."""
    module = module_name(real)
    mat33 = wp.types.matrix((3, 3), real)
    vec3 = wp.types.vector(3, real)
    converged = 1.0e-4 if real == wp.float32 else 1.0e-10

    @wp.func(module=module)
    def cofactor(F: mat33):
        """dJ/dF = J F^-T, which exists at J = 0 too."""
        a = vec3(F[0, 0], F[1, 0], F[2, 0])
        b = vec3(F[0, 1], F[1, 1], F[2, 1])
        c = vec3(F[0, 2], F[1, 2], F[2, 2])
        return wp.matrix_from_cols(wp.cross(b, c), wp.cross(c, a), wp.cross(a, b))

    @wp.func(module=module)
    def largest_root(I1: real, I2: real, J: real):
        """tr S: Newton's method from sqrt(3 I1) >= tr S, above which q is convex: monotone."""
        f = wp.sqrt(real(3.0) * I1)
        constant = I1 * I1 - real(4.0) * I2
        iterations = wp.int32(0)
        change = f
        while iterations < MAX_ITERATIONS and change > real(converged) * f:
            slope = real(4.0) * (f * (f * f - I1) - real(2.0) * J)
            value = f * (f * (f * f - real(2.0) * I1) - real(8.0) * J) + constant
            change = real(0.0)
            if value > real(0.0) and slope > real(0.0):
                change = value / slope
            f -= change
            iterations += 1
        return f

    @wp.func(module=module)
    def from_invariants(F: mat33):
        """R as above, and the denominator over f^3; meaningless where that is tiny."""
        C = cofactor(F)
        I1 = wp.ddot(F, F)
        J = F[0, 0] * C[0, 0] + F[1, 0] * C[1, 0] + F[2, 0] * C[2, 0]
        f = largest_root(I1, wp.ddot(C, C), J)
        denominator = f * (f * f - I1) - real(2.0) * J
        numerator = (f * f + I1) * F - (real(2.0) * F) * (wp.transpose(F) * F) + (real(2.0) * f) * C
        return numerator / wp.max(denominator, real(1.0e-30)), denominator / wp.max(f * f * f, real(1.0e-30))

    if real == wp.float64:

        @wp.func(module=module)
        def rotation(F: mat33):
            R, well = from_invariants(F)
            if not well > real(ILL_FLOAT64):
                U = mat33()
                V = mat33()
                s = vec3()
                wp.svd3(F, U, s, V)
                R = U * wp.transpose(V)
            return R

    else:
        rotation_in_double = rotation_functions(wp.float64).rotation

        @wp.func(module=module)
        def rotation(F: mat33):
            R, well = from_invariants(F)
            if not well > real(ILL_FLOAT32):
                R = mat33(rotation_in_double(wp.mat33d(F)))
            return R

    return SimpleNamespace(mat33=mat33, vec3=vec3, cofactor=cofactor, rotation=rotation)
