"""Polytopes of any dimension and finite unions of them in the plane."""
