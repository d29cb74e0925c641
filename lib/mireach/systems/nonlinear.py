"""Nonlinear systems x+ = f(x, u) with constraints, eq. (28), f of [Teichrib2025]."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..checks import require_columns, require_kind, whole_number
from ..sets.polytope import Polytope
from ..typing import Array, ArrayLike

Controller = Callable[[Array], Array]


@dataclass(frozen=True, eq=False)
class NonlinearSystem:
    """x+ = f(x, u), eq. (28), f, with constraints x in X and u in U.

    Parameters
    ----------
    f : callable
        f(x, u) -> n numbers; x and u are indexable. Arithmetic, whole powers and numpy's exp, log,
        sin, cos, tanh and sqrt may be used, so that f can be evaluated on numbers, arrays and balls.
    state_set : Polytope
        X in R^n.
    input_set : Polytope
        U in R^m.

    Raises
    ------
    TypeError
        If f is not callable, or a set is not a Polytope.

    See Also
    --------
    fit_pwa : A piecewise-affine approximation with a proven error.
    PWASystem : The systems that are analysed.

    Examples
    --------
    >>> from mireach import NonlinearSystem, Polytope
    >>> X, U = Polytope.box([-6, -6], [6, 6]), Polytope.box([-2], [2])
    >>> plant = NonlinearSystem(lambda x, u: (x[0] + x[1], x[1] + u[0] + 0.1 * x[0] ** 2), X, U)
    >>> plant
    NonlinearSystem(2 states, 1 input)
    >>> plant([1.0, 2.0], [0.5]).tolist()
    [3.0, 2.6]
    """

    f: Callable[[Any, Any], Any]
    state_set: Polytope
    input_set: Polytope

    def __post_init__(self) -> None:
        if not callable(self.f):
            raise TypeError(f"f must be a function f(x, u); got {type(self.f).__name__} {self.f!r:.60}")
        require_kind(self.state_set, Polytope, "state_set")
        require_kind(self.input_set, Polytope, "input_set")

    def __repr__(self) -> str:
        n, m = self.state_set.dimension, self.input_set.dimension
        return f"NonlinearSystem({n} state{'s' * (n > 1)}, {m} input{'s' * (m > 1)})"

    def __call__(self, x: ArrayLike, u: ArrayLike) -> Array:
        """f(x, u).

        Parameters
        ----------
        x : array (n,) or (N, n)
        u : array (m,) or (N, m)

        Returns
        -------
        array (n,) or (N, n)

        Raises
        ------
        ValueError
            If x does not have n columns or u not m.
        """
        x, u = np.asarray(x, float), np.asarray(u, float)
        require_columns(x, self.state_set.dimension, "x", "the state's size")
        require_columns(u, self.input_set.dimension, "u", "the input's size")
        values = self.f(np.moveaxis(x, -1, 0), np.moveaxis(u, -1, 0))
        return np.stack(np.broadcast_arrays(*values), axis=-1)

    def step(self, controller: Controller, x: Array) -> Array:
        """f(x, controller(x)) for x (n,) or (N, n).

        Parameters
        ----------
        controller : callable
            (n,) -> (m,) and (N, n) -> (N, m), such as a MaxoutNetwork.
        x : array (n,) or (N, n)

        Returns
        -------
        array (n,) or (N, n)
        """
        return self(x, controller(x))

    def simulate(self, controller: Controller, x0: ArrayLike, steps: int) -> Array:
        """Trajectories of x+ = f(x, controller(x)).

        Parameters
        ----------
        controller : callable
            (n,) -> (m,) and (N, n) -> (N, m), such as a MaxoutNetwork.
        x0 : array (n,) or (N, n)
        steps : int

        Returns
        -------
        array (steps + 1, n) or (N, steps + 1, n)
            A trajectory goes on outside of X.

        See Also
        --------
        ClosedLoop.simulate : Of a piecewise-affine system, with disturbances.

        Examples
        --------
        >>> from mireach import NonlinearSystem, Polytope
        >>> box = Polytope.box([-4], [4])
        >>> NonlinearSystem(lambda x, u: [x[0] ** 2 + u[0]], box, box).simulate(lambda x: -x, [3.0], 2).tolist()
        [[3.0], [6.0], [30.0]]
        """
        path = [np.asarray(x0, float)]
        for _ in range(whole_number(steps, "steps", 0)):
            path.append(self.step(controller, path[-1]))
        return np.stack(path, axis=-2)
