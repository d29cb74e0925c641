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
# **What you will do.** Compute the set that the paper's method cannot compute, the *maximal* RPI set in $\mathcal{X}$,
# for both case studies. See why forward images lose safe states, and why preimages do not. Prove the result in rational
# arithmetic, forge it, and see the proof fail. Compare exact reachable sets with their template over-approximations,
# find the attractor, and compute the largest disturbance that a controller tolerates.
#
# **What you will learn.** That *being reached* and *being safe* are two different questions. How to compute the
# preimage of a nonconvex set under hundreds of affine pieces, including singular ones. How rounding can invalidate a
# proof, and how a margin of $10^{-9}$ and exact fractions prevent this.
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
# Prop. 3, Fmax, iterates $\mathcal{F}_{k+1} = \overline{\mathcal{R}}_1(\mathcal{F}_k) \cap \mathcal{X}$: what can be
# *reached* from $\mathcal{F}_k$? A state that cannot be reached is dropped, even if it is safe. The template also
# encloses a nonconvex image in a convex set. The next image is then too large, leaves $\mathcal{X}$ again, and is
# intersected with $\mathcal{X}$ again.
#
# Safety asks another question: *from which states does every step stay inside?* This is a preimage:
#
# $$ \mathcal{S}_0 = \mathcal{X}, \qquad
#    \mathcal{S}_{k+1} = \{ x \in \mathcal{S}_k : A^{(i)} x + B^{(i)} \Phi(x) + p^{(i)} + d \in \mathcal{S}_k
#    \text{ for all } d \in \mathcal{D}^{(i)} \text{ and every mode } i \text{ that contains } (x, \Phi(x)) \} . $$
#
# Every RPI set in $\mathcal{X}$ lies in all $\mathcal{S}_k$. If $\mathcal{S}_{k+1} = \mathcal{S}_k$, the set is RPI. So
# it is the largest RPI set. **First predict:** how many times as large as $\mathcal{F}_{\max}$ is it?

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
# **What to see.** In case 1 only a small corner is lost. In case 2 the lost states lie in the corners in which the
# network cannot brake in time. The paper's $\mathcal{F}_{\max}$ (hatched) is a part of the safe set, in case 2 a sixth
# of it.

# %% [markdown]
# ## 2 One step backwards
#
# Call a state *lost* if some disturbance sequence drives it out of $\mathcal{X}$. On a cell $\mathcal{C}_j$ the loop is
# $x^+ = M_j x + c_j + d$. If all states of a convex polygon $\mathcal{T}$ are lost, then so are the states of
#
# $$ \{ x \in \mathcal{C}_j : M_j x + c_j \in \mathcal{T} \oplus (-\mathcal{D}) \} . $$
#
# This set is a polygon again: every half-plane $v y \le h_{\mathcal{T}}(v) + h_{\mathcal{D}}(-v)$ becomes
# $(v M_j)\, x \le h_{\mathcal{T}}(v) + h_{\mathcal{D}}(-v) - v c_j$. Nothing is inverted, so $M_j$ may be singular. No
# template is used: lost sets are unions of polygons, and a union need not be convex.
#
# `carried_out(loop, S)` computes this preimage for all cells. In the beginning, the complement of $\mathcal{X}$ is
# lost:

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
# **What to see.** From the bright corners some disturbance leads out of $\mathcal{X}$ in one step. From the darker
# parts more steps are needed, each with a disturbance that leads into the part that is already lost. In case 2, step 5
# loses only a set of area $2.5 \cdot 10^{-6}$, too small to see. Step 6 loses nothing.
#
# The next figure compares the first two forward and backward steps of case 2:

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
# **What to see.** Left: $\mathcal{F}_1$ is the template set around what is reached (grey), intersected with
# $\mathcal{X}$. The strip at the bottom is dropped because no state leads there, not because it is unsafe. The upper
# right corner, from which the loop does leave $\mathcal{X}$, is kept. Right: $\mathcal{S}_1$ and $\mathcal{S}_2$ remove
# exactly what is lost.

# %% [markdown]
# ## 3 What rounding can do, and a proof
#
# GEOS, which computes unions and differences, has relative rounding errors of about $10^{-15}$. The computed set may
# then fail to be RPI because its image exceeds it by a rounding error. So `maximal_safe_set` computes two sets. For
# `set`, every $\mathcal{D}$ and every lost part is enlarged by a slack of $10^{-9}$ of the size. For `outer`, lost sets
# are shrunk by the same amount. The true set lies between them.

# %% tags=["nbval-check-output"]
for name, found in maximal.items():
    print(f"{name}: between {found.set.area:.6f} and {found.outer.area:.6f};", end=" ")
    print(f"given up less than a millionth: {found.given_up < 1e-6}")

# %% [markdown]
# Then `set` is *proven* to be RPI. Its vertices are floats, and floats are fractions. `prove_rpi` divides the region
# into convex pieces, reads every number as the fraction that it is, and builds the cells again without rounding. For
# every piece of every cell it shows that the image, enlarged by $\mathcal{D}$, lies in the union of the pieces. The
# proof does not depend on the code that found the set. Now we forge the set:

# %% tags=["nbval-check-output"]
S = maximal["pwa"].set
corner = mr.Polytope.from_points([[-10, -8], [-10, -7], [-9.9, -8.1]])  # 0.1 wide, at the cut-off corner
for name, region in {"the set": S, "with a bite of the corner": S | corner}.items():
    check = mr.prove_rpi(cases["pwa"].loop, region)
    print(f"{name}: {check.verdict}; {check.reason}")

# %%
step = check.witness.exact
after = steps.successor(cases["pwa"].loop, step.state, step.mode, step.disturbance)
print("replayed in fractions, to the last digit:", after == step.after)
print("x1 =", str(step.state[0])[:60], "...")

# %% [markdown]
# A witness in fractions is conclusive: if you replay the step, you get the same fractions.
#
# It is *not* proven that `outer` contains the maximal set; this rests on floats with a margin. If the set is reported
# to be invariant, it is. If it is reported to be maximal, this holds to within `given_up`, unless rounding errors are a
# thousand times as large as expected.

# %% [markdown]
# ## 4 Exact reachable sets, and what templates add
#
# The same cells give $\mathcal{R}_k$ itself, image by image. This shows the over-approximation of
# $\overline{\mathcal{R}}_k$ (eq. (19), ROverOver):

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
# **What to see.** The exact sets are not convex. The dashed template sets fill every concave part, and the next step
# starts from the filled set. The errors accumulate step by step.
#
# ### The attractor
#
# Starting from the maximal safe set $\mathcal{S}$, the sets $\mathcal{R}_k(\mathcal{S})$ are nested, because
# $\mathcal{S}$ is RPI. After $k$ steps *every* trajectory is in $\mathcal{R}_k$. `attractor` stops when no point of
# $\mathcal{R}_k$ has a distance of more than $10^{-3}$ from $\mathcal{R}_{k+1}$. This means that one more step changes
# little. It does not mean that the limit is that close.

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
# **What to see.** Every trajectory from the maximal set, not only from $\mathcal{F}_{\max}$, ends in the blue set. The
# dashed terminal set, a polygon with eight sides, is larger. In case 1 it also fills the gaps in the attractor, which
# the discontinuities between the modes cause.

# %% [markdown]
# ## 5 How much disturbance is too much?
#
# With a larger $\mathcal{D}$ the maximal set shrinks, until there is none. $\mathcal{F}_{\max}$ disappears much
# earlier:

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
# **What to see.** $\mathcal{F}_{\max}$ soon disappears, while the maximal set still exists. In case 1 the maximal set
# hardly shrinks before it disappears abruptly: beyond the last bound the lost corner spreads, step by step, over all of
# $\mathcal{X}$. `mr.largest_disturbance(loop)` finds these bounds by bisection, to $10^{-4}$. Near them the iteration
# takes hundreds of steps, so the computation takes a minute or two. The results are listed here:
#
# | largest bound on $|d|_\infty$ (the paper's) | $\mathcal{F}_{\max}$ | maximal set | area of the maximal set there |
# | --- | --- | --- | --- |
# | pwa (0.15) | 0.1940 | 1.2530 | 388.6 of 400 |
# | double_integrator (0.1186) | 0.1779 | 0.8793 | 31.9 of 144 |
#
# The existence of the maximal set is monotone: a set that is RPI for $\mathcal{D}$ is RPI for every smaller disturbance
# set. The existence of $\mathcal{F}_{\max}$ for a fixed template is monotone as well: by induction over $k$, every
# $\mathcal{F}_k$ grows with $\mathcal{D}$, so $\mathcal{R}_1(\mathcal{F}_k) \subseteq \mathcal{X}$ carries over to
# every smaller $\mathcal{D}$. Bisection is therefore exact for both.

# %% tags=["nbval-check-output"]
found = mr.largest_disturbance(loop, "template", C=cases["double_integrator"].safe_directions)
print(f"double_integrator, F_max: yes at {found.bound:.4f}, no at {found.above:.4f}, {found.tried} loops tried")

# %% [markdown]
# ## 6 Is this a coincidence? All networks of the seed study

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
# **What to see.** Every one of the 300 networks has a maximal safe set, including those for which the paper's method
# finds none. Within a case the set hardly depends on the network (the marks are spread vertically only to make them
# visible). Presumably the lost part is caused by the limits of $u$ and not by the training.

# %% [markdown]
# ## What you saw
#
# - Safety is a question about preimages. Forward images drop safe states that no state leads to.
# - The preimage of a polygon under an affine piece is a polygon, for every piece. No template is needed for two states.
# - A slack of $10^{-9}$ costs a negligible area and makes a proof in fractions possible.
# - Exact reachable sets show what each template step adds. The attractor is smaller than the terminal set, in case 1 by
#   more than a third, in case 2 by a tenth.
# - If no $\mathcal{F}_{\max}$ is found, this does not mean that the network is unsafe.
#
# ## On your own
#
# - Exercise 10: the lost part of a cell, the iteration, a trajectory that leaves late, and the largest disturbance.
# - Take a network of the study without $\mathcal{F}_{\max}$. Draw its maximal set, and the $\mathcal{F}_k$ that fail.
# - Replace $\mathcal{D}$ of case 2 by the error segment of notebook 07. How much larger is the maximal set?
# - Remove a small disc around one state from the maximal set. Is the rest RPI? What does `prove_rpi` say, and what is
#   the largest RPI set in it?
#
# ## Further reading
#
# - Bertsekas, *Infinite-time reachability of state-space regions by using feedback control*, IEEE Transactions on
#   Automatic Control 17(5), 1972: the sequence $\mathcal{S}_k$.
# - Raković, Grieder, Kvasnica, Mayne, Morari, *Computation of invariant sets for piecewise affine discrete time systems
#   subject to bounded disturbances*, CDC 2004: the same with unions of polytopes.
# - Blanchini, Miani, *Set-Theoretic Methods in Control*, Birkhäuser: which sequences end, and which do not.
