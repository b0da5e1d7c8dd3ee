"""Rotations, as matrices of column vectors."""

from __future__ import annotations

import numpy as np
from pxr import Gf


def rotation_of(linear: np.ndarray) -> np.ndarray:
    """(3, 3), the rotation nearest to a linear map (its polar part), a proper one also of what mirrors."""
    u, _, vt = np.linalg.svd(linear)
    return u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt


def of_quaternion(quaternion: Gf.Quatd) -> np.ndarray:
    """(3, 3)"""
    return np.array(Gf.Matrix3d(quaternion.GetNormalized())).T
