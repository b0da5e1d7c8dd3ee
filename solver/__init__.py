"""The solver: scenes of numpy arrays in, moved nodes out. Knows nothing of USD."""
