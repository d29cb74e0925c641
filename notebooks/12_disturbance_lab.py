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
# **What you will do.** Drag a slider and see how the safe set, the terminal set and the trajectories of three case
# studies change, one of them with three states. Find the largest tolerated disturbance of each loop by hand, then by
# bisection. Change the template, the stopping rule, the trained network and the fit of the nonlinear plant. Save the
# result as a figure, as numbers, or as Python code.
#
# **What you will learn.**
# - that $\mathcal{F}_{\max}$ disappears abruptly and not gradually, and at which state it fails;
# - that the largest disturbance depends on the *template* as well as on the loop;
# - what the shape of the error set gains when the plant is nonlinear;
# - how much of the guaranteed sets the trajectories use;
# - what a projection and what a section shows of a set of $\mathbb{R}^3$.
#
# **What you need.** Notebooks 06 and 09. "Run all" takes about 20 seconds. The three labs need a running kernel. The
# small figures before each of them are made by the same functions and need no kernel.

# %%
import matplotlib.pyplot as plt
import numpy as np

from mireach import lab, plotting

# %% [markdown] tags=["course"]
# `lab.subject` describes what can be varied. `lab.look` computes everything for one choice of settings. The figures
# below and the labs use both.


# %% tags=["course"]
def small_multiples(subject, choices):
    """Draw one look per panel, for a list of (title, settings)."""
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
# **What to see.** From left to right the last $\overline{\mathcal{R}}_k$ (blue hatch) grows, and the trajectories
# spread. For the largest bound there is no $\mathcal{F}_{\max}$ (green) any more: the sequence of boxes stops at a set
# that one step can still leave (red line to the cross). The failure of this sequence does not mean that there is no
# safe set; notebook 13 computes the maximal one.
#
# **The lab.** Drag *disturbance bound*. Drag the red ring to change the initial state (or focus it and use the arrow
# keys). Press *play* to see every $\mathcal{F}_k$ and $\overline{\mathcal{R}}_k$ in turn. While you do not move
# anything, the lab completes the curve at the bottom: the area of $\mathcal{F}_{\max}$ over the bound, up to the
# largest bound for which it exists. At first the area *grows*. The reason: $\mathcal{F}_k$ consists of states that one
# step can reach (eq. (21), Fk), and with a larger disturbance more states can be reached.

# %%
lab.DisturbanceLab("pwa")

# %% [markdown] tags=["course"]
# ### The largest disturbance, by bisection
#
# The next cell does the same in a loop: it evaluates one bound after the other and narrows the interval in which the
# result changes. The lab limits the sequence $\mathcal{F}_k$ to 300 iterations. This is enough here. The double
# integrator would need more very close to its largest bound.


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
# **What to see.** The loop is the same in every row; only the polytopes of the proof differ. More directions are not
# always better. What matters is whether a facet points in the direction in which the loop leaves the set.

# %% [markdown]
# ## 2. The nonlinear double integrator

# %% tags=["course"]
integrator = lab.subject("double_integrator")
choices = [("box, 1 x error", {}), ("segment, 1 x error", {"shape": "segment"}), ("box, 2 x error", {"amount": 2.0})]
small_multiples(integrator, choices)

# %% [markdown] tags=["course"]
# **What to see.** Left: the paper's setting, with the proven error as a box. Middle: the segment, which is the smallest
# convex set that contains all errors. With it the area of the last set is little more than half as large (0.16 instead
# of 0.28). The stopping rule about the origin never holds there; the sequence converges without it. Right: for twice
# the error the sequence $\mathcal{F}_k$ with eight directions stops at a set that is not safe. The dashed purple path
# is a trajectory of the nonlinear plant itself. It does not depend on the disturbance bound.
#
# **The lab.** The amount is a multiple of the *proven* error of the fit. With *regions of the fit* the chessboard
# becomes finer and the proven error smaller. You can select several trained networks, among them one without
# $\mathcal{F}_{\max}$. Tick *with the maximal safe set* to see the set that no template can describe (notebook 13).
# Where $\mathcal{F}_{\max}$ does not exist any more, the maximal set often still does.

# %%
lab.DisturbanceLab("double_integrator")

# %% tags=["course", "nbval-check-output"]
print("largest multiple of the proven error for which F_max is found, 8 directions")
for regions in (2, 3, 4):
    found = [largest(integrator, {"shape": shape, "regions": regions}) for shape in ("box", "segment")]
    box, segment = ("none" if amount is None else f"{amount:.2f}" for amount in found)
    print(f"{regions * regions:2d} regions: box {box}, segment {segment}")

# %% [markdown] tags=["course"]
# **What to see.** A finer fit has a smaller error, so the loop tolerates a larger multiple of it. With four regions it
# does not even tolerate the error of the fit itself. For the same fit the loop tolerates a larger multiple of the
# segment than of the box, because the segment lies in the box. Using only the errors that can occur increases the
# tolerated disturbance by a factor of one and a half or more.

# %% [markdown]
# ## 3. Three tanks: a loop with three states

# %% [markdown] tags=["course"]
# The states are the levels of three tanks in a row, in cm, relative to their set-points (notebook 14). A set of
# $\mathbb{R}^3$ cannot be drawn in the plane as it is. The *view* determines what the lab draws:
#
# - the *projection* $\{(x_1, x_2) : x \in \mathcal{F} \text{ for some } x_3\}$ onto two coordinates, i.e. the shadow of
#   the set;
# - the *section* $\{(x_1, x_2) : x \in \mathcal{F}\}$ for one fixed value of $x_3$.
#
# Other pairs of coordinates can be chosen in the same way.

# %% tags=["course"]
tanks = lab.subject("three_tanks")
sections = [(f"only $x_3 = {level}$ cm", {"view": "section 1 2", "x3": level}) for level in (0, 3)]
small_multiples(tanks, [("any $x_3$", {}), *sections])

# %% [markdown] tags=["course"]
# **What to see.** The projection of $\mathcal{F}_{\max}$ (left) is a square. In the sections, the lower left corner of
# this square is missing. A state there has its projection in the square, but it is outside $\mathcal{F}_{\max}$: the
# three levels must not all be low. The section at $x_3 = 3$ cm does not meet the terminal set at all. Trajectories do
# not stay in a section, so all views show their projection.

# %% tags=["course", "nbval-check-output"]
look = lab.look(tanks, {"x1": 5, "x2": 5, "x3": -1})
x, terminal = look.nominal, look.terminal.set
inside = terminal.contains(x)
shadow = terminal.project([0, 1]).contains(x[:, [0, 1]])
print(f"from {x[0]} the nominal trajectory enters the projection of the terminal set at step {shadow.argmax()}")
print(f"and the terminal set itself at step {inside.argmax()}")

# %% [markdown] tags=["course"]
# **What to see.** A state whose projection lies in the projection of a set need not lie in the set. So the lab also
# states, next to the picture, whether the initial state lies in $\mathcal{F}_{\max}$.
#
# **The lab.** Choose the *view*. The red ring changes the two coordinates that are drawn. The third coordinate has its
# own slider. A section always passes through the initial state, so this slider also moves the section. While you drag
# the bound, the lab updates $\mathcal{F}_{\max}$ and the trajectories. The terminal set takes some tenths of a second;
# the lab updates it when you pause.

# %%
lab.DisturbanceLab("three_tanks")

# %% [markdown] tags=["course"]
# ## 4. Save the result
#
# The three buttons of the lab save the figure (SVG), all sets in it with their verdicts (JSON), and the Python code
# that computes the same sets without the lab. From Python:

# %% tags=["course", "nbval-check-output"]
mine = lab.DisturbanceLab("pwa", amount=0.1, safe_directions=8)
print(mine.script())

# %% tags=["course", "nbval-check-output"]
again = {}
exec(mine.script(), again)
print("the same set:", np.array_equal(again["terminal"].set.h, mine.look.terminal.set.h))

# %% [markdown] tags=["course"]
# `lab.DisturbanceLab(loop)` opens the lab for your own loop with two or more states. It scales the disturbance sets of
# the modes. Exercise: use the loop of notebook 11.
#
# ## What you saw
#
# - A whole case study in the plane, i.e. a hundred sets, takes some hundredths of a second with the engine `cells`.
#   This makes the interactive lab possible.
# - $\mathcal{F}_{\max}$ disappears abruptly, at a bound that depends on the template.
# - Proven sets are conservative: sampled trajectories fill only a part of them.
# - A trajectory may enter the projection of a set before it enters the set. A section shows membership, but only for
#   one value of the coordinates that are not drawn.
#
# ## On your own
#
# - For which bounds does the sequence $\overline{\mathcal{R}}_k$ not end within the lab's 100 steps? Where does it stop
#   changing, and where does the stopping rule hold?
# - In the double integrator's lab, choose the network for which the stopping rule about the origin never holds. Then
#   scale about the equilibrium.
# - Find an initial state outside $\mathcal{F}_{\max}$ from which no trajectory leaves $\mathcal{X}$. What does this say
#   about $\mathcal{F}_{\max}$?
# - In the double integrator's lab, take 36 regions and make the multiple as large as possible. How large is
#   $\|d\|_\infty$ then, compared with 9 regions?
# - In the lab of the three tanks, for which levels $x_3$ does the section meet the terminal set? Compare with the
#   projection onto $(x_1, x_3)$.
#
# ## Further reading
#
# - D. Teichrib, M. Schulze Darup: *A mixed-integer framework for analyzing neural network-based controllers for
#   piecewise affine systems with bounded disturbances*, ECC 2025. Secs. IV and V.
# - S. V. Raković, E. C. Kerrigan, K. I. Kouramas, D. Q. Mayne: *Invariant approximations of the minimal robust
#   positively invariant set*, IEEE TAC 50(3), 2005.
