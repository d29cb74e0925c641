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
# # Write a piecewise-affine system as mixed-integer constraints
#
# **What you will do.** Look at the four-mode system of the first case study: its regions, their images under each mode,
# and the jumps at their boundaries. Then write "choose the right mode and apply it" as linear constraints with binary
# variables in cvxpy. A solver then finds the largest and the smallest value of each component of the next state over a
# whole set.
#
# **What you will learn.** The meaning of eq. (10), gammaForR, and eq. (12), MISys, line by line. Why the model must
# include both modes at a boundary. How the big-$M$ follows from the sets. How regions may also depend on the input.
#
# **What you need.** Notebooks 01 and 02.
#
# *Run all* takes about 15 seconds.

# %%
import cvxpy as cp
import matplotlib.pyplot as plt
import numpy as np

import mireach as mr
from mireach.plotting import BLACK, BLUE, GREEN, GREY, ORANGE, RED, draw_regions, draw_set, label_axes
from mireach.systems.plants import pwa_plant

# %% [markdown]
# ## 1. The system
#
# Without disturbance (notebook 04 adds it), **eq. (1), SysWithDis**, reads
#
# $$ x(k+1) = f_{\text{PWA}}(x(k), u(k)) = A^{(i)} x(k) + B^{(i)} u(k) + p^{(i)}
#    \quad \text{if } \begin{pmatrix} x(k) \\ u(k) \end{pmatrix} \in \mathcal{P}^{(i)}, $$
#
# and **eq. (2), HRep**, describes each region as $\mathcal{P}^{(i)} = \{\xi : H^{(i)} \xi \le h^{(i)}\}$ with
# $\xi = (x, u)$. The first case study has $s = 4$ modes, one for each quadrant of the plane. All of them have
# $B = (1, 0)^\top$ and $p = 0$, and the constraints are $|x|_\infty \le 10$ and $|u| \le 1$.

# %% tags=["nbval-check-output"]
plant = pwa_plant(disturbance_bound=0.0)
for i, mode in enumerate(plant.modes, start=1):
    print(
        f"mode {i}: A = {mode.A.tolist()}, H = {(mode.region.H.astype(int) + 0).tolist()}, h = {mode.region.h.tolist()}"
    )

# %% [markdown]
# The third column of each $H^{(i)}$ belongs to $u$ and is zero, so these regions depend on $x$ only. The next figure
# shows the regions, and the image of each region under its own mode for $u = 0$.

# %%
STYLES = [  # one per mode
    {"facecolor": f"{colour}44", "edgecolor": colour, "hatch": hatch, "linewidth": 1.5}
    for colour, hatch in ((BLUE, "//"), (ORANGE, "\\\\"), (GREEN, ".."), (RED, "xx"))
]


def region_of_x(mode):
    """The part of X in which a mode acts, if its region does not depend on u."""
    return mr.Polytope(mode.region.H[:, :2], mode.region.h) & plant.state_set


def image(mode, P, u=0.0):
    """{A x + B u + p : x in P}, the convex hull of the images of the vertices."""
    return mr.Polytope.from_points(mode.successor(P.vertices(), np.full((len(P.vertices()), 1), u)))


fig, (before, after) = plt.subplots(1, 2, figsize=(8, 4.4), layout="constrained")
for i, (mode, style) in enumerate(zip(plant.modes, STYLES), start=1):
    draw_set(before, region_of_x(mode), **style)
    before.text(*region_of_x(mode).vertices().mean(axis=0), str(i), fontsize=16, ha="center", backgroundcolor="white")
    draw_set(after, image(mode, region_of_x(mode)), **style, label=f"mode {i}")
label_axes(before, plant.state_set, r"regions $\mathcal{P}^{(i)}$ ($x$ part)")
label_axes(after, mr.Polytope.box([-11, -12], [11, 10]), r"their images $A^{(i)} x$")
after.set(xlabel="$x_1^+$", ylabel="$x_2^+$")
fig.legend(loc="outside lower center", ncols=4, frameon=False)
plt.show()

# %% [markdown]
# The regions cover $\mathcal{X}$ without gaps. The images overlap, leave gaps, and partly lie outside $\mathcal{X}$
# (mode 3 gives $x_2^+ < -10$ at some states).
#
# ## 2. Jumps at the boundaries
#
# Neighbouring regions share a boundary. For example, $(4, 0)$ lies in region 1 and in region 2, because regions are
# closed. The two modes need not give the same successor there, and in this system they do not. We compute the
# difference of the two successors at a distance of 1 from the origin, for $u = 0$.

# %% tags=["nbval-check-output"]
half_axes = {(1, 0): (1, 2), (0, 1): (1, 4), (-1, 0): (3, 4), (0, -1): (2, 3)}  # and the modes that meet there
for e, (i, j) in half_axes.items():
    jump = (plant.modes[i - 1].A - plant.modes[j - 1].A) @ e
    print(f"along {e!s:>7}: mode {i} minus mode {j} = {jump.round(3).tolist()}")

# %%
fig, (before, after) = plt.subplots(1, 2, figsize=(8, 4.0), layout="constrained")
draw_regions(before, plant)
for (e, (i, j)), colour, mark in zip(half_axes.items(), (BLUE, ORANGE, GREEN, RED), "os^D"):
    points = np.outer(np.arange(1, 11), e)
    both = [points @ plant.modes[number - 1].A.T for number in (i, j)]
    before.plot(*points.T, mark, color=colour, label=f"modes {i} and {j}")
    after.plot(*np.stack(both, axis=1).transpose(2, 1, 0), ":", color=colour, linewidth=1)
    after.plot(*both[0].T, mark, color=colour)
    after.plot(*both[1].T, mark, color=colour, markerfacecolor="white")
label_axes(before, plant.state_set, "points on the boundaries")
label_axes(after, plant.state_set, "both successors ($u = 0$)")
after.set(xlabel="$x_1^+$", ylabel="$x_2^+$")
fig.legend(loc="outside lower center", ncols=4, frameon=False)
plt.show()

# %% [markdown]
# Each boundary point has two successors, joined by a dotted line. A filled marker is the successor under the mode that
# is named first, an open marker the one under the other mode. (The filled circles, mode 1 on the positive $x_1$ axis,
# lie close together just below the origin.) All modes map the origin to itself for $u = 0$, so there is no jump there.
# The jump grows with the distance from the origin.
#
# Which of the two is the right successor? The equation does not determine it. A measured or computed state is never
# known to lie exactly on a boundary: rounding or an arbitrarily small disturbance may move it to either side. A proof
# about the system must therefore include **both** successors. If a proof includes only one of them, the system may
# still leave the set.
#
# ## 3. Choose a region: eq. (10), gammaForR
#
# There is one binary $\gamma_i$ per mode. **Eq. (10), gammaForR**, for all $i$:
#
# $$ H^{(i)} \begin{pmatrix} x(k) \\ u(k) \end{pmatrix} \le h^{(i)} + \mathbf{1} M (1 - \gamma_i(k)), \qquad
#    \mathbf{1}^\top \gamma(k) = 1, \quad \gamma(k) \in \{0, 1\}^s . $$
#
# $\gamma_i = 1$ enforces $(x, u) \in \mathcal{P}^{(i)}$. $\gamma_i = 0$ must not restrict $(x, u)$ within
# $\mathcal{X} \times \mathcal{U}$. Therefore, as in [Bemporad1999], $M$ is the largest difference between the left-hand
# side and the right-hand side of the row. This is a support function:
#
# $$ M = h_{\mathcal{X} \times \mathcal{U}}(H^{(i)}_r) - h^{(i)}_r \quad \text{for row } r . $$

# %%
XU = plant.state_set.product(plant.input_set)


def choose_region(xi, system, XU):
    """gamma, one binary per mode, and constraints: xi = (x, u) lies in the chosen region (eq. (10), gammaForR)."""
    gamma = cp.Variable(len(system.modes), boolean=True)
    constraints = [cp.sum(gamma) == 1]
    for on, mode in zip(gamma, system.modes):
        H, h = mode.region.H, mode.region.h
        M = np.maximum(XU.support(H) - h, 0)  # one number per row
        constraints.append(H @ xi <= h + cp.multiply(M, 1 - on))
    return gamma, constraints


# %% [markdown]
# Which modes are feasible at a given point? We fix $\xi$ and try each of them.

# %% tags=["nbval-check-output"]
xi, xi_fixed, which = cp.Variable(3), cp.Parameter(3), cp.Parameter(4)
gamma, rows = choose_region(xi, plant, XU)
trial = cp.Problem(cp.Minimize(0), [*rows, xi == xi_fixed, gamma == which])


def modes_at(point):
    """The modes, counted from 1, whose gamma_i = 1 is feasible at a point (x, u)."""
    xi_fixed.value, found = np.array(point), []
    for i in range(4):
        which.value = np.eye(4)[i]
        trial.solve(solver="HIGHS")
        found += [i + 1] if trial.status == cp.OPTIMAL else []
    return found


for point in ([3, 2, 0.5], [-3, 2, 0.5], [4, 0, 0.5], [0, -5, 0.5], [0, 0, 0.5]):
    print(f"x = {point[:2]!s:>7}, u = {point[2]}: modes {modes_at(point)}")

# %% [markdown]
# Inside a region one mode is feasible, on a boundary two, and at the origin four. The constraints do not choose between
# them. The paper states this as $\gamma_i = 1 \Leftrightarrow (x, u) \in \mathcal{P}^{(i)}$ (eq. (11), GammaXinP). Only
# one $\gamma_i$ can be 1 at a time, so the statement means: $\gamma_i = 1$ is *feasible* if and only if
# $(x, u) \in \mathcal{P}^{(i)}$.
#
# ## 4. Apply its dynamics: eq. (12), MISys
#
# Each mode has a copy $\tilde{x}^{(i)}(k+1)$ of the next state. The copy equals the successor if $\gamma_i = 1$, and
# zero otherwise. The next state is the sum of the copies. **Eq. (12), MISys**, for all $i$:
#
# $$ \begin{aligned}
# -\mathbf{1} M (1 - \gamma_i(k)) \le A^{(i)} x(k) + B^{(i)} u(k) + p^{(i)} - \tilde{x}^{(i)}(k+1)
#     &\le \mathbf{1} M (1 - \gamma_i(k)), && \text{(12a, MI\_PWA\_ABp)} \\
# -\mathbf{1} M \gamma_i(k) \le \tilde{x}^{(i)}(k+1) &\le \mathbf{1} M \gamma_i(k), && \text{(12b, MI\_PWA\_xTilde)} \\
# x(k+1) &= \textstyle\sum_{j=1}^{s} \tilde{x}^{(j)}(k+1). && \text{(12c, MI\_PWA\_sumXTilde)}
# \end{aligned} $$
#
# For an inactive mode $\tilde{x}^{(i)} = 0$, and the first line must not restrict $(x, u)$. So $M$ must be at least
# $|A^{(i)} x + B^{(i)} u + p^{(i)}|$ over $\mathcal{X} \times \mathcal{U}$, for each component. This $M$ also suffices
# for the active mode.


# %%
def pwa_step(x, u, system, XU):
    """x(k+1) = f_PWA(x, u) as a cvxpy expression, gamma, and the constraints of eqs. (10), gammaForR; (12), MISys."""
    xi = cp.hstack([x, u])
    gamma, constraints = choose_region(xi, system, XU)
    parts = []
    for on, mode in zip(gamma, system.modes):
        part, AB = cp.Variable(system.state_size), np.hstack([mode.A, mode.B])  # the paper's x~, and (A B)
        M = np.maximum(XU.support(AB) + mode.p, XU.support(-AB) - mode.p)  # |A x + B u + p| <= M
        rest = AB @ xi + mode.p - part
        constraints += [
            -M * (1 - on) <= rest, rest <= M * (1 - on),  # eq. (12a), MI_PWA_ABp
            -M * on <= part, part <= M * on,  # eq. (12b), MI_PWA_xTilde
        ]  # fmt: skip
        parts.append(part)
    return sum(parts), gamma, constraints  # eq. (12c), MI_PWA_sumXTilde


def extremes(system, XU, V, *more):
    """max v x(k+1) for each row v of V, over all (x, u) that satisfy the constraints more(x, u)."""
    x, u = cp.Variable(system.state_size), cp.Variable(system.input_size)
    after, _, constraints = pwa_step(x, u, system, XU)
    v = cp.Parameter(system.state_size)
    problem = cp.Problem(cp.Maximize(v @ after), constraints + [row for add in more for row in add(x, u)])
    values = []
    for v.value in np.asarray(V, float):
        values.append(problem.solve(solver="HIGHS"))
    return np.array(values)


# %% [markdown]
# ### At a boundary point the model finds both values
#
# We fix $x = (4, 0)$ and $u = 0.5$, and compute the largest and the smallest $x_1^+$, and the same for $x_2^+$.

# %% tags=["nbval-check-output"]
x0, u0 = np.array([4.0, 0.0]), np.array([0.5])
both = np.array([plant.modes[i].successor(x0, u0) for i in (0, 1)])
print("mode 1:", both[0].round(4), "  mode 2:", both[1].round(4))
top = extremes(plant, XU, np.eye(2), lambda x, u: [x == x0, u == u0])
bottom = -extremes(plant, XU, -np.eye(2), lambda x, u: [x == x0, u == u0])
for i in (0, 1):
    print(f"MILP:  x{i + 1}+ from {bottom[i]:.4f} to {top[i]:.4f}")

# %% [markdown]
# The model finds both. Are the values *between* them also feasible? They must not be, because the reachable set of this
# point consists of two points and is not a segment.

# %% tags=["nbval-check-output"]
x, u = cp.Variable(2), cp.Variable(1)
after_x, _, constraints = pwa_step(x, u, plant, XU)
for name, target in (("mode 1's", both[0]), ("half way", both.mean(axis=0)), ("mode 2's", both[1])):
    row = cp.abs(after_x - target) <= 1e-6
    problem = cp.Problem(cp.Minimize(0), [*constraints, x == x0, u == u0, row])
    problem.solve(solver="HIGHS")
    print(f"{name} successor: {problem.status}")

# %% [markdown]
# All engines of this package give the same result. In the next cell the controller always gives $u = 0.5$ (a network
# without hidden layers), and $\mathcal{F}$ is a single point. The method `step` simulates the loop and must choose one
# value. It uses the first mode whose region contains the point.

# %% tags=["nbval-check-output"]
loop = mr.ClosedLoop(plant, mr.MaxoutNetwork([], np.zeros((1, 2)), u0))
point = mr.Polytope.box(x0, x0)
for engine in ("cells", "milp", "cvxpy"):
    answer = mr.support(loop, point, mr.box_directions(2), engine=engine).bound
    print(f"{engine:>5}: x1+ from {-answer[2]:.4f} to {answer[0]:.4f}, x2+ from {-answer[3]:.4f} to {answer[1]:.4f}")
print("step:", loop.step(x0).round(4))

# %% [markdown]
# ### Over a set
#
# With $x \in \mathcal{F}$ instead of $x = x_0$, the MILP gives the support function of the set of all successors. Take
# $\mathcal{F} = [3, 5] \times [-1, 1]$, which contains part of the boundary between the modes 1 and 2, and all
# $u \in \mathcal{U}$. We compute it in the paper's 8 directions and draw the resulting template set.

# %% tags=["nbval-check-output"]
F, C = mr.Polytope.box([3, -1], [5, 1]), mr.directions(8)
h = extremes(plant, XU, C, lambda x, u: [F.H @ x <= F.h, plant.input_set.H @ u <= plant.input_set.h])
print("h of the successors along C:", h.round(3) + 0.0)

# %%
fig, ax = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
draw_regions(ax, plant)
draw_set(ax, F, facecolor="none", edgecolor=BLACK, linewidth=1.5, linestyle="--", label=r"$\mathcal{F}$")
for i in (0, 1):
    part = F & region_of_x(plant.modes[i])
    corners = np.vstack([image(plant.modes[i], part, u).vertices() for u in (-1, 1)])
    draw_set(ax, mr.Polytope.from_points(corners), **STYLES[i], label=f"successors by mode {i + 1}")
draw_set(ax, mr.Polytope(C, h), facecolor="none", edgecolor=BLACK, linewidth=1.8, label="template set, 8 directions")
label_axes(ax, mr.Polytope.box([-2.5, -3], [7.5, 6]))
ax.legend(loc="upper left", bbox_to_anchor=(1.01, 1), frameon=False)
plt.show()

# %% [markdown]
# The successors of $\mathcal{F}$ form two disjoint pieces, because the map jumps across the boundary. The template set
# from the eight values of the MILP touches the pieces from outside in each direction. It is convex, so it also covers
# the gap between them. This is a disadvantage of convex sets; notebook 10 shows how large the effect is.
#
# ## 5. The big-$M$ again
#
# In [Bemporad1999] the value of $M$ is computed, not guessed. Here it is 10 for every row of eq. (10), gammaForR. For
# eq. (12), MISys, it is:

# %% tags=["nbval-check-output"]
for i, mode in enumerate(plant.modes, start=1):
    AB = np.hstack([mode.A, mode.B])
    print(f"mode {i}: M of the region's rows {XU.support(mode.region.H)}, of the next state {XU.support(AB).round(3)}")

# %% [markdown]
# (All sets are symmetric about the origin here, so $M$ is needed for one sign only.) What happens with a smaller $M$ in
# eq. (10), gammaForR? A state in region 1 must also satisfy the *relaxed* rows of the three other regions: $x_1 \le M$,
# $x_2 \le M$. With $M = 5$ only the states with $|x|_\infty \le 5$ remain. This is a quarter of the area of
# $\mathcal{X}$. The largest $x_1^+$ is then too small, again without a warning:


# %% tags=["nbval-check-output"]
def largest_next(M):
    """max x1+ over X x U when every row of eq. (10), gammaForR, has the same M."""
    x, u = cp.Variable(2), cp.Variable(1)
    after, gamma, constraints = pwa_step(x, u, plant, XU)
    for on, mode in zip(gamma, plant.modes):
        constraints.append(mode.region.H @ cp.hstack([x, u]) <= mode.region.h + M * (1 - on))
    constraints += [plant.state_set.H @ x <= plant.state_set.h, plant.input_set.H @ u <= plant.input_set.h]
    return cp.Problem(cp.Maximize(after[0]), constraints).solve(solver="HIGHS")


for M in (20, 10, 8, 5, 1):
    print(f"M = {M:2d}: x1+ <= {largest_next(M):7.4f}")

# %% [markdown]
# ## 6. Regions that depend on the input
#
# The regions need not depend on $x$ alone: the rows $H^{(i)}$ act on $(x, u)$. As an example, consider a battery with
# charge $x \in [0, 1]$ and power $u \in [-0.3, 0.3]$. A tenth of the power is lost when charging and when discharging.
# If a step would raise the charge above 0.8, the charger halves its power:
#
# | mode | region | next charge |
# |---|---|---|
# | 1 discharge | $u \le 0$ | $x + u / 0.9$ |
# | 2 charge | $u \ge 0,\ x + 0.9 u \le 0.8$ | $x + 0.9 u$ |
# | 3 throttled | $u \ge 0,\ x + 0.9 u \ge 0.8$ | $x + 0.45 u$ |

# %%
battery = mr.PWASystem(
    [
        mr.Mode([[1]], [[1 / 0.9]], [0], mr.Polytope([[0, 1]], [0])),
        mr.Mode([[1]], [[0.9]], [0], mr.Polytope([[0, -1], [1, 0.9]], [0, 0.8])),
        mr.Mode([[1]], [[0.45]], [0], mr.Polytope([[0, -1], [-1, -0.9]], [0, -0.8])),
    ],
    state_set=mr.Polytope.box([0], [1]),
    input_set=mr.Polytope.box([-0.3], [0.3]),
)
XU_battery = battery.state_set.product(battery.input_set)
controller = mr.MaxoutNetwork([], [[-2]], [1.8]).saturate(-0.3, 0.3)  # charge to 0.9

# %% [markdown]
# At a charge of 0.7, the active mode depends on the power. Under a controller $u = \Phi(x)$ the system moves along a
# curve in the plane of $x$ and $u$. The mode changes where the curve crosses a boundary.

# %%
xs = np.linspace(0, 1, 201)[:, None]
u_of_x = controller(xs)
mode_of_x = battery.violation(xs, u_of_x).argmin(axis=1)
fig, (plane, after) = plt.subplots(1, 2, figsize=(8, 3.6), layout="constrained")
for i, (mode, style) in enumerate(zip(battery.modes, STYLES), start=1):
    draw_set(plane, mode.region & XU_battery, **style, label=f"mode {i}")
    on = mode_of_x == i - 1
    next_charge = mode.successor(xs[on], u_of_x[on])
    after.plot(xs[on], next_charge, ("-", "--", "-.")[i - 1], color=style["edgecolor"], linewidth=2)
plane.plot(xs, u_of_x, color=BLACK, linewidth=2.2, label=r"$u = \Phi(x)$")
after.plot([0, 1], [0, 1], color=GREY, linewidth=0.8)
plane.set(xlabel="$x$", ylabel="$u$", xlim=(0, 1), ylim=(-0.3, 0.34))
after.set(xlabel="$x$", ylabel="$x^+$", xlim=(0, 1), ylim=(0, 1), aspect="equal")
fig.legend(loc="outside lower center", ncols=4, frameon=False)
plt.show()

# %% [markdown]
# Left: the regions in the plane of charge and power, and the controller. Right: the next charge of the loop. Below the
# thin diagonal the charge falls. Where the controller's curve crosses from mode 2 to mode 3, the next charge jumps.
# Where it crosses from mode 3 to mode 1, at $u = 0$, both modes give the same next charge. The functions of parts 3 and
# 4 work for this system without changes, for any $u$:

# %% tags=["nbval-check-output"]
rng, worst = np.random.default_rng(0), 0.0
for x0, u0 in XU_battery.sample(rng, 20):
    true = x0 + (u0 / 0.9 if u0 <= 0 else 0.9 * u0 if x0 + 0.9 * u0 <= 0.8 else 0.45 * u0)
    found = extremes(battery, XU_battery, [[1], [-1]], lambda x, u, at=(x0, u0): [x == at[0], u == at[1]])
    worst = max(worst, np.abs(found * [1, -1] - true).max())
print("20 random points, largest error below 1e-6:", bool(worst < 1e-6))
loop = mr.ClosedLoop(battery, controller)
h = mr.support(loop, battery.state_set, [[1], [-1]]).bound
print(f"all charges of [0, 1] go to [{-h[1]:.4f}, {h[0]:.4f}] in one step")

# %% [markdown]
# ## What you saw
#
# - Eq. (10), gammaForR, chooses a region, and eq. (12), MISys, applies its dynamics. They need $s$ binaries per step,
#   and every $M$ is a support function over $\mathcal{X} \times \mathcal{U}$.
# - A piecewise-affine map may jump. On a boundary the model admits the successor of every mode whose region contains
#   the point, and no values between these successors. Every method that proves invariance must do the same.
# - A big-$M$ in eq. (10), gammaForR, that is too small removes states that are far from the *other* regions.
# - For regions in $(x, u)$ the constraints need no changes.
#
# ## On your own
#
# - Where does the largest $x_1^+$ of part 5 come from? Print the solver's $x$, $u$ and $\gamma$.
# - Make $M$ in eq. (12), MISys, too small instead. Which states are lost now?
# - Put `maxout_network` of notebook 02 between $x$ and $u$, with `mr.case_study("pwa").network`. This is Lemma 2
#   without disturbance. Compare with `mr.support`.
# - Change the third mode of the battery so that the map no longer jumps between modes 2 and 3. Is there an affine map
#   that agrees with both neighbouring modes on their boundaries?
#
# **Exercise:** `exercises/ex03`. **Next:** notebook 04 adds the disturbance and introduces reachable sets.
#
# ## Further reading
#
# - [Bemporad1999], Sec. 3.1: piecewise-affine systems as mixed logical dynamical systems, and the big-$M$.
# - [Teichrib2025], Sec. II.B.
# - [Mignone2000], Sec. 7: the source of the four modes.
# - T. Marcucci, R. Tedrake: *Mixed-integer formulations for optimal control of piecewise-affine systems*, HSCC 2019:
#   formulations that are tighter than big-$M$, and their cost.
