from .fit import ErrorProof, PWAFit, error_directions, fit_pwa, prove_error

__all__ = [
    "ErrorProof",
    "PWAFit",
    "error_directions",
    "fit_pwa",
    "prove_error",
]
