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
# # Certify your own system and your own network
#
# **What you will do.** Replace the paper's plant and network by other plants and ReLU networks. The first plant is
# piecewise affine, and its mode depends on the input. The second is a nonlinear pendulum. The third has three states.
# For each, compute the safe set, the terminal set, and a summary of what is proven.
#
# **What you will learn.** Which five things `mireach` needs. How a nonlinear plant becomes a piecewise-affine one with
# a *proven* error. What to do when there is no safe set. What the error messages look like.
#
# **What you need.** Notebook 00; the others explain what the calls do. PyTorch for the network. "Run all" takes about
# half a minute, including the training of one network.

# %%
from itertools import pairwise

import matplotlib.pyplot as plt
import numpy as np
import torch
from scipy.linalg import solve_discrete_are

import mireach as mr
from mireach import plotting

torch.set_num_threads(1)
generator = torch.manual_seed(0)

# %% [markdown]
# ## 1 The template: five things to change
#
# The loop is $x(k+1) = A^{(i)} x(k) + B^{(i)} u(k) + p^{(i)} + d(k)$ if $(x(k), u(k)) \in \mathcal{P}^{(i)}$, with
# $d(k) \in \mathcal{D}^{(i)}$ and $u(k) = \Phi(x(k))$ (eq. (1), SysWithDis; eq. (13), dinDi; eq. (3), UOfK). The
# example is a mass on a spring with a damper ($x_1$ position, $x_2$ velocity). Its actuator pulls ($u \le 0$) twice as
# hard as it pushes ($u \ge 0$). So the mode depends on the *input*:
#
# $$ \mathcal{P}^{(1)} = \{(x, u) : -u \le 0\}, \qquad \mathcal{P}^{(2)} = \{(x, u) : u \le 0\} . $$
#
# A region is a `Polytope` in $(x, u)$. Its rows have $n + m$ entries, here $(0, 0, -1)$ and $(0, 0, 1)$.

# %%
X = mr.Polytope.box([-2, -2], [2, 2])  # 1: state constraints
U = mr.Polytope.box([-1], [1])  # 2: input constraints


def spring(bound):
    """The plant, with |d|_inf <= bound."""
    A = [[1.0, 0.4], [-0.4, 0.7]]
    D = mr.Polytope.box([-bound, -bound], [bound, bound])  # 3: disturbance set (one per mode, if they differ)
    pushes, pulls = mr.Polytope([[0, 0, -1]], [0]), mr.Polytope([[0, 0, 1]], [0])
    modes = [  # 4: A, B, p, region and D of every mode
        mr.Mode(A, [[0.0], [0.4]], [0, 0], pushes, D),
        mr.Mode(A, [[0.0], [0.8]], [0, 0], pulls, D),
    ]
    return mr.PWASystem(modes, X, U)


# %% [markdown]
# The fifth thing is the controller: any `torch.nn.Sequential` of Linear, ReLU, LeakyReLU and this package's Maxout. A
# ReLU is a maxout neuron with the two channels $(z, 0)$, so the paper's method applies to it. If you have no network
# yet, write a known control law as a network. A saturated linear law is a ReLU network with two neurons,
#
# $$ u = \max(-c, \min(K x, c)) = -c + \max(K x + c, 0) - \max(K x - c, 0) . $$


# %%
def saturated_law(K, c):
    """The law u = K x, saturated at |u| <= c, as a torch module."""
    K = torch.tensor(K, dtype=torch.float64).reshape(1, -1)
    first, last = torch.nn.Linear(K.shape[1], 2).double(), torch.nn.Linear(2, 1).double()
    with torch.no_grad():
        first.weight.copy_(torch.cat([K, K]))
        first.bias.copy_(torch.tensor([c, -c]))
        last.weight.copy_(torch.tensor([[1.0, -1.0]]))
        last.bias.fill_(-c)
    return torch.nn.Sequential(first, torch.nn.ReLU(), last)


def lqr(A, B, Q, R):
    """K of u = K x that minimises the sum of x'Qx + u'Ru."""
    P = solve_discrete_are(A, B, Q, R)
    return -np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)


K = lqr(np.array([[1.0, 0.4], [-0.4, 0.7]]), np.array([[0.0], [0.6]]), np.eye(2), 0.5 * np.eye(1))
module = saturated_law(K, 1.0)  # 5: your network

# %% [markdown]
# From here on nothing depends on the example. `saturate` adds the projection onto $\mathcal{U}$ as two maxout layers.
# (Here it changes nothing, but a trained network needs it.) The summary prints what is proven, and what the proof rests
# on.


# %%
def certify(loop, C, engine=None, **options):
    """Safe set, terminal set, Theorem 1, and two checks that do not rely on how they were found."""
    safe = mr.safe_set(loop, C, engine)
    print(f"safe set: {safe.verdict} after {safe.iterations} iterations")
    if safe.set is None:
        print(safe.reason)
        return safe, None
    terminal = mr.terminal_set(loop, safe, C, engine=engine, **options)
    for name, P in (("F_max", safe.set), ("R_min", terminal.set)):
        lower, upper = P.bounding_box()
        print(f"  {name} spans {np.round(lower, 2) + 0.0} to {np.round(upper, 2) + 0.0};", end=" ")
        print(f"RPI by the MILP: {mr.check_rpi(loop, P, engine='milp').verdict}")
    print(f"  every state of F_max is in R_min after {terminal.steps} steps;", end=" ")
    print(f"stopping rule {terminal.criterion}, Theorem 1 (alpha > 1) {terminal.stable}")
    return safe, terminal


def entered(loop, safe, terminal, count=200):
    """How many disturbed trajectories stay in F_max, and are in R_min after k-bar steps."""
    rng = np.random.default_rng(0)
    paths = loop.simulate(safe.set.sample(rng, count), terminal.steps + 10, rng)
    inside = safe.set.contains(paths, tol=1e-9).all()
    return bool(inside and terminal.set.contains(paths[:, terminal.steps :], tol=1e-9).all()), paths


# %% tags=["nbval-check-output"]
C = mr.directions(16)  # the template; more directions find a safe set more often
loop = mr.ClosedLoop(spring(0.1), mr.MaxoutNetwork.from_torch(module).saturate(-1, 1))
safe, terminal = certify(loop, C)
fine, paths = entered(loop, safe, terminal)
print(f"200 disturbed trajectories stay in F_max and end in R_min: {fine}")


# %%
def draw(ax, loop, safe, terminal, paths):
    """Safe set, terminal set and a few trajectories."""
    plotting.draw_set(ax, safe.set, **plotting.SAFE, label=r"$\mathcal{F}_{\max}$")
    plotting.draw_set(ax, terminal.set, **plotting.TERMINAL, label=r"$\overline{\mathcal{R}}_{\min}$")
    style = {"color": plotting.BLACK, "linewidth": 0.6, "marker": ".", "markersize": 2, "alpha": 0.6}
    plotting.draw_trajectories(ax, paths[:12, :16], **style, label="12 disturbed trajectories, 15 steps")
    plotting.label_axes(ax, loop.system.state_set)
    plotting.legend_above(ax, 3)


figure, ax = plt.subplots(figsize=(5.4, 5.2), layout="constrained")
draw(ax, loop, safe, terminal, paths)
plt.show()

# %% [markdown]
# For every disturbance, a trajectory that starts in the green set never leaves it and ends in the hatched set. Neither
# set is symmetric, because the actuator is not.

# %% [markdown]
# ## 2 Swap in a network that you train
#
# Any training method will do, because `mireach` uses only the weights. Here a ReLU network with two hidden layers of
# eight neurons imitates the law above at 2000 random states. Training takes a few seconds. Only the lines of item 5
# change.

# %%
states = torch.rand(2000, 2, dtype=torch.float64) * 4 - 2
target = module(states).detach()
mine = torch.nn.Sequential(
    torch.nn.Linear(2, 8), torch.nn.ReLU(), torch.nn.Linear(8, 8), torch.nn.ReLU(), torch.nn.Linear(8, 1)
).double()
optimizer = torch.optim.Adam(mine.parameters(), lr=0.01)
for _ in range(1000):
    optimizer.zero_grad()
    loss = ((mine(states) - target) ** 2).mean()
    loss.backward()
    optimizer.step()
print(f"mean squared error {loss.item():.1e}")

# %%
network = mr.MaxoutNetwork.from_torch(mine).saturate(-1, 1)
print(network)
own_loop = mr.ClosedLoop(spring(0.1), network)
own_safe, own_terminal = certify(own_loop, C)

# %%
if own_safe.set is not None:
    figure, ax = plt.subplots(figsize=(5.4, 5.2), layout="constrained")
    draw(ax, own_loop, own_safe, own_terminal, entered(own_loop, own_safe, own_terminal)[1])
    outline = {"facecolor": "none", "edgecolor": plotting.RED, "linestyle": "--", "linewidth": 1.4}
    plotting.draw_set(ax, safe.set, **outline, label="those of the law it imitates")
    plotting.draw_set(ax, terminal.set, **outline)
    plotting.legend_above(ax, 2)
    plt.show()

# %% [markdown]
# The dashed outlines are the sets of the law. A network that imitates the law well has nearly the same sets. The
# difference depends on the training, so your numbers may differ a little from the ones stored here. Save the certified
# network with `network.save("mine.json")`: a network that is read back has exactly the same floats.

# %% [markdown]
# ## 3 A nonlinear plant: fit, prove the error, certify
#
# The plant is an inverted pendulum with friction, with angle $x_1$, velocity $x_2$, torque $u$, and sampling time
# $h = 0.2$:
#
# $$ f(x, u) = \begin{pmatrix} x_1 + h x_2 \\ x_2 + h\,(\sin x_1 - 0.5\, x_2 + u) \end{pmatrix} . $$
#
# `fit_pwa` fits $A^{(i)} x + B^{(i)} u + p^{(i)}$ in every region. It *proves* a bound on the error over all of
# $\mathcal{X} \times \mathcal{U}$, by branch and bound in ball arithmetic. Write $f$ with numpy functions, so that it
# can be evaluated for balls as well as for numbers.

# %%
h = 0.2


def pendulum(x, u):
    """f(x, u), one entry per state."""
    return x[0] + h * x[1], x[1] + h * (np.sin(x[0]) - 0.5 * x[1] + u[0])


plant = mr.NonlinearSystem(pendulum, mr.Polytope.box([-1, -1], [1, 1]), mr.Polytope.box([-1.5], [1.5]))
edges = np.linspace(-1, 1, 4)  # three strips of the angle; sin is the only nonlinearity
strips = [mr.Polytope([[1, 0, 0], [-1, 0, 0]], [high, -low]) for low, high in pairwise(edges)]
fit = mr.fit_pwa(plant, strips, error="ball")

# %% tags=["nbval-check-output"]
print(f"proven: |f - f_PWA| <= {fit.proven_error:.4f} over all of X x U")
print(f"largest error met at the points of the fit: {fit.max_error:.4f}")
for i, mode in enumerate(fit.modes, start=1):
    print(f"mode {i}: A = {np.round(mode.A, 3).tolist()}, p = {(np.round(mode.p, 3) + 0.0).tolist()}")

# %% [markdown]
# The disturbance set is then $\mathcal{D} = \{d : |d|_\infty \le \text{proven error}\}$. With Lemma 5, RkNonlinear, and
# Theorem 2 the results hold for the pendulum itself. We enlarge the set a little, for effects that the model does not
# include:

# %% tags=["nbval-check-output"]
radius = fit.proven_error + 0.01
system = fit.system().with_disturbance(mr.Polytope.box([-radius, -radius], [radius, radius]))
K = lqr(np.array([[1, h], [h, 1 - 0.5 * h]]), np.array([[0], [h]]), np.eye(2), 0.5 * np.eye(1))
pendulum_loop = mr.ClosedLoop(system, mr.MaxoutNetwork.from_torch(saturated_law(K, 1.5)).saturate(-1.5, 1.5))
safe, terminal = certify(pendulum_loop, mr.directions(8))
bounded = mr.ultimately_bounded(plant, pendulum_loop, safe, terminal)
print(f"Theorem 2: {bounded.verdict}")
for words, holds in bounded.conditions.items():
    print(f"  {words}: {holds}")

# %%
start = safe.set.vertices()[safe.set.vertices()[:, 0].argmin()] + 0.0
path = plant.simulate(pendulum_loop.network, start, terminal.steps)
reach = mr.outer_reach(pendulum_loop, mr.Polytope.box(start, start), mr.directions(8), 12)[1:]
figure, ax = plt.subplots(figsize=(7.6, 5.2), layout="constrained")
plotting.plot_vector_field(
    ax, system, safe, terminal, lambda x: plant.step(pendulum_loop.network, x), path, reach, arrows=24
)
plt.show()

# %% [markdown]
# This is Figure 3 of the paper for the pendulum. Arrows are the steps of the *nonlinear* loop. The red line is one of
# its trajectories, and its first states lie in the small reachable sets drawn around them. The safe set extends to the
# angle limits $\pm 1$, but not to the velocity limits: its upper and lower sides are determined by the images of the
# state set.

# %% [markdown]
# ## 4 What to do when there is no safe set
#
# | `verdict` | meaning | what to change |
# |---|---|---|
# | `refuted` | the sequence contains no safe set; a *witness* leaves $\mathcal{X}$ | template, $\mathcal{D}$, network |
# | `unknown` | `max_iterations` was reached first, or a solver was stopped | more iterations, more time |
#
# "Refuted" refers to the sequence of Prop. 3, Fmax, *with this template*; other safe sets may exist. As an example,
# multiply the disturbance of the spring by 2.5, and use eight directions:

# %% tags=["nbval-check-output"]
rough = mr.ClosedLoop(spring(0.25), mr.MaxoutNetwork.from_torch(module).saturate(-1, 1))
none_found = mr.safe_set(rough, mr.directions(8))
witness = none_found.witness
print(f"{none_found.verdict}: set is {none_found.set}")
print(f"from x = {np.round(witness.states[0], 2)} with u = {np.round(witness.inputs[0], 2)} in mode", end=" ")
print(f"{witness.modes[0] + 1} and d = {np.round(witness.disturbances[0], 2)} to {np.round(witness.states[1], 2)}")

# %%
figure, ax = plt.subplots(figsize=(5.4, 5.2), layout="constrained")
plotting.draw_set(ax, X, facecolor="none", edgecolor=plotting.GREY, linewidth=2.2, label=r"$\mathcal{X}$")
last = none_found.history[-1]
plotting.draw_set(ax, last, **plotting.TERMINAL, label="the set that stays, 8 directions")
ax.plot(*witness.states.T, "o-", color=plotting.RED, markersize=5, label="witness")
finer = mr.safe_set(rough, mr.directions(16))
plotting.draw_set(ax, finer.set, **{**plotting.SAFE, "facecolor": "none"}, label=r"$\mathcal{F}_{\max}$, 16 directions")
plotting.label_axes(ax, X.scale(1.2))
plotting.legend_above(ax, 2)
plt.show()

# %% [markdown]
# The witness is a state of the last set whose image leaves $\mathcal{X}$. **Look at where it is.** Here it lies in a
# corner that the template cannot cut off, and 16 directions find a safe set (green outline). If the network gave a bad
# input there, more training data there would help. If no input could keep the state in $\mathcal{X}$, a smaller
# $\mathcal{X}$ or $\mathcal{D}$ would help. What is the largest tolerated disturbance for each template?


# %%
def largest_bound(count, low=0.0, high=0.5, accuracy=0.002):
    """Bisection for `count` directions: a bound with a safe set such that none is found a little above it."""
    while high - low > accuracy:
        middle = (low + high) / 2
        found = mr.safe_set(rough.with_disturbance(mr.Polytope.box([-middle] * 2, [middle] * 2)), mr.directions(count))
        low, high = (middle, high) if found.verdict == "proven" else (low, middle)
    return low


# %% tags=["nbval-check-output"]
for count in (8, 16, 32):
    print(f"{count} directions: a safe set up to |d| <= {largest_bound(count):.2f}")

# %% [markdown]
# Notebook 10 shows two more remedies: error sets with the true shape of the error, and intersecting the image with
# $\mathcal{X}$ before the template encloses it.

# %% [markdown]
# ## 5 More than two states
#
# The same calls work for more states. `mireach` computes the cells of the loop for up to six states and 200,000 cells,
# and uses the MILP of Lemma 2 otherwise (notebook 14). The example has three coupled first-order systems, the last of
# them unstable, and a saturated LQR. The template is a box, i.e. 6 directions:

# %%
A3 = np.array([[0.8, 0.3, 0.0], [0.0, 0.7, 0.3], [0.0, 0.0, 1.05]])
B3 = np.array([[0.0], [0.0], [0.5]])
X3, D3 = mr.Polytope.box([-4, -3, -1], [4, 3, 1]), mr.Polytope.box([-0.02] * 3, [0.02] * 3)
system3 = mr.PWASystem([mr.Mode(A3, B3, np.zeros(3), X3.product(U), D3)], X3, U)
K3 = lqr(A3, B3, np.eye(3), np.eye(1))
loop3 = mr.ClosedLoop(system3, mr.MaxoutNetwork.from_torch(saturated_law(K3, 1.0)).saturate(-1, 1))

# %% tags=["nbval-check-output"]
safe3, terminal3 = certify(loop3, mr.box_directions(3), epsilon=0.1)
print(f"{entered(loop3, safe3, terminal3)[0]} for 200 disturbed trajectories")

# %% [markdown]
# The number of cells grows with the network, and their vertices with the number of states. With the MILP, the time of a
# step depends on the number of binaries that the bounds do not fix; `engine=mr.Milp(time_limit=...)` limits the time of
# a call. Begin with a coarse template and a large $\bar\epsilon$. `mr.directions(count, 3)` spreads a finer template
# evenly.

# %% [markdown]
# ## 6 When something does not fit
#
# Errors are raised early and say what to do. Some typical ones:


# %%
def show(what, attempt):
    """Run a wrong call and print the error message."""
    try:
        attempt()
    except (ValueError, mr.CellLimitError) as error:
        print(f"{what}:\n    {error}\n")


half = mr.Polytope([[0, 0, -1]], [0])
mode = mr.Mode(np.eye(2), [[0], [1]], [0, 0], half)
show("regions with a gap", lambda: mr.PWASystem([mode], X, U))
show("a network that leaves U", lambda: mr.ClosedLoop(spring(0.1), mr.MaxoutNetwork((), [[3.0, 3.0]], [0.0])))
tanh = torch.nn.Sequential(torch.nn.Linear(2, 4), torch.nn.Tanh(), torch.nn.Linear(4, 1))
show("a network that is not piecewise affine", lambda: mr.MaxoutNetwork.from_torch(tanh))
show("too many cells", lambda: mr.safe_set(loop3, engine=mr.Cells(limit=1)))
show("a terminal set without a safe set", lambda: mr.terminal_set(rough, none_found))

# %% [markdown]
# ## What you saw
#
# - Five things define a problem: $\mathcal{X}$, $\mathcal{U}$, $\mathcal{D}$, the modes, the network.
# - You can use any torch network of Linear, ReLU, LeakyReLU and Maxout; `saturate` makes it satisfy $\mathcal{U}$
#   exactly.
# - A nonlinear plant needs a fit and a *proven* error. Then Theorem 2 applies to the plant itself.
# - If no safe set is found, the result contains a witness, and the witness shows where to look.
# - The same calls work for more than two states, with the cells or the MILP.
#
# ## On your own
#
# - Replace the spring by your plant. Begin with $\mathcal{D} = \{0\}$ (`None`) and the law instead of the network.
# - Give the pendulum five strips, or `per_mode=True`. What happens to the terminal set?
# - Train a network of one hidden layer with 4, 8, 16 neurons. Which is the smallest with a safe set?
# - Make the actuator of the spring pull three times as hard. Is the law that was designed for 0.6 still good enough?
#
# ## Further reading
#
# - Bemporad, Morari, *Control of systems integrating logic, dynamics, and constraints*, Automatica 35, 1999: how to
#   model hybrid systems with integer variables.
# - Goodfellow, Warde-Farley, Mirza, Courville, Bengio, *Maxout networks*, ICML 2013.
# - `docs/references.bib` lists the references of the paper and of this course.
#
# Notebooks 12 to 14 continue with a lab for the disturbance, sets without templates, and more than two states.
