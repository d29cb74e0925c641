# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#   kernelspec:
#     display_name: Python 3 (ipykernel)
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Write a maxout network as mixed-integer constraints
#
# **What you will do.** Write one maxout neuron as linear inequalities with binary variables in cvxpy. Do the same for a
# whole network, so that a solver can find the largest output over *all* states of a set. Then break the model twice:
# with a big-$M$ that is too small, and with one that is too large.
#
# **What you will learn.** The purpose of each line of eq. (9), MI_Constraints_NN. How many binaries a network needs.
# Why a big-$M$ that is too small invalidates every proof. Why one that is too large slows the solver down and can also
# make the result wrong. How this package chooses its big-$M$.
#
# **What you need.** Notebook 01 (support functions), and some cvxpy: `cp.Variable`, `cp.Problem`, `solve`.
#
# *Run all* takes about half a minute.

# %%
import cvxpy as cp
import matplotlib.pyplot as plt
import numpy as np

import mireach as mr
from mireach.plotting import BLACK, BLUE, GREEN, ORANGE, RED

# %% [markdown]
# ## 1. One neuron
#
# A maxout neuron with $p$ channels computes the largest of $p$ affine functions of its input (eq. (8), maxout):
#
# $$ g(z) = \max_{1 \le j \le p} z_j, \qquad z = W y + b . $$
#
# Our example has one input $x \in [-3, 3]$ and three channels.

# %%
W, b = np.array([[1.0], [-1.0], [0.2]]), np.array([-1.0, -1.5, 0.5])
xs = np.linspace(-3, 3, 121)
Z = xs[:, None] @ W.T + b  # channels z_j, one per column
fig, ax = plt.subplots(figsize=(6, 3.2), layout="constrained")
for j, (colour, style) in enumerate(zip((BLUE, ORANGE, GREEN), ("--", "-.", ":"))):
    ax.plot(xs, Z[:, j], style, color=colour, linewidth=2, label=f"channel $z_{j + 1}$")
ax.plot(xs, Z.max(axis=1), color=BLACK, linewidth=1.2, label=r"$g(z) = \max_j z_j$")
ax.set(xlabel="$x$", ylabel="$z$")
ax.legend(loc="center left", bbox_to_anchor=(1, 0.5), frameon=False)
plt.show()

# %% [markdown]
# The output of the neuron equals its largest channel: from left to right first $z_2$, then $z_3$, then $z_1$. This is a
# logical *or*: each point of the graph lies on the graph of one of the channels. The graph of $g$ is not convex, so
# linear inequalities alone cannot describe it. With one binary variable per channel they can.
#
# **Eq. (9), MI_Constraints_NN**, for neuron $l$ of layer $i$ and all its channels $j \in \mathcal{A}^{(i)}_l$:
#
# $$ \begin{aligned}
# q^{(i)}_l &\le W^{(i)}_j q^{(i-1)} + b^{(i)}_j + \overline{b}^{(i)} \, (1 - \delta^{(i)}_j), \\
# -q^{(i)}_l &\le -W^{(i)}_j q^{(i-1)} - b^{(i)}_j, \\
# \textstyle\sum_{\jmath \in \mathcal{A}^{(i)}_l} \delta^{(i)}_\jmath &= 1, \qquad \delta^{(i)} \in \{0, 1\}^{p_i w_i}.
# \end{aligned} $$
#
# The second line requires that $q$ is *at least* every channel. For $\delta_j = 1$, the first line requires that $q$ is
# *at most* channel $j$. Together they leave only $q = z_j$, where $z_j$ is the largest channel. For $\delta_j = 0$, the
# first line must not restrict $q$. The constant $\overline{b}$ ensures this: it is a *big-M*. We write $M$ for it, and
# allow a separate value for each channel.


# %%
def maxout_neuron(q, z, M):
    """Constraints (eq. (9), MI_Constraints_NN) for q = largest entry of z (p,); M (p,), one number per channel."""
    delta = cp.Variable(len(M), boolean=True)
    return [
        q <= z + cp.multiply(M, 1 - delta),
        -q <= -z,
        cp.sum(delta) == 1,
    ]


# %% [markdown]
# How large must $M_j$ be? When channel $j$ is not chosen, the first line still requires $q \le z_j + M_j$, and $q$
# equals the largest channel. So the constraint is inactive for every $x$ of the set if and only if
#
# $$ M_j \;\ge\; \max_{x} \Big( \max_i z_i(x) - z_j(x) \Big). $$
#
# This is the largest difference between the largest channel and channel $j$. For one neuron over an interval, the
# maximum is attained at one of the two ends, because differences of affine functions are affine.

# %% tags=["nbval-check-output"]
ends = np.array([-3.0, 3.0])[:, None] @ W.T + b
M_needed = (ends.max(axis=1, keepdims=True) - ends).max(axis=0)
print("M_j that are just big enough:", M_needed.round(4))

# %% [markdown]
# Is the model correct? We fix $x$ and compute the largest and the smallest $q$ that the constraints admit. Both must
# equal $g(x)$. Then the constraints describe exactly the graph of the neuron.

# %% tags=["nbval-check-output"]
x, q = cp.Variable(1), cp.Variable()
at = cp.Parameter(1)
neuron = [*maxout_neuron(q, W @ x + b, M_needed), x == at]
largest, smallest = cp.Problem(cp.Maximize(q), neuron), cp.Problem(cp.Minimize(q), neuron)
for value in (-3.0, -1.0, 0.0, 1.875, 3.0):
    at.value = [value]
    print(
        f"x = {value:6.3f}:  q in [{smallest.solve(solver='HIGHS'):.4f}, {largest.solve(solver='HIGHS'):.4f}],"
        f"  max_j z_j = {(W @ [value] + b).max():.4f}"
    )

# %% [markdown]
# ## 2. A network
#
# A maxout network is a composition of layers of such neurons (eq. (6), NN). The outputs $q^{(i-1)}$ of one layer are
# the inputs of the next, and $\Phi(q^{(0)}) = W^{(\ell+1)} q^{(\ell)} + b^{(\ell+1)}$. The model is built layer by
# layer in the same way. There is one difference: the input set of a later layer is not given. A simple and sound method
# is *interval arithmetic*. It propagates a lower and an upper bound of each quantity through the network. The bounds of
# the channels give $M_j = \max_i \overline{z}_i - \underline{z}_j$.
#
# The network of this notebook has two inputs, two layers of three neurons with three channels each, and weights with
# one decimal. Its output is not limited. The output of a controller must lie in $\mathcal{U}$; part 4 shows how to
# ensure this.

# %%
rng = np.random.default_rng(10)


def tenths(*shape):
    """Random numbers -1.0, -0.9, ..., 1.0."""
    return rng.integers(-10, 11, shape) / 10


net = mr.MaxoutNetwork([mr.Layer(tenths(9, 2), tenths(9), 3), mr.Layer(tenths(9, 3), tenths(9), 3)], tenths(1, 3), [0])
F = mr.Polytope.box([-4, -4], [4, 4])
print(net)


# %%
def interval(W, b, low, high):
    """Limits of W y + b over the box low <= y <= high."""
    centre, radius = (low + high) / 2, (high - low) / 2
    return W @ centre + b - np.abs(W) @ radius, W @ centre + b + np.abs(W) @ radius


def big_M(net, F):
    """M_j = max_i upper limit of z_i - lower limit of z_j by interval arithmetic, one array (w, p) per layer."""
    low, high = F.bounding_box()
    M = []
    for layer in net.hidden:
        z_low, z_high = (z.reshape(-1, layer.pool) for z in interval(layer.weight, layer.bias, low, high))
        M.append(z_high.max(axis=1, keepdims=True) - z_low)
        low, high = z_low.max(axis=1), z_high.max(axis=1)  # of the neurons: eq. (8), maxout
    return M


# %% [markdown]
# With these values of $M_j$, eq. (9), MI_Constraints_NN, for the whole network needs two nested loops, over the layers
# $i$ and the neurons $l$.


# %%
def maxout_network(x, net, M):
    """Phi(x) as a cvxpy expression, and its constraints (eq. (9), MI_Constraints_NN)."""
    q, constraints = x, []  # q^(0) = x
    for layer, M_layer in zip(net.hidden, M):
        z, q = layer.weight @ q + layer.bias, cp.Variable(layer.width)
        for neuron in range(layer.width):
            A_l = slice(layer.pool * neuron, layer.pool * (neuron + 1))
            constraints += maxout_neuron(q[neuron], z[A_l], M_layer[neuron])
    return net.weight @ q + net.bias, constraints


def largest_output(net, F, M, **options):
    """Solve max Phi(x) over x in F (one output): the problem, and the maximiser that the solver returns."""
    x = cp.Variable(net.input_size)
    u, constraints = maxout_network(x, net, M)
    problem = cp.Problem(cp.Maximize(u[0]), [F.H @ x <= F.h, *constraints])
    problem.solve(solver="HIGHS", **options)
    return problem, x.value


# %% [markdown]
# The result is the support function of the image $\Phi(\mathcal{F})$ along $v = 1$. One mixed-integer linear program
# (MILP) gives a statement about infinitely many states. Sampling gives only a lower bound.

# %% tags=["nbval-check-output"]
problem, best = largest_output(net, F, big_M(net, F))
tried = F.sample(np.random.default_rng(0), 20000)
print(f"MILP:              Phi <= {problem.value:.4f}")
print(f"its state, tried:  Phi({np.round(best, 3) + 0.0}) = {net(best)[0]:.4f}")
print(f"20,000 states:     Phi never exceeds the MILP's value: {bool((net(tried) <= problem.value + 1e-6).all())}")

# %% [markdown]
# ### How many binaries?
#
# There is one $\delta_j$ per channel of each neuron, so a network has $\sum_i p_i w_i$ of them. `net.binaries` counts
# them for the given network, including its saturation layers (two neurons with two channels for each entry of $u$).

# %% tags=["nbval-check-output"]
shapes = {"this notebook": net} | {name: mr.case_study(name).network for name in ("pwa", "double_integrator")}
for name, network in shapes.items():
    sizes = " + ".join(f"{layer.pool}*{layer.width}" for layer in network.hidden)
    choices = np.prod([float(layer.pool) ** layer.width for layer in network.hidden])
    print(f"{name:>18}: {sizes} = {network.binaries} binaries, {choices:.1e} choices of channels")

# %% [markdown]
# There are $\prod_i p_i^{w_i}$ choices of channels, far too many to enumerate. Branch and bound avoids the enumeration.
# It solves linear programs in which the binaries may take fractional values, and it prunes every branch whose bound
# shows that it cannot contain the maximum. Its speed depends on the quality of these bounds, and therefore on the
# big-$M$ (part 4).
#
# ## 3. Break it: a big-$M$ that is too small
#
# The paper's constraints have one number $\overline{b}^{(i)}$ per layer; many implementations use one number for
# everything. We take a single $M$ for all rows and decrease it.

# %% tags=["nbval-check-output"]
same = lambda M: [np.full((layer.width, layer.pool), M) for layer in net.hidden]  # noqa: E731
sweep = (30.0, 15.0, 8.0, 6.0, 5.0, 4.0, 3.0, 2.0, 1.0)
claims = {M: largest_output(net, F, same(M)) for M in sweep}
for M, (claim, _) in claims.items():
    print(f"M = {M:4.0f}:  " + (f"Phi <= {claim.value:.4f}" if claim.status == "optimal" else claim.status))

# %% [markdown]
# There is no warning. The solver reports *optimal*, its state is a valid state, and the network has exactly this output
# there. But from some $M$ on, the value is no longer an upper bound. The reason is the following. A state $x$ has a
# feasible $(q, \delta)$ only if, in every neuron, no channel is more than $M$ below the largest channel. All other
# states are removed from $\mathcal{F}$ without a warning. We can compute the $M$ that each state requires:

# %% tags=["nbval-check-output"]
axis = np.linspace(-4, 4, 161)
grid = np.stack(np.meshgrid(axis, axis), axis=-1)
needed, y = np.zeros(grid.shape[:2]), grid
for layer in net.hidden:
    z = layer.channels(y)  # (..., w, p)
    needed = np.maximum(needed, (z.max(axis=-1, keepdims=True) - z).max(axis=(-1, -2)))
    y = z.max(axis=-1)
for M in (4, 6, 8, 15):
    print(f"M = {M:2d} is too small for {np.mean(needed > M):4.0%} of the grid")

# %%
fig, ax = plt.subplots(figsize=(6.6, 4.0), layout="constrained")
cut, colours = {"hatches": ["//", "xx"], "levels": [4, 6, np.inf]}, ["#E69F0040", "#D55E0080"]
patches = ax.contourf(axis, axis, needed, colors=colours, **cut)
ax.contour(axis, axis, needed, levels=[4, 6], colors=BLACK, linestyles=["-", "--"])
handles, _ = patches.legend_elements()
names = ["states that $M = 4$ cuts off", "states that $M = 4$ and $M = 6$ cut off"]
for (M, mark), name in zip(((15.0, "*"), (6.0, "s"), (4.0, "o")), ("all of", "$M = 6$", "$M = 4$")):
    style = {"color": BLUE, "markersize": 15 if mark == "*" else 9, "markeredgecolor": "white", "clip_on": False}
    handles += ax.plot(*claims[M][1], mark, linestyle="none", **style)
    names += [rf"largest $\Phi$ in {name} $\mathcal{{F}}$" if mark == "*" else f"what {name} finds"]
ax.set(xlabel="$x_1$", ylabel="$x_2$", aspect="equal")
ax.legend(handles, names, loc="upper left", bbox_to_anchor=(1.02, 1), frameon=False, handleheight=1.6)
plt.show()

# %% [markdown]
# With $M = 4$ the constraints have no solution at any hatched state. With $M = 6$ they have none at the densely hatched
# states. The star marks the state where $\Phi$ is largest. It lies in the densely hatched region, so both models return
# only the maximum over the remaining states. $M = 8$ still gives the right value by chance: it also removes states, but
# not the star.
#
# In a reachability analysis this is the worst kind of error. The set $\overline{\mathcal{R}}_1(\mathcal{F})$ is built
# from such maxima. If a maximum is too small, the set is too small. The result may then be *"RPI: proven"* for a set
# that trajectories leave. A big-$M$ that is too small is **unsound**.
#
# ## 4. The cost of a big-$M$ that is too large
#
# ### It makes the relaxation loose
#
# Branch and bound starts from the *relaxation*: $\delta \in [0, 1]$ instead of $\{0, 1\}$. We apply it to the neuron of
# part 1. For every $x$, the relaxed constraints admit an interval of values $q$. Its lower end is $g(x)$. Its upper end
# is:


# %%
def relaxed_top(M):
    """Largest q of the relaxed neuron for each x of a grid."""
    q, x, tops = cp.Variable(), cp.Parameter(1), []
    problem = cp.Problem(cp.Maximize(q), maxout_neuron(q, W @ x + b, M))
    for x.value in np.linspace(-3, 3, 25)[:, None]:
        tops.append(problem.solve(solver="HIGHS", solve_relaxation=True))
    return np.array(tops)


fig, ax = plt.subplots(figsize=(6.4, 3.4), layout="constrained")
ax.plot(xs, Z.max(axis=1), color=BLACK, linewidth=2, label="the neuron")
for factor, style, colour in ((1, "-", BLUE), (1.5, "--", ORANGE), (3, "-.", RED)):
    ax.plot(
        np.linspace(-3, 3, 25),
        relaxed_top(factor * M_needed),
        style,
        color=colour,
        label=f"big-$M$: {factor:g} times the needed",
    )
ax.set(xlabel="$x$", ylabel="$q$", ylim=(-0.5, 7))
ax.legend(loc="center left", bbox_to_anchor=(1, 0.5), frameon=False)
plt.show()

# %% [markdown]
# With $\delta$ relaxed, everything between the black graph and a coloured line is feasible. Even the smallest sound $M$
# leaves a gap, and the gap grows with $M$. In the network, the gaps of the first layer are inputs of the second layer.
# The initial bound of branch and bound then becomes useless:

# %% tags=["nbval-check-output"]
for factor in (1, 10, 100, 1000):
    relaxed, _ = largest_output(net, F, [factor * M for M in big_M(net, F)], solve_relaxation=True)
    print(f"{factor:5d} M:  relaxation Phi <= {relaxed.value:10.1f}   (true: {problem.value:.3f})")

# %% [markdown]
# The true value is 1.763, but the solver starts from the bound 13.1, or from 14,491. (The presolve of HiGHS tightens
# the big-$M$ of such models by itself, so it still solves small networks quickly. In larger networks the bounds
# determine the time; see part 5.)
#
# ### It can make the result wrong
#
# A solver works with floating-point numbers. HiGHS accepts a binary within $10^{-6}$ of 0 or 1 as integral. In
# $q \le z_j + M (1 - \delta_j)$ this tolerance is multiplied by $M$. The next cell shows such a point of our neuron,
# chosen by hand, at $x = 0$ for $M = 10^6$. Within the tolerance it is integral, it satisfies every row, and its $q$ is
# twice the output of the neuron.

# %% tags=["nbval-check-output"]
M, x0, q0 = 1e6, np.array([0.0]), 1.0
delta0 = np.array([5e-7, 0, 1 - 5e-7])
z0 = W @ x0 + b
violation = max((q0 - z0 - M * (1 - delta0)).max(), (z0 - q0).max(), abs(delta0.sum() - 1))
print(f"every row holds to 1e-9:         {violation <= 1e-9}")
print(f"furthest from an integer:        {np.abs(delta0 - delta0.round()).max():.1e}")
print(f"q = {q0}, but the neuron gives:   {z0.max():.1f}")

# %% [markdown]
# Does a solver really return such a point? It may, if the objective improves. We saturate the network and solve again:
# two more layers clip the output to $[-2, 2]$. (Sec. II.A requires $\Phi(x) \in \mathcal{U}$.)

# %%
controller = net.saturate(-2.0, 2.0)
print("   big-M        solver   claims Phi <=   Phi at its state   furthest binary from 0 or 1")
for factor in (1, 1e3, 1e6, 1e7, 1e8):
    claim, state = largest_output(controller, F, [factor * M for M in big_M(controller, F)])
    off = max(np.abs(v.value - np.round(v.value)).max() for v in claim.variables() if v.attributes["boolean"])
    print(f"{factor:8.0e}  {claim.status:>12} {claim.value:15.4f} {controller(state)[0]:18.4f} {off:30.1e}")

# %% [markdown]
# With the version of HiGHS that ran here, the rows with a large $M$ give a wrong result. The solver reports 2 as
# *optimal*, but the network has a different output at the state that the solver returns. This error is on the safe
# side, because the tolerance only enlarges the feasible set. But an invalid witness refutes nothing. And if the sets
# are too large, the method may fail although a safe set exists. Three rules follow:
#
# - Compute $M$ from bounds, row by row. Never choose "some large number".
# - *Replay* the solver's result: evaluate the true network at the returned state. This package does so for every
#   witness.
# - Know your solver's tolerances, and multiply them by $M$.
#
# ## 5. How this package chooses its big-$M$
#
# The engine `milp` builds the same constraints, but computes the smallest $M$ that it can prove. The option
# `"interval"` uses the bounds of part 2. The option `"lp"` uses linear programs: it takes the constraints of the layers
# before, relaxes their binaries, and maximises each difference of channels $z_i - z_j$ over $\mathcal{F}$. If a channel
# is proven never to be the largest, it gets no binary. The same holds for a mode that is proven never to be active. We
# compare both for the 5x5 network of the second case study in closed loop with its plant, over the box
# $\mathcal{F} = \frac{1}{2} \mathcal{X}$. (The nine modes of the plant add nine binaries; see notebook 03.)

# %%
from mireach.engines.milp.formulation import build

loop = mr.case_study("double_integrator").loop
half = loop.system.state_set.scale(0.5)
v = np.array([[1.0, 0.0]])
print(f"by the paper's count: {loop.network.binaries + len(loop.system.modes)} binaries")
for bounds in ("interval", "lp"):
    model = build(loop, half, 1, bounds)
    start = model.program.maximize(model.states[1], v[0]).value  # the relaxation
    print(f'bounds="{bounds}": {len(model.binaries)} binaries, relaxation {start:.4f}')

# %% [markdown]
# The bounds are tighter for smaller sets. The engine uses this: it bisects $\mathcal{F}$ repeatedly
# (`mr.Milp("split")`), unless you request one model for the whole set (`mr.Milp("whole")`). On a small box only a few
# channels can be the largest. Boxes that cannot contain the maximum are dropped, and each remaining box needs only a
# few binaries. We compare the run times:

# %%
from time import perf_counter

ways = {
    "one model, interval": mr.Milp("whole", bounds="interval"),
    "one model, lp": mr.Milp("whole", bounds="lp"),
    "split": mr.Milp("split"),  # the default of engine="milp"
    "cells": mr.Cells(),
}
values = []
for name, engine in ways.items():
    begin = perf_counter()
    values.append(mr.support(loop, half, v, engine=engine).bound[0])
    print(f"{name:>19}: h(v) <= {values[-1]:.6f} in {perf_counter() - begin:.2f} s")

# %% tags=["nbval-check-output"]
print("all four agree to 1e-5:", bool(np.ptp(values) < 1e-5))

# %% [markdown]
# All four give the same maximum. From the first to the third, the number of binaries decreases and the initial bound
# becomes tighter. The fourth is a different engine: it divides the plane into the cells on which the loop is affine
# (notebook 10), and needs neither a big-$M$ nor binaries. The two engines are independent, so each one checks the
# other.
#
# ## What you saw
#
# - A maxout neuron needs three lines of constraints: $q$ is at least every channel, $q$ is at most the chosen channel,
#   and exactly one channel is chosen.
# - A network needs $\sum_i p_i w_i$ binaries. The optimum of the MILP is a statement about *all* states of a set.
# - The smallest sound $M_j$ is the largest amount by which channel $j$ is below the largest channel. With a smaller
#   $M_j$, states are lost without a warning, the maximum may be too small, and a proof that uses it is invalid. With a
#   larger $M_j$, the relaxation is loose. With a much larger one, the solver's tolerance times $M$ becomes an error in
#   the network's output.
# - Bounds over the current set $\mathcal{F}$, instead of over $\mathcal{X}$, save binaries and tighten the relaxation.
#
# ## On your own
#
# - Write a ReLU network with this notebook's functions (channels $z$ and $0$). How many of its binaries can you save?
# - Replace `interval` by two small LPs for each channel difference, over the relaxation of the layers before. How much
#   smaller do the $M_j$ of the second layer become?
# - Shrink `F` step by step to the origin. When does the first binary become superfluous?
# - Use another solver that cvxpy supports (`cp.installed_solvers()`) in part 4. Which of them returns a wrong value,
#   and when?
#
# **Exercise:** `exercises/ex02`. **Next:** notebook 03 writes the plant in the same way.
#
# ## Further reading
#
# - [Teichrib2025], Sec. II.A: the constraints, and their sources.
# - [Goodfellow2013]: maxout networks.
# - R. Anderson, J. Huchette, W. Ma, C. Tjandraatmadja, J. P. Vielma: *Strong mixed-integer programming formulations for
#   trained neural networks*, Mathematical Programming 183, 2020: formulations that are tighter than a good big-$M$.
# - V. Tjeng, K. Xiao, R. Tedrake: *Evaluating robustness of neural networks with mixed integer programming*, ICLR 2019:
#   how bounds of neurons are tightened step by step.
