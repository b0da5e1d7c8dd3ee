"""Linear solves: sparse rows, conjugate gradients, coarse correction."""
