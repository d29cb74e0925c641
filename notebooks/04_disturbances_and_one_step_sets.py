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
# # Add disturbances and compute one-step sets
#
# **What you will do.** Extend the mixed-integer model of notebook 03 by a disturbance whose set depends on the mode.
# Compute support functions of reachable sets with this model. Draw a reachable set and its over-approximations by
# templates. Decide whether a set is robustly positively invariant (RPI), with a counterexample if it is not.
#
# **What you will learn.** What eq. (14), MISysWithDis, adds to eq. (12), MISys. What Lemmas 1 and 2 state. Why the
# paper prefers $k$ small problems to one large problem, and how much accuracy this costs. How to check whether a set is
# RPI with a few support functions.
#
# **What you need.** Notebooks 01 to 03: support functions, templates, and the big-$M$ model of a piecewise-affine
# system. "Run all" takes about 15 seconds.

# %%
from time import perf_counter

import cvxpy as cp
import matplotlib.pyplot as plt
import numpy as np

import mireach as mr
from mireach.engines.cells import cells
from mireach.engines.cvxpy_model import model
from mireach.lab import step_viewer
from mireach.plotting import BLACK, BLUE, GREEN, GREY, RED, draw_regions, draw_set, label_axes

case = mr.case_study("pwa")
loop, system, X = case.loop, case.system, case.system.state_set
print(f"{len(system.modes)} modes, |d| <= {case.disturbance_bound} in each, {loop.network}")

# %% [markdown]
# ## 1. A disturbance set for every mode
#
# The system of the paper (eq. (1), SysWithDis) is
#
# $$x(k+1) = A^{(i)} x(k) + B^{(i)} u(k) + p^{(i)} + d(k), \qquad d(k) \in \mathcal{D}^{(i)}
#   \quad\text{if}\quad \begin{pmatrix} x(k) \\ u(k) \end{pmatrix} \in \mathcal{P}^{(i)}.$$
#
# By eq. (13), dinDi, the region of $(x, u)$ determines *which* disturbances are admissible. In the case study all four
# sets are the same small box. To show the possibilities of the model, we use four large sets of different shape: a box,
# a segment, a point and a diamond. If the set is a segment, the disturbance acts on both states in a fixed ratio. If it
# is a point, the disturbance is constant; here it is zero.

# %%
box = mr.Polytope.box([-1.2, -0.6], [1.2, 0.6])
segment = mr.Polytope.from_points([[-1.5, -1.5], [1.5, 1.5]])
point = mr.Polytope.box([0, 0], [0, 0])
diamond = mr.Polytope.from_points([[1, 0], [0, 1], [-1, 0], [0, -1]])

plant = system.with_disturbance([box, segment, point, diamond])  # eq. (13), dinDi

# %% [markdown]
# Notebook 03 chose the mode by binaries $\gamma_i$ (eq. (10), gammaForR). Each mode had its own copy $\tilde x^{(i)}$
# of the successor, which is zero unless $\gamma_i = 1$ (eq. (12b), MI_PWA_xTilde), and the successor was the sum of the
# copies (eq. (12c), MI_PWA_sumXTilde). All of this remains. **Eq. (14), MISysWithDis**, adds $d$ to the dynamics and
# makes its limits depend on the mode:
#
# $$\begin{aligned}
# -\mathbf{1} M (1 - \gamma_i) \le A^{(i)} x + B^{(i)} u + p^{(i)} + d - \tilde x^{(i)}
#   &\le \mathbf{1} M (1 - \gamma_i) & &\text{(14a, MI\_PWA\_ABpd)} \\
# H^{(\mathcal{D}^{(i)})} d &\le h^{(\mathcal{D}^{(i)})} + \mathbf{1} M (1 - \gamma_i) & &\text{(14b, MI\_PWA\_Hd)}
# \end{aligned}$$
#
# There is one $d$ for all modes. The binary that selects the mode also selects the set in which $d$ must lie.


# %%
def disturbed_step(system, x, u, M=100.0):
    """Constraints of one disturbed step from x under u; x_next and the choice gamma are their variables."""
    d, x_next = cp.Variable(2), cp.Variable(2)
    gamma = cp.Variable(len(system.modes), boolean=True)
    parts = [cp.Variable(2) for _ in system.modes]
    constraints = [cp.sum(gamma) == 1, x_next == sum(parts)]  # eqs. (10), gammaForR and (12c), MI_PWA_sumXTilde
    for i, mode in enumerate(system.modes):
        D, off = mode.disturbance, M * (1 - gamma[i])
        gap = mode.A @ x + mode.B @ u + mode.p + d - parts[i]
        constraints += [mode.region.H @ cp.hstack([x, u]) <= mode.region.h + off]  # eq. (10), gammaForR
        constraints += [-M * gamma[i] <= parts[i], parts[i] <= M * gamma[i]]  # eq. (12b), MI_PWA_xTilde
        constraints += [-off <= gap, gap <= off]  # eq. (14a), MI_PWA_ABpd
        constraints += [D.H @ d <= D.h + off]  # eq. (14b), MI_PWA_Hd
    return constraints, x_next, gamma


# %% [markdown]
# One common $M = 100$ is large enough here, because no quantity in this system exceeds 40. Notebook 02 showed the
# effect of a big-$M$ that is too small or too large. Now we fix a state and its input $u = \Phi(x)$, and maximise $x^+$
# along the eight directions of the template. The result is $h_{\mathcal{R}_1(\{x\})}(C)$. It must equal
# $C (A^{(i)} x + B^{(i)} u + p^{(i)}) + h_{\mathcal{D}^{(i)}}(C)$.

# %% tags=["nbval-check-output"]
C = mr.directions(8)
x, u, v = cp.Parameter(2), cp.Parameter(1), cp.Parameter(2)
constraints, x_next, gamma = disturbed_step(plant, x, u)
farthest = cp.Problem(cp.Maximize(v @ x_next), constraints)


def one_step_support(state):
    """h of R_1({state}) along the rows of C, one small MILP per row."""
    x.value, u.value = np.array(state), loop.network(np.array(state))
    supports = []
    for v.value in C:
        supports.append(farthest.solve(solver="HIGHS"))
    return np.array(supports)


states = [(4.5, 3), (8, -3), (-7, -5), (-6, 7)]  # one in each region
for state, mode in zip(states, plant.modes):
    by_hand = C @ mode.successor(np.array(state), u=loop.network(np.array(state))) + mode.disturbance.support(C)
    print(f"x = {state}: MILP and hand differ by {np.abs(one_step_support(state) - by_hand).max():.4f}")

# %%
fig, ax = plt.subplots(figsize=(6, 6))
draw_regions(ax, plant)
shapes = {"box": (-46, 8), "segment": (-58, 4), "point": (10, -4), "diamond": (-24, -34)}  # label offsets
for state, (shape, offset) in zip(states, shapes.items()):
    image = mr.Polytope(C, one_step_support(state) + 1e-6)
    middle = image.vertices().mean(axis=0)
    ax.plot(*state, "o", color=BLACK)
    ax.annotate("", middle, state, arrowprops={"arrowstyle": "->", "color": GREY, "linestyle": "--"})
    draw_set(ax, image, facecolor="#0072B250", edgecolor=BLUE, linewidth=1.8)
    if shape == "point":
        ax.plot(*middle, "o", color=BLUE, markersize=5)
    ax.annotate(shape, middle, offset, textcoords="offset points", color=BLUE)
    ax.annotate(
        f"$x = {state}$", state, (-28, 9 if state[1] > 0 else -17), textcoords="offset points", fontsize="small"
    )
label_axes(ax, X, r"$\mathcal{R}_1^{\mathcal{D}}(\{x\})$ for one state in each region")
plt.show()

# %% [markdown]
# Each dashed arrow leads from a state (black) to its undisturbed successor. Around the successor lies the disturbance
# set of the state's region: a box, a segment, a single point, a diamond.
#
# The regions are closed, so on a boundary more than one mode is feasible. The state $x = (0, -7)$ lies in the regions
# of modes 2 and 3. Their dynamics differ there, and the model admits both successors:

# %% tags=["nbval-check-output"]
on_boundary = (0, -7)
h_both = one_step_support(on_boundary)
for i in (1, 2):
    x_plus = plant.modes[i].successor(np.array(on_boundary, float), loop.network(np.array(on_boundary)))
    print(f"mode {i + 1}: x+ = ({x_plus[0]:.2f}, {x_plus[1]:.2f}) + D^({i + 1})")
print("h along (1, 0), (0, 1), (-1, 0), (0, -1):", np.round(h_both[::2], 2))

# %% [markdown]
# The value of the support function along $(-1, 0)$ comes from mode 3, and the value along $(1, 0)$ from mode 2. The
# model treats the map as set-valued on the boundary. A verdict therefore does not depend on the mode to which a
# boundary point is assigned.
#
# ## 2. Lemmas 1 and 2: the whole loop as one model
#
# **Lemma 1** combines the three parts for $k = 0, \dots, K-1$: the network (eq. (9), MI_Constraints_NN), the input
# $u = W^{(\ell+1)} q^{(\ell)} + b^{(\ell+1)}$ (eq. (15d), hatUEqWqplusB), and the disturbed step above. Every solution
# is a trajectory of the closed loop with admissible disturbances. **Lemma 2** adds an objective (eq. (17),
# MILPReachableSets):
#
# $$c_k^*(v, \mathcal{F}) = \max\; v\, x(k) \quad\text{s.t. the constraints of Lemma 1 and } x(0) \in \mathcal{F},
#   \qquad c_k^*(v, \mathcal{F}) = h_{\mathcal{R}_k^{\mathcal{D}}(\mathcal{F})}(v).$$
#
# `mireach.engines.cvxpy_model.model` builds this MILP, line by line as in this notebook, but with a computed big-$M$
# for every row. We return to the paper's disturbance $|d|_\infty \le 0.15$, and compute one step from a small box that
# contains part of the boundary between modes 2 and 3.

# %% tags=["nbval-check-output"]
F = mr.Polytope.box([-1, -8], [1, -6])
by_milp = mr.support(loop, F, C, engine="cvxpy")  # Lemma 2 with k = 1, in cvxpy
by_cells = mr.support(loop, F, C)  # the default engine in the plane
print("h by the MILP: ", np.round(by_milp.bound, 3))
print("h by the cells:", np.round(by_cells.bound, 3))
print("what attains h along (1, 0):")
print(by_cells.witness[0])

# %% [markdown]
# Both engines agree. The witness is the trajectory that attains the maximum. For two states there is a method without a
# MILP. It also lets us *draw* the set. $\mathcal{X}$ is divided into convex **cells**. On each cell one mode is active
# and the network is affine, $\Phi(x) = K x + g$. So $\mathcal{R}_1^{\mathcal{D}}(\mathcal{F})$ is the union of the
# convex pieces
#
# $$\big(A^{(i)} + B^{(i)} K\big)\,(\text{cell} \cap \mathcal{F}) + B^{(i)} g + p^{(i)} \;\oplus\; \mathcal{D}^{(i)}.$$


# %%
def image_pieces(loop, F):
    """The convex pieces of R_1(F), one for each cell that meets F."""
    every = cells(loop)
    parts, index = every.restrict(F)
    pieces = []
    for polygon, i in zip(parts, index):
        mode = loop.system.modes[every.mode[i]]
        u = polygon @ every.K[i].T + every.g[i]
        nominal = mode.successor(polygon, u)
        sums = nominal[:, None] + mode.disturbance.vertices()  # sums of vertices, for the Minkowski sum
        pieces.append(mr.Polytope.from_points(sums.reshape(-1, 2)))
    return pieces


# %% [markdown]
# We compare the pieces with samples: 20,000 random states of a larger box, each with a random disturbance.

# %% tags=["nbval-check-output"]
G = mr.Polytope.box([-6, -9], [8, 3])
rng = np.random.default_rng(0)
starts = G.sample(rng, 20_000)
landed = loop.simulate(starts, 1, rng)[:, 1]

pieces = image_pieces(loop, G)
inside = np.any([piece.contains(landed, tol=1e-9) for piece in pieces], axis=0)
print(f"{len(cells(loop))} cells, of which {len(pieces)} meet G; {inside.sum()} of {len(landed)} samples lie in them")

# %%
fig, axes = plt.subplots(1, 2, figsize=(8, 4.3), sharey=True)
axes[0].plot(*landed.T, ".", color=BLUE, markersize=1)
axes[0].set_title(r"sampled $x^+ \in \mathcal{R}_1^{\mathcal{D}}(\mathcal{G})$")
for piece in pieces:
    draw_set(axes[1], piece, facecolor="#0072B230", edgecolor=BLUE, linewidth=0.7)
axes[1].set_title("exact pieces, from the cells")
for ax in axes:
    draw_set(ax, G, facecolor="none", edgecolor=GREEN, linestyle="--", linewidth=1.8, label=r"$\mathcal{G}$")
    label_axes(ax, X, ax.get_title())
axes[1].set_ylabel("")
axes[0].legend(loc="upper left")
plt.show()

# %% [markdown]
# Left: the sampled successors. Right: the polygons that contain them. The set is not convex. It consists of pieces, and
# each piece is the image of one cell. Where a region boundary runs through $\mathcal{G}$, the image is split. The
# samples hardly ever come close to the corners of the set, so a proof cannot be based on them.
#
# ## 3. The outer approximation by a template
#
# The values $h_{\mathcal{R}_1^{\mathcal{D}}(\mathcal{F})}$ along the rows of a template $C$ define the set (eq. (18),
# Rover1)
#
# $$\overline{\mathcal{R}}_1^{\mathcal{D}}(\mathcal{F})
#   = \{x : C x \le h_{\mathcal{R}_1^{\mathcal{D}}(\mathcal{F})}(C)\}
#   \supseteq \mathcal{R}_1^{\mathcal{D}}(\mathcal{F}).$$
#
# It is the smallest set with these facet normals that contains the reachable set: every facet touches the reachable
# set. Additional rows cut off additional corners.


# %% tags=["nbval-check-output"]
outer = {rows: mr.outer_step(loop, G, mr.directions(rows)) for rows in (4, 8, 16)}  # eq. (18), Rover1
hull = mr.Polytope.from_points(np.vstack([piece.vertices() for piece in pieces]))
for rows, R in outer.items():
    print(f"{rows:2d} directions: area {R.area:6.1f}")
print(f"convex hull:   area {hull.area:6.1f}")

# %%
fig, axes = plt.subplots(1, 3, figsize=(8, 3.2), sharey=True)
for ax, (rows, R) in zip(axes, outer.items()):
    for piece in pieces:
        draw_set(ax, piece, facecolor="#0072B260", edgecolor="none")
    draw_set(ax, R, facecolor="none", edgecolor=BLACK, linewidth=1.5)
    label_axes(ax, X, f"{rows} directions")
for ax in axes[1:]:
    ax.set_ylabel("")
plt.show()

# %% [markdown]
# The black outline is $\overline{\mathcal{R}}_1^{\mathcal{D}}(\mathcal{G})$, and the blue area is the reachable set
# itself. With 8 directions instead of 4, the outline no longer has the large empty corners. With 16 directions it is
# close to the convex hull. A template set always contains the convex hull, so the gaps between the pieces remain inside
# for every $C$. Each row requires one MILP.
#
# ## 4. Several steps: one large MILP, or many small ones
#
# Lemma 2 holds for any $k$. Its MILP contains $k$ copies of the loop, each with $N_1 = s + \sum_i p_i w_i$ binaries:

# %% tags=["nbval-check-output"]
N_1 = len(system.modes) + loop.network.binaries  # saturation layers included
for k in (1, 2, 3):
    problem, *_ = model(loop, F, steps=k)
    binaries = sum(variable.size for variable in problem.variables() if variable.attributes["boolean"])
    print(f"k = {k}: {binaries:3d} binary variables in the model; k N_1 = {k * N_1}")

# %% [markdown]
# In the worst case each additional binary doubles the computation time. The alternative is to take $k$ single steps,
# and to over-approximate after each step (eq. (19), ROverOver):
#
# $$\overline{\mathcal{R}}_k^{\mathcal{D}}(\mathcal{F}) =
#   \underbrace{\overline{\mathcal{R}}_1^{\mathcal{D}}(\dots\overline{\mathcal{R}}_1^{\mathcal{D}}}_{k\text{ times}}
#   (\mathcal{F})) \supseteq \mathcal{R}_k^{\mathcal{D}}(\mathcal{F}).$$
#
# Each of these problems has only $N_1$ binaries, but from the second step on, each step starts from a set that is
# already too large. How large is the error? We compare along $v = (1, 0)$:

# %% tags=["nbval-check-output"]
v_right = C[:1]
sequence = mr.outer_reach(loop, F, C, steps=3)  # eq. (19), ROverOver
print("k   one MILP   by cells   outer steps")
for k in (1, 2, 3):
    large = mr.support(loop, F, v_right, steps=k, engine="cvxpy").value[0]  # eq. (17), MILPReachableSets
    exact = mr.support(loop, F, v_right, steps=k).value[0]
    print(f"{k}   {large:8.3f}   {exact:8.3f}   {sequence[k].support(v_right)[0]:11.3f}")

# %% [markdown]
# For $k = 1$ the three values agree by definition. From $k = 2$ on, the outer steps may give a larger value than the
# exact set, but never a smaller one. The MILP and the exact cells agree for every $k$. The next figure shows the same
# for all directions:

# %%
exact_pieces = [F]
fig, axes = plt.subplots(1, 3, figsize=(8, 3.4), sharey=True, layout="constrained")
for k, ax in enumerate(axes, start=1):
    exact_pieces = [image for piece in exact_pieces for image in image_pieces(loop, piece)]
    for piece in exact_pieces:
        draw_set(ax, piece, facecolor="#0072B2", edgecolor="none")
    around = mr.Polytope(C, mr.support(loop, F, C, steps=k).bound)
    draw_set(ax, around, facecolor="none", edgecolor=BLACK, linewidth=1.2, label="template, Lemma 2")
    draw_set(ax, sequence[k], facecolor="none", edgecolor=RED, linestyle="--", linewidth=1.6, label="outer steps")
    label_axes(ax, mr.Polytope.box([-7, -7], [3, 3]), f"$k = {k}$")
    ax.set_ylabel("$x_2$" if k == 1 else "")
fig.legend(handles=ax.patches[-2:], loc="outside lower center", ncols=2, frameon=False)
plt.show()

# %% [markdown]
# Blue: the exact set $\mathcal{R}_k^{\mathcal{D}}(\mathcal{F})$. Black: the template set around it, from Lemma 2 with
# $k$ steps. Red, dashed: $k$ outer steps. At $k = 1$ black and red coincide. The region boundary splits the image of
# $\mathcal{F}$ into two separate parts. The outer step fills the gap between them with states that are not reachable.
# The following steps also propagate these states. So from $k = 2$ on the red set is larger.
#
# The exact set needs a larger problem. On most machines the computation time grows much faster than $k$:

# %%
for k in (1, 2, 3):
    begin = perf_counter()
    mr.support(loop, F, v_right, steps=k, engine="cvxpy")
    print(f"k = {k}: {perf_counter() - begin:.2f} s for one direction")

# %% [markdown]
# The next figures show the sequence of outer sets step by step: first a few of them, then all with a slider. The dots
# are 1,500 simulated trajectories with random disturbances. **The slider needs a running kernel**; without one you see
# the static row.

# %%
long_sequence = mr.outer_reach(loop, F, C, steps=12)
paths = loop.simulate(F.sample(rng, 1500), 12, rng)


def draw_reach(ax, k):
    """Step k: all outer sets so far, the current one in red, and the states of the trajectories."""
    draw_regions(ax, system)
    for R in long_sequence[:k]:
        draw_set(ax, R, facecolor="none", edgecolor=GREY, linewidth=0.7)
    ax.plot(*paths[:, k].T, ".", color=BLUE, markersize=1.5)
    draw_set(ax, long_sequence[k], facecolor="none", edgecolor=RED, linestyle="--", linewidth=1.6)
    label_axes(ax, X, f"$k = {k}$")


fig, axes = plt.subplots(1, 4, figsize=(8, 2.6), sharey=True)
for ax, k in zip(axes, (0, 1, 3, 12)):
    draw_reach(ax, k)
    ax.set_ylabel("$x_2$" if k == 0 else "")
plt.show()

# %%
step_viewer(draw_reach, len(long_sequence))

# %% [markdown]
# All dots lie in the red set at every step. The sets move to the origin and converge to a set around it. Notebook 06
# studies this limit: the terminal set.
#
# ## 5. Is a set RPI?
#
# A set is RPI if no admissible disturbance leads out of it in one step:
# $\mathcal{R}_1^{\mathcal{D}}(\mathcal{F}) \subseteq \mathcal{F}$ (eq. (5), RPI). For a polytope
# $\mathcal{F} = \{x : H^{(\mathcal{F})} x \le h^{(\mathcal{F})}\}$ it suffices to check its own facets:
#
# $$\mathcal{F} \text{ is RPI} \iff h_{\mathcal{R}_1^{\mathcal{D}}(\mathcal{F})}\big(H^{(\mathcal{F})}\big)
#   \le h^{(\mathcal{F})}.$$
#
# No template is involved, so the test is exact. If the set is not RPI, a trajectory shows it. We check three
# candidates: all of $\mathcal{X}$, the box $|x|_\infty \le 4$, and the safe set $\mathcal{F}_{\max}$ that notebook 06
# computes.

# %% tags=["nbval-check-output"]
F_max = mr.safe_set(loop, case.safe_directions).set
candidates = {"X": X, "|x| <= 4": mr.Polytope.box([-4, -4], [4, 4]), "F_max": F_max}
for name, candidate in candidates.items():
    h_image = mr.support(loop, candidate, candidate.H).bound
    margin = np.round(candidate.h - h_image, 2) + 0.0
    print(f"{name:8s} is RPI: {bool((h_image <= candidate.h).all())!s:5s}  h - h_R1 = {margin}")

# %% [markdown]
# A negative entry belongs to a facet that the image violates. `mr.check_rpi` does the same and returns a **witness**: a
# state of the set, its input, the mode, a disturbance, and the successor, which lies outside the set. You can verify a
# witness by hand, independently of how it was found.

# %% tags=["nbval-check-output"]
checks = {name: mr.check_rpi(loop, candidate) for name, candidate in candidates.items()}
for name, check in checks.items():
    print(f"{name}: {check.verdict}")
    if check.witness is not None:
        print("   x =", np.round(check.witness.states[0], 2), " d =", np.round(check.witness.disturbances[0], 2))
        print("   x+ =", np.round(check.witness.states[1], 2))

# %%
fig, axes = plt.subplots(1, 3, figsize=(8, 3.5), sharey=True, layout="constrained")
symbols = (r"$\mathcal{X}$", r"$|x|_\infty \leq 4$", r"$\mathcal{F}_{\max}$")
for ax, symbol, (name, candidate) in zip(axes, symbols, candidates.items()):
    for piece in image_pieces(loop, candidate):
        draw_set(ax, piece, facecolor="#0072B240", edgecolor="none")
    draw_set(ax, candidate, facecolor="none", edgecolor=GREEN, linewidth=2)
    label_axes(ax, mr.Polytope.box([-11, -12], [11, 11]), f"{symbol}: {checks[name].verdict}")
    ax.set_ylabel("$x_2$" if ax is axes[0] else "")
    witness = checks[name].witness
    if witness is not None:
        start, end = witness.states
        ax.plot(*start, "o", color=BLACK, label=r"$x \in \mathcal{F}$")
        ax.plot(*end, "X", color=RED, markersize=8, label=r"$x^+ \notin \mathcal{F}$")
        arrow = {"arrowstyle": "-|>", "color": RED, "linewidth": 1.8, "connectionstyle": "arc3,rad=-0.5", "shrinkB": 3}
        ax.annotate("", end, start, arrowprops=arrow)
fig.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
plt.show()

# %% [markdown]
# Green outline: the candidate. Blue: its image $\mathcal{R}_1^{\mathcal{D}}$. In the first two panels a red arrow leads
# from a state of the set to a successor outside. This refutes the claim. In the third panel the blue set lies within
# the green outline: $\mathcal{F}_{\max}$ is proven to be RPI.
#
# The boxes fail for the following reason. In mode 3, $x_2^+ = 0.491\,x_1 + 0.62\,x_2 + d_2$ does not depend on the
# input. At the corner $(-r, -r)$ the smallest value is $-1.111\,r - 0.15 < -r$. So for every controller, no box
# $|x|_\infty \le r$ is RPI. An RPI set must exclude this corner.

# %% tags=["nbval-check-output"]
for r in (0.5, 2, 6, 10):
    check = mr.check_rpi(loop, mr.Polytope.box([-r, -r], [r, r]))
    print(f"r = {r}: {check.verdict}, margin along (0, -1): {check.margin[3]:.3f}")

# %% [markdown]
# The MILP engine reaches the same verdict without cells, and it also works for more than two states. There is a third
# verdict, *unknown*. If a solver is stopped early, its bound may be too weak for a proof, and it may have found no
# counterexample either.

# %% tags=["nbval-check-output"]
for name, candidate in candidates.items():
    print(f"{name}: {mr.check_rpi(loop, candidate, engine='milp').verdict} by the MILP")

# %% [markdown]
# ## What you saw
#
# - Eq. (14), MISysWithDis, adds one vector $d$ and one switched inequality per mode to the model of notebook 03. Boxes,
#   segments and points are all described by rows $H^{(\mathcal{D}^{(i)})} d \le h^{(\mathcal{D}^{(i)})}$.
# - Lemma 2 computes the support function of the $k$-step reachable set along $v$ by one MILP with $k N_1$ binaries.
# - Outer steps need $N_1$ binaries each, for every $k$. They over-approximate whatever a template cannot describe:
#   nonconvex shapes and gaps.
# - The RPI check is exact. It uses the facets of the set itself, and a refuted claim comes with a witness.
#
# ## On your own
#
# - Move $\mathcal{F}$ in section 4 away from the boundary $x_1 = 0$. Do black and red still differ at $k = 2$?
# - Use `mr.directions(32)` in the outer steps. Which errors become smaller, and which do not?
# - Replace the disturbance by `loop.with_disturbance(segment.scale(0.1))`. Is $\mathcal{F}_{\max}$ still RPI?
# - Exercises: in `exercises/ex04` you refute sets by hand, and compute the largest disturbance for which a set stays
#   RPI.
#
# ## Further reading
#
# - D. Teichrib, M. Schulze Darup, *A mixed-integer framework for analyzing neural network-based controllers for
#   piecewise affine systems with bounded disturbances*, ECC 2025: Sec. III (Lemmas 1 and 2, eq. (18), Rover1), Def. 1.
# - A. Bemporad, M. Morari, *Control of systems integrating logic, dynamics, and constraints*, Automatica 1999: the
#   big-$M$ model of piecewise-affine dynamics.
# - S. V. Raković et al., *Invariant approximations of the minimal robust positively invariant set*, IEEE TAC 2005.
#
# Next: **05_from_mpc_to_a_maxout_net** shows how the controller $\Phi$ is obtained.
