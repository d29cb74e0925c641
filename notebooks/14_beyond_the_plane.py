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
# Most plants have more than two states. The paper's method is not limited to two: the definitions, the template sets
# and the MILP of Lemma 2 are the same for any number $n$ of states. But a set of $\mathbb{R}^3$ is harder to draw than
# one of $\mathbb{R}^2$, and a network divides $\mathbb{R}^3$ into far more pieces.
#
# **What you will do.** Model three tanks as a piecewise-affine system. Look at the cells of the loop, which are
# polytopes of $\mathbb{R}^3$. Follow every set $\mathcal{F}_k$ and $\overline{\mathcal{R}}_k$ in space. Compare the
# engines `cells` and `milp`, for different networks and for four tanks.
#
# **What you will learn.**
# - what a cell is for $n = 3$, and how it gives a one-step set without a solver;
# - why a state can lie in every projection of a set, but not in the set;
# - how the number of cells grows with $n$ and with the network, and when the MILP is the better choice;
# - how the template decides whether a safe set is found;
# - how a certificate is proven for any number of states, and what a forged one is refused by.
#
# **What you need.** Notebooks 03, 04 and 06. "Run all" takes about a minute.

# %%
import json
import tempfile
from fractions import Fraction
from math import comb
from pathlib import Path
from time import perf_counter

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.patches import Patch, Rectangle
from scipy.spatial import ConvexHull

import mireach as mr
from mireach import plotting
from mireach.engines.space import dynamics
from mireach.lab import step_viewer
from mireach.plotting import BLACK, BLUE, GREEN, GREY, ORANGE, RED
from mireach.studies.case_studies import data_file, load_sets

tanks = mr.case_study("three_tanks")
loop, X, U = tanks.loop, tanks.system.state_set, tanks.system.input_set
print(tanks)

# %% [markdown]
# ## 1. Three tanks
#
# Two pumps fill the outer tanks, and a drain empties the middle one. Each outer tank is connected to the middle one by
# a pipe at the bottom and by a second pipe at a height of 30 cm.


# %%
def draw_tanks(ax):
    """The three tanks at the levels that are to be kept; heights in cm, widths not to scale."""
    water, wall = "#0072B255", {"color": BLACK, "linewidth": 1.6}
    for left, level, name in ((0, 30, "1"), (5, 20, "3"), (10, 30, "2")):
        ax.add_patch(Rectangle((left, 0), 3, level, facecolor=water, edgecolor="none"))
        ax.plot([left, left + 3], [level, level], color=BLUE, linewidth=1.5)
        ax.plot([left, left, left + 3, left + 3], [62, 0, 0, 62], **wall)
        ax.text(left + 1.5, 52, f"tank {name}", ha="center", va="center")
        ax.text(left + 1.5, level / 2, f"$h_{name} = {level} + x_{name}$", ha="center", va="center", fontsize="small")
    for left in (3, 8):
        for bottom, filled in ((1, water), (30, "white")):
            ax.add_patch(Rectangle((left, bottom), 2, 3, facecolor="white", edgecolor="none", zorder=3))
            ax.add_patch(Rectangle((left, bottom), 2, 3, facecolor=filled, edgecolor="none", zorder=3))
            ax.plot([left, left + 2], [bottom, bottom], zorder=3, **wall)
            ax.plot([left, left + 2], [bottom + 3, bottom + 3], zorder=3, **wall)
    arrow = {"arrowstyle": "-|>", "color": RED, "linewidth": 1.4}
    for left, name in ((0, "1"), (10, "2")):
        ax.add_patch(Rectangle((left + 0.9, 66), 1.2, 12, facecolor="white", edgecolor=BLACK, linewidth=1.4))
        ax.text(left + 1.5, 72, "pump", ha="center", va="center", fontsize="x-small", rotation=90)
        ax.annotate("", (left + 1.5, 56), (left + 1.5, 66), arrowprops=arrow)
        ax.text(left + 2.4, 72, f"$Q_{name}$ ($u_{name}$)", va="center", color=RED)
        toward = 1 if name == "1" else -1
        edge = left + 3 if name == "1" else left
        for height, pipe in ((2.5, "bottom pipe"), (31.5, "upper pipe")):
            ax.annotate("", (edge + 1.8 * toward, height), (edge + 0.2 * toward, height), arrowprops=arrow, zorder=4)
            ax.text(edge + toward, height + 3.5, pipe, ha="center", fontsize="x-small")
    ax.plot([6.2, 6.2], [0, -8], **wall)
    ax.plot([6.8, 6.8], [0, -8], **wall)
    ax.annotate("", (6.5, -14), (6.5, -1), arrowprops=arrow)
    ax.text(7.1, -8, "drain", va="center", fontsize="small")
    ax.plot([-1.6, 0], [30, 30], ":", color=GREY)
    ax.text(-1.7, 30, "$h_v = 30$ cm", ha="right", va="center", fontsize="small")
    ax.plot([-1.6, 0], [62, 62], ":", color=GREY)
    ax.text(-1.7, 62, r"$h_{\max} = 62$ cm", ha="right", va="center", fontsize="small")
    ax.set(xlim=(-5.2, 15.2), ylim=(-16, 82))
    ax.set_axis_off()


fig, ax = plt.subplots(figsize=(8, 4.2), layout="constrained")
draw_tanks(ax)
plt.show()

# %% [markdown]
# **The plant.** All tanks have the area $A_T = 154$ cm², and all pipes and the drain have the cross-section $S = 0.2$
# cm². By Torricelli's law, water flows through an opening at depth $z$ below the surface at the speed $\sqrt{2 g z}$.
# So while $h_3 \le h_1, h_2$ and $h_3 \le h_v$, with $h_v = 30$ cm,
#
# $$ A_T \dot h_i = Q_i - q_i \ \ (i = 1, 2), \qquad A_T \dot h_3 = q_1 + q_2 - S \sqrt{2 g h_3}, $$
# $$ q_i = S \sqrt{2 g (h_i - h_3)} + \begin{cases} S \sqrt{2 g (h_i - h_v)} & \text{if } h_i \ge h_v, \\
#    0 & \text{if } h_i \le h_v. \end{cases} $$
#
# **The model.** As in the literature on this benchmark, the square roots are replaced by secants from zero to the
# largest value, $S\sqrt{2 g z} \approx \big(S \sqrt{2 g / z_{\max}}\big) z$, with $z_{\max} = h_{\max} = 62$ cm for the
# bottom pipes and the drain, and $z_{\max} = h_{\max} - h_v = 32$ cm for the upper pipes. The model also uses the
# linear flow of the bottom pipes where $h_3 > h_i$ and water flows back. One Euler step of $T = 10$ s gives
#
# $$ x_i^+ = x_i - \kappa_0 (x_i - x_3) - \sigma_i \kappa_v x_i + b\, u_i + d_i \ \ (i = 1, 2), $$
# $$ x_3^+ = x_3 + \textstyle\sum_{i=1,2} \big( \kappa_0 (x_i - x_3) + \sigma_i \kappa_v x_i \big)
#    - \kappa_0 x_3 + d_3, $$
#
# with $\kappa_0 = \frac{T S}{A_T} \sqrt{2 g / h_{\max}}$, $\kappa_v = \frac{T S}{A_T} \sqrt{2 g / (h_{\max} - h_v)}$
# and $b = \frac{T}{A_T} \cdot 100$ cm³/s. Here $x$ is the deviation of the levels from $(30, 30, 20)$ cm, and $u$ is
# the deviation of the pump flows from the flows that keep these levels, in units of the largest flow, 100 cm³/s.
# $\sigma_i = 1$ if the level of tank $i$ is above the upper pipe, $x_i \ge 0$, and $\sigma_i = 0$ if $x_i \le 0$. So
# there are **four modes**, and
#
# $$ A = \begin{pmatrix} 1 - \kappa_0 - \sigma_1 \kappa_v & 0 & \kappa_0 \\
#    0 & 1 - \kappa_0 - \sigma_2 \kappa_v & \kappa_0 \\
#    \kappa_0 + \sigma_1 \kappa_v & \kappa_0 + \sigma_2 \kappa_v & 1 - 3 \kappa_0 \end{pmatrix}, \qquad
#    B = \begin{pmatrix} b & 0 \\ 0 & b \\ 0 & 0 \end{pmatrix}, \qquad p = 0. $$
#
# The limits are $\mathcal{X} = \{x : |x|_\infty \le 10 \text{ cm}\}$ and $\mathcal{D} = \{d : |d|_\infty \le 0.2
# \text{ cm}\}$. The input set $\mathcal{U}$ is a box: each pump may run at any flow from zero to the largest.

# %% tags=["nbval-check-output"]
T, A_T, S, g = 10.0, 154.0, 0.2, 981.0  # s, cm^2, cm^2, cm/s^2
kappa_0, kappa_v, b = T / A_T * S * np.sqrt(2 * g / 62), T / A_T * S * np.sqrt(2 * g / 32), T / A_T * 100
print(f"kappa_0 = {kappa_0:.4f}, kappa_v = {kappa_v:.4f}, b = {b:.3f} cm")
for number, mode in enumerate(tanks.system.modes, start=1):
    s1, s2 = (int(row[i] < 0) for i, row in enumerate(mode.region.H[:, :2]))  # the row -x_i <= 0: above the pipe
    rows = [[1 - kappa_0 - s1 * kappa_v, 0, kappa_0], [0, 1 - kappa_0 - s2 * kappa_v, kappa_0]]
    A = np.array([*rows, [kappa_0 + s1 * kappa_v, kappa_0 + s2 * kappa_v, 1 - 3 * kappa_0]])
    print(f"mode {number}: sigma = ({s1}, {s2}), A and B as in the equations: ", end="")
    print(np.allclose(mode.A, A) and np.allclose(mode.B, [[b, 0], [0, b], [0, 0]]))
lower, upper = U.bounding_box()
print(f"U = [{lower[0]:.4f}, {upper[0]:.4f}]^2")

# %% [markdown]
# **What to see.** The set-point of the outer levels is exactly the height of the upper pipes. So all four modes meet at
# the origin, and near it a disturbance of two millimetres decides which one is active. At full flow, a pump adds 5.8 cm
# per step more to its tank than at the set-point. A pump that is off adds only 0.7 cm per step less. So the controller
# can raise the levels much faster than it can lower them. The input acts on $x_3$ only through the outer tanks, one
# step later.
#
# The controller $u = \Phi(x)$ is a maxout network that was trained on solutions of a mixed-integer MPC.

# %% [markdown]
# ## 2. Cells in space
#
# On which parts of $\mathcal{X}$ is the loop affine? Fix the active mode, and for every neuron the channel that attains
# the maximum. The states with this mode and these channels satisfy a set of linear inequalities, so they form a
# polytope of $\mathbb{R}^3$, a **cell**. On it, $x^+ = M x + c + d$.

# %% tags=["nbval-check-output"]
every = dynamics(loop, 500_000)  # raises an error if there are more cells
cells, mode_of = every.cells.complex, every.cells.mode
corners = cells.counts[:, 0]
print(
    f"{len(cells)} cells with {corners.sum()} vertices: "
    f"{corners.min()} to {corners.max()} per cell, {corners.mean():.1f} on average"
)
print("cells of modes 1 to 4:", np.bincount(mode_of))

# %% [markdown]
# `mireach` stores for each cell its inequalities, its vertices, and the inequalities that are *tight* at each vertex,
# i.e. hold with equality. Here is a cell with only four vertices:

# %% tags=["nbval-check-output"]
i = int(np.flatnonzero((corners == 4) & (mode_of == 3))[0])
cell = cells.polytope(i)
tight = np.abs(cells.vertices(i) @ cell.H.T - cell.h) < 1e-9  # (vertices, rows)
facets = np.flatnonzero(tight.sum(axis=0) >= 3)  # a facet has three vertices at least
facets = [r for k, r in enumerate(facets) if not (tight[:, facets[:k]] == tight[:, [r]]).all(axis=0).any()]  # once each
for letter, r in zip("abcd", facets):
    print(f"row {letter}: {np.round(cell.H[r], 3) + 0.0} x <= {cell.h[r] + 0.0:.3f}")
for x, row in zip(cells.vertices(i), tight[:, facets]):
    print(f"vertex {np.round(x, 3) + 0.0}, tight: {' '.join(letter for letter, on in zip('abcd', row) if on)}")

# %% [markdown]
# **What to see.** The cell is a tetrahedron. Three facets meet at each vertex, and two vertices that have two facets in
# common are the ends of an edge. The next neuron adds a plane that may cut the cell in two. Then every vertex belongs
# to one of the two parts, and each edge that crosses the plane gives a new vertex of both. No solver is needed for
# this. The same works for any $n$: the ends of an edge have $n - 1$ tight rows in common. (Degenerate vertices, where
# more than $n$ rows are tight, need an additional check.)
#
# The next figure shows the section of all cells at $x_3 = 0$ (`Polytope.section`).

# %%
TINTS = np.array(["#CDE4F2", "#FBE5B9", "#C4E8DC", "#F6D3C0"])  # one per mode
pieces = [cells.polytope(j).section([0, 1]) for j in range(len(cells))]
flat = {j: P.vertices() for j, P in enumerate(pieces) if not P.is_empty}
flat = {j: points for j, points in flat.items() if len(points) > 2}  # a cell that only touches the plane is left out
shown = list(flat)
middle = np.array([np.append(points.mean(axis=0), 0) for points in flat.values()])
u1 = np.array([every.cells.K[j, 0] @ x + every.cells.g[j, 0] for j, x in zip(shown, middle)])

fig, (left, right) = plt.subplots(1, 2, figsize=(9, 4.6), layout="constrained")
left.add_collection(PolyCollection(flat.values(), facecolors=TINTS[mode_of[shown]], edgecolors=GREY, linewidths=0.6))
right.add_collection(PolyCollection(flat.values(), facecolors=plt.cm.cividis((u1 - lower[0]) / (upper[0] - lower[0]))))
right.add_collection(PolyCollection(flat.values(), facecolors="none", edgecolors="white", linewidths=0.4))
for ax, title in (
    (left, f"{len(shown)} of {len(cells)} cells meet $x_3 = 0$"),
    (right, "$u_1$ at the centroid of each cell"),
):
    plotting.label_axes(ax, X.project([0, 1]), title)
tints = [Patch(facecolor=tint, edgecolor=GREY, label=f"mode {k}") for k, tint in enumerate(TINTS, start=1)]
fig.legend(handles=tints, loc="outside lower center", ncols=4, frameon=False)
fig.colorbar(plt.cm.ScalarMappable(plt.Normalize(lower[0], upper[0]), "cividis"), ax=right, label="$u_1$", shrink=0.85)
plt.show()

# %% [markdown]
# **What to see.** The modes are the quadrants of $(x_1, x_2)$, and the network divides each of them. Where tank 1 is
# too full, pump 1 is off (dark). The section shows a polygon for each cell that meets the plane. It does not show the
# other cells, or how far a cell extends along $x_3$. Here are the six largest cells in space:

# %%
size = np.array([ConvexHull(cells.vertices(j), qhull_options="QJ").volume for j in range(len(cells))])
largest = np.argsort(-size)[:6]
fig, ax = plt.subplots(figsize=(6.4, 5.2), layout="constrained", subplot_kw={"projection": "3d"})
for j in largest[np.argsort(mode_of[largest], kind="stable")]:
    colour, label = (BLUE, ORANGE, GREEN, RED)[mode_of[j]], f"mode {mode_of[j] + 1}"
    named = label in ax.get_legend_handles_labels()[1]
    plotting.draw_set(ax, cells.polytope(j), facecolor=f"{colour}66", edgecolor=colour, label=None if named else label)
plotting.draw_set(ax, X, facecolor="none", edgecolor=GREY, linewidth=0.8)
plotting.label_axes(ax, X, f"the 6 largest cells, {size[largest].sum() / size.sum():.0%} of the volume")
ax.legend(loc="upper left", fontsize="small")
plt.show()

# %% [markdown]
# ### One step, without a solver
#
# The support function of $\mathcal{R}_1(\mathcal{F})$ is a maximum over the cells that meet $\mathcal{F}$. A linear
# function on a polytope attains its maximum at a vertex, so
#
# $$ h_{\mathcal{R}_1(\mathcal{F})}(v) = \max_{\text{cells } \mathcal{C}} \ \max_{x \text{ vertex of }
#    \mathcal{C} \cap \mathcal{F}} v (M x + c) + h_{\mathcal{D}}(v). $$
#
# For $\mathcal{F} = \mathcal{X}$ these are the vertices of the cells themselves, which we already have. The MILP of
# Lemma 2 gives the same numbers.

# %% tags=["nbval-check-output"]
V = mr.box_directions(3)
owner = np.repeat(np.arange(len(cells)), corners)  # the cell of each vertex
images = np.einsum("tij,tj->ti", every.M[owner], cells.points) + every.c[owner]
by_hand = (images @ V.T).max(axis=0) + tanks.disturbance_bound * np.abs(V).sum(axis=1)
print("by hand:", by_hand.round(4))
for engine in ("cells", "milp"):
    bound = mr.support(loop, X, V, engine=engine).bound
    print(f"{engine:>6}: {bound.round(4)}, differs by less than 1e-8: {np.abs(bound - by_hand).max() < 1e-8}")

# %% [markdown]
# ## 3. Every set of the iterations
#
# The calls are those of notebook 06. The template is the box, $(I, -I)$, and two more rows, $\pm(1, 1, 2)$.

# %% tags=["nbval-check-output"]
safe = mr.safe_set(loop, tanks.safe_directions)
print(f"{safe.verdict} after {safe.iterations} iterations: {safe.reason}")
for k, F in enumerate(safe.history):
    lower, upper = F.bounding_box()
    box = " x ".join(f"[{a:6.2f}, {b:5.2f}]" for a, b in zip(lower, upper))
    print(f"F_{k}: volume {F.volume():6.0f} cm^3, in {box}")

# %%
fig, axes = plt.subplots(2, 3, figsize=(9, 5.8), layout="constrained", subplot_kw={"projection": "3d"})
plotting.plot_history(axes, safe.history)
plt.show()

# %% [markdown]
# **What to see.** Each panel shows one set (blue) and its predecessors (grey). In every iteration the upper limits of
# $x_1$ and $x_2$ decrease, and the lower limit of $x_3$ increases. $\mathcal{F}_0 = \mathcal{X}$ itself is not safe: if
# all three levels are 10 cm too high, more water flows into the middle tank than out of it, whatever the input, and its
# level exceeds the limit. $\mathcal{F}_{\max}$ excludes these states. The slanted facet at the bottom belongs to the
# row $-(1, 1, 2)$. (The volumes are those of sets in the state space, not amounts of water.)

# %% tags=["nbval-check-output"]
terminal = mr.terminal_set(loop, safe, tanks.directions)
print(terminal.reason)
print(f"volume {terminal.set.volume():.2f} cm^3")
print(f"alpha > 1: {terminal.alpha > 1}; stable by Theorem 1: {terminal.stable}")

# %%
fig, axes = plt.subplots(2, 4, figsize=(10, 5.2), layout="constrained", subplot_kw={"projection": "3d"})
plotting.plot_history(axes, terminal.history, [0, 2, 4, 6, 8, 12, 20, terminal.steps], r"\overline{\mathcal{R}}")
plt.show()

# %% [markdown]
# These are eight of the 38 sets. The next figure shows all of them, as projections onto the coordinate planes. Later
# sets are darker, and the last one is blue.

# %%
fig, axes = plt.subplots(1, 3, figsize=(10, 3.6), layout="constrained")
plotting.plot_planes(axes, terminal.history, chosen=range(terminal.steps + 1), name=r"\overline{\mathcal{R}}")
plt.show()

# %% [markdown]
# The next figure shows each sequence in one picture: all sets $\mathcal{F}_k$, and some of the sets
# $\overline{\mathcal{R}}_k$ from step 12 on.

# %%
fig, (left, right) = plt.subplots(1, 2, figsize=(9.4, 4.8), layout="constrained", subplot_kw={"projection": "3d"})
plotting.draw_history(left, safe.history)
plotting.draw_history(right, terminal.history, [12, 14, 17, 20, 25, terminal.steps], r"\overline{\mathcal{R}}")
for ax in (left, right):
    ax.legend(loc="upper left", ncols=3, fontsize="small", frameon=False)
plt.show()

# %% [markdown]
# With the sliders you can step through every set of both sequences. From step 12 on, $\overline{\mathcal{R}}_k$ is
# drawn at a larger scale. The sliders need a running kernel; without one, use the panels above.


# %%
def draw_terminal_step(ax, k):
    """R_k-bar over its predecessors; later steps at a larger scale."""
    first = 0 if k < 12 else 12
    plotting.plot_step(ax, terminal.history[first:], k - first)
    ax.set_title(rf"$\overline{{\mathcal{{R}}}}_{{{k}}}$")


step_viewer(lambda ax, k: plotting.plot_step(ax, safe.history, k), len(safe.history), dimension=3)

# %%
step_viewer(draw_terminal_step, len(terminal.history), dimension=3)

# %% [markdown]
# ### Trajectories
#
# We test the sets by simulation: 2,000 random initial states in $\mathcal{F}_{\max}$, with a random vertex of
# $\mathcal{D}$ as the disturbance in every step.

# %% tags=["nbval-check-output"]
rng = np.random.default_rng(0)
steps = 80
starts = safe.set.sample(rng, 2000)
paths = loop.simulate(starts, steps, tanks.disturbance_bound * rng.choice([-1.0, 1.0], (len(starts), steps, 3)))
inside = terminal.set.contains(paths, tol=1e-9)  # (2000, 81)
print("all states in F_max:                          ", safe.set.contains(paths, tol=1e-9).all())
print(f"all in the terminal set from step {terminal.steps} on:      ", inside[:, terminal.steps :].all())
entered = steps + 1 - inside[:, ::-1].cumprod(axis=1).sum(axis=1)  # from this step on it stays inside
print(f"they enter it for good after {entered.min()} to {entered.max()} steps, {np.median(entered):.0f} is the median")

# %%
fig, (far, near) = plt.subplots(1, 2, figsize=(9.4, 4.8), layout="constrained", subplot_kw={"projection": "3d"})
some = loop.simulate(np.vstack([tanks.starts, safe.set.vertices()]), steps, rng)
plotting.draw_set(far, safe.set, **{**plotting.SAFE, "facecolor": "#009E7318"}, label=r"$\mathcal{F}_{\max}$")
plotting.draw_set(far, terminal.set, **plotting.TERMINAL, label=r"$\overline{\mathcal{R}}_{\min}$")
plotting.draw_trajectories(far, some, color=BLACK, linewidth=0.8, label="trajectories")
plotting.label_axes(far, safe.set, "from the vertices and three more states")
far.legend(loc="upper left", fontsize="small")
plotting.draw_set(near, terminal.set, **{**plotting.TERMINAL, "facecolor": "#0072B222"})
plotting.draw_trajectories(near, some[:, terminal.steps :], color=BLACK, linewidth=0.6)
plotting.label_axes(near, terminal.set, rf"the same from step {terminal.steps} on")
plt.show()

# %% [markdown]
# **What to see.** Left: all trajectories stay in the green set and end in the small blue one. Right, at a larger scale:
# the disturbance keeps the state moving inside the blue set, but never drives it out. The trajectories fill only a part
# of this set, for two reasons: random disturbances rarely add up to the worst case, and a set with only eight facets is
# an over-approximation.

# %% [markdown]
# ## 4. Projections and sections
#
# A two-dimensional picture shows a set of $\mathbb{R}^3$ either as a *projection*, which is the shadow of the set, or
# as a *section*, which is its intersection with a plane. Let $y$ denote the coordinates that are not drawn, here $x_3$.
# Then
#
# $$ \text{projection} = \{(x_1, x_2) : (x_1, x_2, y) \in \mathcal{R} \textbf{ for some } y\}, \qquad
#    \text{section at } y = \{(x_1, x_2) : (x_1, x_2, y) \in \mathcal{R}\}. $$
#
# The projection is the union of all sections. A state whose projection lies outside the projection of the set is
# outside the set. The converse is false. We count the states of our 2,000 trajectories that lie in each projection of
# the terminal set, and how many of them are not in the set.

# %% tags=["nbval-check-output"]
shadows = {
    f"x{a + 1}, x{b + 1}": terminal.set.project((a, b)).contains(paths[..., (a, b)], tol=1e-9)
    for a, b in ((0, 1), (0, 2), (1, 2))
}
shadows["all three"] = np.logical_and.reduce([*shadows.values()])
for name, seen in shadows.items():
    print(f"in {name:9}: {seen.sum()} states, of which {(seen & ~inside).sum():4} are not in the set")
early = entered - (steps + 1 - shadows["x1, x2"][:, ::-1].cumprod(axis=1).sum(axis=1))
print(f"a trajectory stays in the projection onto x1, x2 up to {early.max()} steps before it is in the set")

# %%
j = int(np.argmax(early))
k, end = int(entered[j] - early[j]), int(entered[j]) + 1
path, x = paths[j, :end], paths[j, k]  # x(k) is in the projection, not in the set
fig = plt.figure(figsize=(9.6, 4.8), layout="constrained")
ax, space = fig.add_subplot(1, 2, 1), fig.add_subplot(1, 2, 2, projection="3d")
shadow = terminal.set.project([0, 1])
plotting.draw_set(ax, shadow, **plotting.TERMINAL, label=r"projection of $\overline{\mathcal{R}}_{\min}$")
for at, line in ((-0.7, "-"), (0.0, "--"), (0.9, ":")):
    section = terminal.set.section([0, 1], at=[0, 0, at])
    plotting.draw_set(
        ax, section, facecolor="none", edgecolor=RED, linewidth=2, linestyle=line, label=f"section at $x_3 = {at}$"
    )
ax.plot(*path[:, :2].T, ".-", color=BLACK, linewidth=0.8, markersize=5)
ax.plot(*x[:2], "X", color=ORANGE, markeredgecolor=BLACK, markersize=12, label=f"$x({k})$, with $x_3 = {x[2]:.2f}$")
plotting.label_axes(ax, shadow.scale(1.6))
plotting.legend_above(ax, 2)
plotting.draw_set(space, terminal.set, **{**plotting.TERMINAL, "facecolor": "#0072B255"})
plotting.draw_trajectories(space, path[k:], color=BLACK, linewidth=0.8, marker=".")
space.plot(*np.column_stack([x, [*x[:2], 0]]), ":", color=BLACK)
space.plot(*x[:, None], "X", color=ORANGE, markeredgecolor=BLACK, markersize=10)
view = mr.Polytope.box([-1.6, -1.6, -1.2], [1.6, 1.6, max(x[2], 1.3)])
plotting.label_axes(space, view, f"the same trajectory from step {k} to {end - 1}")
plt.show()

# %% [markdown]
# **What to see.** Left: the section depends on $x_3$. For $x_3 = -0.7$ it is the upper right part of the projection,
# for $x_3 = 0.9$ the lower left part. The orange state lies inside the projection. Right: it lies far above the set.
# Its $x_3$ is larger than that of any state in the set, so the section at this $x_3$ is empty. (The dotted line leads
# straight down from the state to $x_3 = 0$.) The pumps change the outer levels directly, within a few steps. The middle
# level follows slowly, because only the flow through the pipes changes it. So a picture of $(x_1, x_2)$ shows the fast
# states and hides the slow one. All claims that this package proves are about the set itself, not about projections.

# %% [markdown]
# ## 5. Cells or the MILP?
#
# We compute one step from $\mathcal{X}$ along the $2 n$ box directions with three engines. Besides the two tank systems
# we use random loops. They have a ReLU network with two hidden layers and a saturation, and
# $\mathcal{X} = \{x : |x|_\infty \le 1\}$.


# %%
def random_loop(n, width, seed=0):
    """x+ = A x + B Phi(x) + d on |x|_inf <= 1: Phi has two layers of `width` ReLU neurons, and a saturation."""
    rng = np.random.default_rng(seed)
    hidden, size = [], n
    for _ in range(2):  # a ReLU neuron is a maxout neuron whose second channel is 0
        W, bias = rng.normal(size=(width, size)) / np.sqrt(size), 0.5 * rng.normal(size=width)
        hidden.append(mr.Layer(np.kron(W, [[1], [0]]), np.kron(bias, [1, 0]), 2))
        size = width
    net = mr.MaxoutNetwork(tuple(hidden), rng.normal(size=(1, size)) / np.sqrt(size), np.zeros(1)).saturate([-1], [1])
    A, B = rng.normal(size=(n, n)), 0.3 * rng.normal(size=(n, 1))
    A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
    X, U = mr.Polytope.box([-1] * n, [1] * n), mr.Polytope.box([-1], [1])
    mode = mr.Mode(A, B, np.zeros(n), X.product(U), mr.Polytope.box([-0.01] * n, [0.01] * n))
    return mr.ClosedLoop(mr.PWASystem((mode,), X, U), net)


four = mr.case_study("four_tanks")
loops = {"three tanks": loop, "four tanks": four.loop}
loops |= {f"n = {n}, ReLU 2 x {w}": random_loop(n, w) for n, w in ((3, 16), (4, 8), (4, 16), (4, 32))}
found = {}
print("times in seconds; the cells of the three tanks were computed above")
print(f"{'':20}{'cells':>8}{'build':>9}{'step':>9}{'MILP':>9}{'exact':>9}")
for name, each in loops.items():
    n, begin = each.system.state_size, perf_counter()
    count = len(dynamics(each, 500_000).cells)
    row, found[name] = [perf_counter() - begin], []
    for engine in (mr.Cells(), mr.Milp(), mr.Exact(most_cells=1000)):
        mr.support(each, each.system.state_set, [np.eye(n)[0]], engine=mr.Cells())  # so that the cells are there
        begin = perf_counter()
        try:
            found[name].append(mr.support(each, each.system.state_set, mr.box_directions(n), engine=engine).bound)
            row.append(perf_counter() - begin)
        except mr.CellLimitError:
            row.append(np.nan)
    print(f"{name:20}{count:8}" + "".join("        -" if np.isnan(t) else f"{t:9.3f}" for t in row))

# %% tags=["nbval-check-output"]
gaps = [np.abs(bounds[0] - other).max() for bounds in found.values() for other in bounds[1:]]
print(f"the engines agree to 1e-8 in all loops: {max(gaps) < 1e-8}")

# %% [markdown]
# **What to see.** *build* is the time to compute the cells, which is needed once per loop. *step* is the time of a
# query with these cells. An iteration queries the same loop many times, so it matters whether a query takes
# milliseconds or tenths of a second. The MILP does not enumerate the cells. For the largest network it takes about as
# long for one step as the cells take to build, so an iteration is much faster with the cells. For still larger
# networks the MILP is the better choice. *exact* is `mr.Exact`, which computes the same cells in rational arithmetic;
# here it was limited to 1000 cells.
#
# ### How the number of cells grows
#
# $N$ hyperplanes in general position divide $\mathbb{R}^n$ into $\sum_{i=0}^{n} \binom{N}{i}$ parts. For large $N$ this
# number grows like $N^n / n!$, so twice as many hyperplanes give about $2^n$ times as many parts. For a network the
# formula is only a guide: the kinks of a neuron in the second layer do not form one hyperplane, and not every
# hyperplane meets $\mathcal{X}$. So we count the cells of random loops, and take the median of three for each size:

# %%
WIDTHS = {2: (4, 8, 16, 32, 64), 3: (4, 8, 16, 32), 4: (4, 8, 16), 5: (4, 8, 12)}


def typical_count(n, width):
    """The median number of cells of three random loops."""
    return np.median([len(dynamics(random_loop(n, width, seed), 500_000).cells) for seed in (1, 2, 3)])


fig, ax = plt.subplots(figsize=(6.4, 4.0), layout="constrained")
for (n, widths), colour, marker in zip(WIDTHS.items(), (BLUE, ORANGE, GREEN, RED), "os^D"):
    neurons = 2 * np.array(widths)
    counts = [typical_count(n, width) for width in widths]
    parts = [sum(comb(int(N), i) for i in range(n + 1)) for N in neurons]
    ax.loglog(neurons, counts, "-", color=colour, marker=marker, label=f"$n = {n}$")
    ax.loglog(neurons, parts, ":", color=colour, linewidth=1)
ax.plot([], [], ":", color=GREY, linewidth=1, label="$N$ hyperplanes")
ax.set(xlabel="$N$, ReLU neurons (two layers)", ylabel="cells", xticks=[8, 16, 32, 64, 128])
ax.set_xticklabels(["8", "16", "32", "64", "128"])
ax.minorticks_off()
ax.legend(fontsize="small")
plt.show()

# %% [markdown]
# **What to see.** The dotted lines show the number of parts for $N$ hyperplanes in general position. The counts of the
# networks lie below them, but they also tend to grow faster for larger $n$. Networks of the same size differ much, and
# three are few: for $N = 8$ the median for $n = 4$ is even smaller than that for $n = 3$.
#
# `benchmarks/space.py` measured larger random loops, with two modes: two layers of 32 neurons give 18,929 cells for
# $n = 3$ (0.8 s) and 133,503 for $n = 4$ (6 to 8 s), two layers of 16 give 111,900 for $n = 5$ (5 to 7 s), and two
# layers of 12 give 41,266 for $n = 6$ (3 to 4 s). A cell has about $2^n$ vertices on average, so the memory per cell
# also grows with $n$.
#
# Without `engine=...`, `mireach` chooses the engine. For more than two states it uses the cells if there are at most
# 200,000 of them. It uses the MILP if there are more, if $n > 6$, or if you ask for $\mathcal{R}_k$ with $k > 1$. If
# you select the cells and there are more than their limit, the search stops with an error:

# %% tags=["nbval-check-output"]
try:
    mr.support(loops["n = 4, ReLU 2 x 16"], random_loop(4, 16).system.state_set, np.eye(4), engine=mr.Cells(limit=1000))
except mr.CellLimitError as error:
    print(error)

# %% [markdown]
# ### What makes the MILP fast
#
# Lemma 2 as printed in the paper has a binary for every channel and every mode. `mr.Milp("paper")` is this model, with
# one big-M per layer and one for the plant, from interval arithmetic. "whole" is also a single model. It has a separate
# big-M for each row, computed by LPs, and it omits channels that never attain the maximum and modes that are never
# active. "split", the default, is a branch and bound that halves boxes of the state space until few binaries are left.
# Affine bounds on the loop settle most boxes without any solver.

# %%
bounds = {}
for formulation in ("paper", "whole", "split"):
    begin = perf_counter()
    bounds[formulation] = mr.support(loop, safe.set, tanks.directions[:2], engine=mr.Milp(formulation)).bound
    print(f"{formulation:6s} {perf_counter() - begin:6.2f} s")

# %% tags=["nbval-check-output"]
print(f"agree to 1e-6: {all(np.abs(bound - bounds['split']).max() < 1e-6 for bound in bounds.values())}")

# %% [markdown]
# ## 6. Which template?
#
# Three templates work in any dimension: `mr.box_directions(n)` with $2 n$ rows, `mr.octahedral_directions(n)` with the
# box and all diagonals of two coordinates, $2 n^2$ rows, and `mr.directions(count, n)`, whose rows are spread evenly.
# The larger $n$ is, the more rows are needed to cover all directions. In the plane, eight evenly spread rows leave an
# angle of at most 22.5 degrees between any direction and the nearest row. In $\mathbb{R}^3$, fourteen rows of
# `mr.directions` leave up to 36.5 degrees, and in $\mathbb{R}^6$, seventy-two rows leave up to 49. Instead, you can add
# a row that the physics suggests. We try all of this on the three tanks, with the disturbance of the case study and a
# larger one:

# %% tags=["nbval-check-output"]
BOX = mr.box_directions(3)
templates = {
    "box": BOX,
    "box and (1, 1, 2)": np.vstack([BOX, [[1, 1, 2]]]),
    "box and -(1, 1, 2)": np.vstack([BOX, [[-1, -1, -2]]]),
    "box and +-(1, 1, 2)": tanks.safe_directions,
    "directions(5, 3)": mr.directions(5, 3),
    "directions(14, 3)": mr.directions(14, 3),
    "octahedral": mr.octahedral_directions(3),
}
rough = loop.with_disturbance(mr.Polytope.box([-0.5] * 3, [0.5] * 3))
print(f"{'':20} rows  |d| <= 0.2      |d| <= 0.5")
for name, C in templates.items():
    tries = [mr.safe_set(each, C, max_iterations=300) for each in (loop, rough)]
    words = [f"{'F_max' if t.set else 'none '}, k = {t.iterations:<3}" for t in tries]
    print(f"{name:20}{len(C):5}  " + "  ".join(words))

# %%
failed = mr.safe_set(rough, BOX, max_iterations=300)
print(f"{failed.verdict}: {failed.reason}")
top = mr.support(rough, failed.history[-1], [[1, 0, 0]]).witness[0]  # the step that leads to the largest x1
print("the step to the largest x1:", top)
low = -mr.safe_set(rough, templates["box and -(1, 1, 2)"]).set.support([[-1, -1, -2]])[0]
print(f"x1 + x2 + 2 x3 = {top.states[0] @ [1, 1, 2]:.1f} before this step")
print(f"in the F_max of box and -(1, 1, 2), x1 + x2 + 2 x3 >= {low:.1f}")

# %% [markdown]
# **What to see.** For $|d|_\infty \le 0.5$ the box finds no safe set. *refuted* means that this sequence ended without
# an RPI set. It does not mean that the loop has none: with the row $-(1, 1, 2)$ added, the iteration finds one. The
# last box contains states where all levels are high, and from there $x_3$ exceeds its limit. Why does the box not
# shrink any further? Its upper limit of $x_1$ is attained from a state with much water in tank 1 and little in the
# other two. In this state the network still pumps into tank 1. The row $-(1, 1, 2)$ bounds $x_1 + x_2 + 2 x_3$ from
# below, i.e. the water in all tanks, with the middle tank counted twice. This excludes the state. The opposite row,
# $(1, 1, 2)$, does not help for this disturbance. The number of rows is not decisive: five evenly spread rows suffice,
# one fewer than the box has.
#
# The template also decides how large the terminal set is:

# %% tags=["nbval-check-output"]
for name in ("box", "box and +-(1, 1, 2)", "octahedral"):
    C = templates[name]
    start = mr.safe_set(loop, C)
    end = mr.terminal_set(loop, start, C)
    print(
        f"{name:20} F_max {start.set.volume():5.0f} cm^3, "
        f"terminal set {end.set.volume():8.2f} cm^3 after {end.steps} steps"
    )

# %% [markdown]
# **What to see.** The box gives the largest of these $\mathcal{F}_{\max}$, because a set with fewer facets encloses the
# image less tightly. But its terminal set is three hundred times as large as with two more rows. None of these
# templates is best for both sets, and you may choose a different one for each.

# %% [markdown]
# ## 7. Four tanks
#
# The quadruple-tank process has four states, two inputs and one mode. The states are the levels of two lower tanks
# ($x_1$, $x_2$) and of two upper tanks ($x_3$, $x_4$), which drain into the lower ones. Each pump feeds one lower tank
# and the upper tank on the opposite side. The limits are $|x| \le (5, 5, 1.5, 1.2)$ cm componentwise, $|u|_\infty \le
# 1$ V and $|d|_\infty \le 0.05$ cm. The plant is linear. The loop is piecewise affine because of the network, and has
# 40 cells.

# %% tags=["nbval-check-output"]
sets = load_sets("four_tanks")  # shipped with the package
four_safe = mr.safe_set(four.loop, four.safe_directions)
print(f"{four_safe.verdict} after {four_safe.iterations} iterations: {four_safe.reason}")
print(f"{len(sets) - 1} steps; terminal set {mr.check_rpi(four.loop, sets[-1]).verdict}")
print("slowest eigenvalue near the origin:", end=" ")
four_cells = dynamics(four.loop, 500_000)
home = next(j for j in range(len(four_cells.cells)) if four_cells.cells.complex.polytope(j).contains(np.zeros(4)))
print(np.abs(np.linalg.eigvals(four_cells.M[home])).max().round(3))

# %%
fig, axes = plt.subplots(2, 3, figsize=(9.6, 6.4), layout="constrained")
path = four.loop.simulate(four.starts[0], 60, np.random.default_rng(0))
plotting.plot_planes(axes, sets, name=r"\overline{\mathcal{R}}", paths=path)
fig.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=7, frameon=False)
plt.show()

# %% [markdown]
# **What to see.** A set of $\mathbb{R}^4$ has six projections onto two coordinates. They are rectangles because the
# template is the box. The sets shrink slowly. The next figure shows how far the upper limit of each coordinate is from
# its final value.

# %%
size = np.array([R.support(four.directions) for R in sets])
fig, ax = plt.subplots(figsize=(6.4, 3.4), layout="constrained")
for row, (line, colour) in enumerate((("-", BLUE), ("--", RED), ("-.", GREEN), (":", BLACK))):
    ax.semilogy(size[:-1, row] - size[-1, row], linestyle=line, color=colour, label=f"$x_{row + 1}$")
ax.set(xlabel="$k$", ylabel="distance from the last offset (cm)")
ax.legend(title="along")
plt.show()

# %% [markdown]
# **What to see.** After about twenty steps, all four distances decrease at the same rate, by a factor of 0.935 per
# step. This is close to the slowest eigenvalue, 0.928. It is slightly slower because the boxes over-approximate every
# step. The curves bend down at the end because the last set is not quite the limit.
#
# ## 8. A certificate in space
#
# The certificates of notebook 10 work for any number of states. The checker needs Python's standard library only. It
# computes the cells of the three tanks in whole numbers, and then decides every claim at their vertices. Brackets state
# how each claim was proven and how much was looked at: 237 cells meet $\mathcal{F}_{\max}$.

# %% tags=["nbval-check-output"]
genuine = data_file("three_tanks", "certificate.json")
print(mr.certificate.verify(genuine))

# %% [markdown]
# **A forged certificate.** A forger moves the facet $x_3 \le 10$ of $\mathcal{F}_{\max}$ to $x_3 \le 8.5$. The sets
# look plausible, and a new digest is soon computed (`ignore_digest` stands for that). The checker finds a state of the
# forged set whose successor lies outside. It returns the step in fractions, so that anybody can replay it.

# %% tags=["nbval-check-output"]
forged = json.loads(genuine.read_text())
top = forged["template"].index([0.0, 0.0, 1.0])
print(f"x3 <= {forged['sets'][0][top]:g} becomes x3 <= 8.5")
forged["sets"][0][top] = 8.5
folder = Path(tempfile.mkdtemp())
(folder / "forged.json").write_text(json.dumps(forged))
report = mr.certificate.verify(folder / "forged.json", ignore_digest=True)
print(report["safe_set"])
step = report["safe_set"].witness
x, d, after = (np.array([float(Fraction(part)) for part in step[key]]) for key in ("state", "disturbance", "after"))
print(f"\nreplayed: {x} -> {loop.step(x, d).round(6)}")

# %%
fig, ax = plt.subplots(figsize=(5.2, 3.2), layout="constrained")
false_set = mr.Polytope(forged["template"], forged["sets"][0])
plotting.draw_set(
    ax, false_set.project([0, 2]), edgecolor=GREEN, facecolor="none", label=r"forged $\mathcal{F}_{\max}$"
)
ax.plot(x[0], x[2], "o", color=RED, markersize=4)
ax.annotate("", after[[0, 2]], x[[0, 2]], arrowprops={"arrowstyle": "->", "color": RED})
ax.plot([], [], color=RED, marker="o", markersize=4, label="a step out of it")
ax.set(xlim=(3.5, 5.6), ylim=(8, 8.9), xlabel="$x_1$ (cm)", ylabel="$x_3$ (cm)")
ax.legend(frameon=False)
plt.show()

# %% [markdown]
# **What to see.** A corner of the forged set, projected onto $(x_1, x_3)$. The step starts beside the corner and ends
# above the facet that the forger moved.
#
# **A proof without cells.** A network with many neurons and six states has too many cells. Its certificate then holds a
# *proof by cases*. It is the tree of a branch and bound for each facet: in each case the winning channels of some
# neurons are fixed, the others are relaxed as in a MILP, and a linear program bounds the image. By weak duality any
# non-negative multipliers of its rows give an upper bound. The file has these multipliers as short whole numbers. The
# checker derives the rows itself and only adds up; it does not solve a linear program. `proof="cases"` asks for it:

# %%
four_terminal = mr.terminal_set(four.loop, four_safe, four.directions, four.epsilon)
made = mr.certificate.write(folder / "four.json", four.loop, four_safe, four_terminal, proof="cases")
print(made.report)
for node in made.content["cases"]["images"][0]["rows"][0][:3]:
    print(node)

# %% [markdown]
# The last lines are the first nodes of the tree for the first facet of $\mathcal{F}_{\max}$. A node with two entries
# (layer, neuron) splits a case by the channels of this neuron. In any other node, the first entry multiplies the row of
# the image, and pairs of a limit's number and its multiplier follow. If you change a multiplier and the sum no longer
# proves the row, the checker says *not checked*. No change of a proof can make a false claim *proven*. The shipped
# certificate of the `quadrotor`, with six states, is of this kind: 4,750 cases, checked in about ten seconds.
#
# **The verdicts of the package.** Each result states in `settled` what its verdict rests on: *exact arithmetic*,
# *rounding counted* (the bounds include every rounding error), or only the word of a solver. `mr.Exact` does not round
# at all.

# %% tags=["nbval-check-output"]
for name, each, R in (("three tanks", loop, terminal.set), ("four tanks", four.loop, sets[-1])):
    for engine in ("cells", "milp", "exact"):
        check = mr.check_rpi(each, R, engine=engine)
        print(f"{name:>11}, {engine:>5}: {check.verdict}; {check.settled}")

# %% [markdown]
# **The cost of exact steps.** $\mathcal{R}_k$ without a template between the steps needs $k$ times as many binaries
# (Lemma 2). For the four tanks the time grows slowly, because the terminal set lies in a single cell. For the three
# tanks it grows quickly, because all four modes meet in the terminal set, which meets 40 cells. The table has two
# steps; `benchmarks/README.md` has five.

# %%
print("k     three tanks      four tanks")
for k in (1, 2):
    seconds = []
    for case, R in ((tanks, terminal.set), (four, sets[-1])):
        begin = perf_counter()
        mr.support(case.loop, R, np.eye(case.system.state_size)[:1], steps=k, engine=mr.Milp("whole"))
        seconds.append(perf_counter() - begin)
    print(f"{k} {seconds[0]:12.2f} s {seconds[1]:12.2f} s")

# %% [markdown]
# ## What you saw
#
# - For $n > 2$ the same calls give the same guarantees. A cell is a polytope of $\mathbb{R}^n$, and the support
#   function of a one-step set is a maximum over vertices.
# - A projection contains all sections. A state that lies in all projections need not lie in the set.
# - The number of cells grows roughly like the $n$-th power of the number of neurons. Use the cells if one loop is
#   queried many times, and the MILP if there are too many cells.
# - *No safe set found* is a statement about the template. One row in the right direction can be enough.
# - A certificate is proven in whole numbers, by cells or by cases, for any number of states. A forged one is refused,
#   with a step that leaves the set.
#
# ## On your own
#
# - Exercise 14: projections, the pieces of a network, one step computed from vertices, and a template of your own.
# - Draw the sections of the cells at $x_3 = -8$ and $x_3 = 8$. How many cells do they meet? Where is pump 1 off?
# - What is the largest disturbance of the three tanks for which `tanks.safe_directions` finds a safe set? Use
#   `loop.with_disturbance(...)` and bisection. Does `mr.octahedral_directions(3)` find one for a larger disturbance?
# - Compute the cells of `random_loop(6, 8)`. How many vertices does a cell have on average? Compare with $2^6$.
# - Forge the certificate of the four tanks: change a weight of the network, a set, a multiplier. Which changes does the
#   checker accept, and why is it right each time?
#
# ## Further reading
#
# - Johansson, *The quadruple-tank process*, IEEE Transactions on Control Systems Technology 8(3), 2000.
# - Bemporad, Morari, *Control of systems integrating logic, dynamics, and constraints*, Automatica 35, 1999.
# - Montúfar, Pascanu, Cho, Bengio, *On the number of linear regions of deep neural networks*, NeurIPS 2014.
# - `mireach.systems.plants` states which parameters of the two plants come from the literature, and which are our
#   choice.
#
# This is the last notebook. To return to the paper's claims, run `python3 run.py reproduce`.
