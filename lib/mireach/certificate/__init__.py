"""Certificates of what was found about a loop, and a checker that shares no code with the rest."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
