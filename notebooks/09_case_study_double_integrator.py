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
# # Certify the nonlinear double integrator
#
# The plant is nonlinear, and a 5x5 maxout network closes the loop. Nine affine maps approximate the plant, and a
# disturbance represents the approximation error. What the sets prove for the *piecewise-affine* loop also holds for the
# *nonlinear* one. This notebook is the paper's second case study and draws every set of it.
#
# **What you will do.** Iterate the safe set $\mathcal{F}_k$ and the terminal set $\overline{\mathcal{R}}_k$. Redraw
# Figure 3. Test Lemma 5, RkNonlinear, by simulations of the plant. Check Theorem 2. Vary the error bound.
#
# **What you will learn.**
# - why the safe set takes many iterations here, which facet delays the stopping rule, and which states cause the delay;
# - what eq. (25), TerminationFmin, measures, about the origin and about the equilibrium;
# - how a proof about a disturbed PWA loop applies to a plant without disturbance;
# - what a smaller or flatter error set gains.
#
# **What you need.** Notebooks 06 (the two iterations), 07 (the fit and its proven error) and 08 (the network, and the
# states without training data). "Run all" takes about 20 seconds.

# %%
import matplotlib.pyplot as plt
import numpy as np

import mireach as mr
from mireach import plotting
from mireach.lab import step_viewer
from mireach.studies.case_studies import double_integrator_fit

case = mr.case_study("double_integrator")
plant, network, loop, data = case.plant, case.network, case.loop, case.data
X, C = case.system.state_set, case.directions  # C: 8 directions
DASHED = {"facecolor": "none", "edgecolor": plotting.BLACK, "linestyle": "--", "linewidth": 1.4}
print(case)

# %% [markdown]
# ## 1. The loop that is analysed
#
# $$x(k+1) = A^{(i)} x(k) + B^{(i)} \Phi(x(k)) + p^{(i)} + d(k) \quad\text{if } x(k) \in \mathcal{P}^{(i)}, \qquad
#   d(k) \in \mathcal{D} = \{d : \|d\|_\infty \le 0.1186\}$$
#
# with nine square regions $\mathcal{P}^{(i)}$. It includes every step of the plant (eq. (28), f) if
#
# $$f(x, u) - f_{\text{PWA}}(x, u) \in \mathcal{D} \quad\text{for all } x \in \mathcal{X},\ u \in \mathcal{U}.$$
#
# Lemma 5, RkNonlinear, and Theorem 2 (Theorem 6 in the preprint's numbering, UUB) assume this. Notebook 07 has proven
# it with these numbers:

# %% tags=["nbval-check-output"]
print("largest error at the points of the fit:", round(case.fit.max_error, 4))
print("proven bound for all of X x U:         ", round(case.fit.proven_error, 4))
print("|d| <= 0.1186 covers it:               ", bool(case.fit.proven_error <= case.disturbance_bound))
print("regions:", len(case.system.modes), " binaries of the network:", network.binaries)

# %% [markdown]
# ## 2. The safe set, step by step
#
# Eq. (21), Fk, and Prop. 3, Fmax, as in notebook 06, now with eight directions:
#
# $$\mathcal{F}_0 = \mathcal{X}, \qquad
#   \mathcal{F}_{k+1} = \overline{\mathcal{R}}{}^{\mathcal{D}}_1(\mathcal{F}_k) \cap \mathcal{X},
#   \qquad\text{until}\quad \mathcal{R}^{\mathcal{D}}_1(\mathcal{F}_k) \subseteq \mathcal{X} .$$

# %%
history = [X]
while not (image := mr.outer_step(loop, history[-1], C)).is_subset(X) and len(history) < 200:
    history.append(image & X)  # eq. (21), Fk
print("by hand: F_max = F_k with k =", len(history) - 1)

# %% tags=["nbval-check-output"]
safe = mr.safe_set(loop, C)  # the same, and a verdict
print(f"{safe.verdict}: {safe.reason} (paper: {case.paper['iterations']} iterations)")
print("same set as by hand:", np.abs(safe.set.support(C) - history[-1].support(C)).max() < 1e-9)
print("F_max along the 8 directions:", safe.set.support(C).round(2))

# %%
fig, axes = plt.subplots(2, 4, figsize=(8, 4.6), layout="constrained", sharex=True, sharey=True)
plotting.plot_history(axes, safe.history)
for ax in axes.flat:
    ax.label_outer()
plt.show()

# %% [markdown]
# **What to see.** The first steps quickly cut off the corners. Then the set shrinks by thin layers, from above and from
# the left, while its right-hand side does not move at all. The slider shows all steps (it needs a running kernel):

# %%
step_viewer(lambda ax, k: plotting.plot_step(ax, safe.history, k), len(safe.history))

# %% [markdown]
# ### Which facet delays the end, and why?
#
# The iteration ends when the image of $\mathcal{F}_k$ lies in $\mathcal{X}$. The next figure shows, for each $k$, the
# offsets $h_{\mathcal{F}_k}(C_i)$ of the eight facets, and by how much the image exceeds $\mathcal{X}$ on each side.

# %%
facets = np.array([F.support(C) for F in safe.history])  # (k, 8)
leaves = np.array([mr.support(loop, F, X.H).value - X.h for F in safe.history])  # (k, 4)
fig, (left, right) = plt.subplots(1, 2, figsize=(8, 3.8), layout="constrained")
lines = ("-", "--", "-.", ":") * 2
arrows = ("→", "↗", "↑", "↖", "←", "↙", "↓", "↘")
for i, (values, arrow) in enumerate(zip(facets.T, arrows)):
    colour = plotting.BLUE if i < 4 else plotting.RED
    left.plot(values, lines[i], color=colour, label=f"{arrow} $C_{i + 1}$")
for values, side, line in zip(leaves.T, ("x_1 = 6", "x_2 = 6", "x_1 = -6", "x_2 = -6"), lines):
    right.plot(values, line, color=plotting.BLACK, label=f"${side}$")
left.set(xlabel="$k$", ylabel=r"$h_{\mathcal{F}_k}(C_i)$")
right.axhline(0, color=plotting.GREY, linewidth=2.2)
right.set(xlabel="$k$", ylabel=r"image leaves $\mathcal{X}$ by")
left.legend(ncols=2, fontsize="small", loc="upper right")
right.legend(fontsize="small")
plt.show()

# %% [markdown]
# **What to see.** Right: after the first few steps, and until the end, only the side $x_1 = 6$ is violated. The
# constraints at the other sides are satisfied after a few steps (below the grey line). Left: the facet $C_1$ (→) stays
# at 6, because the intersection cuts the image there in every step. The facets above and to the left keep shrinking.
#
# Which states leave $\mathcal{X}$ at $x_1 = 6$? The witnesses answer this. For each $k$ the witness is the state of
# $\mathcal{F}_k$ whose image has the largest $x_1$.

# %% tags=["nbval-check-output"]
shown = [0, len(safe.history) // 3, 2 * len(safe.history) // 3, safe.iterations - 1, safe.iterations]
for k in shown:
    step = mr.support(loop, safe.history[k], C[:1]).witness[0]  # along C_1
    (x, after), u = step.states.round(2), step.inputs[0, 0]
    no_data = np.abs(data.infeasible - x).max(axis=1).min() < np.abs(data.states - x).max(axis=1).min()
    print(f"k = {k:2d}: {x} with u = {u:.1f} -> {after}  {'no data there' if no_data else 'data nearby'}")

# %% [markdown]
# It is always the upper right corner of $\mathcal{F}_k$, on $x_1 = 6$. As long as the image exceeds $\mathcal{X}$, this
# corner lies where the data set has no data. This is *not* a mistake of the network. It brakes with the full input, and
# notebook 08 has shown that no input can keep such states in $\mathcal{X}$. For the plant at $x_1 = 6$,
#
# $$x_1^+ = 6 + x_2 + 0.5\,u + 0.025\,(36 + x_2^2) \le 6 \quad\text{with } u = -2
#   \quad\Longleftrightarrow\quad x_2 + 0.025\, x_2^2 \le 0.1 .$$

# %% tags=["nbval-check-output"]
highest = np.roots([0.025, 1, -0.1]).max()
print(f"at x1 = 6 the plant can be kept in X only where x2 <= {highest:.3f}, whatever the controller")

# %% [markdown]
# So $\mathcal{F}_k$ cannot be RPI while it contains such states in its upper right corner. What the network does in the
# corner does not matter for this, because $\mathcal{F}_{k+1}$ encloses the states that are *reached*. The corner
# disappears only when no step ends in it or so close to it that the polygon with eight facets contains it. Which steps
# determine the upper facets? For each facet we draw the step that attains it.


# %%
def draw_attaining(ax, k):
    """F_k, its image, and for each direction C_i the step x -> x+ that attains the support."""
    F = safe.history[k]
    plotting.draw_set(ax, X, facecolor="none", edgecolor=plotting.GREY, linewidth=2.2)
    plotting.draw_set(ax, F, **plotting.SAFE)
    plotting.draw_set(ax, mr.outer_step(loop, F, C), **DASHED)
    for witness in mr.support(loop, F, C).witness:
        start, end = witness.states
        inside = X.contains(end, tol=1e-9)
        ax.annotate("", end, start, arrowprops={"arrowstyle": "->", "linestyle": "-" if inside else "--",
                    "color": plotting.BLUE if inside else plotting.RED, "linewidth": 1.5})  # fmt: skip
    plotting.label_axes(ax, mr.Polytope.box([-9.6, -6.2], [13, 7.5]), f"$k = {k}$")


fig, axes = plt.subplots(2, 2, figsize=(8, 5.4), layout="constrained", sharex=True, sharey=True)
for ax, k in zip(axes.flat, (0, 5, 2 * safe.iterations // 3, safe.iterations)):
    draw_attaining(ax, k)
    ax.label_outer()
plt.show()

# %% [markdown]
# **What to see.** Green: $\mathcal{F}_k$. Dashed black: its image $\overline{\mathcal{R}}_1(\mathcal{F}_k)$. Dashed red
# arrows leave $\mathcal{X}$. In the lower left panel the facets ↑, ↖ and ← are attained by arrows from the *left*. They
# start in states with $x_1 < 0$, where the network accelerates strongly, with almost $u = 2$, and they overshoot to
# $x_2 > 0$. The template has only eight directions. The half-plane of the facet ↑ must contain these successors far on
# the left. It therefore also contains the corner at $x_1 = 6$, whether or not any step ends there. The left side
# shrinks layer by layer, and with it the corner.
#
# We can test whether the template causes the delay. More directions remove the corner earlier:

# %% tags=["nbval-check-output"]
for count in (4, 8, 12, 16):
    found = mr.safe_set(loop, mr.directions(count))
    print(f"{count:2d} directions: {found.verdict:8s} k = {found.iterations}")

# %%
step_viewer(draw_attaining, len(safe.history), size=(6.5, 4.0))

# %% [markdown]
# ## 3. The terminal set
#
# Starting from $\mathcal{F}_{\max}$, the sequence
# $\overline{\mathcal{R}}_k = \overline{\mathcal{R}}_1(\overline{\mathcal{R}}_{k-1})$ shrinks to the set where the
# trajectories end (eq. (24), RminOver). Every $\overline{\mathcal{R}}_k$ is RPI. Eq. (25), TerminationFmin, only
# determines when to stop: for $\overline\epsilon = 10^{-3}$, at the first $k$ with
#
# $$\mathcal{S} \subseteq \overline{\mathcal{R}}_1(\mathcal{S}), \qquad
#   \mathcal{S} = c + \tfrac{1}{1 + \overline\epsilon}\, \big(\overline{\mathcal{R}}_k(\mathcal{F}_{\max}) - c\big).$$
#
# The paper scales about the origin, $c = 0$. The equilibrium of the loop is another point, and the sets converge around
# the equilibrium:

# %% tags=["nbval-check-output"]
print("equilibrium of the nominal loop:", loop.equilibrium().round(2))
about = {name: mr.terminal_set(loop, safe, C, epsilon=1e-3, centre=name) for name in ("origin", "equilibrium")}
for name, found in about.items():
    print(f"about the {name:12s} k = {found.steps}, eq. (25), TerminationFmin, holds: {found.criterion}")
print("paper:                 k =", case.paper["steps"])

# %%
terminal = about["origin"] if about["origin"].criterion else about["equilibrium"]
fig, axes = plt.subplots(2, 4, figsize=(8, 3.3), layout="constrained", sharex=True, sharey=True)
plotting.plot_history(axes, terminal.history, name=r"\overline{\mathcal{R}}")
for ax in axes.flat:
    ax.label_outer()
plt.show()

# %% [markdown]
# **What to see.** After about seven steps all states are in a small neighbourhood of the origin. The rest is a slow
# convergence to the limit. The slider and the next cell show it in detail:

# %%
step_viewer(lambda ax, k: plotting.plot_step(ax, terminal.history, k, r"\overline{\mathcal{R}}"), len(terminal.history))


# %%
def excess(R, c, epsilon=1e-3):
    """By how much S exceeds R1-bar(S); eq. (25), TerminationFmin, holds where this is at most 0."""
    S = R.scale(1 / (1 + epsilon), c)
    return (S.support(C) - mr.support(loop, S, C).value).max()


fig, ax = plt.subplots(figsize=(6.4, 3.4), layout="constrained")
for (name, found), colour, line in zip(about.items(), (plotting.BLACK, plotting.BLUE), ("o-", "s--")):
    values = np.array([excess(R, found.centre) for R in found.history])
    positive = values > 0
    ax.semilogy(np.flatnonzero(positive), values[positive], line, color=colour, markersize=4, label=f"about the {name}")
    if not positive[-1]:
        ax.axvline(len(values) - 1, color=colour, linestyle=":", label=f"holds at k = {len(values) - 1}")
ax.set(xlabel="$k$", ylabel=r"$\mathcal{S}$ sticks out by")
ax.legend()
plt.show()

# %% [markdown]
# **What to see.** Once the trajectories are near the equilibrium, the excess falls by a constant factor per step, the
# contraction factor of the loop. At the dotted lines it becomes negative, which a logarithmic axis cannot show. About
# the equilibrium this happens a little earlier here. The reason: the sets converge around the equilibrium, so scaling
# $\overline{\mathcal{R}}_k$ towards it shrinks the set evenly. About another point, especially one near the boundary of
# the sets, the test may fail for every $k$. Section 6 has examples.
#
# ## 4. Figure 3
#
# The figure shows one trajectory of the *plant* from $x(0) = (5.5, -1.5)$, and the sets
# $\overline{\mathcal{R}}_i(\{x(0)\})$, which contain the state of the disturbed PWA loop after $i$ steps (eq. (19),
# ROverOver). They start from a single point.

# %%
start = case.starts[0]
path = plant.simulate(network, start, terminal.steps)
point = mr.Polytope(C, C @ start)
reach = mr.outer_reach(loop, point, C, terminal.steps)[1:]
inside = [R.contains(x, tol=1e-9) for R, x in zip(reach, path[1:])]

fig, ax = plt.subplots(figsize=(7.6, 5.2), layout="constrained")
plotting.plot_vector_field(ax, case.system, safe, terminal, lambda x: plant.step(network, x), path, reach)
plt.show()

# %% tags=["nbval-check-output"]
print("the plant's state is in the reachable set at every step:", all(inside))
entered = [R.is_subset(terminal.set) for R in reach]
print("guaranteed to be in the terminal set from step", terminal.steps, "for all of F_max,")
print(
    "    and already from step", 1 + int(np.argmax(entered)), "for this initial state (its reachable sets lie in it);"
)
print("it is there from step", int(np.argmax(terminal.set.contains(path))))

# %% [markdown]
# **What to see.** The red path of the plant stays within the small black sets around its states, and both end in the
# hatched terminal set. Grey arrows: one step of the plant from many states, drawn at a quarter of its length. On the
# right they point down and left, because the plant brakes.
#
# ## 5. What holds for the plant
#
# **Lemma 5, RkNonlinear.** If $\mathcal{F}$ is RPI, lies in $\mathcal{X}$, and $f - f_{\text{PWA}} \in \mathcal{D}$,
# then $\mathcal{R}_k(\mathcal{F}) \subseteq \mathcal{R}^{\mathcal{D}}_k(\mathcal{F})$ for all $k$: the reachable sets
# of the plant lie in those of the disturbed PWA loop. A simulation cannot prove this, but it could refute it.

# %% tags=["nbval-check-output"]
begin = np.vstack([safe.set.sample(np.random.default_rng(0), 3000), safe.set.vertices()])
paths = plant.simulate(network, begin, terminal.steps + 10)  # (N, k, 2), the plant: no disturbance
slack = np.array([(R.h - paths[:, k] @ R.H.T).min() for k, R in enumerate(terminal.history)])
print("plant trajectories: 3000, and from every vertex")
print("all in R_k-bar at every step k:", bool((slack >= -1e-9).all()))
print("all in F_max at all times:     ", bool(safe.set.contains(paths, tol=1e-9).all()))
print("all in R_min-bar from k-bar on:", bool(terminal.set.contains(paths[:, terminal.steps :], tol=1e-9).all()))

# %%
fig, axes = plt.subplots(1, 2, figsize=(8, 3.4), layout="constrained")
steps = np.arange(terminal.steps + 1)
for j, ax in enumerate(axes):
    boxes = np.array([R.bounding_box() for R in terminal.history])[:, :, j]
    ax.fill_between(steps, *boxes.T, facecolor="#0072B225", edgecolor=plotting.BLUE, hatch="//", linewidth=1,
                    label=r"$\overline{\mathcal{R}}_k(\mathcal{F}_{\max})$")  # fmt: skip
    spread = paths[:, : len(steps), j]
    ax.fill_between(steps, spread.min(axis=0), spread.max(axis=0), color=plotting.RED, alpha=0.6, label="plant")
    ax.set(xlabel="$k$", ylabel=f"$x_{j + 1}$")
    ax.legend()
plt.show()

# %% [markdown]
# **What to see.** The plant (red) stays within the guaranteed band (hatched), and in the end it uses only a small part
# of the band. The plant converges to a point, while the bound must allow for a disturbance that may act in any
# direction at every step.
#
# **Theorem 2.** Under the same assumption the plant with $u(k) = \Phi(x(k))$ is ultimately bounded in
# $\overline{\mathcal{R}}_{\min}$, uniformly in $\mathcal{F}_{\max}$, and never violates the constraints on $x$ and $u$.
# The next cell checks each condition. It checks the first one by ball arithmetic, over all of
# $\mathcal{X} \times \mathcal{U}$:

# %% tags=["nbval-check-output"]
theorem = mr.ultimately_bounded(plant, loop, safe, terminal)
for condition, holds in theorem.conditions.items():
    print(f"{'yes' if holds else 'NO ':4s}{condition}")
print("Theorem 2:", theorem.verdict)

# %% [markdown]
# The last condition is needed because ultimate boundedness is defined for C-sets, which contain the origin in their
# interior.
#
# ## 6. What a better error set gains
#
# The error bound is a choice. We compare four disturbance sets for the same plant and network, all proven (notebook
# 07):
#
# - **paper**: least squares, $\|d\|_\infty \le 0.1186$;
# - **tight box**: the same fit, but the error is not symmetric: it lies in $[-0.0815, 0.1185]$ in each component;
# - **minimax**: another fit, with the smallest possible bound, $\|d\|_\infty \le 0.1$;
# - **segment**: both components of $f$ have the same nonlinear term, so $d_1 = d_2$ always.


# %%
minimax = double_integrator_fit(method="minimax")
systems = {
    "paper": case.system,
    "tight box": case.fit.system(),
    "minimax": minimax.system(),
    "segment": case.fit.with_error("polytope").system(),
}

# %% tags=["nbval-check-output"]
sets = {}
for name, system in systems.items():
    variant = mr.ClosedLoop(system, network)
    F = mr.safe_set(variant, C)
    R = {centre: mr.terminal_set(variant, F, C, centre=centre) for centre in ("origin", "equilibrium")}
    sets[name] = F.set, R["equilibrium"].set
    bounded = mr.ultimately_bounded(plant, variant, F, R["equilibrium"]).verdict
    areas = f"areas {F.set.area:.2f} and {sets[name][1].area:.2f}"
    met = R["origin"].criterion
    print(f"{name:9s} k = {F.iterations}, {areas}, Theorem 2 {bounded}, rule about the origin met: {met}")

# %% [markdown]
# Each line gives the $k$ with $\mathcal{F}_{\max} = \mathcal{F}_k$, the areas of $\mathcal{F}_{\max}$ and of
# $\overline{\mathcal{R}}_{\min}$ (with the equilibrium as centre), the verdict of Theorem 2, and whether eq. (25),
# TerminationFmin, ever held about the origin. Where it did not, the sequence converged without it. Its last set is RPI
# nevertheless; only the stopping rule does not apply.

# %%
fig, (left, middle, right) = plt.subplots(1, 3, figsize=(8.6, 3.6), layout="constrained")
looks = {"paper": (plotting.BLACK, "-"), "tight box": (plotting.ORANGE, "--"), "minimax": (plotting.BLUE, ":"),
         "segment": (plotting.RED, "-.")}  # fmt: skip
for name, (colour, line) in looks.items():
    style = {"facecolor": "none", "edgecolor": colour, "linestyle": line, "linewidth": 1.8, "label": name}
    for ax, P in zip((left, middle, right), (systems[name].modes[0].disturbance, *sets[name])):
        plotting.draw_set(ax, P, **style)
for ax, P, title in zip((left, middle, right), (systems["paper"].modes[0].disturbance, *sets["paper"]),
                        (r"$\mathcal{D}$", r"$\mathcal{F}_{\max}$", r"$\overline{\mathcal{R}}_{\min}$")):  # fmt: skip
    plotting.label_axes(ax, P, title)
left.set(xlabel="$d_1$", ylabel="$d_2$")
fig.legend(*middle.get_legend_handles_labels(), loc="outside lower center", ncols=4)
plt.show()

# %% [markdown]
# **What to see.** Left: the four sets $\mathcal{D}$. Middle: $\mathcal{F}_{\max}$ changes little. A smaller
# $\mathcal{D}$ makes it *smaller* here, because it consists of forward images: $\mathcal{F}_{\max}$ is a safe set, not
# the largest one. Right: the terminal set, which contains the plant's state in the end, improves most. (It also moves
# away from the origin, which then lies close to its boundary. The origin is then not a good centre for eq. (25),
# TerminationFmin.)
#
# The tight box and the minimax fit give the same sets. To see why, compare the two fits:

# %% tags=["nbval-check-output"]
shifts = np.array([a.p - b.p for a, b in zip(minimax.modes, case.fit.modes)])
same = max(np.abs(a.A - b.A).max() for a, b in zip(minimax.modes, case.fit.modes)) < 1e-9
print("same A in all regions:", same)
print("p differs by", np.unique(shifts.round(4)), "in every region and component")

# %% [markdown]
# They differ by a constant in $p$, and the centre of the tight box differs from 0 by the same constant. So
# $p^{(i)} + \mathcal{D}$ is the same set. The smaller number 0.1 needs no other fit: it suffices to bound the error
# separately from below and from above.
#
# The segment has no area, but $\overline{\mathcal{R}}_{\min}$ has, because the loop rotates the segments of earlier
# steps before it adds the next one.
#
# ## What you saw
#
# - In the upper right corner of $\mathcal{F}_k$ no controller can keep the state in $\mathcal{X}$. The iteration could
#   not end before this corner was removed. The corner remained that long because of the eight directions, not because
#   of the network's extrapolation.
# - Eq. (25), TerminationFmin, depends on a centre. The equilibrium is the natural one.
# - Lemma 5, RkNonlinear, and Theorem 2 turn sets of a disturbed PWA loop into guarantees for the undisturbed plant. The
#   approximation enlarges the terminal set, and a better error set reduces this effect.
#
# ## On your own
#
# - Take a fit on 5 x 5 regions (`double_integrator_fit(5)`). What happens to the error, and to both sets?
# - Use 16 directions for everything. Compare the area of the terminal set with what the error sets gained.
# - Train a network of your own in notebook 08 and analyse it: `mr.case_study("double_integrator", network)`.
# - Use the MILP: `mr.safe_set(loop, C, engine="milp")`. Are the numbers the same, and how long does it take?
#
# ## Further reading
#
# - D. Teichrib, M. Schulze Darup: *A mixed-integer framework for analyzing neural network-based controllers for
#   piecewise affine systems with bounded disturbances*, ECC 2025. Secs. IV.D and V.B.
# - F. Blanchini: *Ultimate boundedness control for uncertain discrete-time systems via set-induced Lyapunov functions*,
#   IEEE TAC 39(2), 1994.
# - M. Lazar, W. P. M. H. Heemels: *Optimized input-to-state stabilization of discrete-time nonlinear systems with
#   bounded inputs*, ACC 2008: the plant.
#
# **Next:** notebook 10 goes beyond the paper: exact sets instead of templates. **Exercise:** set ex09: the iteration by
# hand, the largest disturbance bound, plant trajectories as counterexamples, eq. (25), TerminationFmin, a bound that is
# too small.
