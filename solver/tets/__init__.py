"""Elastic bodies of tetrahedra, solved implicitly."""
