"""Rotations, as matrices of column vectors."""

from __future__ import annotations

import numpy as np
from pxr import Gf


def nearest_axes(linear: np.ndarray) -> np.ndarray:
    """(3, 3), orthogonal: the directions of a linear map's axes without its scales; what mirrors still does."""
    u, _, vt = np.linalg.svd(linear)
    return u @ vt


def rotation_of(linear: np.ndarray) -> np.ndarray:
    """(3, 3), a linear map's rotation, proper also of what mirrors: as USD has it, all axes are turned then."""
    axes = nearest_axes(linear)
    return axes * np.sign(np.linalg.det(axes))


def of_quaternion(quaternion: Gf.Quatd) -> np.ndarray:
    """(3, 3)"""
    return np.array(Gf.Matrix3d(quaternion.GetNormalized())).T
