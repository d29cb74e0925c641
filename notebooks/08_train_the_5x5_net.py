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
# # Train the 5x5 net for the double integrator
#
# The second case study begins like the first one: we solve an optimal control problem at many states and train a maxout
# network on the solutions. This time the plant is nonlinear, and more than a quarter of the states have no solution.
# The network will be evaluated at these states nevertheless.
#
# **What you will do.** Solve the nonlinear problem for some states. Look at the shipped data set. Train two 5x5 maxout
# networks in the notebook, and compare them where there is no data.
#
# **What you will learn.**
# - what nonlinear model predictive control (NMPC) computes, and what "feasible" means for its data;
# - why the corners contain no data, and why no controller works in most of them;
# - how well a network with 681 parameters imitates the NMPC, and that training determines nothing outside the data.
#
# **What you need.** Notebook 05 (data, training, saturation) and eq. (29), NL_DI, from notebook 07. "Run all" takes
# about half a minute, most of it for training.

# %%
import matplotlib.pyplot as plt
import numpy as np
import torch

import mireach as mr
from mireach import plotting
from mireach.learning.mpc import NonlinearMPC
from mireach.learning.training import train

torch.set_num_threads(1)  # small networks gain nothing from more
case = mr.case_study("double_integrator")
plant, data, X = case.plant, case.data, case.system.state_set
print(data)

# %% [markdown]
# ## 1. The optimal control problem
#
# The plant is the nonlinear double integrator (eq. (29), NL_DI)
#
# $$f(x, u) = \begin{pmatrix} 1 & 1 \\ 0 & 1 \end{pmatrix} x + \begin{pmatrix} 0.5 \\ 1 \end{pmatrix} u
#   + \begin{pmatrix} 0.025 \\ 0.025 \end{pmatrix} x^\top x,
#   \qquad \mathcal{X} = \{\|x\|_\infty \le 6\}, \quad \mathcal{U} = \{|u| \le 2\},$$
#
# and NMPC has a horizon of $N = 10$ steps:
#
# $$\min_{u(0), \dots, u(N-1)} \; 0.8\, x(N)^\top x(N)
#   + \sum_{k=0}^{N-1} \big( 0.8\, x(k)^\top x(k) + 0.1\, u(k)^2 \big)
#   \quad \text{s.t.} \quad x(k+1) = f(x(k), u(k)), \; x(k) \in \mathcal{X}, \; u(k) \in \mathcal{U}.$$
#
# Only the first input of the optimal sequence, $u^\ast(x(0))$, is applied. `NonlinearMPC` solves the problem with
# CasADi and IPOPT. The problem is not convex, so IPOPT finds *local* optima. `NonlinearMPC` uses several starting
# points and keeps the best result.

# %% tags=["nbval-check-output"]
mpc = NonlinearMPC(plant)  # N = 10 and the weights above
starts = {"A": (5.5, -1.5), "B": (-4, 3), "C": (-3, -2), "D": (4, 2.5)}
solutions = {name: mpc.solve(np.array(x, float)) for name, x in starts.items()}
for name, found in solutions.items():
    if found.feasible:
        print(f"{name}: u* = {found.inputs[0, 0]:5.2f}, cost {found.cost:.2f}, {found.solved} of 4 starts solved")
    else:
        print(f"{name}: no feasible input sequence was found")

# %%
fig, (left, right) = plt.subplots(1, 2, figsize=(8, 3.8), layout="constrained")
looks = {"A": (plotting.RED, "-"), "B": (plotting.BLUE, "--"), "C": (plotting.GREEN, "-.")}
for name, (colour, line) in looks.items():
    found = solutions[name]
    left.plot(*found.states.T, line, color=colour, marker="o", markersize=3)
    left.annotate(name, found.states[0], xytext=(4, 4), textcoords="offset points")
    right.stairs(found.inputs[:, 0], color=colour, linestyle=line, linewidth=1.6, label=f"from {name}")
left.plot(*starts["D"], "x", color=plotting.BLACK)
left.annotate("D", starts["D"], xytext=(4, 4), textcoords="offset points")
plotting.label_axes(left, X, "predicted states")
right.axhline(2, color=plotting.GREY), right.axhline(-2, color=plotting.GREY)
right.set(xlabel="$k$", ylabel="$u(k)$", title="predicted inputs")
right.legend()
plt.show()

# %% [markdown]
# **What to see.** All three predicted trajectories begin with an input at its limit (grey lines: $|u| \le 2$) and are
# close to the origin after about six steps. For D the solver found no solution, although D does not look critical.
#
# ## 2. The data set and its gaps
#
# The paper uses a $30 \times 30$ grid over $\mathcal{X}$. The project ships the solutions. As a test, we solve the
# problem again at some of these states.

# %% tags=["nbval-check-output"]
rows = np.random.default_rng(0).choice(len(data), 12, replace=False)
again = np.array([mpc.solve(x).inputs[0] for x in data.states[rows]])
print(f"{len(data)} of {len(data) + len(data.infeasible)} grid states have a solution")
print("12 of them solved again give the same u*:", bool(np.abs(again - data.inputs[rows]).max() < 1e-3))
print(f"|u*| = 2 (on the bound) at {np.mean(np.abs(data.inputs) > 1.999):.0%} of them")

# %% [markdown]
# "Infeasible" means that the solver *found* no feasible plan. This is not a proof. But for many of these states there
# is a proof. One step from $x$ leads to
#
# $$x_1^+ = x_1 + x_2 + 0.5\,u + 0.025\, x^\top x \;\ge\; x_1 + x_2 - 1 + 0.025\, x^\top x$$
#
# for every $u \in \mathcal{U}$. Where the right-hand side exceeds 6, no controller keeps the state in $\mathcal{X}$.
# The same holds where $x_1 + x_2 + 1 + 0.025\,x^\top x < -6$.


# %% tags=["nbval-check-output"]
def drift(x):
    """x1+ without input: x1 + x2 + 0.025 x'x."""
    return x[..., 0] + x[..., 1] + 0.025 * (x**2).sum(axis=-1)


def lost(x):
    """Whether one step leads out of X for every input, because of x1+."""
    return (drift(x) - 1 > 6) | (drift(x) + 1 < -6)


print(f"lost in one step: {lost(data.infeasible).sum()} of the {len(data.infeasible)} states without a plan,")
print(f"                  {lost(data.states).sum()} of the {len(data)} states with one")
print("state D is lost:", bool(lost(np.array(starts["D"]))))

# %% [markdown]
# The next figure shows $u^\ast$ as colour. The hatched parts have no data.


# %%
nodes = np.linspace(-6, 6, 30)
table = np.full((30, 30), np.nan)  # rows: x2, columns: x1
columns, lines = np.rint((data.states.T + 6) / 12 * 29).astype(int)
table[lines, columns] = data.inputs[:, 0]
mesh = np.stack(np.meshgrid(np.linspace(-6, 6, 241), np.linspace(-6, 6, 241)), axis=-1)


def draw_holes(ax, table=table):
    """Hatch the part of X that has no data, and outline where a state is provably lost in one step."""
    ax.contourf(nodes, nodes, np.isnan(table), levels=[0.5, 1.5], colors="none", hatches=["xxx"], zorder=3)
    ax.contour(nodes, nodes, np.isnan(table), levels=[0.5], colors=plotting.BLACK, linewidths=1.2, zorder=3)
    ax.contour(*mesh.T, drift(mesh).T, levels=[-7, 7], colors=plotting.RED, linestyles="--", zorder=4)
    plotting.label_axes(ax, X)


# %%
fig, ax = plt.subplots(figsize=(6.4, 5.4), layout="constrained")
colours = ax.pcolormesh(nodes, nodes, table, cmap="cividis", vmin=-2, vmax=2)
fig.colorbar(colours, label=r"$u^\ast(x)$")
draw_holes(ax)
for name, x in starts.items():
    ax.plot(*x, "o", color="white", markeredgecolor="black", zorder=5)
    ax.annotate(name, x, xytext=(5, 5), textcoords="offset points", color=plotting.BLACK, zorder=6,
                bbox={"facecolor": "white", "edgecolor": "none", "pad": 1})  # fmt: skip
plt.show()

# %% [markdown]
# **What to see.** Most of the plane is dark (full braking, $u^\ast = -2$) or bright ($u^\ast = 2$). The input varies
# only in the narrow band between. The hatched corners have no data. Beyond the dashed red lines every input leads out
# of $\mathcal{X}$ within one step. Between the black and the red line no plan was found either, but the argument about
# one step does not apply there. If these states leave $\mathcal{X}$ at all, they need more than one step.
#
# ## 3. Train two networks
#
# A 5x5 maxout network has $\ell = 5$ hidden layers of $w_i = 5$ neurons with $p_i = 5$ channels each. Training
# minimises over the weights $\theta$ the mean squared error of the *clipped* output over the data,
#
# $$L(\theta) = \frac{1}{639} \sum_i \Big( \min\{\max\{\Phi_\theta(x^{(i)}), -2\}, 2\} - u^\ast(x^{(i)}) \Big)^2 .$$
#
# It then appends two maxout layers that perform the clipping exactly (`saturate`, notebook 05). We train the network
# twice, from two random initialisations, with half as many steps as for the shipped network.

# %%
shape = {"layers": 5, "width": 5, "pool": 5, "lower": -2, "upper": 2, "steps": 3000, "progress": False}
results = [train(data.states, data.inputs, rng=seed, **shape) for seed in (0, 1)]
first, second, shipped = results[0].network, results[1].network, case.network

fig, ax = plt.subplots(figsize=(6.4, 3), layout="constrained")
for result, colour, line in zip(results, (plotting.BLUE, plotting.RED), ("-", "--")):
    ax.semilogy(*result.history.T, line, color=colour, label=f"net {results.index(result) + 1}")
ax.axhline(np.var(data.inputs), color=plotting.GREY, linestyle=":", label="a constant controller")
ax.set(xlabel="step", ylabel=r"$L(\theta)$")
ax.legend()
plt.show()

# %% [markdown]
# **What to see.** The loss falls to about a ten-thousandth of the loss of the best constant controller. Your curves may
# differ from the stored ones: another processor rounds differently, and training amplifies the differences.
#
# How many binary variables does this network need in the mixed-integer model of notebook 02?

# %% tags=["nbval-check-output"]
trained = sum(layer.weight.size + layer.bias.size for layer in shipped.hidden[:-2]) + 5 + 1
print("trained numbers:", trained)
print("binary variables:", shipped.binaries, "= 5 layers x 25 channels + 4 for the saturation")
outputs = shipped(mesh.reshape(-1, 2))
print("output on a fine grid over X within", outputs.min().round(6), "and", outputs.max().round(6))

# %% [markdown]
# ## 4. Compare with the data

# %%
for name, network in {"net 1": first, "net 2": second, "shipped": shipped}.items():
    error = np.abs(network(data.states) - data.inputs)[:, 0]
    mean, worst = np.sqrt((error**2).mean()), data.states[error.argmax()].round(2).tolist()
    print(f"{name:8s} |Phi - u*|: root mean square {mean:.3f}, worst {error.max():.3f} at {worst}")

# %%
error_table = np.full((30, 30), np.nan)
error_table[lines, columns] = np.abs(first(data.states) - data.inputs)[:, 0]
fig, (left, right) = plt.subplots(1, 2, figsize=(8, 3.9), layout="constrained", sharey=True)
field = first(mesh.reshape(-1, 2)).reshape(mesh.shape[:2])
colours = left.pcolormesh(*np.moveaxis(mesh, -1, 0), field, cmap="cividis", vmin=-2, vmax=2)
fig.colorbar(colours, ax=left, label=r"$\Phi(x)$ of net 1", location="bottom")
colours = right.pcolormesh(nodes, nodes, error_table, cmap="Greys")
fig.colorbar(colours, ax=right, label=r"$|\Phi(x) - u^\ast(x)|$ on the data", location="bottom")
for ax in (left, right):
    draw_holes(ax)
right.set_ylabel("")
plt.show()

# %% [markdown]
# **What to see.** Left: the network continues the pattern of the data into the hatched corners, without data to support
# it. Right: the errors (dark) lie in and beside the band. Where the data are $\pm 2$, saturation makes most errors 0.
#
# An imitation may have a small error at every point and still behave differently in the loop. So we simulate the plant
# from A, once with NMPC at every step, and once with the network:

# %%
x, optimal = np.array(starts["A"], float), []
for _ in range(12):
    optimal.append(x)
    x = plant(x, mpc.solve(x).inputs[0])
optimal = np.array(optimal)
imitated = plant.simulate(first, np.array(starts["A"]), 11)
fig, ax = plt.subplots(figsize=(6, 3.6), layout="constrained")
ax.plot(*optimal.T, "o-", color=plotting.BLACK, markersize=6, markerfacecolor="none", label="NMPC")
ax.plot(*imitated.T, "s--", color=plotting.RED, markersize=3, label="net 1, live")
ax.set(xlabel="$x_1$", ylabel="$x_2$")
ax.legend()
plt.show()
print(f"sum of |x(k)|^2 along the path, network / NMPC = {(imitated**2).sum() / (optimal**2).sum():.3f}")

# %% [markdown]
# **What to see.** Both paths nearly coincide. The path of the network does not end exactly at the origin, because
# $\Phi(0)$ is not exactly 0. For this reason the paper certifies that the state reaches a small *set*, not a point.
#
# ## 5. What the network does where it has no data
#
# We cut through $\mathcal{X}$ along the diagonal $x_1 = x_2$, from the lower left to the upper right corner. We look at
# the network *before* the two saturation layers, to see what training leaves undetermined.


# %%
def before_saturation(network):
    """The network without the two layers that `saturate` has appended."""
    raise_up = network.hidden[-2]
    return mr.MaxoutNetwork(network.hidden[:-2], raise_up.weight[:1], raise_up.bias[:1])


t = np.linspace(-6, 6, 400)
diagonal = np.column_stack([t, t])
on_it = data.states[:, 0] == data.states[:, 1]
low, high = data.states[on_it, 0].min(), data.states[on_it, 0].max()
print(f"the data on the diagonal end at x1 = x2 = {low:.2f} and {high:.2f}")

# %%
fig, ax = plt.subplots(figsize=(6.6, 3.8), layout="constrained")
for a, b in ((-6, low), (high, 6)):
    ax.axvspan(a, b, facecolor="none", edgecolor=plotting.GREY, hatch="xx", linewidth=0)
names = {"net 1": (first, plotting.BLUE, "-"), "net 2": (second, plotting.RED, "--"),
         "shipped": (shipped, plotting.GREEN, "-.")}  # fmt: skip
for name, (network, colour, line) in names.items():
    ax.plot(t, before_saturation(network)(diagonal), line, color=colour, linewidth=2, label=name)
ax.plot(data.states[on_it, 0], data.inputs[on_it, 0], "o", color=plotting.BLACK, markersize=5, label=r"$u^\ast$")
ax.axhline(2, color=plotting.BLACK, linewidth=0.8), ax.axhline(-2, color=plotting.BLACK, linewidth=0.8)
ax.set(xlabel="$x_1 = x_2$", ylabel=r"$\Phi$ before saturation", xlim=(-6, 6))
plotting.legend_above(ax, 4)
plt.show()

# %% [markdown]
# **What to see.** On the data (dots) the networks agree, except beyond $\pm 2$, where the loss hardly depends on the
# output. In the hatched parts they differ, and the training data do not favour any of them. Where all outputs lie
# beyond the thin lines at $\pm 2$, saturation makes them equal again. Where one output lies between these lines, the
# applied inputs differ. This is *extrapolation*. How large is the difference over the whole plane?

# %%
for a, b in (("net 1", "net 2"), ("net 1", "shipped"), ("net 2", "shipped")):
    one, other = names[a][0], names[b][0]
    known, unknown = (np.abs(one(x) - other(x)).max() for x in (data.states, data.infeasible))
    print(f"{a} and {b:7s} differ by up to {known:.2f} on the data, {unknown:.2f} at the states without data")

# %% [markdown]
# Which of the two numbers is larger depends on the seed. Run the training with other seeds to see both cases. Do these
# differences matter? Beyond the red lines of section 2 they do not, because no input keeps the state in $\mathcal{X}$:

# %% tags=["nbval-check-output"]
corner = data.infeasible[lost(data.infeasible)]
after = plant.step(shipped, corner)
print("states without data that are lost in one step:", len(corner))
print("of these, kept in X by the shipped network:   ", int(X.contains(after).sum()))

# %% [markdown]
# So no safe set can contain these states, for any controller. But the *search* for a safe set must deal with them,
# because it begins with all of $\mathcal{X}$. The next cell searches for a safe set for the two networks that you have
# just trained:

# %%
for name, (network, _, _) in names.items():
    found = mr.safe_set(mr.ClosedLoop(case.system, network), case.safe_directions)
    print(f"{name:8s} {found.verdict}: after {found.iterations} iterations")

# %% [markdown]
# ## What you saw
#
# - NMPC gives $u^\ast$ only where it finds a plan of 10 steps. In the upper part and in the lower left corner of
#   $\mathcal{X}$ it finds none, and most of those states provably leave $\mathcal{X}$ within one step, for every
#   controller.
# - A 5x5 maxout network learns the rest to within a few hundredths on average, in seconds. It adds 129 binary variables
#   to the mixed-integer analysis.
# - Outside the data, training determines nothing: networks that agree on the data may differ there. Only an analysis of
#   the trained network, not of its training, can show whether this matters.
#
# ## On your own
#
# - Train with `rng=2` and `rng=3`. Does the cut along the diagonal change? Do the safe sets?
# - Train with `steps=300`. Is the loop still certified?
# - Add the states that leave $\mathcal{X}$ to the training data, with $u = 2$ or $u = -2$, whichever brakes. Does the
#   search for a safe set need fewer iterations?
#
# ## Further reading
#
# - D. Teichrib, M. Schulze Darup: *A mixed-integer framework for analyzing neural network-based controllers for
#   piecewise affine systems with bounded disturbances*, ECC 2025, Sec. V.B: this case study, and the references there
#   to the plant and to the optimal control problem.
# - I. J. Goodfellow, D. Warde-Farley, M. Mirza, A. Courville, Y. Bengio: *Maxout networks*, ICML 2013.
# - J. A. E. Andersson, J. Gillis, G. Horn, J. B. Rawlings, M. Diehl: *CasADi: a software framework for nonlinear
#   optimization and optimal control*, Mathematical Programming Computation 11, 2019.
#
# **Next:** notebook 09 finds the safe set and the terminal set of this loop, step by step. **Exercise:** set ex08:
# states that no input keeps in $\mathcal{X}$, the cost by hand, a network of your own, and a controller that the data
# cannot distinguish from the shipped one.
