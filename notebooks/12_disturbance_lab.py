# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#   kernelspec:
#     display_name: Python 3 (ipykernel)
#     language: python
#     name: python3
# ---

# %% [markdown] tags=["course"]
# # Move the disturbance, watch the sets
#
# **What you will do.** Drag a slider and see the safe set, the terminal set and the trajectories of both case studies
# follow. Find by hand, then by bisection, how much disturbance each loop stands. Change the template, the stopping
# rule, the trained network and the fit of the nonlinear plant, and take the result home as a figure, as numbers, or
# as Python.
#
# **What you will learn.**
# - how $\mathcal{F}_{\max}$ ends: not by fading away, but at once, and where the state is that breaks it;
# - that the largest disturbance belongs to the *template* as much as to the loop;
# - what the shape of the error set is worth when the plant is nonlinear;
# - how far trajectories stay inside the sets that hold all of them.
#
# **What you need.** Notebooks 06 and 09. "Run all" takes about 15 seconds. The two labs need a running kernel; the
# small pictures before each of them are made by the same functions and say the same without one.

# %%
import matplotlib.pyplot as plt
import numpy as np

from mireach import lab, plotting

# %% [markdown] tags=["course"]
# `lab.subject` says what may be varied, `lab.look` computes everything for one choice of settings. The pictures below
# use both, and so do the labs.


# %% tags=["course"]
def small_multiples(subject, choices):
    """One look a panel: list of (title, settings)."""
    fig, axes = plt.subplots(1, len(choices), figsize=(8, 3.4), layout="constrained", sharex=True, sharey=True)
    for ax, (title, settings) in zip(axes, choices):
        plotting.plot_look(ax, lab.look(subject, settings), title)
        ax.label_outer()
    handles = {label: handle for ax in axes for handle, label in zip(*ax.get_legend_handles_labels())}
    fig.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=5, frameon=False, fontsize="small")
    plt.show()


# %% [markdown]
# ## 1. The four-mode loop

# %% tags=["course"]
pwa = lab.subject("pwa")
small_multiples(pwa, [(rf"$\|d\|_\infty \leq {bound}$", {"amount": bound}) for bound in (0.05, 0.15, 0.25)])

# %% [markdown] tags=["course"]
# **What to see.** From left to right the last $\overline{\mathcal{R}}_k$ (blue hatch) swells, the trajectories spread,
# and then $\mathcal{F}_{\max}$ (green) is gone altogether: for the largest bound the sequence of boxes comes to a stop
# at a set that one step still leaves (red line to the cross). That this sequence fails does not say that nothing is
# safe; notebook 13 says what is.
#
# **The lab.** Drag *disturbance bound*; drag the red ring to start elsewhere (or put the focus on it and use the arrow
# keys); press *play* to see every $\mathcal{F}_k$ and $\overline{\mathcal{R}}_k$ in turn. The curve at the bottom fills
# in by itself while you rest: the area of $\mathcal{F}_{\max}$ over the bound, up to the largest bound that has one. Do
# not be surprised that the area *grows* at first: $\mathcal{F}_k$ keeps what one step can reach (eq. (21), Fk), and a
# larger disturbance reaches more.

# %%
lab.DisturbanceLab("pwa")

# %% [markdown] tags=["course"]
# ### The largest disturbance, by bisection
#
# What the curve does, as a loop: ask at one bound after the other, and close in on the last change. The lab gives the
# sequence $\mathcal{F}_k$ at most 300 iterations, which are enough here; the double integrator would need more very
# close to its largest bound.


# %% tags=["course"]
def largest(subject, settings):
    """The largest amount of disturbance for which F_max is found, to within 1e-4 of the slider's range."""
    known, control = {}, subject.control("amount")
    while (amount := lab.next_amount(known, control.low, control.high)) is not None:
        known[amount] = lab.safe_set_at(subject, settings, amount)
    return lab.largest_amount(known)


# %% tags=["course", "nbval-check-output"]
counts = (4, 6, 8, 12, 16, 24, 32)
bounds = [largest(pwa, {"safe_directions": count}) for count in counts]
for count, bound in zip(counts, bounds):
    print(f"{count:2d} directions: safe up to |d|_inf <= {bound:.3f}")

# %% [markdown] tags=["course"]
# **What to see.** The loop has not changed from row to row, only the polytopes with which we try to prove something.
# More directions are not always better: what counts is whether a facet points where the loop throws the state out.

# %% [markdown]
# ## 2. The nonlinear double integrator

# %% tags=["course"]
integrator = lab.subject("double_integrator")
choices = [("box, 1 x error", {}), ("segment, 1 x error", {"shape": "segment"}), ("box, 2 x error", {"amount": 2.0})]
small_multiples(integrator, choices)

# %% [markdown] tags=["course"]
# **What to see.** Left: the paper's setting, with the proven error as a box. Middle: the error set that is really
# needed, a segment, makes the last set little more than half as large (0.16 instead of 0.28); the rule about the
# origin never holds there, the sequence just stops changing. Right: for twice the error the sequence
# $\mathcal{F}_k$ with eight directions comes to rest at a set that is not safe. The dashed purple path is the
# nonlinear plant itself; it belongs to no disturbance bound.
#
# **The lab.** The amount is a multiple of the *proven* error of the fit. With *regions of the fit* the chessboard
# becomes finer and the proven error smaller. Several trained networks are at hand, among them one without
# $\mathcal{F}_{\max}$.
# Tick *with the maximal safe set* to see what no template can describe (notebook 13): where there is no
# $\mathcal{F}_{\max}$ any more, the maximal set is often still there.

# %%
lab.DisturbanceLab("double_integrator")

# %% tags=["course", "nbval-check-output"]
print("largest multiple of the proven error for which F_max is found, 8 directions")
for regions in (2, 3, 4):
    found = [largest(integrator, {"shape": shape, "regions": regions}) for shape in ("box", "segment")]
    box, segment = ("none" if amount is None else f"{amount:.2f}" for amount in found)
    print(f"{regions * regions:2d} regions: box {box}, segment {segment}")

# %% [markdown] tags=["course"]
# **What to see.** A finer fit has a smaller error, so that the loop stands a larger multiple of it; with four regions
# not even the error of the fit itself. For the same fit the segment is the easier disturbance, because it lies in the
# box: counting only the errors that can occur is worth one and a half times the disturbance, and more.

# %% [markdown] tags=["course"]
# ## 3. Take it home
#
# The three buttons of the lab save the picture (SVG), all sets that it shows, with their verdicts (JSON), and the
# lines of Python that compute the same sets without the lab. From Python:

# %% tags=["course", "nbval-check-output"]
mine = lab.DisturbanceLab("pwa", amount=0.1, safe_directions=8)
print(mine.script())

# %% tags=["course", "nbval-check-output"]
again = {}
exec(mine.script(), again)
print("the same set:", np.array_equal(again["terminal"].set.h, mine.look.terminal.set.h))

# %% [markdown] tags=["course"]
# A loop of your own gets a lab in the same way: `lab.DisturbanceLab(loop)` scales whatever disturbance sets the
# modes have. Exercise: bring the loop of notebook 11.
#
# ## What you saw
#
# - A whole case study, a hundred sets, takes some hundredths of a second with the exact cells; that is why it can
#   follow the hand.
# - $\mathcal{F}_{\max}$ ends abruptly, at a bound that depends on the template.
# - Proven sets are cautious: sampled trajectories fill only a part of them.
#
# ## On your own
#
# - For which bounds does the sequence $\overline{\mathcal{R}}_k$ not end within the lab's 100 steps? Where does it
#   stagnate, where does the rule hold?
# - In the double integrator's lab, choose the network for which the rule about the origin does not end, then scale
#   about the equilibrium.
# - Find a start outside $\mathcal{F}_{\max}$ from which no trajectory leaves $\mathcal{X}$. What does that say about
#   $\mathcal{F}_{\max}$?
# - In the double integrator's lab, take 36 regions and make the multiple as large as it gets. How large is
#   $\|d\|_\infty$ then, compared with 9 regions?
#
# ## Further reading
#
# - D. Teichrib, M. Schulze Darup: *A mixed-integer framework for analyzing neural network-based controllers for
#   piecewise affine systems with bounded disturbances*, ECC 2025. Secs. IV and V.
# - S. V. Raković, E. C. Kerrigan, K. I. Kouramas, D. Q. Mayne: *Invariant approximations of the minimal robust
#   positively invariant set*, IEEE TAC 50(3), 2005.
