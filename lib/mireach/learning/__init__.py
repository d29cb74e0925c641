"""Optimal control problems, their data sets, and the training of networks."""
