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
# # Train a maxout network to imitate a model predictive controller
#
# **What you will do.** Solve the optimal control problem of the first case study at some states. Look at the control
# law $u^*(x)$ that it defines. Train a $3 \times 3$ maxout network on 992 samples of it in this notebook. Modify the
# network so that it satisfies $|u| \le 1$ at *every* state.
#
# **What you will learn.** Why a piecewise-affine plant makes model predictive control (MPC) a mixed-integer problem.
# Why the control law jumps, and how well a continuous network can approximate it. Why the loss uses the clipped output.
# What it means that the output is saturated exactly.
#
# **What you need.** Notebook 02 (maxout networks), notebook 03 (the four-mode system), and the idea of least squares.
# The notebook uses PyTorch only through one function. "Run all" takes about half a minute, most of it training.

# %%
import matplotlib.pyplot as plt
import numpy as np
import torch
from matplotlib.tri import Triangulation

import mireach as mr
from mireach.learning.mpc import solve_miqp
from mireach.learning.training import LEAK, train
from mireach.plotting import BLACK, BLUE, GREEN, GREY, ORANGE, RED, draw_regions, label_axes, legend_above

torch.set_num_threads(1)
case = mr.case_study("pwa")
system, data, X = case.system, case.data, case.system.state_set
print(f"{data}; {len(system.modes)} modes")

# %% [markdown]
# ## 1. One optimal control problem, solved
#
# The network imitates an optimal controller. At every state $x$ this controller solves the problem (Sec. V.A)
#
# $$\begin{aligned}
# \min_{u(0), \dots, u(N-1)} \quad
# & \sum_{k=0}^{N-1} \big(x(k)^\top Q\, x(k) + u(k)^\top R\, u(k)\big) + x(N)^\top P\, x(N) \\
# \text{s.t.} \quad & x(0) = x, \quad x(k+1) = f_{\text{PWA}}(x(k), u(k)), \\
# & \|x(k)\|_\infty \le 10, \quad |u(k)| \le 1
# \end{aligned}$$
#
# with $Q = P = I$, $R = 1$, $N = 10$, without disturbance, and applies the first input $u^*(x) = u(0)$. If the mode of
# every step were known, this would be a small quadratic program (QP). The modes are not known, and there are $4^{10}$
# mode sequences, so the problem is a mixed-integer QP. `solve_miqp` uses a best-first search over the sequences. The
# QPs of partial sequences give lower bounds on the optimal cost.

# %% tags=["nbval-check-output"]
starts = [(-7.3, 8.52), (5, 5), (-5, -5), (8, -6)]
solutions = [solve_miqp(system, np.array(x0, float)) for x0 in starts]  # N = 10 and unit weights are its defaults
print("state             u*(x)     cost   first modes")
for x0, solution in zip(starts, solutions):
    modes = " ".join(str(i + 1) for i in solution.modes[:4])
    print(f"{x0!s:14} {solution.inputs[0, 0]:8.3f} {solution.cost:8.2f}   {modes}")

# %%
print(f"{4**10} mode sequences; QPs solved:", [solution.nodes for solution in solutions])
fig, ax = plt.subplots(figsize=(5.5, 6))
draw_regions(ax, system)
looks = [(BLUE, "-", "o"), (RED, "--", "s"), (GREEN, "-.", "^"), (BLACK, ":", "D")]
for x0, solution, (colour, line, marker) in zip(starts, solutions, looks):
    ax.plot(*solution.states.T, color=colour, linestyle=line, marker=marker, markersize=4, label=f"$x = {x0}$")
label_axes(ax, X)
legend_above(ax, 2)
plt.show()

# %% [markdown]
# From each state, the optimal trajectory $x(0), \dots, x(10)$ jumps between the regions and approaches the origin.
# There are about a million mode sequences, but the search solves only a few dozen QPs per state. The final lower bound
# proves that no other sequence has a smaller cost.
#
# Some states have no solution. In mode 3 the next $x_2$ is $0.491\,x_1 + 0.62\,x_2$, and no input can change it. Where
# this value is below $-10$, the constraints are violated after one step:

# %% tags=["nbval-check-output"]
corner = solve_miqp(system, np.array([-9.5, -9.5]))
print("a solution at (-9.5, -9.5):", corner.feasible)
print("largest 0.491 x1 + 0.62 x2 of the infeasible samples:", (data.infeasible @ [0.491, 0.62]).max().round(2))
print("smallest of the feasible ones:", (data.states @ [0.491, 0.62]).min().round(2))

# %% [markdown]
# ## 2. The control law as a surface
#
# For the data set, the problem was solved at 1000 random states; 992 of them have a solution. The optimal inputs, drawn
# over the plane, show the law $u^*(x)$.

# %% tags=["nbval-check-output"]
u_star = data.inputs[:, 0]
at_limit = np.abs(u_star) > 1 - 1e-6
print(f"{len(data)} states with a solution, {len(data.infeasible)} without")
print(f"{100 * at_limit.mean():.0f} % of the inputs lie on a limit: {(u_star[at_limit] > 0).sum()} at +1,", end=" ")
print(f"{(u_star[at_limit] < 0).sum()} at -1")

# %%
triangles = Triangulation(*data.states.T)
triangles.set_mask(np.ptp(u_star[triangles.triangles], axis=1) > 1)  # do not draw over a jump
fig = plt.figure(figsize=(8, 3.8), layout="constrained")
surface = fig.add_subplot(1, 2, 1, projection="3d")
surface.plot_trisurf(triangles, u_star, cmap="cividis", linewidth=0)
surface.set(xlabel="$x_1$", ylabel="$x_2$", title="$u^*(x)$")
surface.view_init(elev=48, azim=-115)
flat = fig.add_subplot(1, 2, 2)
image = flat.tripcolor(triangles, u_star, cmap="cividis", shading="gouraud")
flat.plot(*data.states.T, ".", color=BLACK, markersize=1)
flat.plot(*data.infeasible.T, "x", color=RED, label="no solution")
label_axes(flat, X)
flat.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)
fig.colorbar(image, ax=flat, label="$u^*$")
plt.show()

# %% [markdown]
# Left: the law as a surface. Right: the law from above, with the samples as dots and the states without a solution as
# crosses. Two plateaus at $u^* = -1$ (dark) and $u^* = +1$ (bright) cover most of the plane. Between them the law is
# steep, and in places it **jumps**. Neighbouring samples that differ by more than 1 are not connected, so the surface
# has a gap there. To see the law near such a gap, we solve the problem at many points on two lines through the plane:

# %% tags=["nbval-check-output"]
x1 = np.linspace(-9, 9, 181)
lines = {x2: np.column_stack([x1, np.full(181, x2)]) for x2 in (5.0, -6.0)}
optimal = {x2: np.array([solve_miqp(system, x).inputs[0, 0] for x in line]) for x2, line in lines.items()}
print("x2 =  5: u* at x1 = -0.1, 0.1: ", optimal[5][[89, 91]].round(2))
print("x2 = -6: u* at x1 = -4.6, -4.4:", optimal[-6][[44, 46]].round(2))

# %% [markdown]
# At $x_2 = 5$ the law is $-1$ left of the border between modes 4 and 1, and $+1$ right of it. The plant jumps there, so
# the optimal input changes its sign. The jump printed for $x_2 = -6$ lies *inside* the region of mode 3. The reason: on
# its two sides, different mode sequences are optimal for the following steps. We will compare the network with the law
# on both lines.
#
# ## 3. Train the network in this notebook
#
# The paper's network for this case has $\ell = 3$ hidden layers of $w_i = 3$ neurons with $p_i = 3$ channels each
# (eq. (6), NN, and eq. (8), maxout):
#
# $$\Phi(x) = f^{(4)} \circ g^{(3)} \circ f^{(3)} \circ g^{(2)} \circ f^{(2)} \circ g^{(1)} \circ f^{(1)}(x).$$
#
# The loss is the mean squared error over the data, with the output *clipped* to $\mathcal{U} = [-1, 1]$; section 6
# explains why. One run takes 6000 steps of Adam, each on all data.

# %%
trained = train(
    data.states, data.inputs, layers=3, width=3, pool=3, lower=-1, upper=1, rng=0, steps=6000, progress=False
)
live = trained.network
print(live)
print(f"mean squared error {trained.loss:.4f}")

# %%
fig, ax = plt.subplots(figsize=(6, 3))
ax.semilogy(*trained.history.T, color=BLUE)
ax.set(xlabel="training step", ylabel=r"mean of $(\mathrm{clip}\,\Phi(x) - u^*(x))^2$")
ax.grid(alpha=0.3)
plt.show()

# %% [markdown]
# The error falls by about two orders of magnitude. It falls fast at first. Later it falls slowly, while the kinks of
# the network move to the kinks of the law. At the end the learning rate goes to zero, so the curve is flat. Your digits
# may differ from those stored here, because rounding differs between machines and 6000 steps amplify the differences.
#
# ## 4. Compare the network with the data

# %%
grid = np.stack(np.meshgrid(*[np.linspace(-10, 10, 201)] * 2), axis=-1)


def values(net):
    """The network's outputs on the grid."""
    return net(grid.reshape(-1, 2)).reshape(201, 201)


error = np.abs(live(data.states)[:, 0] - u_star)
fig, axes = plt.subplots(1, 2, figsize=(8, 3.8), layout="constrained")
image = axes[0].pcolormesh(*np.moveaxis(grid, -1, 0), values(live), cmap="cividis", zorder=0)
fig.colorbar(image, ax=axes[0], label=r"$\Phi$", shrink=0.75)
order = np.argsort(error)  # large errors on top
dots = axes[1].scatter(*data.states[order].T, c=error[order], s=6, cmap="cividis_r", vmin=0, vmax=1)
fig.colorbar(dots, ax=axes[1], label=r"$|\Phi(x) - u^*(x)|$", shrink=0.75)
for ax, title in zip(axes, (r"network $\Phi(x)$", "error at the samples")):
    draw_regions(ax, system)
    label_axes(ax, X, title)
plt.show()
print(f"{100 * (error < 0.05).mean():.0f} % of the samples are off by less than 0.05; the worst by {error.max():.2f}")

# %% [markdown]
# The network (left) has the same plateaus as the law. On the right nearly all samples are bright, i.e. their error is
# small. The dark dots lie where the law jumps. The next figure compares both on the two lines:

# %%
fig, axes = plt.subplots(1, 2, figsize=(8, 3.2), sharey=True, layout="constrained")
for ax, (x2, line) in zip(axes, lines.items()):
    ax.plot(x1, optimal[x2], ".", color=BLACK, markersize=4, label="optimal law $u^*$")
    ax.plot(x1, live(line)[:, 0], color=RED, linewidth=1.5, label=r"network $\Phi$")
    ax.set(xlabel="$x_1$", title=f"$x_2 = {x2:g}$")
axes[0].set_ylabel("$u$")
axes[0].legend(loc="center left", fontsize="small")
plt.show()

# %% [markdown]
# The optimal law (dots) jumps. The network (line) is continuous, so it connects the levels by steep ramps. Training can
# make a ramp steeper, but next to a jump the error stays large on at least one side (exercise 05 asks how large). At a
# sample on the ramp the error can be as large as 2. This is not a failure. $\Phi$ need not equal $u^*$; the *closed
# loop with $\Phi$* must be safe. The sets of the other notebooks decide this.
#
# ## 5. Saturate the network exactly
#
# The analysis assumes $\Phi(x) \in \mathcal{U}$ for all $x \in \mathcal{X}$ (Sec. II.A). Training achieves this only
# approximately. But the projection onto an interval is itself a small maxout network,
#
# $$\min\{\max\{z, \underline{u}\}, \overline{u}\} = -\max\{-v,\, -\overline{u}\}
#   \quad\text{with}\quad v = \max\{z,\, \underline{u}\}.$$
#
# It has two layers, each with one neuron of two channels. `train` has already added them. To see the network before the
# projection, we remove them. In the first of the two layers, one channel is the limit $\underline{u}$, and the other is
# the raw output $z$.

# %%
before, raise_up, cut_off = live.hidden[:-2], *live.hidden[-2:]
raw = mr.MaxoutNetwork(before, raise_up.weight[:1], raise_up.bias[:1])  # channel 1 is z, channel 2 is -1
print("v = max(z, -1):  weight", raise_up.weight.round(2).tolist(), " bias", raise_up.bias.round(2).tolist())
print("y = max(-v, -1): weight", cut_off.weight.tolist(), " bias", cut_off.bias.tolist())
print(f"{raw.binaries} binaries before, {live.binaries} after")

# %%
fig, axes = plt.subplots(1, 3, figsize=(8, 3.2), layout="constrained", width_ratios=[1, 1, 1.15])
for ax, net, title in zip(axes, (raw, raw.saturate(-1, 1)), ("before: $z$", r"after: $\Phi$")):
    image = ax.pcolormesh(*np.moveaxis(grid, -1, 0), values(net), cmap="cividis", vmin=-2.5, vmax=2.5)
    ax.contour(*np.moveaxis(grid, -1, 0), values(raw), [-1, 1], colors=BLACK, linewidths=0.8, linestyles="-")
    label_axes(ax, X, title)
fig.colorbar(image, ax=axes[:2], label="$u$", location="bottom", shrink=0.6, extend="both")
axes[2].plot(x1, raw(lines[5]), color=ORANGE, linestyle="--", label="before: $z$")
axes[2].plot(x1, live(lines[5]), color=BLUE, label=r"after: $\Phi$")
axes[2].axhspan(-1, 1, color=GREY, alpha=0.25, label=r"$\mathcal{U}$")
axes[2].set(xlabel="$x_1$", ylabel="$u$", title="on $x_2 = 5$")
axes[2].legend(loc="upper left", fontsize="small")
plt.show()

# %% [markdown]
# Left: the raw output goes far beyond $\pm 1$. The black contours mark where it crosses the limits. Middle: the output
# of the same network with the two layers. It is constant outside the contours and unchanged between them. Right: both
# outputs along a line. The dashed curve (raw) leaves the grey band $\mathcal{U}$. The solid curve (saturated) equals it
# inside the band and stays at the limit elsewhere.
#
# There is not even a rounding error. The channels for the limits have weight 0 and the limit as their bias, and the
# following layers only multiply by $-1$. So a saturated output is the float $1.0$, not $0.9999$ or $1.0000001$. We test
# it for a million values with the shipped network, which the rest of the course uses:

# %% tags=["nbval-check-output"]
shipped = case.network
first = shipped.hidden[-2]
shipped_raw = mr.MaxoutNetwork(shipped.hidden[:-2], first.weight[:1], first.bias[:1])
x = X.sample(np.random.default_rng(0), 1_000_000)
z, phi = shipped_raw(x), shipped(x)
print("largest difference from clip(z):", np.abs(phi - np.clip(z, -1, 1)).max().round(9))
print("outputs outside U:", int((np.abs(phi) > 1).sum()), " smallest:", phi.min(), " largest:", phi.max())

# %% [markdown]
# A million samples do not prove the claim for all of $\mathcal{X}$. Every engine of the library therefore checks the
# assumption itself, by interval arithmetic, at the vertices of all affine pieces, or by a MILP. It rejects a loop with
# the raw network:

# %%
try:
    mr.ClosedLoop(system, shipped_raw)
except ValueError as refusal:
    print(refusal)

# %% [markdown]
# ## 6. Why the loss is clipped
#
# Two thirds of the optimal inputs lie on a limit. At these samples the unsaturated output may take *any* value beyond
# the limit, because the projection corrects it. There are three candidates for the loss of one sample, with $z$ the raw
# output:
#
# $$(z - u^*)^2, \qquad (\mathrm{clip}(z) - u^*)^2, \qquad
#   (\mathrm{clip}(z) + \lambda\,(z - \mathrm{clip}(z)) - u^*)^2.$$
#
# The first penalises $z = 3$ where $u^* = 1$, although the clipped output is optimal. The second does not, but its
# gradient is also zero at $z = -3$, where the output is clipped to the wrong limit. The third keeps a small slope
# $\lambda$ outside the limits.

# %%
z = torch.linspace(-3, 3, 601, requires_grad=True)
clipped = z.clamp(-1, 1)
losses = {
    "plain": (z - 1) ** 2,
    "clipped": (clipped - 1) ** 2,
    rf"leaky, $\lambda = {LEAK}$": (clipped + LEAK * (z - clipped) - 1) ** 2,
}
fig, axes = plt.subplots(1, 2, figsize=(8, 3.2), layout="constrained")
for (name, loss), colour, style in zip(losses.items(), (GREY, ORANGE, BLUE), ("--", "-", ":")):
    (slope,) = torch.autograd.grad(loss.sum(), z, retain_graph=True)
    axes[0].plot(z.detach(), loss.detach(), style, color=colour, linewidth=2, label=name)
    axes[1].semilogy(z.detach(), slope.abs().clamp(min=1e-8), style, color=colour, linewidth=2)
axes[0].set(xlabel="raw output $z$", ylabel="loss", title="one sample with $u^* = 1$", ylim=(-0.3, 8))
axes[1].set(xlabel="raw output $z$", ylabel="|slope of the loss|", ylim=(1e-6, 30), title="how hard it pulls at $z$")
axes[0].legend(loc="upper right")
plt.show()

# %% [markdown]
# Left: for $z > 1$ the plain loss rises again, while the other two stay at (about) zero. Right, on a logarithmic scale:
# for $z < -1$ the gradient of the clipped loss is zero (its line leaves the figure), so such a sample could never
# correct its output. The leaky loss keeps one hundredth of the gradient. `train` uses the leaky loss. Does this make a
# difference? We train with limits so wide that nothing is clipped, and saturate afterwards:

# %%
options = {"layers": 3, "width": 3, "pool": 3, "steps": 3000, "progress": False}
print("seed   leaky clipped   plain, saturated afterwards")
for seed in (0, 2):
    leaky = train(data.states, data.inputs, lower=-1, upper=1, rng=seed, **options).loss
    plain = train(data.states, data.inputs, lower=-1000, upper=1000, rng=seed, **options).network
    saturated = plain.saturate(-1, 1)
    print(f"{seed:4d} {leaky:15.4f} {((saturated(data.states) - data.inputs) ** 2).mean():29.4f}")

# %% [markdown]
# The leaky clipped loss usually gives the smaller error, by up to a factor of two. The plain loss penalises outputs
# beyond the limits. So the network must use kinks to keep the plateaus flat, and with nine neurons it has only a few
# kinks. We say "usually" because training is not convex: with other seeds the order may change. The seed study in
# notebook 10 examines how much the seed affects the *sets*.
#
# ## 7. The network for the rest of the course
#
# Training on another machine gives another network. To make the results reproducible, the project ships one network per
# case, trained by the same function on the same data:

# %% tags=["nbval-check-output"]
off = np.abs(shipped(data.states) - data.inputs)[:, 0]
print(shipped)
print(f"mean squared error {(off**2).mean():.4f}")
print(f"{100 * (off < 0.05).mean():.0f} % of the samples are off by less than 0.05")

# %% [markdown]
# ## What you saw
#
# - MPC of a piecewise-affine plant is a mixed-integer QP. Branch and bound solved it with a few dozen QPs per state.
# - The control law has plateaus at the limits of $u$, and it jumps. A network with 27 channels can approximate the
#   plateaus, but not the jumps.
# - The projection onto $\mathcal{U}$ consists of two maxout layers. It adds 4 binaries, and the assumption of the
#   analysis holds exactly.
# - If the output is saturated, the loss should account for the saturation, but it must not lose its gradient.
#
# ## On your own
#
# - Train with `layers=2` or `width=5`. How does the accuracy depend on the number of binaries?
# - Build `mr.case_study("pwa", live)` and compute `mr.safe_set(study.loop, study.safe_directions)`. Is there a safe set
#   for *your* network?
# - Run the optimal controller itself: apply $u^*$ step by step with random disturbances, and compare with the network.
# - Exercises: in `exercises/ex05` you implement the projection and the loss, and derive the infeasible corner.
#
# ## Further reading
#
# - I. Goodfellow et al., *Maxout networks*, ICML 2013.
# - D. Mignone, G. Ferrari-Trecate, M. Morari, *Stability and stabilization of piecewise affine and hybrid systems: an
#   LMI approach*, CDC 2000: the source of the four-mode system.
# - F. Borrelli, A. Bemporad, M. Morari, *Predictive Control for Linear and Hybrid Systems*, Cambridge University Press
#   2017: MPC of hybrid systems.
# - B. Karg, S. Lucia, *Efficient representation and approximation of model predictive control laws via deep learning*,
#   IEEE Transactions on Cybernetics 2020.
#
# Next: **06_case_study_pwa** computes the safe set and the terminal set of the loop with this network.
