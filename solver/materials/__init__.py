"""Constitutive laws as device functions, one law a file."""
