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
# # Go beyond the paper: exact cells, better centres, tighter errors, many seeds, certificates
#
# **What you will do.** Draw the closed loops of both case studies as hundreds of affine pieces, and compute
# $h_{\mathcal{R}_1}$ without a MILP. Find a network for which the paper's stopping rule never holds, find the reason,
# and correct the rule. Shrink the error set of the double integrator from a square to a segment. Use a study of many
# trained networks to see how typical the paper's numbers are, and what determines them. Write a certificate, check it
# in exact arithmetic, and forge one.
#
# **What you will learn.** Why a maximum over vertices replaces the MILP for two states. Why *the sequence has
# converged* and *the stopping rule holds* are two different statements. What $\alpha = 1$ means. How much a certificate
# depends on the template, on the error set, and on the seed of the training.
#
# **What you need.** Notebooks 04, 06, 07 and 09. "Run all" takes about a minute.

# %%
import json
import tempfile
from fractions import Fraction
from pathlib import Path
from timeit import timeit

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import PolyCollection
from scipy.stats import spearmanr

import mireach as mr
from mireach import plotting
from mireach.engines.cells import cells
from mireach.studies.case_studies import CASES, data_file, double_integrator_fit
from mireach.studies.seed_study import load_networks, load_rows

cases = {name: mr.case_study(name) for name in ("pwa", "double_integrator")}
safe = {name: mr.safe_set(case.loop, case.safe_directions) for name, case in cases.items()}
for name in cases:
    print(f"{name}: F_max after {safe[name].iterations} iterations, {safe[name].verdict}")

# %% [markdown]
# ## 1 The closed loop is piecewise affine: draw the pieces
#
# A maxout network is piecewise affine, the plant is piecewise affine, and so is their loop. There are convex polygons
# $\mathcal{C}_1, \mathcal{C}_2, \dots$ that cover $\mathcal{X}$, the *cells*. On each of them one mode $i$ is active
# and $\Phi(x) = K x + g$ with one $K$ and one $g$. So
#
# $$ x^+ = \underbrace{(A^{(i)} + B^{(i)} K)}_{M}\, x + \underbrace{B^{(i)} g + p^{(i)}}_{c} + d,
#    \qquad d \in \mathcal{D}^{(i)}, \qquad x \in \mathcal{C}_j . $$
#
# For two states the cells are easy to compute. Begin with the regions $\mathcal{P}^{(i)}$, intersected with
# $\mathcal{X}$. Pass them through the network neuron by neuron, and split a polygon wherever the largest channel in
# eq. (8), maxout, changes. `mireach.engines.cells.cells` does this.


# %%
def draw_cells(ax, found, colour, hatched):
    """All cells as polygons; `colour` (N, 4) is their face colour, `hatched` (N,) selects those with a hatch."""
    faces = [found.polygons[i] for i in range(len(found))]
    ax.add_collection(PolyCollection(faces, facecolors=colour, edgecolors="black", linewidths=0.3))
    faces = [face for face, dots in zip(faces, hatched) if dots]  # grey dots are visible on dark and on bright cells
    ax.add_collection(PolyCollection(faces, facecolors="none", edgecolors=plotting.GREY, linewidths=0, hatch="...."))


# %%
TINTS = np.array([[0.90, 0.62, 0.0, 0.8], [0.34, 0.71, 0.91, 0.8], [1.0, 1.0, 1.0, 1.0], [0.0, 0.45, 0.70, 0.8]])
figure, axes = plt.subplots(2, 2, figsize=(7.6, 6.6), layout="constrained")
for (name, case), (top, bottom) in zip(cases.items(), axes.T):
    found, limit = cells(case.loop), case.system.input_set.h.max()
    u = np.array([case.network(found.polygons[i].mean(axis=0))[0] for i in range(len(found))])
    saturated = (found.K == 0).all(axis=(1, 2))
    draw_cells(top, found, TINTS[found.mode % 4], np.zeros(len(found), bool))
    draw_cells(bottom, found, plt.cm.cividis((u / limit + 1) / 2), saturated)
    plotting.label_axes(top, case.system.state_set, f"{name}: {len(found)} cells by mode")
    plotting.label_axes(bottom, case.system.state_set, r"by $\Phi$ at their centres")
    scale = plt.cm.ScalarMappable(plt.Normalize(-limit, limit), "cividis")
    figure.colorbar(scale, ax=bottom, label="$u$", shrink=0.7, aspect=15)
plt.show()

# %% [markdown]
# Every polygon is one affine map. Top: the colour shows the mode, i.e. the four quadrants of case 1 and the chessboard
# of case 2. Bottom: the colour shows the input in the middle of the cell. Dots mark cells on which the network is
# saturated ($K = 0$, $u$ at a limit); they fill most of $\mathcal{X}$. Small cells accumulate where the slope of the
# control law changes quickly.
#
# ### The support function of R1 is a maximum over vertices
#
# On a cell, $v x^+ = v (M x + c) + v d$ is linear in $x$ and in $d$, and a linear function attains its maximum over a
# polygon at a vertex. So Lemma 2 needs no integer variable here:
#
# $$ h_{\mathcal{R}_1(\mathcal{F})}(v) = \max_j \; \max_{x \in \operatorname{vert}(\mathcal{C}_j \cap \mathcal{F})}
#    v (M_j x + c_j) + h_{\mathcal{D}^{(i_j)}}(v) . $$


# %%
def h_by_vertices(loop, F, V):
    """h of R_1(F) along the rows of V: the formula above."""
    found = cells(loop)
    parts, index = found.restrict(F)  # the polygons C_j & F, and the j of each
    x, j = parts.points, index[parts.owner]  # all their vertices, and the cell of each
    u = np.einsum("tij,tj->ti", found.K[j], x) + found.g[j]  # Phi(x) = K x + g
    value = np.full(len(V), -np.inf)
    for i, mode in enumerate(loop.system.modes):
        here = found.mode[j] == i
        if here.any():
            best = (mode.successor(x[here], u[here]) @ V.T).max(axis=0) + mode.disturbance.support(V)
            value = np.maximum(value, best)
    return value


# %% [markdown]
# We compare with the MILP of Lemma 2, which does not use cells, over $\mathcal{F}_{\max}$ in eight directions:

# %% tags=["nbval-check-output"]
C = mr.directions(8)
milp = {}
for name, case in cases.items():
    F = safe[name].set
    here, milp[name] = h_by_vertices(case.loop, F, C), mr.support(case.loop, F, C, engine="milp")
    engine = mr.support(case.loop, F, C, engine="cells")
    print(f"{name}: vertices against MILP {np.abs(here - milp[name].value).max():.5f},", end=" ")
    print(f"against the cell engine {np.abs(here - engine.value).max():.5f}")

# %% [markdown]
# Two methods that share only the network's weights agree. Their times differ:

# %%
for name in cases:
    case = cases[name]
    by_cells = timeit('mr.support(case.loop, safe[name].set, C, engine="cells")', globals=globals(), number=1)
    by_milp = timeit('mr.support(case.loop, safe[name].set, C, engine="milp")', globals=globals(), number=1)
    print(f"{name}: cells {1000 * by_cells:.1f} ms, MILP {1000 * by_milp:.0f} ms for 8 directions")

# %% [markdown]
# Because of this speed, the earlier notebooks could iterate sets interactively. The drawback: the library computes
# these cells only for two states, and their number grows quickly with the network. The MILP also works for $n > 2$.
#
# ### What the template adds
#
# The union of the images of the cells, each enlarged by $\mathcal{D}$, *is* $\mathcal{R}_1(\mathcal{F}_{\max})$. So we
# can draw what the outer set $\overline{\mathcal{R}}_1 = \{x : C x \le h_{\mathcal{R}_1}(C)\}$ (eq. (18), Rover1) adds
# to it.


# %%
def draw_image(ax, loop, F, **style):
    """R_1(F) without a template: the image of every cell within F, enlarged by D (Minkowski sum)."""
    found = cells(loop)
    parts, index = found.restrict(F)
    for i, j in enumerate(index):
        mode = loop.system.modes[found.mode[j]]
        after = mode.successor(parts[i], parts[i] @ found.K[j].T + found.g[j])
        corners = (after[:, None] + mode.disturbance.vertices()).reshape(-1, 2)
        plotting.draw_set(ax, mr.Polytope.from_points(corners), **style)


# %%
figure, axes = plt.subplots(1, 2, figsize=(7.6, 4.2), layout="constrained")
for ax, (name, case) in zip(axes, cases.items()):
    F = safe[name].set
    draw_image(ax, case.loop, F, facecolor=plotting.GREY, edgecolor="none")
    plotting.draw_set(ax, F, **{**plotting.SAFE, "facecolor": "none"}, label=r"$\mathcal{F}_{\max}$")
    outer = mr.outer_step(case.loop, F, case.directions)
    style = {"facecolor": "none", "edgecolor": plotting.BLUE, "linewidth": 1.6, "linestyle": "--"}
    plotting.draw_set(ax, outer, **style, label=r"$\overline{\mathcal{R}}_1(\mathcal{F}_{\max})$, 8 directions")
    plotting.label_axes(ax, F)
    plotting.legend_above(ax, 2)
    ax.set_xlabel(f"$x_1$\n{name}")
plt.show()

# %% [markdown]
# Grey is the exact reachable set. It is not convex. In case 1 it has several arms, because the dynamics are
# discontinuous between modes. The dashed polygon touches it in eight directions and fills the rest. This
# over-approximation is added in every step of the paper's sequences. Section 4 shows how much it can matter.

# %% [markdown]
# ## 2 Why the stopping rule can fail
#
# The terminal set is $\overline{\mathcal{R}}_{\min} = \overline{\mathcal{R}}_{\bar k}(\mathcal{F}_{\max})$ with the
# first $\bar k$ at which (eq. (25), TerminationFmin)
#
# $$ S := \tfrac{1}{1+\bar\epsilon} \overline{\mathcal{R}}_{\bar k}(\mathcal{F}_{\max})
#    \subseteq \overline{\mathcal{R}}_1(S) . $$
#
# This bounds the distance of the set from the limit $\overline{\mathcal{R}}_\infty$. But there is no guarantee that it
# ever holds. The seed study has 100 networks for the double integrator that differ only in the seed of their initial
# weights. We select one for which it does not hold.

# %% tags=["nbval-check-output"]
rows = {name: load_rows(data_file(name, "seeds.csv")) for name in cases}
networks = {name: load_networks(name) for name in cases}
proven = {name: [row for row in rows[name] if row.verdict == "proven"] for name in cases}
failing = [row for row in proven["double_integrator"] if not row.criterion and row.criterion_equilibrium]
print(f"double_integrator: {len(proven['double_integrator'])} of {len(rows['double_integrator'])} have a safe set;")
print(f"for {len(failing)} of these the rule never holds about the origin, but does about the equilibrium")

# %% tags=["nbval-check-output"]
chosen = min(failing, key=lambda row: (row.alpha_equilibrium <= 1, row.loss))
case = mr.case_study("double_integrator", networks["double_integrator"][chosen.seed])
loop, F_max = case.loop, mr.safe_set(case.loop, case.directions)
about = {z: mr.terminal_set(loop, F_max, case.directions, case.epsilon, z) for z in ("origin", "equilibrium")}
limit = about["origin"].set
print(f"seed {chosen.seed}:")
for z, found in about.items():
    words = f"the rule holds at k = {found.steps}" if found.criterion else found.reason.split(":")[0]
    print(f"  about the {z} {np.round(found.centre, 3) + 0.0}: {words}")

# %% [markdown]
# `terminal_set` detected that two consecutive sets are equal, to the last digit of every offset: the sequence *has*
# converged. The set is RPI and is reached from all of $\mathcal{F}_{\max}$, regardless of the rule. Only the rule
# fails, and it fails at every later $k$, too. The next figure shows the distance to the limit, and $S$ with an
# $\bar\epsilon$ that is large enough to be visible:


# %%
def draw_shrunk(ax, z, epsilon=0.4):
    """The limit R, S = z + (R - z) / (1 + epsilon), and the image of S; in red the edges of S outside this image."""
    S = limit.scale(1 / (1 + epsilon), z)
    after = mr.outer_step(loop, S, C)
    plotting.draw_set(ax, limit, facecolor="none", edgecolor=plotting.GREY, label=r"$\overline{\mathcal{R}}_\infty$")
    plotting.draw_set(ax, S, facecolor="#E69F0070", edgecolor=plotting.ORANGE, linewidth=1.5, label="$S$")
    style = {"facecolor": "none", "edgecolor": plotting.BLUE, "linewidth": 1.5, "linestyle": "--"}
    plotting.draw_set(ax, after, **style, label=r"$\overline{\mathcal{R}}_1(S)$")
    for v, reached in zip(C, after.h):
        ax.plot(*S.vertices()[S.vertices() @ v > reached].T, color=plotting.RED, linewidth=3)
    ax.plot(*z, "+", color=plotting.BLACK, markersize=9)
    plotting.label_axes(ax, limit.scale(1.15, limit.chebyshev()[0]))


# %%
figure, axes = plt.subplots(1, 3, figsize=(8, 3.4), layout="constrained", width_ratios=[1.15, 1, 1])
distance = np.array([max(R.support(C) - limit.support(C)) for R in about["origin"].history])
axes[0].semilogy(np.where(distance > 0, distance, np.nan), "o-", color=plotting.BLACK, markersize=3)
axes[0].axvline(about["equilibrium"].steps, color=plotting.BLUE, linestyle="--", linewidth=1.2)
axes[0].set(
    xlabel="$k$", ylabel=r"$\max_i\, h_{\overline{\mathcal{R}}_k}(C_i) - h_{\overline{\mathcal{R}}_\infty}(C_i)$"
)
for ax, (name, found) in zip(axes[1:], about.items()):
    draw_shrunk(ax, found.centre)
    ax.set_xlabel(f"$x_1$\nabout the {name} (+)")
    plotting.legend_above(ax, 3)
plt.show()

# %% [markdown]
# Left: the distance to the limit falls until it is exactly 0. About the equilibrium the rule holds at the dashed line.
# Middle: scaled about the origin (+), $S$ (orange) exceeds its own image (dashed) at the thick red edges. Right: scaled
# by the same factor about the equilibrium, it lies inside.
#
# ### The reason, in one formula
#
# Let $R = \overline{\mathcal{R}}_1(R)$ be the limit and $z$ the centre. Let the facet $v$ of $R$ be attained at a
# vertex $x^*$ in a cell with $x^+ = M x + c + d$. Scale the set: $S = z + (R - z)/(1+\epsilon)$ with a small
# $\epsilon$. If the scaled vertex lies in the same cell, its image gives
#
# $$ h_{\mathcal{R}_1(S)}(v) - h_S(v) \;\ge\; \tfrac{\epsilon}{1+\epsilon}
#    \Big[\, v\,(M z + c - z) + h_{\mathcal{D}}(v) \Big] , $$
#
# with equality if no other vertex attains a larger value. The rule needs every bracket to be non-negative. In words:
# **take the affine piece that attains a facet and evaluate it at the centre $z$. It must not move $z$ inwards by more
# than the disturbance moves it outwards.** If $z$ is the fixed point of the piece, $M z + c = z$, only
# $h_{\mathcal{D}}(v) > 0$ remains of the bracket. The origin is not a fixed point here: the least-squares fit has
# $f_{\text{PWA}}(0, 0) = p \ne 0$ in the middle region. We compute the bracket:


# %%
def slack(R, z, epsilon=1e-3):
    """(1 + epsilon) / epsilon (h of R_1(S) - h of S) along C; the rule needs all of them to be >= 0."""
    S = R.scale(1 / (1 + epsilon), z)
    return (mr.support(loop, S, C).value - S.support(C)) * (1 + epsilon) / epsilon


figure, ax = plt.subplots(figsize=(6.4, 3.0), layout="constrained")
for shift, (z, found), style in zip(
    (-0.2, 0.2), about.items(), ({"color": plotting.ORANGE}, {"color": plotting.BLUE, "hatch": "///"})
):
    ax.bar(np.arange(1, 9) + shift, slack(limit, found.centre), 0.4, edgecolor="black", label=f"about the {z}", **style)
ax.axhline(0, color=plotting.BLACK, linewidth=0.8)
ax.set(xlabel="row $i$ of the template $C$", ylabel="slack of facet $i$", xticks=range(1, 9))
plotting.legend_above(ax, 2)
plt.show()

# %% tags=["nbval-check-output"]
for z, found in about.items():
    print(f"about the {z}: smallest slack {slack(limit, found.centre).min():.3f}")

# %% [markdown]
# One negative bar suffices: the rule then fails for every small $\bar\epsilon$, and more iterations do not help. With
# $z$ as centre the statement changes only a little:
# $\overline{\mathcal{R}}_\infty \subseteq \overline{\mathcal{R}}_{\bar k}$ and
# $\overline{\mathcal{R}}_{\bar k} \subseteq z + (1+\bar\epsilon)(\overline{\mathcal{R}}_\infty - z)$.
# The equilibrium does not always help. A discontinuous loop may have none, and then `centre="equilibrium"` reports
# this.

# %% tags=["nbval-check-output"]
for name in cases:
    P = proven[name]
    print(f"{name}: of {len(P)} networks with a safe set the rule holds")
    print(f"  about the origin for {sum(row.criterion for row in P)},", end=" ")
    print(f"about the equilibrium for {sum(row.criterion_equilibrium for row in P)};", end=" ")
    print(f"no equilibrium: {sum(row.steps_equilibrium == 0 for row in P)}")

# %% [markdown]
# ### Alpha is exactly 1 at a fixed point
#
# Theorem 1 requires $\alpha > 1$ with $\alpha\, \overline{\mathcal{R}}_{k} \subseteq \overline{\mathcal{R}}_{k-1}$
# (eq. (26), StabCondFmin). When the sequence has converged, $\overline{\mathcal{R}}_k = \overline{\mathcal{R}}_{k-1}$
# and $\alpha = 1$, so the theorem does not apply. *One facet* that does not move is enough for this. So $\alpha$ must
# be taken at a $k$ at which the sequence still shrinks in every direction. Every such $\overline{\mathcal{R}}_k$ is a
# stable set.
#
# The proof uses only that a slightly larger set is mapped back:
#
# $$ \mathcal{R}_1(\alpha\, \overline{\mathcal{R}}_{k}) \subseteq \overline{\mathcal{R}}_{k}
#    \quad\text{for some } \alpha > 1 . $$
#
# Eq. (26), StabCondFmin, implies this (apply $\overline{\mathcal{R}}_1$ to both sides). `mireach.contraction` computes
# the largest such $\alpha$ by bisection, without using $\overline{\mathcal{R}}_{k-1}$.

# %%
z = about["equilibrium"].centre
to_rest = mr.terminal_set(loop, F_max, case.directions, 1e-12, z)  # epsilon too small to stop early
proof_needs = [mr.contraction(loop, R, z) for R in to_rest.history[1:]]
k = np.arange(1, len(proof_needs) + 1)

# %%
figure, ax = plt.subplots(figsize=(6.4, 3.3), layout="constrained")
for values, label, style in (
    (to_rest.alphas, r"$\alpha_k$ of eq. (26), StabCondFmin", {"color": plotting.BLACK, "marker": "o"}),
    (
        np.array(proof_needs),
        r"contraction of $\overline{\mathcal{R}}_k$",
        {"color": plotting.RED, "marker": "x", "linestyle": "--"},
    ),
):
    ax.semilogy(k, np.where(values > 1, values - 1, np.nan), label=label, markersize=5, **style)
    at_one = k[values <= 1]
    ax.plot(at_one, np.full(len(at_one), 1e-12), style["marker"], color=style["color"], markersize=5, alpha=0.5)
ax.axhline(3e-12, color=plotting.GREY, linewidth=0.8)
ax.set(xlabel="$k$", ylabel=r"$\alpha - 1$", ylim=(4e-13, 1))
ax.text(k[-1], 6e-12, "below this line: exactly 1", ha="right", fontsize="small")
plotting.legend_above(ax, 2)
plt.show()

# %% [markdown]
# In the first steps some facet has not moved yet, and $\alpha = 1$. Near the end the facets stop moving one after the
# other, and at the fixed point $\alpha$ is exactly 1 again. In between, Theorem 1 applies, and the terminal set should
# be taken from this range of $k$. The crosses are never below the dots: the inclusion that the proof needs holds for a
# few more $k$.

# %% tags=["nbval-check-output"]
window = to_rest.stable_steps
k_bar = about["equilibrium"].steps
print(f"alpha > 1 for the first time at k = {window[0]}; at k = {k_bar}, where the rule holds: {k_bar in window}")
print(f"at the fixed point: alpha - 1 = {about['origin'].alphas[-1] - 1}")
for name in cases:
    resting = [row for row in proven[name] if row.criterion and row.alpha == 1]
    print(f"{name}: the rule holds, yet alpha is exactly 1, for {len(resting)} networks")

# %% [markdown]
# The paper reports $\alpha = 1 + 9 \cdot 10^{-7}$, which is about the accuracy of a MILP solver. Bounds from cells are
# rounded up by at most a few $10^{-11}$, and equal sets give equal numbers. So here "exactly 1" can be distinguished
# from "a little more than 1".

# %% [markdown]
# ## 3 Tighter error sets: square, box, segment
#
# Theorem 2 needs $f(x, u) - f_{\text{PWA}}(x, u) \in \mathcal{D}^{(i)}$. The paper takes the largest error and a
# square, $\mathcal{D} = \{d : |d|_\infty \le 0.1186\}$. But the error of the double integrator is
# $0.025\,(x_1^2 + x_2^2)$ minus its affine fit. It is **the same in both components**, and not symmetric about 0. So we
# may take the box of the true range, or the *segment* along $(1, 1)$. The bounds proven for the fit show that each of
# them contains the error.

# %% tags=["nbval-check-output"]
fit = cases["double_integrator"].fit
names = {"ball": "square, as in the paper", "box": "box of the range", "polytope": "segment along (1, 1)"}
for kind, words in names.items():
    corners = np.round(fit.with_error(kind).modes[0].disturbance.vertices(), 4)
    print(f"{words}: from {corners.min(axis=0)} to {corners.max(axis=0)}, {len(corners)} corners")


# %%
def area(P):
    """Area of a polygon (shoelace formula)."""
    x, y = P.vertices().T
    return 0.5 * abs(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def analyse(network, kind):
    """Safe and terminal set of the double integrator with one kind of error set."""
    loop = mr.ClosedLoop(fit.with_error(kind).system(), network)
    found = mr.safe_set(loop, C)
    return found, mr.terminal_set(loop, found, C, centre="equilibrium")


tight = {kind: analyse(cases["double_integrator"].network, kind) for kind in names}

# %% tags=["nbval-check-output"]
print(f"{'error set':24} {'iterations':>10} {'area F_max':>10} {'area R_min':>10}   rule holds at k")
for kind, (found, R) in tight.items():
    k = R.steps if R.criterion else "never"
    print(f"{names[kind]:24} {found.iterations:10} {area(found.set):10.2f} {area(R.set):10.3f}   {k}")

# %%
figure, axes = plt.subplots(1, 3, figsize=(8, 3.0), layout="constrained")
styles = (plotting.ORANGE, "-"), (plotting.BLUE, "--"), (plotting.BLACK, ":")
for (kind, (found, R)), (colour, line) in zip(tight.items(), styles):
    style = {"facecolor": "none", "edgecolor": colour, "linestyle": line, "linewidth": 1.8}
    D = fit.with_error(kind).modes[0].disturbance
    plotting.draw_set(axes[0], D, **style)
    plotting.draw_set(axes[1], found.set, **style, label=names[kind])
    plotting.draw_set(axes[2], R.set, **style)
sets = [fit.with_error("ball").modes[0].disturbance, *tight["ball"]]
for ax, P, title in zip(axes, sets, ("error set $\\mathcal{D}$", r"$\mathcal{F}_{\max}$", r"terminal set")):
    plotting.label_axes(ax, getattr(P, "set", P), title)
axes[0].set(xlabel="$d_1$", ylabel="$d_2$")
figure.legend(loc="outside lower center", ncols=3, frameon=False)
plt.show()

# %% [markdown]
# The smaller the error set, the fewer iterations $\mathcal{F}_{\max}$ takes, and the smaller is the terminal set. This
# costs nothing: the network, the fit and the theorem are the same. $\mathcal{F}_{\max}$ itself also becomes a little
# *smaller*. It is not a maximal set: it is made of images of $\mathcal{X}$, and these shrink with $\mathcal{D}$.
#
# With the segment the stopping rule may also fail about the equilibrium (last column): in a direction $v$ across the
# segment, $h_{\mathcal{D}}(v) = 0$, so the disturbance adds nothing to the bracket of section 2. The sequence converges
# nevertheless.
#
# A minimax fit shifts $p$ to the middle of the error range. Its square error set is exactly the box above, shifted, so
# the two give the same sets.

# %% tags=["nbval-check-output"]
minimax = double_integrator_fit(method="minimax", error="ball")
other = mr.safe_set(mr.ClosedLoop(minimax.system(), cases["double_integrator"].network), C)
print(f"minimax: proven error {minimax.proven_error:.4f}, {other.iterations} iterations, area {area(other.set):.2f}")

# %% [markdown]
# ## 4 How typical are the numbers of one network?
#
# The paper shows one trained network per case. Training begins with random weights, so its numbers are one random
# sample. `mireach` ships a study with one network per seed, each analysed like the paper's. How many of them have a
# safe set at all?

# %% tags=["nbval-check-output"]
for name in cases:
    count, P = len(rows[name]), proven[name]
    sound = sum(row.criterion and row.alpha > 1 for row in P)
    print(f"{name}: {count} networks, {len(P)} with a safe set ({len(P) / count:.0%});", end=" ")
    print(f"{sound} fulfil all that the paper claims (rule about the origin, alpha > 1)")
    k, wanted = [row.iterations for row in P], CASES[name].paper["iterations"]
    print(f"  iterations of F_max: {min(k)} to {max(k)}, median {np.median(k):.0f}; paper {wanted}")


# %%
def shipped_row(name):
    """The row of the network that ships as network.json, or None if it is not from this study."""
    mine = cases[name].network.to_dict()
    return next((row for row in rows[name] if networks[name][row.seed].to_dict() == mine), None)


def mark(ax, here, paper):
    """The paper's value as a dashed red line, the shipped network's as a dotted black one."""
    for value, colour, line, label in ((paper, plotting.RED, "--", "paper"), (here, plotting.BLACK, ":", "shipped")):
        if value is not None:
            ax.axvline(value, color=colour, linestyle=line, linewidth=1.8, label=label)


# %%
def histogram(ax, name, column, bins, paper, only=lambda row: True, log=False, **style):
    """Histogram of one column of the study, for the networks with a safe set."""
    values = [getattr(row, column) - log for row in proven[name] if only(row)]
    ax.hist(values, bins, edgecolor="black", linewidth=0.5, **style)
    row = shipped_row(name)
    mark(ax, None if row is None else getattr(row, column) - log, paper)
    if log:
        ax.set_xscale("log")


# %%
name, paper = "pwa", CASES["pwa"].paper
figure, axes = plt.subplots(2, 2, figsize=(7.6, 5.2), layout="constrained")
one, two, three, four = axes.ravel()
histogram(one, name, "x1_max", np.linspace(8.4, 10, 17), paper["safe_set_box"][1][0], color="#56B4E9")
one.set(xlabel=r"right end of $\mathcal{F}_{\max}$ (of $x_1$)", ylabel="networks")
steps = np.arange(20, 130, 5)
histogram(two, name, "steps", steps, paper["steps"], lambda row: row.criterion, color="#56B4E9")
two.set(xlabel=r"$\bar k$ about the origin", ylabel="networks")
histogram(three, name, "steps_equilibrium", steps, paper["steps"], lambda r: r.criterion_equilibrium, color="#56B4E9")
three.set(xlabel=r"$\bar k$ about the equilibrium", ylabel="networks")
alphas = np.logspace(-11, -3, 25)
histogram(four, name, "alpha", alphas, 9e-7, lambda row: row.criterion and row.alpha > 1, log=True, color="#56B4E9")
four.set(xlabel=r"$\alpha - 1$ where the rule holds and $\alpha > 1$", ylabel="networks")
handles, labels = one.get_legend_handles_labels()
figure.legend(handles, labels, loc="outside upper center", ncols=2, frameon=False)
plt.show()

# %% [markdown]
# Case 1. A network that has a safe set usually has it after one iteration, as in the paper, and three of the four sides
# of $\mathcal{F}_{\max}$ hardly depend on the network (notebook 06). The fourth side does: the paper's 8.91 lies well
# within the range. The paper's $\bar k = 51$ also lies within the range, between a group of networks with fewer steps
# and a group with more.

# %%
name, paper = "double_integrator", CASES["double_integrator"].paper
figure, axes = plt.subplots(2, 2, figsize=(7.6, 5.2), layout="constrained")
one, two, three, four = axes.ravel()
histogram(one, name, "iterations", np.arange(17.5, 40), paper["iterations"], color="#56B4E9")
one.set(xlabel=r"iterations of $\mathcal{F}_{\max}$", ylabel="networks")
steps = np.arange(11.5, 24)
histogram(two, name, "steps", steps, paper["steps"], lambda row: row.criterion, color="#56B4E9")
two.set(xlabel=r"$\bar k$ about the origin", ylabel="networks")
histogram(three, name, "steps_equilibrium", steps, paper["steps"], lambda r: r.criterion_equilibrium, color="#56B4E9")
three.set(xlabel=r"$\bar k$ about the equilibrium", ylabel="networks")
alphas = np.logspace(-11, -3, 25)
histogram(four, name, "alpha", alphas, None, lambda row: row.criterion and row.alpha > 1, log=True, color="#56B4E9")
four.set(xlabel=r"$\alpha - 1$ where the rule holds and $\alpha > 1$", ylabel="networks")
handles, labels = one.get_legend_handles_labels()
figure.legend(handles, labels, loc="outside upper center", ncols=2, frameon=False)
plt.show()

# %% [markdown]
# Case 2. Here the paper's numbers are *not* typical of networks that are trained like ours. Its 19 iterations lie far
# to the left of all of them, and its $\bar k = 20$ lies at the right end or beyond. (The paper prints no $\alpha$ for
# this case.) Below we examine what determines the number of iterations.
#
# The dotted lines are not a random sample. Of the networks that fit about as well as the best, `mireach` ships the one
# whose numbers are closest to the paper's (`mireach.studies.seed_study.choose`).
#
# ### Does a smaller loss mean a better certificate?

# %%
figure, axes = plt.subplots(1, 2, figsize=(7.6, 3.4), layout="constrained")
for ax, (name, column, label) in zip(
    axes,
    (
        ("pwa", "x1_max", r"right end of $\mathcal{F}_{\max}$"),
        ("double_integrator", "iterations", r"iterations of $\mathcal{F}_{\max}$"),
    ),
):
    P, none = proven[name], [row for row in rows[name] if row.verdict != "proven"]
    values = [getattr(row, column) for row in P]
    ax.semilogx([row.loss for row in P], values, "o", color=plotting.BLUE, markersize=4, label="safe set")
    floor = min(values) - 0.12 * np.ptp(values)
    ax.plot([row.loss for row in none], np.full(len(none), floor), "x", color=plotting.RED, label="none found")
    row = shipped_row(name)
    if row is not None:
        ax.plot(
            row.loss, getattr(row, column), "s", color="none", markeredgecolor="black", markersize=9, label="shipped"
        )
    ax.set(xlabel=f"loss ({name})", ylabel=label)
    plotting.legend_above(ax, 3)
plt.show()

# %% tags=["nbval-check-output"]
for name in cases:
    ordered = sorted(rows[name], key=lambda row: row.loss)
    better, worse = (
        np.mean([row.verdict == "proven" for row in half]) for half in np.split(np.array(ordered), [len(ordered) // 2])
    )
    column = "x1_max" if name == "pwa" else "iterations"
    rho = spearmanr([r.loss for r in proven[name]], [getattr(r, column) for r in proven[name]]).statistic
    print(f"{name}: safe set in the half with the smaller loss {better:.0%}, in the other half {worse:.0%};")
    print(f"  rank correlation of loss and {column} {rho:.2f}; the best loss of all: {ordered[0].verdict}")

# %% [markdown]
# Dots and crosses are mixed along the loss axis. In case 2 the loss does not predict whether there is a safe set, and
# hardly predicts how many iterations it takes. In case 1 the networks with the larger losses fail more often, but a
# small loss is no guarantee; see the crosses on the left. The loss is an average over the data. A certificate concerns
# the worst state, and part of $\mathcal{X}$ has no data.
#
# ### The corner without data
#
# In case 2, the upper right corner of $\mathcal{X}$ contains states for which no input sequence is feasible, so there
# are no training data. What does each network do at $x = (6, 6)$?

# %%
name = "double_integrator"
corner = np.array([6.0, 6.0])
u_corner = np.array([networks[name][row.seed](corner)[0] for row in rows[name]])
has_set = np.array([row.verdict == "proven" for row in rows[name]])
loss = np.array([row.loss for row in rows[name]])
figure, ax = plt.subplots(figsize=(6.4, 3.2), layout="constrained")
ax.semilogx(loss[has_set], u_corner[has_set], "o", color=plotting.BLUE, markersize=4, label="safe set")
ax.semilogx(loss[~has_set], u_corner[~has_set], "x", color=plotting.RED, label="none found (8 directions)")
ax.set(xlabel="loss", ylabel=r"$\Phi(6, 6)$")
plotting.legend_above(ax, 2)
plt.show()

# %% tags=["nbval-check-output"]
print(f"networks with a safe set: at most u = {u_corner[has_set].max():.2f} at (6, 6)")
print(f"networks without:         at least u = {u_corner[~has_set].min():.2f}")
sixteen = [
    mr.safe_set(mr.ClosedLoop(cases[name].system, networks[name][row.seed]), mr.directions(16))
    for row, fine in zip(rows[name], has_set)
    if not fine
]
print(f"with 16 directions {sum(found.verdict == 'proven' for found in sixteen)} of {len(sixteen)} of these have one")

# %% [markdown]
# One number, at a state far from all data points, separates the two groups. Networks that do not brake (almost) fully
# in the corner have no safe set with this template. The loss cannot show this. More training is not the only remedy:
# with twice as many directions these loops have safe sets as well.
#
# ### What determines the number of iterations
#
# We use the same few networks and make one change at a time:

# %%
few = sorted(proven[name], key=lambda row: row.loss)[:4]
system = cases[name].system
square = {bound: system.with_disturbance(mr.Polytope.box([-bound] * 2, [bound] * 2)) for bound in (0.0, 0.05, 0.1186)}
changes = {f"|d| <= {bound}, 8 directions": (square[bound], 8) for bound in square}
changes["|d| <= 0.1186, 16 directions"] = system, 16
changes["box of the range, 8 directions"] = fit.with_error("box").system(), 8
changes["segment, 8 directions"] = fit.with_error("polytope").system(), 8
counts = {
    words: [mr.safe_set(mr.ClosedLoop(plant, networks[name][row.seed]), mr.directions(rows_of_C)) for row in few]
    for words, (plant, rows_of_C) in changes.items()
}

# %% tags=["nbval-check-output"]
print(f"{'':34}" + "".join(f"seed {row.seed:<5}" for row in few))
for words, found in counts.items():
    print(f"{words:34}" + "".join(f"{answer.iterations:<10}" for answer in found))

# %% [markdown]
# The disturbance set and the template change the number of iterations by far more than the seed does. The tight error
# sets come near the paper's 19, and so does a square of about half the size.
#
# Why does the square take so long? We look at two states: the support vector of $\mathcal{F}_{k+1}$ at the top ($x_2$),
# and the state from which the image exceeds $\mathcal{X}$ by the largest amount on the right ($x_1$):

# %%
case, sequence = cases[name], safe[name]
for k in range(0, sequence.iterations + 1, 4):
    found = mr.support(case.loop, sequence.history[k], [[0, 1], [1, 0]])
    top, right = (witness.states[0] + 0.0 for witness in found.witness)
    print(f"k = {k:2}: top from x = ({top[0]:5.2f}, {top[1]:5.2f}),", end=" ")
    print(f"right from ({right[0]:.2f}, {right[1]:5.2f}), beyond X by {found.value[1] - 6:5.2f}")

# %%
k = sequence.iterations // 2
figure, ax = plt.subplots(figsize=(7.2, 4.2), layout="constrained")
draw_image(ax, case.loop, sequence.history[k - 1], facecolor=plotting.GREY, edgecolor="none")
outer = mr.outer_step(case.loop, sequence.history[k - 1], C)
style = {"facecolor": "none", "linewidth": 1.6}
before = rf"$\overline{{\mathcal{{R}}}}_1(\mathcal{{F}}_{{{k - 1}}})$"
plotting.draw_set(ax, outer, **style, edgecolor=plotting.BLACK, linestyle=":", label=before)
plotting.draw_set(ax, sequence.history[k], **style, edgecolor=plotting.BLUE, label=rf"$\mathcal{{F}}_{{{k}}}$")
right = mr.support(case.loop, sequence.history[k], [[1, 0]]).witness[0]
ax.plot(*right.states[0], "*", color=plotting.BLACK, markersize=12, label=r"leaves $\mathcal{X}$ next")
plotting.label_axes(ax, outer)
plotting.legend_above(ax, 3)
plt.show()

# %% [markdown]
# Grey is the exact image $\mathcal{R}_1(\mathcal{F}_{k-1})$, the dotted polygon is its outer set, and the blue polygon
# is the intersection of the outer set with $\mathcal{X}$. The star marks the state from which the next image leaves
# $\mathcal{X}$. It lies in the upper right corner of $\mathcal{F}_k$, **which no trajectory reaches in this step**. Two
# things keep that corner in the set. States on the left, from which the network accelerates to the right, determine the
# top facet. The part of the image *outside* $\mathcal{X}$ determines the slanted facet. The top moves down by a few
# hundredths per iteration.
#
# ### First intersect, then over-approximate
#
# Eq. (21), Fk, first encloses the image by the template and then intersects it with $\mathcal{X}$. Write
# $\overline{\,\cdot\,}$ for the enclosure by the template, and reverse the order:
#
# $$ \mathcal{F}_{k+1} = \overline{\mathcal{R}_1(\mathcal{F}_k) \cap \mathcal{X}} \cap \mathcal{F}_k . $$
#
# It still holds that $\mathcal{F}_k$ is RPI if $\mathcal{R}_1(\mathcal{F}_k) \subseteq \mathcal{X}$ for some $k$.
# Proof: $\mathcal{R}_1(\mathcal{F}_k) \subseteq \mathcal{R}_1(\mathcal{F}_{k-1}) \cap \mathcal{X}$, and so on down to
# $\mathcal{R}_1(\mathcal{F}_0) \cap \mathcal{X}$. Each of these sets lies in its enclosure, and $\mathcal{F}_k$ is the
# intersection of the enclosures. The cells need an intersection with $\mathcal{X}$ for each image:
# `mr.safe_set(..., cut_first=True)`.

# %% tags=["nbval-check-output"]
none_found = next(row for row in rows[name] if row.verdict != "proven")
loops = {"shipped network": case.loop}
loops["one without a safe set"] = mr.ClosedLoop(system, networks[name][none_found.seed])
for words, loop in loops.items():
    for count in (8, 16):
        V = mr.directions(count)
        paper_way, here = mr.safe_set(loop, V), mr.safe_set(loop, V, cut_first=True)
        print(f"{words}, {count} directions: cover first {paper_way.verdict} after {paper_way.iterations},", end=" ")
        print(f"cut first {mr.check_rpi(loop, here.set).verdict} after {here.iterations}")

# %% [markdown]
# The reversed order alone saves many of the iterations, and it finds a set where the other order finds none.
# `check_rpi` confirms each of the sets, so you need not trust the derivation above. The number of iterations mostly
# depends on the template, the error set and such details. The text of the paper does not show which of them gave 19.

# %% [markdown]
# ## 5 A certificate that anybody can check
#
# So far *proven* meant that this package proves it, with bounds on all rounding errors or in exact arithmetic. A
# referee need not trust the package. `mr.certificate.write` writes the system, the network, the template, the sequence
# of sets and the claims to one file. Where a set misses its claim by rounding, it is enlarged until the claim is
# *exactly* true. `mr.certificate.verify` derives every claim again. The checker, `mireach/certificate/checker.py`,
# imports only Python's standard library, shares no code with the engines, and computes with integers, so nothing is
# ever rounded.
#
# Every number of the case study is a float, i.e. a binary fraction: 0.936 is 8430738502437569 / 2^53. Both the package
# and the checker use exactly this fraction.

# %% tags=["nbval-check-output"]
folder = Path(tempfile.mkdtemp())
paper_case, paper_safe = cases["pwa"], safe["pwa"]
paper_terminal = mr.terminal_set(paper_case.loop, paper_safe, paper_case.directions, paper_case.epsilon)
certificate = mr.certificate.write(folder / "certificate.json", paper_case.loop, paper_safe, paper_terminal)
print(mr.certificate.verify(folder / "certificate.json", network=data_file("pwa", "network.json")))

# %% [markdown]
# Theorem 1 no longer depends on tolerances. For the sets of the file, $\alpha$ is a fraction:

# %% tags=["nbval-check-output"]
print(f"alpha = {certificate.alpha}")
print(f"alpha > 1: {certificate.alpha > 1}")

# %% [markdown]
# ### A forged certificate is refused
#
# Suppose a forger wants a smaller safe set and moves the top of $\mathcal{F}_{\max}$ from 8.52 down to 8. The digest no
# longer matches, and the checker reports this before it checks anything else.

# %% tags=["nbval-check-output"]
forged = json.loads((folder / "certificate.json").read_text())
top = forged["template"].index([0.0, 1.0])
print(f"x2 <= {forged['sets'][0][top]:.6f} becomes x2 <= 8")
forged["sets"][0][top] = 8.0
(folder / "forged.json").write_text(json.dumps(forged))
print(mr.certificate.verify(folder / "forged.json"))

# %% [markdown]
# A better forger also computes a new digest, with `mireach.certificate.checker.digest`. Then the checker must examine
# the claims themselves. It returns a step out of the set, which anybody can replay: $x$ lies in the forged set, and its
# successor does not.

# %% tags=["nbval-check-output"]
report = mr.certificate.verify(folder / "forged.json", ignore_digest=True)
print(report)
witness = report["safe_set"].witness
x, d = (np.array([float(Fraction(part)) for part in witness[key]]) for key in ("state", "disturbance"))
print(f"\nreplayed: {x} -> {paper_case.loop.step(x, d).round(6)}, and x2 should be at most 8")

# %% [markdown]
# Claims that depend on a refuted claim are not checked; the results for the other claims remain valid. With 8.5 instead
# of 8 the changed certificate would have been accepted: that smaller set is RPI as well, and the checker proves it. The
# checker judges only the content of a file.
#
# Every case study has a certificate, `data/CASE/certificate.json`. That of `double_integrator` contains the error set
# of the fit and Theorem 2. `python3 run.py verify FILE` checks them within seconds, on any machine with Python, without
# installing anything. Notebook 14 shows certificates of three, four and six states.

# %% [markdown]
# ## What you saw
#
# - For two states the closed loop is a list of polygons with one affine map each, and $h_{\mathcal{R}_1}$ is a maximum
#   over their vertices within $\mathcal{F}$. It agrees with the MILP of Lemma 2.
# - The stopping rule tests more than convergence: its centre must be nearly a fixed point of the dynamics, up to
#   $\mathcal{D}$. The origin need not satisfy this. The equilibrium does, where there is one.
# - At a fixed point $\alpha = 1$ exactly. Theorem 1 needs a $k$ at which every facet still moves; `contraction` also
#   works for other $k$.
# - Error sets that use the structure of the error cost nothing and shrink the terminal set.
# - A small loss is no certificate; in case 2 it is not even an indication. The template, the error set, the order of
#   operations and the states without data determine the result.
# - A certificate contains all data that its claims need. The checker decides the claims in exact arithmetic,
#   $\alpha > 1$ included, and refutes a forged set by a step that leaves it.
#
# ## On your own
#
# - Find the bounds on $|d|_\infty$ for which the shipped network needs exactly 19 iterations.
# - Take the networks without a safe set. Does a small change help? Add states in the upper right corner with $u = -2$
#   to the data, and train again (`mireach.learning.training.train`).
# - Repeat the table with `mr.directions(32)`. From which number of directions on do more directions gain nothing?
# - Forge the certificate so that it is still proven. Which sets can be changed, and in which direction? How may you
#   change the weights of the network?
# - Take a network for which the rule holds and $\alpha = 1$. Print `alphas`. From which $k$ on does a facet not move?
#
# ## Further reading
#
# - Raković, Kerrigan, Kouramas, Mayne, *Invariant approximations of the minimal robust positively invariant set*, IEEE
#   Transactions on Automatic Control 50(3), 2005: the source of rules such as eq. (25), TerminationFmin.
# - Blanchini, Miani, *Set-Theoretic Methods in Control*, Birkhäuser: contraction, ultimate boundedness, C-sets.
#
# **Next:** notebook 11 analyses your own system and your own network.
