"""Reachable sets, RPI sets, both theorems, and maximal sets, all built on the support function."""
