"""Piecewise-affine approximations of nonlinear systems, and proofs of their error."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
