"""Surfaces that follow the animation: skinned points, meshes for queries, root frames."""
