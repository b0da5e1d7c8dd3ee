"""Strands against strands."""
