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
# # Beyond the plane: three and four tanks
#
# **What you will do.** Find the safe set of a hybrid system with three states, and simulate its trajectories. Compare
# the cells with the MILP. Check the sets of a system with four states. See what a certificate of more than two states
# can state.
#
# **What you will learn.** What changes for $n > 2$, and what does not. How the template decides whether a safe set is
# found. How *bound by a solver* differs from *proven*. What exact $k$-step sets cost.
#
# **What you need.** Notebooks 03, 04 and 06; 11 for your own system. "Run all" takes about a minute.

# %%
from time import perf_counter

import matplotlib.pyplot as plt
import numpy as np

import mireach as mr
from mireach import plotting
from mireach.studies.case_studies import data_file, load_sets

tanks = mr.case_study("three_tanks")
print(tanks)

# %% [markdown]
# ## 1 Three tanks with four modes
#
# Two pumps fill the outer tanks, and a drain empties the middle one. Pipes connect the tanks at the bottom and at a
# height of 30 cm. Water flows through an upper pipe only if the level of a tank is higher than that. Let $x_1$ and
# $x_2$ be the deviations of the outer levels from 30 cm. Their signs determine the mode, so there are four modes. All
# four meet at the setpoint, and a disturbance of two millimetres decides which one is active. The network was trained
# on solutions of a mixed-integer MPC.

# %%
for number, mode in enumerate(tanks.system.modes, start=1):
    signs = ["above" if row[i] < 0 else "below" for i, row in enumerate(mode.region.H[:, :2])]
    print(f"mode {number}: tank 1 {signs[0]}, tank 2 {signs[1]} the upper pipe, A = {np.round(mode.A, 3).tolist()}")
print(f"|d| <= {tanks.disturbance_bound} cm; {tanks.network}")

# %% [markdown]
# ## 2 The safe set
#
# The calls are the same as for two states. `mireach` computes the cells of the loop, polytopes of $\mathbb{R}^3$ on
# which the map is affine; there are 358 of them here. A loop with too many cells, or with more than six states, gets
# the MILP of Lemma 2 instead. The template is the box, $(I, -I)$, and two more rows, $\pm(1, 1, 2)$: the amount of
# water in all three tanks together changes more slowly than any single level.

# %%
begin = perf_counter()
safe = mr.safe_set(tanks.loop, tanks.safe_directions)
print(f"{perf_counter() - begin:.1f} s")

# %% tags=["nbval-check-output"]
print(f"{safe.verdict} after {safe.iterations} iterations: {safe.reason}")
for row, before, after in zip(safe.set.H[:8], tanks.system.state_set.support(safe.set.H), safe.set.h):
    print(f"{np.round(row, 2)} x <= {after:5.2f}   (X: {before:5.2f})")

# %% [markdown]
# Why is the safe set smaller than $\mathcal{X}$? If the outer levels are 10 cm too high, water flows into the middle
# tank for every input, and raises its level above the limit. $\mathcal{F}_{\max}$ excludes these states.
#
# The terminal set is shipped with the package, in the certificate of the case. `check_rpi` proves it again.

# %% tags=["nbval-check-output"]
sequence = load_sets("three_tanks")
check = mr.check_rpi(tanks.loop, sequence[-1])
print(f"R_{len(sequence) - 1}: {check.verdict}")
print(
    f"the same F_max as here: {np.allclose(sequence[0].support(safe.set.H), safe.set.support(safe.set.H), atol=1e-6)}"
)

# %%
rng = np.random.default_rng(0)
starts = safe.set.sample(rng, 60)
steps = 80
path = tanks.loop.simulate(starts, steps, tanks.disturbance_bound * rng.choice([-1.0, 1.0], (60, steps, 3)))


def project(P, axes):
    """The projection of a bounded polytope onto two of its coordinates."""
    return mr.Polytope.from_points(P.vertices()[:, axes])


figure, panels = plt.subplots(1, 2, figsize=(9.2, 4.6), layout="constrained")
for ax, axes in zip(panels, ([0, 1], [0, 2])):
    X = project(tanks.system.state_set, axes)
    plotting.draw_set(ax, X, facecolor="none", edgecolor=plotting.GREY, linewidth=2, label=r"$\mathcal{X}$")
    plotting.draw_set(ax, project(safe.set, axes), **plotting.SAFE, label=r"$\mathcal{F}_{\max}$")
    plotting.draw_trajectories(ax, path[:, :, axes], color=plotting.BLACK, linewidth=0.5, alpha=0.5, label="disturbed")
    plotting.draw_set(ax, project(sequence[-1], axes), **plotting.TERMINAL, label=r"$\overline{\mathcal{R}}_{\min}$")
    ax.set(xlim=(-11, 11), ylim=(-11, 11), aspect="equal", xticks=range(-10, 11, 5), yticks=range(-10, 11, 5))
    ax.set(xlabel=f"$x_{axes[0] + 1}$ in cm", ylabel=f"$x_{axes[1] + 1}$ in cm")
plotting.legend_above(panels[0], 4)
plt.show()

# %% [markdown]
# The figures show projections of three-dimensional sets. A trajectory may enter the projection of
# $\overline{\mathcal{R}}_{\min}$ long before it enters the set itself. From step 37 on it is in the set, and stays
# there.

# %% tags=["nbval-check-output"]
print(f"stay in F_max: {safe.set.contains(path, tol=1e-6).all(axis=1).sum()} of 60")
print(f"in the terminal set from step 37 on: {sequence[-1].contains(path[:, 37:], tol=1e-6).all(axis=1).sum()} of 60")

# %% [markdown]
# ## 3 What makes the MILP fast
#
# Lemma 2 as printed in the paper has a binary for every channel and every mode, and one big-M by interval arithmetic.
# This is `mr.Milp("paper")`. "whole" is also a single model. It has a separate big-M for each row, computed by LPs.
# It omits channels that are never the largest and modes that are never active. "split", the default, halves the state
# space until few binaries are left. Bounds of the loop that are affine in $x$ settle most boxes without any solver. The
# three formulations must agree, and they do, to within the accuracy of a MILP solver.

# %%
V, F = tanks.directions[:2], safe.set
bounds = {}
for formulation in ("paper", "whole", "split"):
    begin = perf_counter()
    bounds[formulation] = mr.support(tanks.loop, F, V, engine=mr.Milp(formulation)).bound
    print(f"{formulation:6s} {perf_counter() - begin:6.2f} s")

# %% tags=["nbval-check-output"]
print(np.round(bounds["split"], 5))
print(f"agree to 1e-6: {all(np.abs(bound - bounds['split']).max() < 1e-6 for bound in bounds.values())}")

# %% [markdown]
# ## 4 Four tanks
#
# The quadruple-tank process has four states, two inputs and one mode. Each pump feeds one lower tank and the upper tank
# on the opposite side. Its sequence is long, because the slowest eigenvalue of the closed loop is about 0.93.

# %% tags=["nbval-check-output"]
four = mr.case_study("four_tanks")
sets = load_sets("four_tanks")
print(f"{len(sets) - 1} steps; F_max {mr.check_rpi(four.loop, sets[0]).verdict}, ", end="")
print(f"terminal set {mr.check_rpi(four.loop, sets[-1]).verdict}")

# %%
size = np.array([R.support(four.directions) for R in sets])
figure, ax = plt.subplots(figsize=(6.4, 3.4), layout="constrained")
for row, style in enumerate(
    (("-", plotting.BLUE), ("--", plotting.RED), ("-.", plotting.GREEN), (":", plotting.BLACK))
):
    drawn = dict(zip(("linestyle", "color"), style), label=f"$x_{row + 1}$")
    ax.semilogy(size[:, row] - size[-1, row] + 1e-4, **drawn)
ax.set(xlabel="$k$", ylabel=r"$h$ of $\overline{\mathcal{R}}_k$ less that of the last, cm")
ax.legend(title="along")
plt.show()

# %% [markdown]
# After a dozen steps all four shrink at the same rate, that of the slowest eigenvalue. (1e-4 is added so that the end
# is visible.)
#
# ## 5 A certificate without cells
#
# The checker computes exact cells for two states only. A certificate of a larger system contains the bounds of an
# engine. The checker compares them exactly with the sets, but it cannot derive them again, and it reports this. It
# never reports *proven*.

# %% tags=["nbval-check-output"]
print(mr.certificate.verify(data_file("four_tanks", "certificate.json")))

# %% [markdown]
# ## 6 The price of exact steps
#
# $\mathcal{R}_k$ without a template between the steps needs $k$ times the binaries (Lemma 2). With one mode the time
# hardly grows, because the network is a single affine piece near the origin. With four modes that meet there, it grows
# very quickly.

# %%
print("k     three tanks      four tanks")
for k in (1, 2, 3):
    seconds = []
    for case, R in ((tanks, sequence[-1]), (four, sets[-1])):
        begin = perf_counter()
        mr.support(case.loop, R, np.eye(case.system.state_size)[:1], steps=k, engine=mr.Milp("whole"))
        seconds.append(perf_counter() - begin)
    print(f"{k} {seconds[0]:12.2f} s {seconds[1]:12.2f} s")

# %% [markdown]
# ## What you saw
#
# - For $n > 2$ the same calls give the same guarantees. With the MILP they hold to within 1e-6 of the size of X, unless
#   exact arithmetic decides.
# - One template row that uses the physics, here the amount of water in all tanks, is worth more than many that do not.
# - The time depends on how many binaries the bounds leave undecided, not on how many the formulation has.
# - A certificate distinguishes bounds of a solver from proofs.
#
# ## On your own
#
# - Take the box alone as template, `mr.box_directions(3)`. How many iterations, and how large is the terminal set?
# - Replace (1, 1, 2) by (1, 1, 1), which weights the tanks equally. Why does the drain matter here?
# - What is the largest tolerated disturbance of the three tanks? Use `tanks.loop.with_disturbance(...)` and bisection.
# - Forge the bounds in the certificate of the four tanks, digest included. What can the checker detect, and what not?
#
# ## Further reading
#
# - Johansson, *The quadruple-tank process*, IEEE Transactions on Control Systems Technology 8(3), 2000.
# - Bemporad, Morari, *Control of systems integrating logic, dynamics, and constraints*, Automatica 35, 1999.
# - `mireach.systems.plants` states which data of the two systems come from the literature, and which are our choice.
#
# This is the last notebook. To return to the paper's claims, run `python3 run.py reproduce`.
