"""Strand nodes against moving triangle surfaces."""
