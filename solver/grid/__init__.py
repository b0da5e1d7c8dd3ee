"""Sparse background grid: blocks, B-splines, transfers."""
