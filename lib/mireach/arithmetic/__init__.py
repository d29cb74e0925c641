"""Arithmetic that rounds nothing or counts what it rounds: fractions, balls, powers of two."""
