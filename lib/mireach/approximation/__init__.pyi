from .error_bound import ErrorProof, error_directions, prove_error
from .fit import PWAFit, fit_pwa

__all__ = [
    "ErrorProof",
    "PWAFit",
    "error_directions",
    "fit_pwa",
    "prove_error",
]
