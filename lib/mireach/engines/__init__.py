"""Engines: algorithms for the support function of R_k(F) along V."""
