"""The closed loop x+ = f_PWA(x, Phi(x)) + d, eq. (16a), CLSystem of [Teichrib2025]."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checks import real_array, require_columns, require_kind, whole_number
from ..sets.polytope import Polytope
from ..tolerances import AT_REST, OUTSIDE_X, SAMPLED_INPUT
from ..typing import Array, ArrayLike, IntArray
from .network import MaxoutNetwork
from .pwa import PWASystem

SAMPLES = 200  # states of X at which Phi(x) in U is sampled
NOMINAL_STEPS = 100  # of the nominal loop towards a fixed point, before the fixed point is solved for
FURTHER_STARTS = 50  # random states from which fixed points that repel are searched


@dataclass(frozen=True, eq=False, init=False)
class ClosedLoop:
    """A piecewise-affine system under a maxout network, eqs. (3), (16a), UOfK, CLSystem.

    Parameters
    ----------
    system : PWASystem
    network : MaxoutNetwork or torch module
        A torch module is imported by `MaxoutNetwork.from_torch`. Phi(x) must lie in U for every x in X
        (Sec. II.A); the engines check this exactly, here it is checked at sampled states only.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If sizes do not match, a torch module cannot be imported, or Phi leaves U.

    See Also
    --------
    support : How far the loop can go along a direction.
    safe_set : A set that it never leaves.

    Examples
    --------
    >>> from mireach import ClosedLoop, case_study
    >>> case = case_study("pwa")
    >>> loop = ClosedLoop(case.system, case.network)
    >>> loop
    ClosedLoop(4 modes, 2 states, 1 input, 31 binaries)
    >>> loop.simulate([5.0, 5.0], 20)[-1].round(3).tolist()
    [0.0, -0.033]
    """

    system: PWASystem
    network: MaxoutNetwork

    def __init__(self, system: PWASystem, network: MaxoutNetwork | Any) -> None:
        require_kind(system, PWASystem, "system")
        if not isinstance(network, MaxoutNetwork):
            network = MaxoutNetwork.from_torch(network)
        if network.input_size != system.state_size:
            raise ValueError(f"the network has {network.input_size} inputs, but x has {system.state_size} entries")
        if network.output_size != system.input_size:
            raise ValueError(f"the network has {network.output_size} outputs, but u has {system.input_size} entries")
        _require_inputs(network, system.input_set, system.state_set.sample(np.random.default_rng(0), SAMPLES))
        object.__setattr__(self, "system", system)
        object.__setattr__(self, "network", network)

    def __repr__(self) -> str:
        sizes = repr(self.system).removeprefix("PWASystem(").removesuffix(")")
        return f"ClosedLoop({sizes}, {self.network.binaries} binaries)"

    def with_disturbance(self, disturbance: Polytope | list[Polytope] | tuple[Polytope, ...]) -> "ClosedLoop":
        """The same loop with other disturbance sets.

        Parameters
        ----------
        disturbance : Polytope, or a sequence of one Polytope per mode
            In R^n, in units of x.

        See Also
        --------
        PWASystem.with_disturbance
        """
        return replace(self, system=self.system.with_disturbance(disturbance))

    def step(self, x: ArrayLike, d: ArrayLike | None = None) -> Array:
        """One step of the loop, f_PWA(x, Phi(x)) + d.

        Parameters
        ----------
        x : array (n,) or (N, n)
            States in X. On a boundary that modes share, the first of them is taken.
        d : array like x, or None
            Disturbance, in units of x; None is 0.

        Returns
        -------
        array (n,) or (N, n)

        Raises
        ------
        ValueError
            If x does not have n columns, or a state lies outside X.

        Examples
        --------
        >>> from mireach import case_study
        >>> loop = case_study("pwa").loop
        >>> bool((loop.step([1.0, 1.0], [0.1, 0.0]) - loop.step([1.0, 1.0]) == [0.1, 0.0]).all())
        True
        """
        x = np.asarray(x, float)
        require_columns(x, self.system.state_size, "x", "the state's size")
        states = np.atleast_2d(x)
        outside = self._outside(states)
        if outside.any():
            raise ValueError(f"x = {states[outside][0].tolist()} lies outside the state set; the dynamics end there")
        after, _ = self._advance(states)
        return (after + (0.0 if d is None else np.asarray(d, float))).reshape(x.shape)

    def simulate(self, x0: ArrayLike, steps: int, disturbances: np.random.Generator | ArrayLike | None = None) -> Array:
        """Trajectories of the loop.

        Parameters
        ----------
        x0 : array (n,) or (N, n)
        steps : int
        disturbances : None, numpy.random.Generator, or array (steps, n) or (N, steps, n)
            None is the nominal loop; a generator draws from D of the current mode at every step.

        Returns
        -------
        array (steps + 1, n) or (N, steps + 1, n)
            NaN from the first step after a state left X.

        Raises
        ------
        ValueError
            If sizes do not match.

        Examples
        --------
        >>> import numpy as np
        >>> from mireach import case_study
        >>> case_study("pwa").loop.simulate([[5.0, 5.0], [1.0, 0.0]], 20, np.random.default_rng(0)).shape
        (2, 21, 2)
        """
        x0, steps = np.asarray(x0, float), whole_number(steps, "steps", 0)
        require_columns(x0, self.system.state_size, "x0", "the state's size")
        states = np.atleast_2d(x0)
        if disturbances is not None and not isinstance(disturbances, np.random.Generator):
            disturbances = _one_per_trajectory(disturbances, len(states), steps, states.shape[1])
        trajectory = np.full((len(states), steps + 1, states.shape[1]), np.nan)
        trajectory[:, 0] = states
        for k in range(steps):
            alive = np.flatnonzero(~self._outside(trajectory[:, k]))
            after, modes = self._advance(trajectory[alive, k])
            if disturbances is None:
                d = np.zeros(after.shape)
            elif isinstance(disturbances, np.random.Generator):
                d = self._draw(modes, disturbances)
            else:
                d = disturbances[alive, k]
            trajectory[alive, k + 1] = after + d
        return trajectory.reshape(*x0.shape[:-1], steps + 1, -1)

    def equilibrium(self, rng: np.random.Generator | int = 0) -> Array:
        """A fixed point x = f_PWA(x, Phi(x)) of the nominal loop, stable or not.

        Parameters
        ----------
        rng : numpy.random.Generator or int
            Draws further starts, for fixed points that repel.

        Returns
        -------
        array (n,)

        Raises
        ------
        ValueError
            If the search ends without one. A loop that jumps at a region boundary need not have any.

        Notes
        -----
        Newton's method on the affine pieces: solve (I - A - B K) x = B g + p on the piece of the current
        point, until the solution lies on that piece, which one step of the loop confirms. The first starts follow the
        nominal trajectory from the middle of X.

        Examples
        --------
        >>> from mireach import case_study
        >>> loop = case_study("pwa").loop
        >>> x = loop.equilibrium()
        >>> bool(abs(loop.step(x) - x).max() < 1e-9)
        True
        """
        X = self.system.state_set
        middle = X.chebyshev_centre()[0]
        path = self.simulate(middle, NOMINAL_STEPS)
        path = path[np.isfinite(path).all(axis=1)][-50:]
        starts = [path[-1], path.mean(axis=0), *X.sample(np.random.default_rng(rng), FURTHER_STARTS)]
        for start in starts:
            for x in self._newton(start):
                if (np.abs(self.step(x) - x) <= AT_REST * self._size).all():
                    return x
        raise ValueError(
            f"no equilibrium was found from {len(starts)} starts; the nominal loop from {middle.tolist()} is at "
            f"{path[-1].tolist()} after {NOMINAL_STEPS} steps and may circle; give the centre as a point"
        )

    def _newton(self, x: Array) -> Iterator[Array]:
        """Iterates of Newton's method from x, until one lies outside of X or on a piece for the second time."""
        pieces = set()
        while not self._outside(x[None])[0]:
            yield x
            mode = self.system.modes[self._advance(x[None])[1][0]]
            K, g = self.network.affine_piece(x)
            piece = (mode, K.tobytes(), g.tobytes())
            if piece in pieces:
                return
            pieces.add(piece)
            try:
                x = np.linalg.solve(np.eye(len(x)) - mode.A - mode.B @ K, mode.B @ g + mode.p)
            except np.linalg.LinAlgError:
                return

    @cached_property
    def _size(self) -> Array:
        """Largest |x| over X, by component: (n,)."""
        return np.abs(self.system.state_set.bounding_box()).max(axis=0)

    def _outside(self, x: Array) -> NDArray[np.bool_]:
        """Whether states (N, n) lie outside of X, or are not finite: (N,) of bool."""
        X = self.system.state_set
        limit = X.h + OUTSIDE_X * (np.abs(X.H) @ self._size)
        inside = np.all(np.nan_to_num(x) @ X.H.T <= limit, axis=-1)
        return ~(np.all(np.isfinite(x), axis=-1) & inside)

    def _advance(self, x: Array) -> tuple[Array, IntArray]:
        """Nominal successors of states (N, n), and the mode of each: the first whose region contains (x, Phi(x)).

        Where rounding has put a point outside all regions, the nearest one acts.
        """
        if not len(x):
            return x, np.zeros(0, int)
        u = self.network(x)
        modes = self.system.violation(x, u).argmin(axis=-1)
        return self.system.successor(x, u, modes), modes

    def _draw(self, modes: IntArray, rng: np.random.Generator) -> Array:
        """One random disturbance for each entry of `modes`, from its mode's set."""
        d = np.empty((len(modes), self.system.state_size))
        for i in np.unique(modes):
            chosen = modes == i
            d[chosen] = self.system.modes[i].disturbance.sample(rng, int(chosen.sum()))
        return d


def _one_per_trajectory(disturbances: ArrayLike, trajectories: int, steps: int, n: int) -> Array:
    """Disturbances (steps, n) or (trajectories, steps, n) as an array of the latter shape."""
    disturbances = real_array(disturbances, "disturbances", np.ndim(disturbances))
    shared, separate = (steps, n), (trajectories, steps, n)
    if disturbances.shape not in (shared, separate):
        raise ValueError(
            f"disturbances has shape {disturbances.shape}, but must be {shared} or {separate}, "
            "or a numpy.random.Generator"
        )
    return np.broadcast_to(disturbances, separate)


def _require_inputs(network: MaxoutNetwork, input_set: Polytope, states: Array) -> None:
    """Raise ValueError if Phi leaves U at one of `states` (N, n) by more than rounding."""
    inputs = network(states)
    excess = inputs @ input_set.H.T - input_set.h
    beyond = excess - SAMPLED_INPUT * (np.abs(inputs) @ np.abs(input_set.H).T + np.abs(input_set.h))
    worst = int(np.argmax(beyond.max(axis=-1)))
    if beyond[worst].max() > 0:
        raise ValueError(input_message(excess[worst].max(), states[worst], inputs[worst]))


def input_message(excess: float, x: Array, u: Array) -> str:
    """The message of the error where Phi(x) = u leaves U.

    Parameters
    ----------
    excess : float
        By how much, in units of the row of U.
    x : array (n,)
    u : array (m,)
    """
    return (
        f"the network leaves the input set by {excess:.3g}: at x = {x.tolist()} it gives u = {u.tolist()}; "
        "use network.saturate(lower, upper)"
    )
