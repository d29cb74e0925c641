"""mireach: robustly positively invariant sets of neural loops by mixed-integer reachability."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
