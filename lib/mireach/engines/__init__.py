"""Engines: each answers one question, the support function of R_k(F) along V, in its own way."""
