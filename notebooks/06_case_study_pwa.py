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
# # Certify the four-mode loop step by step
#
# The plant is piecewise affine with four modes. A disturbance of up to 0.15 acts on each state, and a small maxout
# network closes the loop. Is the loop safe, and where do its trajectories end? This notebook answers both questions
# with the paper's method. It is the first case study of the paper.
#
# **What you will do.** Write the two iterations of the method in a few lines each, look at every set that they produce,
# and redraw Figures 1 and 2 of the paper.
#
# **What you will learn.**
# - how Prop. 3, Fmax, finds a safe set, which sides of it depend on the network, and what a failure looks like;
# - how the iteration of eq. (24), RminOver, shrinks the safe set to a terminal set, and when eq. (25), TerminationFmin,
#   stops the iteration;
# - why two disturbed trajectories that start in the same state can separate suddenly;
# - how large the margin of Theorem 1 is, and what its proof needs.
#
# **What you need.** Notebooks 03 and 04 (regions, one-step sets). The notebook uses a shipped network; notebook 05
# trains a similar one. "Run all" takes about 20 seconds.

# %%
import matplotlib.pyplot as plt
import numpy as np

import mireach as mr
from mireach import plotting
from mireach.lab import step_viewer

case = mr.case_study("pwa")
loop, X, U = case.loop, case.system.state_set, case.system.input_set
C_box, C_eight = mr.box_directions(2), mr.directions(8)
DASHED = {"facecolor": "none", "edgecolor": plotting.RED, "linestyle": "--", "linewidth": 1.8}
LIMITS = {"facecolor": "none", "edgecolor": plotting.GREY, "linewidth": 2.2, "label": r"$\mathcal{X}$"}
print(case)

# %% [markdown]
# ## 1. The loop
#
# $$x(k+1) = A^{(i)} x(k) + B^{(i)} \Phi(x(k)) + d(k) \quad\text{if } x(k) \in \mathcal{P}^{(i)}, \qquad
#   d(k) \in \mathcal{D} = \{d : \|d\|_\infty \le 0.15\}$$
#
# The regions are the four quadrants, $\mathcal{X} = \{x : \|x\|_\infty \le 10\}$ and $\mathcal{U} = \{u : |u| \le 1\}$.
# The controller $u = \Phi(x)$ imitates a model predictive controller that ignores the disturbance. We want to know
# whether the loop is safe with the disturbance.

# %%
fig, ax = plt.subplots(figsize=(5.6, 5.4), layout="constrained")
plotting.draw_regions(ax, case.system)
grid = np.stack(np.meshgrid(np.linspace(-9.5, 9.5, 20), np.linspace(-9.5, 9.5, 20)), axis=-1).reshape(-1, 2)
move = loop.step(grid) - grid
ax.quiver(*grid.T, *move.T, color=plotting.BLUE, angles="xy", scale_units="xy", scale=8, width=0.003)
for number, place in enumerate(((8, 8), (8, -8), (-8, -8), (-8, 8)), start=1):
    ax.text(*place, f"$i = {number}$", ha="center", va="center", bbox={"facecolor": "white", "edgecolor": "none"})
plotting.label_axes(ax, X, r"nominal loop, $x^+ - x$ (arrows scaled by 1/8)")
plt.show()

# %% [markdown]
# **What to see.** The arrows change abruptly across the axes, because the map jumps at the region boundaries. Section 5
# shows the consequences.

# %% [markdown]
# ## 2. A safe set, iteration by iteration
#
# Start with the whole set $\mathcal{X}$. In each iteration, keep the part of $\mathcal{X}$ that one step can reach
# (eq. (21), Fk):
#
# $$\mathcal{F}_0 = \mathcal{X}, \qquad
#   \mathcal{F}_{k+1} = \overline{\mathcal{R}}{}^{\mathcal{D}}_1(\mathcal{F}_k) \cap \mathcal{X}.$$
#
# Here $\overline{\mathcal{R}}{}^{\mathcal{D}}_1(\mathcal{F}) = \{x : C x \le h(C)\}$ is the smallest set with the
# normals $C$ that contains all states reachable from $\mathcal{F}$ in one step (eq. (18), Rover1). With $C = (I, -I)$
# the sets are boxes. We compute the first step by hand:

# %% tags=["nbval-check-output"]
image = mr.outer_step(loop, X, C_box)  # R_1-bar(F_0), eq. (18), Rover1
print("R1-bar(F0) along x1, x2, -x1, -x2:", image.support(C_box).round(2))
print("does it lie in X?                 ", image.is_subset(X))
F_1 = image & X  # eq. (21), Fk
print("F1 along x1, x2, -x1, -x2:        ", F_1.support(C_box).round(2))

# %% [markdown]
# One side of the image lies outside $\mathcal{X}$. So from some states of $\mathcal{X}$ the loop may leave
# $\mathcal{X}$, and $\mathcal{X}$ itself is not safe. The intersection cuts this side off, and the iteration continues
# with $\mathcal{F}_1$.
#
# **When to stop.** $\mathcal{F}_k$ is robustly positively invariant (RPI) if
# $\mathcal{R}_1(\mathcal{F}_k) \subseteq \mathcal{F}_k$. It suffices to check
# $\overline{\mathcal{R}}_1(\mathcal{F}_k) \subseteq \mathcal{X}$. The sets are nested,
# $\mathcal{F}_k \subseteq \mathcal{F}_{k-1}$, hence
# $\overline{\mathcal{R}}_1(\mathcal{F}_k) \subseteq \overline{\mathcal{R}}_1(\mathcal{F}_{k-1})$. If the left-hand side
# also lies in $\mathcal{X}$, it lies in $\overline{\mathcal{R}}_1(\mathcal{F}_{k-1}) \cap \mathcal{X} = \mathcal{F}_k$.
# This is Prop. 3, Fmax:

# %%
history, images = [X], [mr.outer_step(loop, X, C_box)]
while not images[-1].is_subset(X) and len(history) < 100:  # stop: R_1-bar(F_k) in X
    history.append(images[-1] & X)  # eq. (21), Fk
    images.append(mr.outer_step(loop, history[-1], C_box))
print("F_max = F_k with k =", len(history) - 1)


# %%
def draw_iteration(ax, k, history=history, images=images):
    """F_k, and its one-step image (dashed)."""
    plotting.draw_set(ax, X, **LIMITS)
    plotting.draw_set(ax, history[k], **plotting.SAFE, label=rf"$\mathcal{{F}}_{{{k}}}$")
    name = rf"$\overline{{\mathcal{{R}}}}_1(\mathcal{{F}}_{{{k}}})$"
    plotting.draw_set(ax, images[k], **DASHED, label=name)
    plotting.label_axes(ax, X.scale(1.25))
    plotting.legend_above(ax, 3)


fig, axes = plt.subplots(1, len(history), figsize=(3.9 * len(history), 4.2), layout="constrained")
for k, ax in enumerate(np.ravel(axes)):
    draw_iteration(ax, k)
plt.show()

# %% [markdown]
# **What to see.** Left: the image (dashed) of $\mathcal{F}_0 = \mathcal{X}$ (green on top of grey) extends beyond
# $\mathcal{X}$ at the bottom. Right, the last panel: the image of $\mathcal{F}_k$ lies inside $\mathcal{X}$, and
# therefore inside $\mathcal{F}_k$. This set is $\mathcal{F}_{\max}$.
#
# The library does the same, takes care of rounding, and states whether the result is *proven*:

# %% tags=["nbval-check-output"]
safe = mr.safe_set(loop, C_box)
print(f"{safe.verdict} after {safe.iterations} iteration(s): {safe.reason}")
lower, upper = safe.set.bounding_box()
print(f"F_max = [{lower[0]:.2f}, {upper[0]:.2f}] x [{lower[1]:.2f}, {upper[1]:.2f}]")
print("same set as by hand:", np.abs(safe.set.support(C_box) - history[-1].support(C_box)).max() < 1e-9)

# %% [markdown]
# ### Which sides of $\mathcal{F}_1$ depend on the network?
#
# All $B^{(i)}$ are $(1, 0)^\top$: the input acts on $x_1^+$ only. For *any* controller with values in $\mathcal{U}$,
# the image of $\mathcal{X}$ along a direction $v$ therefore extends to
#
# $$\max_i \; \max_{x \in \mathcal{P}^{(i)}} v A^{(i)} x + h_{\mathcal{D}}(v) + v B u
#   \quad\text{for some } u \in [-1, 1].$$
#
# We can compute the smallest and the largest possible value, limited by $\mathcal{X}$, without a network:

# %% tags=["nbval-check-output"]
limits = {"right": (1, 0), "top": (0, 1), "left": (-1, 0), "bottom": (0, -1)}
for (name, v), here in zip(limits.items(), F_1.support(C_box)):
    v, B = np.array(v), case.system.modes[0].B
    drift = max(
        (mode.region & X.product(U)).support([[*(v @ mode.A), 0.0]])[0] + mode.disturbance.support([v])[0]
        for mode in case.system.modes
    )
    least, most = (min(drift + sign * abs(v @ B).item(), 10.0) for sign in (-1, 1))
    print(f"{name:>6}: any controller gives between {least:5.2f} and {most:5.2f}; this network {here:5.2f}")

# %% [markdown]
# **What to see.** The *top* side, $8.37 + 0.15$, and the *bottom* side, the edge of $\mathcal{X}$, follow from the
# modes and $\mathcal{X}$ alone. The *left* side is as close to the origin as any controller allows. At the worst state
# $(0, -10)$ and near it, the network applies the best input, $\Phi = +1$ (full braking), so that
# $-8.15 + 1 - 0.15 = -7.30$. So for every network that brakes fully there, three sides agree with the paper's box
# $[-7.3, 8.91] \times [-10, 8.52]$ in every printed digit. The *right* side depends on the particular network.

# %% tags=["nbval-check-output"]
print("Phi(0, -10) =", loop.network(np.array([0.0, -10.0])).round(6))

# %% [markdown]
# ### When it takes longer, and when it fails
#
# A single iteration is not a typical example. We increase the disturbance to $\|d\|_\infty \le 0.5$, and compare the
# boxes with sets of eight directions, $C_i = (\cos\frac{\pi}{4}(i-1), \; \sin\frac{\pi}{4}(i-1))$.

# %% tags=["nbval-check-output"]
rough = loop.with_disturbance(mr.Polytope.box([-0.5, -0.5], [0.5, 0.5]))
for name, C in (("8 directions", C_eight), ("box", C_box)):
    attempt = mr.safe_set(rough, C)
    print(f"{name}: {attempt.verdict} after {attempt.iterations} iteration(s)")
    print("   ", attempt.reason.split(":")[0])

# %% [markdown]
# With boxes the sequence becomes constant, $\mathcal{F}_{k+1} = \mathcal{F}_k$, although one step from $\mathcal{F}_k$
# can still leave $\mathcal{X}$. The next figure shows eight sets of the sequence:

# %%
failed = mr.safe_set(rough, C_box)
fig, axes = plt.subplots(2, 4, figsize=(8, 4.4), layout="constrained", sharex=True, sharey=True)
plotting.plot_history(axes, failed.history)
for ax in axes.flat:
    ax.label_outer()
plt.show()

# %% [markdown]
# **What to see.** Each panel shows one set (blue) over its predecessors (grey). The upper and the right side move
# inwards slowly. The lower and the left side do not move after the first step. The slider below shows every step with
# its image. It needs a running kernel; without one, use the panels above.

# %%
failed_images = [mr.outer_step(rough, F, C_box) for F in failed.history]
step_viewer(lambda ax, k: draw_iteration(ax, k, failed.history, failed_images), len(failed.history))

# %% [markdown]
# The lower left *corner* of the box causes the failure: one step from there may lead below $x_2 = -10$. The witness
# shows this step: a state, its input, its mode, a disturbance, and the successor. But can a trajectory reach that
# corner? A box cannot exclude it, because it bounds $x_1$ and $x_2$ separately.

# %%
witness = failed.witness
print("from", witness.states[0].round(2), "by u =", witness.inputs[0].round(2), "in mode", witness.modes[0] + 1)
print("with d =", witness.disturbances[0].round(2), "to", witness.states[1].round(2))
eight = mr.safe_set(rough, C_eight)
if eight.set is not None:
    print("in F_max with 8 directions:", eight.set.contains(witness.states[0]))

# %%
fig, ax = plt.subplots(figsize=(5.4, 5.4), layout="constrained")
plotting.draw_set(ax, failed.history[-1], **DASHED, label="last box, not RPI")
if eight.set is not None:
    plotting.draw_set(ax, eight.set, **plotting.SAFE, label=r"$\mathcal{F}_{\max}$, 8 directions")
ax.plot(*witness.states.T, "-", color=plotting.BLACK, marker="o", markersize=5, label="witness")
ax.annotate("start", witness.states[0], textcoords="offset points", xytext=(-14, -14))
plotting.draw_set(ax, X, **LIMITS)
plotting.label_axes(ax, X.scale(1.12))
plotting.legend_above(ax, 2)
plt.show()

# %% [markdown]
# **What to see.** Eight directions cut that corner off. The same loop is then proven safe for more than three times the
# paper's disturbance. So a failure with one template does not mean that the loop is unsafe. Exercise 06 asks for the
# largest disturbance that boxes tolerate, and for a better template with only one additional row.

# %% [markdown]
# ## 3. From the safe set to a terminal set
#
# We return to $\|d\|_\infty \le 0.15$. $\mathcal{F}_{\max}$ is large. Where do its trajectories end? Apply the one-step
# set repeatedly (eq. (19), ROverOver, and eq. (24), RminOver), now with eight directions:
#
# $$\overline{\mathcal{R}}_0 = \mathcal{F}_{\max}, \qquad
#   \overline{\mathcal{R}}_k = \overline{\mathcal{R}}{}^{\mathcal{D}}_1(\overline{\mathcal{R}}_{k-1}), \qquad
#   \overline{\mathcal{R}}_{\min} := \overline{\mathcal{R}}_{\bar k}.$$
#
# Each of these sets is RPI, contains the next one, and contains every trajectory from step $k$ on. They converge to a
# limit set, which is typically not reached in finitely many steps. Eq. (25), TerminationFmin, is the stopping
# criterion:
#
# $$\frac{1}{1 + \bar\epsilon}\,\overline{\mathcal{R}}_{\bar k} \subseteq \overline{\mathcal{R}}{}^{\mathcal{D}}_1
#   \!\left(\frac{1}{1 + \bar\epsilon}\,\overline{\mathcal{R}}_{\bar k}\right).$$
#
# A set that lies in its own one-step set also lies in all later ones. So if the scaled set has this property, the limit
# set contains the scaled set and is contained in $\overline{\mathcal{R}}_{\bar k}$. We first write the iteration by
# hand:


# %%
def near_limit(R, epsilon=1e-3):
    """Eq. (25), TerminationFmin."""
    S = R.scale(1 / (1 + epsilon))
    return S.is_subset(mr.outer_step(loop, S, C_eight))


sequence = [safe.set]  # R_0-bar = F_max
while (len(sequence) == 1 or not near_limit(sequence[-1])) and len(sequence) < 300:
    sequence.append(mr.outer_step(loop, sequence[-1], C_eight))  # eq. (24), RminOver
print("k-bar =", len(sequence) - 1)

# %% tags=["nbval-check-output"]
terminal = mr.terminal_set(loop, safe, C_eight, epsilon=1e-3)
print(terminal.reason)
print("same k-bar as by hand:", terminal.steps == len(sequence) - 1)
print("R_min along the 8 directions:", terminal.set.support(C_eight).round(2))
print("RPI:", mr.check_rpi(loop, terminal.set).verdict)

# %%
chosen = [0, 1, 3, 6, 10, 15, 20, terminal.steps]
fig, axes = plt.subplots(2, 4, figsize=(8, 4.6), layout="constrained", sharex=True, sharey=True)
plotting.plot_history(axes, terminal.history, chosen, name=r"\overline{\mathcal{R}}")
for ax in axes.flat:
    ax.label_outer()
plt.show()

# %% [markdown]
# **What to see.** The first step cuts off two corners of the box. The following sets become rounder and shrink a little
# in every step. After about twenty steps the changes are hardly visible at this scale. The slider shows all sets, from
# step 20 on at a larger scale; it needs a running kernel.


# %%
def draw_step(ax, k):
    """R_k-bar over its predecessors; later steps at a larger scale."""
    first = 0 if k < 20 else 20
    plotting.plot_step(ax, terminal.history[first:], k - first)
    ax.set_title(rf"$\overline{{\mathcal{{R}}}}_{{{k}}}$")


step_viewer(draw_step, len(terminal.history))

# %% [markdown]
# The next figure shows the convergence in numbers. Left: the values of the support function
# $h_{\overline{\mathcal{R}}_k}(C_i)$. Right: the violation of eq. (25), TerminationFmin,
# $\max_i h_S(C_i) - h_{\overline{\mathcal{R}}_1(S)}(C_i)$ with $S = \overline{\mathcal{R}}_k / (1 + \bar\epsilon)$.

# %%
supports = np.array([R.support(C_eight) for R in terminal.history])
scaled = [R.scale(1 / (1 + case.epsilon)) for R in terminal.history]
violation = np.array([(S.support(C_eight) - mr.support(loop, S, C_eight).value).max() for S in scaled])
fig, (left, right) = plt.subplots(1, 2, figsize=(8, 3.4), layout="constrained")
for i, (row, style) in enumerate(zip(supports.T, 2 * ["-", "--", "-.", ":"]), start=1):
    left.plot(row, style, color=plotting.BLUE if i <= 4 else plotting.ORANGE, label=f"$C_{i}$")
left.set(xlabel="$k$", ylabel=r"$h_{\overline{\mathcal{R}}_k}(C_i)$")
left.legend(ncols=2, fontsize="small")
right.semilogy(np.where(violation > 0, violation, np.nan), ".-", color=plotting.BLUE)
right.axvline(terminal.steps, color=plotting.RED, linestyle="--", label=rf"$\bar k = {terminal.steps}$")
right.set(xlabel="$k$", ylabel="violation of eq. (25), TerminationFmin")
right.legend()
plt.show()

# %% [markdown]
# **What to see.** After about 25 steps the curves on the left look constant. The sets still shrink, but by a smaller
# amount in each step. Near the end the change decreases by about the same factor per step. Right: the violation falls
# below zero at $\bar k$ (no dot there). With a smaller $\bar\epsilon$ the iteration needs more steps, but the curves
# look the same.
#
# Figure 1 of the paper, for this network:

# %%
fig, ax = plt.subplots(figsize=(6.4, 6.2), layout="constrained")
plotting.plot_sequence(ax, case.system, safe, terminal)
plt.show()

# %% [markdown]
# **What to see.** Green: $\mathcal{F}_{\max}$. Black: the sets in between. Blue (magnified in the corner): the terminal
# set. For every disturbance and every initial state in the green set, the state is in the blue set after $\bar k$ steps
# and stays there.

# %% [markdown]
# ## 4. Test the proof with trajectories
#
# We test the proof by simulation. We simulate 20,000 trajectories with random initial states in $\mathcal{F}_{\max}$.
# The disturbances are random *vertices* of $\mathcal{D}$.

# %% tags=["nbval-check-output"]
rng = np.random.default_rng(6)
starts = safe.set.sample(rng, 20_000)
corners = case.system.modes[0].disturbance.vertices()
d = corners[rng.integers(4, size=(len(starts), terminal.steps + 10))]
paths = loop.simulate(starts, terminal.steps + 10, d)
print("all states in F_max:               ", safe.set.contains(paths, tol=1e-9).all())
print("all in R_min from step k-bar on:   ", terminal.set.contains(paths[:, terminal.steps :], tol=1e-9).all())

# %% [markdown]
# Figure 2 of the paper: 100 trajectories with random disturbances from each of two corners of $\mathcal{F}_{\max}$.

# %%
rng = np.random.default_rng(0)
steps = terminal.steps + 10
tubes = [loop.simulate(np.tile(start, (100, 1)), steps, rng) for start in case.starts]
nominal = loop.simulate(case.starts, steps)
fig, ax = plt.subplots(figsize=(6.4, 6.4), layout="constrained")
plotting.plot_tubes(ax, case.system, safe, terminal, tubes, nominal)
plt.show()

# %% [markdown]
# **What to see.** Both bundles stay inside $\mathcal{F}_{\max}$ and end in the small red set. They enter it long before
# step $\bar k$. The remaining steps are needed for the convergence of the *sets*, not of the trajectories. One of the
# bundles is not a narrow tube: halfway, some of its trajectories separate from the nominal one (black).

# %% [markdown]
# ## 5. The jump phenomenon
#
# At each step, we compare the region of a disturbed trajectory with the region of the nominal one. We take the 100
# trajectories that start in the lower left corner. We count how many of them are in another region than the nominal
# state, and compute their largest distance from the nominal state.


# %% tags=["nbval-check-output"]
def region(x):
    """Number of the quadrant of x (..., 2)."""
    return 2 * (x[..., 0] < 0) + (x[..., 1] < 0)


tube, path = tubes[1], nominal[1]
other = region(tube) != region(path)
distance = np.abs(tube - path).max(axis=(0, 2))
for k in range(8):
    print(f"k = {k}: {other[:, k].sum():3d} in another region, farthest {distance[k]:.1f} away")

# %%
j = int(np.argmax(np.diff(distance)))  # the step with the largest increase of the distance
reach = mr.outer_reach(loop, mr.Polytope.box(path[0], path[0]), C_eight, j + 1)
fig, axes = plt.subplots(1, 2, figsize=(8, 4.1), layout="constrained")
for ax, k in zip(axes, (j, j + 1)):
    plotting.draw_set(ax, reach[k], **plotting.SEQUENCE, label=r"$\overline{\mathcal{R}}_k(\{x(0)\})$")
    for name, chosen, style in (("same", ~other[:, j], "o"), ("other", other[:, j], "^")):
        colour = plotting.BLUE if name == "same" else plotting.RED
        ax.scatter(*tube[chosen, k].T, s=14, color=colour, marker=style, label=f"{name} region at $k = {j}$")
    ax.plot(*path[k], "*", color=plotting.BLACK, markersize=14, label="nominal")
    plotting.label_axes(ax, reach[k].scale(1.15, reach[k].chebyshev()[0]), f"$k = {k}$")
    ax.axvline(0, color=plotting.GREY, linewidth=2.2, zorder=0)
    ax.axhline(0, color=plotting.GREY, linewidth=2.2, zorder=0)
fig.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
plt.show()

# %% [markdown]
# **What to see.** Left: the states at one step form a single small cloud across a region boundary (grey line).
# Triangles mark states that are not in the region of the nominal state (star). Right, one step later: there are two
# clouds, several units apart. The table above gives the largest distance before and after this step. The small
# disturbances cause the distance before this step. The *jump of the map* causes the rest. A linear error analysis
# around the nominal trajectory would miss the jump. The reachable set (black) includes it, because the maximum is taken
# over every mode whose closed region meets the set. The reachable set is convex, so it also covers the gap between the
# clouds.
#
# Near the origin all four regions meet, so most disturbed states are in another region than the nominal state. This is
# harmless: the four maps agree at the origin, so the jumps near it are small.

# %% [markdown]
# ## 6. The margin of Theorem 1
#
# Theorem 1 (label BoundedStab, Theorem 4 in the preprint) requires an $\alpha > 1$ with (eq. (26), StabCondFmin)
#
# $$\alpha\,\overline{\mathcal{R}}_{\bar k} \subseteq \overline{\mathcal{R}}_{\bar k - 1}.$$
#
# So the last step must have shrunk the set in *every* direction. Both sets have the normals $C$, so the largest such
# $\alpha$ is the smallest ratio of their support functions. The tube around $\overline{\mathcal{R}}_{\min}$ in the
# proof has the radius $\delta_{\max}$:
#
# $$\alpha_k = \min_i \frac{h_{\overline{\mathcal{R}}_{k-1}}(C_i)}{h_{\overline{\mathcal{R}}_k}(C_i)}, \qquad
#   \delta_{\max} = (\alpha - 1) \min_i h_{\overline{\mathcal{R}}_{\bar k}}(C_i).$$

# %% tags=["nbval-check-output"]
h_before, h_last = terminal.history[-2].support(C_eight), terminal.set.support(C_eight)
alpha = (h_before / h_last).min()
print("alpha > 1:", alpha > 1, "  as the library has it:", abs(alpha - terminal.alpha) < 1e-9)
delta_max = (alpha - 1) * h_last.min()
print("delta_max as the library has it:", np.isclose(delta_max, terminal.delta_max, rtol=1e-6, atol=0))
print("delta_max is below a thousandth of R_min's size:", delta_max < 1e-3 * h_last.min())
print("Theorem 1 applies at k-bar:", terminal.stable)

# %%
print(f"alpha     = 1 + {alpha - 1:.2g}   (the paper: 1 + {case.paper['alpha'] - 1:.1g})")
print(f"delta_max = {delta_max:.2g}")
print(f"Theorem 1 applies at {len(terminal.stable_steps)} of the {terminal.steps} steps")

# %% [markdown]
# The margin is necessarily small, because a sequence that has nearly converged hardly shrinks any more. The next figure
# shows $\alpha_k$ for all steps. It also shows a second factor, which is never smaller and follows from the proof of
# the theorem. The proof uses
#
# $$\overline{\mathcal{R}}_1(\alpha\,\overline{\mathcal{R}}_k) \subseteq
#   \overline{\mathcal{R}}_1(\overline{\mathcal{R}}_{k-1}) = \overline{\mathcal{R}}_k,$$
#
# but it needs only that the first set lies in the last set. Eq. (26), StabCondFmin, is sufficient for this inclusion,
# but not necessary. If a facet *does not move*,
# $h_{\overline{\mathcal{R}}_k}(C_i) = h_{\overline{\mathcal{R}}_{k-1}}(C_i)$, then $\alpha_k = 1$ exactly, and the
# theorem does not apply. But one step from a slightly larger set may still lead into $\overline{\mathcal{R}}_k$.
# `mr.contraction` computes the largest $\alpha$ with
# $\mathcal{R}_1(\alpha\,\overline{\mathcal{R}}_k) \subseteq \overline{\mathcal{R}}_k$ by bisection.

# %%
k = np.arange(1, terminal.steps + 1)
direct = np.array([mr.contraction(loop, R) for R in terminal.history[1:]]) - 1
shrink = terminal.alphas - 1
rest = shrink <= 0
fig, ax = plt.subplots(figsize=(6.6, 4), layout="constrained")
ax.semilogy(k, direct, "o--", color=plotting.ORANGE, markersize=5, label=r"$\alpha$ by the proof's own inclusion")
ax.semilogy(k[~rest], shrink[~rest], ".-", color=plotting.BLUE, label=r"$\alpha_k$ of eq. (26), StabCondFmin")
paper = case.paper["alpha"] - 1
bottom = min(paper, shrink[~rest].min()) / 10
floor = np.full(rest.sum(), bottom)  # where to draw alpha_k - 1 = 0 on the log scale
ax.plot(k[rest], floor, "x", color=plotting.RED, markersize=9, label=r"$\alpha_k = 1$: Theorem 1 silent")
ax.axhline(paper, color=plotting.GREY, linestyle=":", label=r"the paper's $\alpha - 1$ at $\bar k = 51$")
ax.set(xlabel="$k$", ylabel=r"$\alpha - 1$", ylim=(bottom / 3, 1))
plotting.legend_above(ax, 2)
plt.show()

# %% [markdown]
# **What to see.** The blue curve rises and then falls. For a while the sets shrink in every direction by several
# percent. Then the contraction decreases exponentially (a straight line on the logarithmic scale). Where a facet does
# not move (red cross), there is no blue value, but there is an orange one. Towards $\bar k$ both curves fall in the
# same way. The paper's $\alpha - 1$ (dotted) is small for the same reason. It is about a millionth, which is about the
# feasibility tolerance of a MILP solver. To distinguish such an $\alpha$ from 1, the sets must be computed more
# accurately.
#
# For a stability result with a larger margin, take an earlier $k$. All these sets are RPI, and every trajectory from
# $\mathcal{F}_{\max}$ enters them. An earlier set is larger, but its tube can be much wider.

# %% tags=["nbval-check-output"]
best = int(np.argmax(shrink)) + 1
print("alpha at its largest exceeds 1.01:", terminal.alphas[best - 1] > 1.01)
tube_there = shrink[best - 1] * terminal.history[best].support(C_eight).min()
print("the tube there is over 100 times as wide as at k-bar:", tube_there > 100 * delta_max)
print("contraction is never below alpha:", (direct >= shrink - 1e-8).all())

# %% [markdown]
# ## 7. The scaled minimal RPI set
#
# For linear systems one usually starts from the origin, and the sets *grow*: $\underline{\mathcal{R}}_{\min} = (1 +
# \underline\epsilon)\,\overline{\mathcal{R}}_{\underline k}(\mathbf 0)$, where $\underline k$ is the first step at
# which this set is RPI. For a PWA system, trajectories from $\mathcal{F}_{\max}$ need not reach this set; they may
# converge to another attractor. For this loop we can check that they reach it:

# %% tags=["nbval-check-output"]
minimal = mr.scaled_minimal_set(loop, C_eight, epsilon=1e-3, safe=safe)
print("RPI:", minimal.verdict, "- reached from F_max:", minimal.reached_at is not None)
print("along the 8 directions:", minimal.set.support(C_eight).round(2))
print("the same as R_min within 1 percent:", np.allclose(minimal.set.support(C_eight), h_last, rtol=0.01))

# %%
print(minimal.reason, "- and F_max is inside it from step", minimal.reached_at, "on")
fig, ax = plt.subplots(figsize=(5.4, 5), layout="constrained")
plotting.draw_set(ax, terminal.set, **plotting.TERMINAL, label=r"$\overline{\mathcal{R}}_{\min}$, from outside")
for i, R in enumerate(minimal.history[1:]):
    label = r"$\overline{\mathcal{R}}_k(\mathbf{0})$, from inside" if i == 0 else None
    plotting.draw_set(ax, R, **plotting.SEQUENCE, label=label)
plotting.draw_set(ax, minimal.set, **DASHED, label=r"$\underline{\mathcal{R}}_{\min}$")
plotting.label_axes(ax, terminal.set.scale(1.2, terminal.set.chebyshev()[0]))
plotting.legend_above(ax, 3)
plt.show()

# %% [markdown]
# **What to see.** The black sets grow from the origin and approach the outline of the blue set from inside. For this
# loop the two constructions give nearly the same set, and $\mathcal{F}_{\max}$ does reach the scaled minimal set. So
# the construction from outside is not more conservative here, and it needs no such check.

# %% [markdown]
# ## 8. The paper's numbers beside ours

# %%
rows = [
    ("iterations to F_max", case.paper["iterations"], safe.iterations),
    ("F_max, x1", "[-7.30, 8.91]", f"[{lower[0]:.2f}, {upper[0]:.2f}]"),
    ("F_max, x2", "[-10.00, 8.52]", f"[{lower[1]:.2f}, {upper[1]:.2f}]"),
    ("k-bar", case.paper["steps"], terminal.steps),
    ("alpha - 1", f"{case.paper['alpha'] - 1:.0e}", f"{terminal.alpha - 1:.0e}"),
]
for name, paper, here in rows:
    print(f"{name:20} paper {paper!s:>15}   here {here!s:>15}")

# %% [markdown]
# The differences depend on the trained network, and the paper's network is not published. Notebook 10 compares these
# numbers for many trained networks.
#
# ## What you saw
#
# - The iteration of Prop. 3, Fmax, is a loop of two lines. It stops when
#   $\overline{\mathcal{R}}_1(\mathcal{F}_k) \subseteq \mathcal{X}$, because $\mathcal{F}_k$ is then RPI. Two sides of
#   $\mathcal{F}_{\max}$ do not depend on the network here.
# - One template can fail where another succeeds. The witness shows at which state.
# - Eq. (25), TerminationFmin, bounds the limit set from inside and outside. The sets keep shrinking long after the
#   trajectories have arrived.
# - Reachable sets include the jumps at region boundaries. The nominal trajectory alone does not show them.
# - Theorem 1 needs $\alpha > 1$, and $\alpha - 1$ becomes very small near the limit. Its proof needs only a
#   contraction, which exists even where facets do not move.
#
# ## On your own
#
# - Replace `C_eight` by `mr.directions(16)` or `(32)` in section 3. How much smaller does the terminal set become?
# - Take `epsilon=1e-2` and `1e-5`. How does $\bar k$ depend on it? Why is the dependence roughly logarithmic?
# - Give the modes different disturbance sets (`loop.with_disturbance([D1, D2, D3, D4])`). Which mode matters for
#   $\mathcal{F}_{\max}$, which for $\overline{\mathcal{R}}_{\min}$?
# - Switch the controller off: `mr.MaxoutNetwork` with zero weights. What remains of the guarantee?
# - Exercise set 06: the largest disturbance, a template of your own, two different trajectories from one state.
#
# ## Further reading
#
# - D. Teichrib, M. Schulze Darup: *A mixed-integer framework for analyzing neural network-based controllers for
#   piecewise affine systems with bounded disturbances*, ECC 2025. Secs. IV and V.A.
# - S. V. Raković, E. C. Kerrigan, K. I. Kouramas, D. Q. Mayne: *Invariant approximations of the minimal robust
#   positively invariant set*, IEEE TAC 50(3), 2005: the construction from inside, for linear systems.
# - D. Mignone, G. Ferrari-Trecate, M. Morari: *Stability and stabilization of piecewise affine and hybrid systems: an
#   LMI approach*, CDC 2000: the source of the four modes.
#
# **Next:** notebook 07 turns a nonlinear plant into a PWA system whose disturbance set provably contains the error.
