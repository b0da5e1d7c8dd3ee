"""Flesh's geometry: a skin's tets, what lies where in them, and what of them is bone. No USD here."""
