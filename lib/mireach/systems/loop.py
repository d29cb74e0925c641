"""The closed loop x+ = f_PWA(x, Phi(x)) + d (eq. CLSystem of [Teichrib2025])."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..checks import real_array, require_columns, require_kind, whole_number
from .network import MaxoutNetwork
from .pwa import PWASystem

OUTSIDE = 1e-7  # a state this far outside of X counts as outside (relative to the size of X)
AT_REST = 1e-11  # a step that moves a state by less leaves it where it is (relative to the size of X)
ROUNDING = 1e-9  # by which Phi may leave U at a state that is tried (relative to the terms of the row)


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """A piecewise-affine system under a maxout network.

    Parameters
    ----------
    system : PWASystem
    network : MaxoutNetwork or torch module
        A torch module is imported by `MaxoutNetwork.from_torch`. Phi(x) must lie in U for every x in X
        (Sec. II.A); the engines check this exactly, here it is tried at some points.

    Raises
    ------
    ValueError
        If sizes do not match or Phi leaves U.
    """

    system: PWASystem
    network: MaxoutNetwork

    def __post_init__(self):
        require_kind(self.system, PWASystem, "system")
        if not isinstance(self.network, MaxoutNetwork):
            object.__setattr__(self, "network", MaxoutNetwork.from_torch(self.network))
        net, system = self.network, self.system
        if net.input_size != system.state_size:
            raise ValueError(f"the network has {net.input_size} inputs, but x has {system.state_size} entries")
        if net.output_size != system.input_size:
            raise ValueError(f"the network has {net.output_size} outputs, but u has {system.input_size} entries")
        _require_inputs(net, system.input_set, system.state_set.sample(np.random.default_rng(0), 200))

    def with_disturbance(self, disturbance):
        """The same loop with other disturbance sets (one Polytope, or one a mode)."""
        return replace(self, system=self.system.with_disturbance(disturbance))

    def step(self, x, d=None):
        """One step of the loop.

        Parameters
        ----------
        x : array (n,) or (N, n)
            States in X. On a boundary that modes share, the first of them is taken.
        d : array like x, or None
            Disturbance; None is 0.

        Returns
        -------
        array (n,) or (N, n)

        Raises
        ------
        ValueError
            If a state lies outside X.
        """
        x = np.asarray(x, float)
        require_columns(x, self.system.state_size, "x", "the state's size")
        states = np.atleast_2d(x)
        outside = self._outside(states)
        if outside.any():
            raise ValueError(f"x = {states[outside][0].tolist()} lies outside the state set; the dynamics end there")
        after, _ = self._advance(states)
        return (after + (0.0 if d is None else np.asarray(d, float))).reshape(x.shape)

    def simulate(self, x0, steps, disturbances=None):
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
        """
        x0, steps = np.asarray(x0, float), whole_number(steps, "steps", 0)
        require_columns(x0, self.system.state_size, "x0", "the state's size")
        states = np.atleast_2d(x0)
        if disturbances is not None and not isinstance(disturbances, np.random.Generator):
            disturbances = real_array(disturbances, "disturbances", np.ndim(disturbances))
            each, every = (steps, states.shape[1]), (*states.shape[:1], steps, states.shape[1])
            if disturbances.shape not in (each, every):
                raise ValueError(
                    f"disturbances has shape {disturbances.shape}, but must be {each} or {every}, "
                    "or a numpy.random.Generator"
                )
            disturbances = np.broadcast_to(disturbances, every)
        trajectory = np.full((len(states), steps + 1, states.shape[1]), np.nan)
        trajectory[:, 0] = states
        for k in range(steps):
            alive = np.flatnonzero(~self._outside(trajectory[:, k]))
            now = trajectory[alive, k]
            after, modes = self._advance(now)
            if disturbances is None:
                d = 0.0
            elif isinstance(disturbances, np.random.Generator):
                d = self._draw(modes, disturbances)
            else:
                d = disturbances[alive, k]
            trajectory[alive, k + 1] = after + d
        return trajectory.reshape(*x0.shape[:-1], steps + 1, -1)

    def equilibrium(self, start=None, steps=100, tries=50):
        """A fixed point x = f_PWA(x, Phi(x)) of the nominal loop, stable or not.

        Parameters
        ----------
        start : array (n,) or None
            Where the search begins; None is the middle of X.
        steps : int
            Nominal steps towards the fixed point before it is solved for.
        tries : int
            Further starts, drawn from X, for fixed points that repel.

        Returns
        -------
        array (n,)

        Raises
        ------
        ValueError
            If none was found. A loop that jumps at a region boundary need not have any.

        Notes
        -----
        Newton's method on the affine pieces: solve (I - A - B K) x = B g + p on the piece of the current
        point, until the solution lies on that piece, which one step of the loop confirms.
        """
        start = self.system.state_set.chebyshev()[0] if start is None else real_array(start, "start", 1)
        require_columns(start, self.system.state_size, "start", "the state's size")
        path = self.simulate(start, steps)
        path = path[np.isfinite(path).all(axis=1)][-50:]
        starts = [path[-1], path.mean(axis=0), *self.system.state_set.sample(np.random.default_rng(0), tries)]
        for x in starts:
            pieces = set()
            while not self._outside(x[None])[0]:
                if (np.abs(self.step(x) - x) <= AT_REST * self._size).all():
                    return x
                mode = self.system.modes[self._advance(x[None])[1][0]]
                K, g = self.network.affine_piece(x)
                if (mode, K.tobytes(), g.tobytes()) in pieces:  # back on a piece that has sent the search away
                    break
                pieces.add((mode, K.tobytes(), g.tobytes()))
                try:
                    x = np.linalg.solve(np.eye(len(x)) - mode.A - mode.B @ K, mode.B @ g + mode.p)
                except np.linalg.LinAlgError:
                    break
        raise ValueError(
            f"no equilibrium was found from {len(starts)} starts; the nominal loop from {start.tolist()} is at "
            f"{path[-1].tolist()} after {steps} steps and may circle; give the centre as a point"
        )

    @cached_property
    def _size(self):
        """Largest |x| over X, by component: (n,)."""
        return np.abs(self.system.state_set.bounding_box()).max(axis=0)

    def _outside(self, x):
        X = self.system.state_set
        limit = X.h + OUTSIDE * (np.abs(X.H) @ self._size)
        return ~(np.isfinite(x) & (np.nan_to_num(x) @ X.H.T <= limit).all(axis=-1, keepdims=True)).all(axis=-1)

    def _advance(self, x):
        """Nominal successors of states (N, n), and the mode of each: the first whose region contains (x, Phi(x)).

        Where rounding has put a point outside all regions, the nearest one acts.
        """
        if not len(x):
            return x, np.zeros(0, int)
        u = self.network(x)
        modes = self.system.violation(x, u).argmin(axis=-1)
        return self.system.successor(x, u, modes), modes

    def _draw(self, modes, rng):
        """One random disturbance for each entry of `modes`, from its mode's set."""
        d = np.empty((len(modes), self.system.state_size))
        for i in np.unique(modes):
            chosen = modes == i
            d[chosen] = self.system.modes[i].disturbance.sample(rng, int(chosen.sum()))
        return d


def _require_inputs(network, input_set, states):
    """Raise ValueError if Phi leaves U at one of `states` (N, n) by more than rounding."""
    inputs = network(states)
    excess = inputs @ input_set.H.T - input_set.h
    beyond = excess - ROUNDING * (np.abs(inputs) @ np.abs(input_set.H).T + np.abs(input_set.h))
    worst = int(np.argmax(beyond.max(axis=-1)))
    if beyond[worst].max() > 0:
        raise ValueError(input_message(excess[worst].max(), states[worst], inputs[worst]))


def input_message(excess, x, u):
    """What is said where Phi(x) = u leaves U."""
    return (
        f"the network leaves the input set by {excess:.3g}: at x = {x.tolist()} it gives u = {u.tolist()}; "
        "use network.saturate(lower, upper)"
    )
