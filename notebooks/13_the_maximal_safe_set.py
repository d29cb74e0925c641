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
# # Find every safe state: the maximal set, backwards and exactly
#
# **What you will do.** Compute the set that the paper calls out of reach, the *maximal* RPI set in $\mathcal{X}$, for
# both case studies. See why images forward throw safe states away, and why preimages do not. Prove the result in
# rational arithmetic, forge it and watch the proof fail. Compare exact reachable sets with their covers, find the
# attractor, and ask how much disturbance a controller survives.
#
# **What you will learn.** That *being reached* and *being safe* are two different questions; how a nonconvex set is
# taken backwards through hundreds of affine pieces, singular ones included; what rounding can do to a proof, and how
# a margin of $10^{-9}$ and exact fractions settle it.
#
# **What you need.** Notebooks 06, 09 and the first section of 10 (cells). "Run all" takes about a minute.

# %%
import matplotlib.pyplot as plt
import numpy as np

import mireach as mr
from mireach import plotting
from mireach.analysis.maximal_set import carried_out
from mireach.engines import steps
from mireach.studies.case_studies import data_file
from mireach.studies.seed_study import load_rows

cases = {name: mr.case_study(name) for name in ("pwa", "double_integrator")}
safe = {name: mr.safe_set(case.loop, case.safe_directions) for name, case in cases.items()}
loop, X = cases["double_integrator"].loop, cases["double_integrator"].system.state_set

# %% [markdown]
# ## 1 Forward images answer another question
#
# Proposition Fmax iterates $\mathcal{F}_{k+1} = \overline{\mathcal{R}}_1(\mathcal{F}_k) \cap \mathcal{X}$: what can be
# *reached* from $\mathcal{F}_k$? A state that nothing leads to is dropped, be it as safe as any other. And the
# template covers what is not convex, so that the next image is too large, leaves $\mathcal{X}$ again, and is cut again.
#
# The question that safety asks is *from where does every step stay inside?* That is a preimage:
#
# $$ \mathcal{S}_0 = \mathcal{X}, \qquad
#    \mathcal{S}_{k+1} = \{ x \in \mathcal{S}_k : A^{(i)} x + B^{(i)} \Phi(x) + p^{(i)} + d \in \mathcal{S}_k
#    \text{ for all } d \in \mathcal{D}^{(i)} \text{ and every mode } i \text{ that contains } (x, \Phi(x)) \} . $$
#
# Every RPI set in $\mathcal{X}$ lies in all $\mathcal{S}_k$, and where the sequence comes to rest, the set is RPI.
# So it is the largest of all: **first predict** how many times as large as $\mathcal{F}_{\max}$ it is.

# %% tags=["nbval-check-output"]
maximal = {name: mr.maximal_safe_set(case.loop) for name, case in cases.items()}
for name, found in maximal.items():
    F = mr.Region.of(safe[name].set)
    print(f"{name}: F_max {F.area:.1f}, maximal set {found.set.area:.1f}", end=" ")
    print(f"of {cases[name].system.state_set.area:.0f}, iterations: {found.iterations}, {found.verdict}")

# %%
figure, axes = plt.subplots(1, 2, figsize=(8.2, 4.6), layout="constrained")
for ax, (name, case) in zip(axes, cases.items()):
    plotting.plot_maximal(ax, case.system, safe[name], maximal[name])
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False, fontsize="small")
    ax.set_xlabel(f"$x_1$\n{name}")
plt.show()

# %% [markdown]
# **What to see.** In case 1 only a small corner is lost; in case 2 the corners in which the network cannot brake in
# time. The paper's $\mathcal{F}_{\max}$ (hatched) is a part of the safe set, in case 2 a sixth of it.

# %% [markdown]
# ## 2 One step backwards
#
# On a cell $\mathcal{C}_j$ the loop is $x^+ = M_j x + c_j + d$. If a convex polygon $\mathcal{T}$ is lost, then so is
#
# $$ \{ x \in \mathcal{C}_j : M_j x + c_j \in \mathcal{T} \oplus (-\mathcal{D}) \} , $$
#
# a polygon again: every half-plane $v y \le h_{\mathcal{T}}(v) + h_{\mathcal{D}}(-v)$ becomes
# $(v M_j)\, x \le h_{\mathcal{T}}(v) + h_{\mathcal{D}}(-v) - v c_j$. Nothing is inverted, so $M_j$ may be singular, and
# nothing is covered by a template: lost sets are unions of polygons, and a union need not be convex.
#
# `carried_out(loop, S)` does this for all cells. The outside of $\mathcal{X}$ is lost to begin with:

# %% tags=["nbval-check-output"]
S = mr.Region.of(X)
for k in range(1, 7):
    S = S - carried_out(loop, S)
    print(f"S_{k}: area {S.area:.4f}")

# %%
figure, axes = plt.subplots(1, 2, figsize=(8.2, 4.8), layout="constrained")
for ax, (name, case) in zip(axes, cases.items()):
    plotting.plot_lost(ax, maximal[name].history, case.system.state_set)
    plotting.legend_above(ax, 2)
    ax.set_xlabel(f"$x_1$\n{name}")
plt.show()

# %% [markdown]
# **What to see.** From the bright corners one disturbance leads out of $\mathcal{X}$ at once; from darker ones it takes
# more steps, and each of them needs a disturbance that leads into what is lost already. What is lost at step 5
# of case 2 is a sliver of $2.5 \cdot 10^{-6}$, too thin to be seen; at step 6 nothing is.
#
# Forward and backward side by side, the first two steps of case 2:

# %%
figure, axes = plt.subplots(1, 2, figsize=(8.2, 4.4), layout="constrained")
styles = [{"color": plotting.GREY, "linestyle": "-"}, {"color": plotting.ORANGE}, {"color": plotting.BLUE}]
for k, style in enumerate(styles):
    line = {"facecolor": "none", "edgecolor": style["color"], "linewidth": 1.8, "linestyle": ("-", "--", "-")[k]}
    plotting.draw_set(axes[0], safe["double_integrator"].history[k], **line, label=rf"$\mathcal{{F}}_{k}$")
    plotting.draw_region(axes[1], maximal["double_integrator"].history[k], **line, label=rf"$\mathcal{{S}}_{k}$")
reached = mr.exact_reach(loop, X, 1)[1] & X
for ax in axes:
    plotting.draw_region(ax, reached, facecolor="#9A9A9A55", edgecolor="none", label=r"$\mathcal{R}_1(\mathcal{X})$")
    plotting.label_axes(ax, X)
    plotting.legend_above(ax, 4)
plt.show()

# %% [markdown]
# **What to see.** Left: $\mathcal{F}_1$ is the cover of what is reached (grey), cut by $\mathcal{X}$. The strip at the
# bottom is dropped because nothing leads there, not because it is unsafe; and the upper right corner, from which the
# loop does leave, is kept. Right: $\mathcal{S}_1$ and $\mathcal{S}_2$ cut off what is lost, and only that.

# %% [markdown]
# ## 3 What rounding can do, and a proof
#
# GEOS, which computes unions and differences, rounds at about $10^{-15}$. A set that is RPI on paper may then have an
# image that sticks out by the last digit. So `maximal_safe_set` computes two sets: `set`, with every $\mathcal{D}$ and
# every lost part widened by a slack of $10^{-9}$ of the size, and `outer`, with lost sets shrunk by as much. The true
# set lies between them.

# %% tags=["nbval-check-output"]
for name, found in maximal.items():
    print(f"{name}: between {found.set.area:.6f} and {found.outer.area:.6f};", end=" ")
    print(f"given up less than a millionth: {found.given_up < 1e-6}")

# %% [markdown]
# That `set` is RPI is then *proven*: its corners are floats, and floats are fractions. `prove_rpi` cuts the region into
# convex pieces, takes every number as the fraction that it is, builds the cells anew without rounding, and shows for
# every piece of every cell: image, widened by $\mathcal{D}$, less all pieces is empty.
# None of the code that found the set is trusted. Now forge it:

# %% tags=["nbval-check-output"]
S = maximal["pwa"].set
corner = mr.Polytope.from_points([[-10, -8], [-10, -7], [-9.9, -8.1]])  # 0.1 wide, at the cut-off corner
for name, region in {"the set": S, "with a bite of the corner": S | corner}.items():
    check = mr.prove_rpi(cases["pwa"].loop, region)
    print(f"{name}: {check.verdict}; {check.reason}")

# %%
step = check.witness
after = steps.successor(cases["pwa"].loop, step.state, step.mode, step.disturbance)
print("replayed in fractions, to the last digit:", after == step.after)
print("x1 =", str(step.state[0])[:60], "...")

# %% [markdown]
# A witness in fractions leaves nothing to argue about: the same step, replayed, ends in the same fraction.
#
# What is *not* proven is that `outer` holds the maximal set: that rests on floats with a margin. A set called
# invariant is; one called maximal is so to within `given_up`, unless rounding was a thousand times worse than expected.

# %% [markdown]
# ## 4 Exact reachable sets, and what covers add
#
# The same cells give $\mathcal{R}_k$ itself, image by image. With it the over-approximation of
# $\overline{\mathcal{R}}_k$ (eq. ROverOver) can be seen:

# %%
F, C, steps = safe["double_integrator"].set, cases["double_integrator"].directions, 6
exactly, covers = mr.exact_reach(loop, F, steps), mr.outer_reach(loop, F, C, steps)
figure, axes = plt.subplots(1, 3, figsize=(8.4, 3.4), layout="constrained")
for ax, k in zip(axes, (1, 3, 6)):
    plotting.draw_region(ax, exactly[k], **plotting.MAXIMAL, label=rf"$\mathcal{{R}}_{k}$")
    style = {"facecolor": "none", "edgecolor": plotting.BLACK, "linestyle": "--"}
    plotting.draw_set(ax, covers[k], **style, label=rf"$\overline{{\mathcal{{R}}}}_{k}$")
    plotting.label_axes(ax, covers[k])
    plotting.legend_above(ax, 2)
plt.show()

# %% tags=["nbval-check-output"]
for k in range(1, steps + 1):
    cover, inside = covers[k].area, exactly[k].area
    print(f"k = {k}: exact {inside:.3f}, cover {cover:.3f}, {cover / inside:.2f} times as large")

# %% [markdown]
# **What to see.** The exact sets bend; the dashed covers fill every bay, and the next cover starts from the filled set.
# The errors add up, step by step.
#
# ### The attractor
#
# From the maximal safe set on, $\mathcal{R}_k(\mathcal{S})$ is a nested sequence: an RPI set and its images. After $k$
# steps *everything* is in $\mathcal{R}_k$. `attractor` stops when no point of $\mathcal{R}_k$ is farther than $10^{-3}$
# from $\mathcal{R}_{k+1}$, which says that one more step changes little, not that the limit is that near.

# %% tags=["nbval-check-output"]
attractors = {name: mr.attractor(case.loop, maximal[name]) for name, case in cases.items()}
terminal = {name: mr.terminal_set(c.loop, safe[name], c.directions, c.epsilon) for name, c in cases.items()}
for name, found in attractors.items():
    cover = terminal[name].set.area
    print(f"{name}: attractor {found.set.area:.3f} after {found.steps} steps;", end=" ")
    print(f"terminal set of the paper {cover:.3f} after {terminal[name].steps}")

# %%
figure, axes = plt.subplots(1, 2, figsize=(8.2, 4.4), layout="constrained")
for ax, (name, found) in zip(axes, attractors.items()):
    R = terminal[name].set
    plotting.draw_set(ax, R, facecolor="none", edgecolor=plotting.BLACK, linestyle="--", label="terminal set")
    plotting.draw_region(ax, found.set, **{**plotting.MAXIMAL, "facecolor": "#0072B2"}, label="attractor")
    plotting.label_axes(ax, R)
    plotting.legend_above(ax, 2)
    ax.set_xlabel(f"$x_1$\n{name}")
plt.show()

# %% [markdown]
# **What to see.** Everything in the maximal set, not only $\mathcal{F}_{\max}$, ends in the blue set. The dashed
# terminal set, a polygon with eight sides, is larger: in case 1 by the bays that the jumps between the modes leave.

# %% [markdown]
# ## 5 How much disturbance is too much?
#
# With a larger $\mathcal{D}$ the maximal set shrinks, until there is none. $\mathcal{F}_{\max}$ gives up much earlier:

# %%
figure, axes = plt.subplots(1, 2, figsize=(8.2, 3.6), layout="constrained")
for ax, (name, case), last in zip(axes, cases.items(), (1.25, 0.8)):
    bounds, areas = np.linspace(0, last, 9), []
    for r in bounds:
        other = case.loop.with_disturbance(mr.Polytope.box([-r, -r], [r, r]))
        sets = mr.safe_set(other, case.safe_directions).set, mr.maximal_safe_set(other, prove=False).set
        areas.append([0.0 if part is None else part.area for part in sets])
    small, large = np.transpose(areas)
    ax.plot(bounds, large, "o-", color=plotting.BLUE, label="maximal safe set")
    ax.plot(bounds, small, "s--", color=plotting.GREEN, label=r"$\mathcal{F}_{\max}$ (0: none found)")
    ax.set(xlabel=f"bound on $|d|_\\infty$\n{name}", ylabel="area")
    plotting.legend_above(ax, 2)
plt.show()

# %% [markdown]
# **What to see.** $\mathcal{F}_{\max}$ is gone soon, the maximal set lives on. In case 1 it hardly shrinks before it
# ends at once: beyond the last bound the lost corner spreads, step by step, over all of $\mathcal{X}$.
# `mr.largest_disturbance(loop)` finds the ends by bisection, to $10^{-4}$; near them the iteration takes hundreds of
# steps, so that this takes a minute or two and stands here as a table:
#
# | largest bound on $|d|_\infty$ (the paper's) | $\mathcal{F}_{\max}$ | maximal set | and its area there |
# | --- | --- | --- | --- |
# | pwa (0.15) | 0.1940 | 1.2530 | 388.6 of 400 |
# | double_integrator (0.1186) | 0.1779 | 0.8793 | 31.9 of 144 |
#
# For the maximal set existence is monotone: what is RPI for $\mathcal{D}$ is RPI for less. For $\mathcal{F}_{\max}$ it
# need not be, since the sequence starts elsewhere and a template fits one image better than another; the
# bisection finds a bound at which the answer changes.

# %% tags=["nbval-check-output"]
found = mr.largest_disturbance(loop, "template", C=cases["double_integrator"].safe_directions)
print(f"double_integrator, F_max: yes at {found.bound:.4f}, no at {found.above:.4f}, {found.tried} loops tried")

# %% [markdown]
# ## 6 Is that luck? All networks of the seed study

# %%
rows = {name: load_rows(data_file(name, "seeds.csv")) for name in cases}
sizes = {name: case.system.state_set.area for name, case in cases.items()}
figure, ax = plt.subplots(figsize=(7.0, 4.0), layout="constrained")
plotting.plot_areas(ax, rows, sizes)
plt.show()

# %% tags=["nbval-check-output"]
for name, study in rows.items():
    ratios = [row.area_ratio for row in study if row.safe_area]
    proven = sum(row.maximal_verdict == "proven" for row in study)
    print(f"{name}: {proven} of {len(study)} proven, {len(ratios)} have an F_max as well;", end=" ")
    print(f"ratios {min(ratios):.2f} to {max(ratios):.2f}")

# %% [markdown]
# **What to see.** Every one of the 300 networks has a maximal safe set, those included for which the paper's method
# finds none. Within a case it hardly depends on the network (marks are spread vertically only to be seen): what is lost
# is presumably lost to the limits of $u$, not to the training.

# %% [markdown]
# ## What you saw
#
# - Safety is a question about preimages. Forward images drop safe states that nothing reaches.
# - Preimages of polygons under affine pieces are polygons, whatever the piece; no template is needed in the plane.
# - A slack of $10^{-9}$ costs no area that matters, and makes a proof in fractions possible.
# - Exact reachable sets show what each cover adds; the attractor is smaller than the terminal set,
#   in case 1 by more than a third, in case 2 by a tenth.
# - A verdict *none found* by $\mathcal{F}_{\max}$ does not say that the network is unsafe.
#
# ## On your own
#
# - Exercise 10: the lost part of a cell, the iteration, a trajectory that leaves late, and the largest disturbance.
# - Take a network of the study without $\mathcal{F}_{\max}$. Draw its maximal set, and the $\mathcal{F}_k$ that fail.
# - Replace $\mathcal{D}$ of case 2 by the error segment of notebook 07. How much larger is the maximal set?
# - Take away from the maximal set a small disc around one of its states. Is what remains RPI? What does
#   `prove_rpi` say, and what is the largest RPI set in it?
#
# ## Further reading
#
# - Bertsekas, *Infinite-time reachability of state-space regions by using feedback control*, IEEE Transactions on
#   Automatic Control 17(5), 1972: the sequence $\mathcal{S}_k$.
# - Raković, Grieder, Kvasnica, Mayne, Morari, *Computation of invariant sets for piecewise affine discrete time systems
#   subject to bounded disturbances*, CDC 2004: the same with unions of polytopes.
# - Blanchini, Miani, *Set-Theoretic Methods in Control*, Birkhäuser: which sequences end, and which do not.
