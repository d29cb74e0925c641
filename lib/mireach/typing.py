"""Names of types that signatures use; shapes stand in the docstrings."""

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Array", "ArrayLike", "IntArray", "Rational"]

Array: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.integer[Any]]
Rational: TypeAlias = Any  # an fmpq of python-flint, which has no types
