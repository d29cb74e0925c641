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
# # Replace a nonlinear plant by nine affine ones, and prove the error
#
# The notebooks so far use a piecewise-affine plant. The paper's second plant is not piecewise affine: it is a double
# integrator with a quadratic term. We fit a PWA system to it and treat the error of the fit as a disturbance. The
# analysis is then only as good as the bound on this error.
#
# **What you will do.** Fit nine affine maps, one per square of a chessboard. Look at the error over the whole state
# set. Prove a bound on it, first by hand with intervals, then with the library.
#
# **What you will learn.**
# - how least-squares and minimax fits differ, and where the paper's 0.1186 comes from;
# - why the largest error on a grid proves nothing, and how to prove a bound;
# - that the shape of the error set (box or segment) matters for the safe set;
# - what more regions gain, and what they cost.
#
# **What you need.** Notebooks 03 and 04; from 06 the terms *safe set* and *terminal set*. "Run all" takes about 20
# seconds.

# %%
from itertools import pairwise

import matplotlib.pyplot as plt
import numpy as np

import mireach as mr
from mireach import plotting
from mireach.studies.case_studies import double_integrator_fit

case = mr.case_study("double_integrator")
plant, X, U = case.plant, case.system.state_set, case.system.input_set
print(case)

# %% [markdown]
# ## 1. The plant
#
# $$f(x, u) = \begin{pmatrix} 1 & 1 \\ 0 & 1 \end{pmatrix} x + \begin{pmatrix} 0.5 \\ 1 \end{pmatrix} u
#   + \begin{pmatrix} 0.025 \\ 0.025 \end{pmatrix} x^\top x \qquad\text{(eq. (29), NL_DI)}$$
#
# with $\|x\|_\infty \le 6$ and $|u| \le 2$. Only the *quadratic term* $0.025\, x^\top x$ is not affine (*the bend* in
# the figures). It is the same in both components and does not depend on $u$. Nine regions $\mathcal{P}^{(i)}$, squares
# of side 4, divide $\mathcal{X}$ like a chessboard.

# %%
axis = np.linspace(-6, 6, 241)
x1, x2 = np.meshgrid(axis, axis)
fig, ax = plt.subplots(figsize=(5.8, 4.9), layout="constrained")
lines = ax.contour(x1, x2, 0.025 * (x1**2 + x2**2), levels=8, colors=plotting.BLUE)
ax.clabel(lines, fmt="%.1f")
plotting.draw_regions(ax, case.system)
plotting.label_axes(ax, X, r"the bend $0.025\, x^\top x$")
plt.show()

# %% [markdown]
# **What to see.** The quadratic term reaches 1.8 in the corners. Without regions, the error set would be far too large.
# Within one square (grey) the term varies by much less than over $\mathcal{X}$, and most of this variation is affine.
#
# ## 2. Least squares in one region, by hand
#
# In region $i$ we solve
#
# $$\min_{A^{(i)}, B^{(i)}, p^{(i)}} \; \sum_{j} \big\| f(x_j, u_j) - A^{(i)} x_j - B^{(i)} u_j - p^{(i)} \big\|_2^2$$
#
# over points $(x_j, u_j)$ of a grid in $\mathcal{P}^{(i)}$. The paper does not state the grid. A grid with ten points
# along each axis of $(x, u)$, ends included, reproduces its number 0.1186. As an example we take the square to the
# right of the middle, $[2, 6] \times [-2, 2]$:

# %% tags=["nbval-check-output"]
axes = [np.linspace(2, 6, 10), np.linspace(-2, 2, 10), np.linspace(-2, 2, 10)]
z = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)  # rows (x, u)
values = plant(z[:, :2], z[:, 2:])
theta = np.linalg.lstsq(np.column_stack([z, np.ones(len(z))]), values, rcond=None)[0].T  # rows (A, B, p)
errors = values - np.column_stack([z, np.ones(len(z))]) @ theta.T
print("A, B, p =", (theta + 0.0).round(4).tolist())
print("errors between", errors.min().round(6), "and", errors.max().round(6))

# %% [markdown]
# **What to see.** The fit recovers $B$ exactly. $A$ is the linear part, plus the slope of the quadratic term at the
# centre of the square: $0.05$ times the $x_1$ of the centre, in the column of $x_1$. The largest error is 0.118519,
# which the paper rounds up to 0.1186.
#
# The library fits all nine regions. The case study contains the result (`case.fit`):

# %% tags=["nbval-check-output"]
fit = mr.fit_pwa(plant, [mode.region for mode in case.system.modes], method="least_squares", grid=10)
square = next(m for m in fit.modes if m.region.contains(np.array([4.0, 0.0, 0.0])))
print("same as by hand:", np.allclose(np.column_stack([square.A, square.B, square.p]), theta, atol=1e-9))
print(f"largest error on the grids of all nine regions: {fit.max_error:.6f}")

# %% [markdown]
# ## 3. Least squares against minimax
#
# A fit that is good *on average* is not what we need, because the largest error becomes the disturbance bound. The
# suitable fit is
#
# $$\min_{A, B, p} \; \max_{(x, u) \in \mathcal{P}^{(i)}} \big\| f(x, u) - A x - B u - p \big\|_\infty.$$
#
# On a grid this is a linear program ($\min t$ subject to $-t \le f_l(x_j, u_j) - \dots \le t$). Here we can also find
# the solution by hand. Let $\xi$ be the state relative to the centre of a square. Up to an affine part, the quadratic
# term is $0.025 (\xi_1^2 + \xi_2^2)$ with $|\xi_l| \le 2$. By symmetry, its best affine approximation is a constant.
# The term ranges from 0 to 0.2, so the best constant is 0.1, and the error is 0.1.

# %% tags=["nbval-check-output"]
minimax = double_integrator_fit(method="minimax")
for name, result in (("least squares", fit), ("minimax", minimax)):
    low, high = (ends[0, 0] for ends in result.error_range)
    print(f"{name:>13}: error between {low:.4f} and {high:.4f}, largest {result.errors.max():.4f}")
print("same A in both:", all(np.allclose(a.A, b.A, atol=1e-6) for a, b in zip(fit.modes, minimax.modes)))

# %%
cut = np.linspace(-6, 6, 1201)
states = np.column_stack([cut, np.zeros_like(cut)])  # x2 = 0
bend = plant(states, np.zeros((len(cut), 1)))[:, 0]
fig, ax = plt.subplots(figsize=(7, 3.4), layout="constrained")
for result, colour, style in ((fit, plotting.BLUE, "-"), (minimax, plotting.RED, "--")):
    name = result.method.replace("_", " ")
    for i, mode in enumerate(result.modes):
        here = mode.region.contains(np.column_stack([states, np.zeros(len(cut))]))
        error = bend - mode.successor(states, np.zeros((len(cut), 1)))[:, 0]
        ax.plot(cut[here], error[here], style, color=colour, label=name if i == 1 else None)
for edge in (-2, 2):
    ax.axvline(edge, color=plotting.GREY, linewidth=2.2, zorder=0)
ax.set(xlabel="$x_1$ (at $x_2 = 0$, $u = 0$)", ylabel="$f_1 - f_{PWA,1}$")
plotting.legend_above(ax, 2)
plt.show()

# %% [markdown]
# **What to see.** The error is a parabola in each region, with a sharp kink where two regions meet (grey). There the
# slope changes abruptly from steeply rising to steeply falling. The two fits have the same slopes and differ by a
# constant. Least squares keeps the error of the many inner points closer to zero and has a larger error at the edges.
# Minimax balances both. Over the whole square the error is largest in the corners, which this cut does not show.
#
# ## 4. The error over all of $\mathcal{X}$


# %%
def fit_error(result, x, u):
    """f - f_PWA at states (N, 2) and inputs (N, 1): array (N, 2); on a shared edge the first region counts."""
    active = case.system.violation(x, u).argmin(axis=1)
    after = np.stack([mode.successor(x, u) for mode in result.modes])
    return plant(x, u) - after[active, np.arange(len(x))]


# %%
coarse = np.linspace(-6, 6, 145)
x1, x2 = np.meshgrid(coarse, coarse)
x = np.stack([x1, x2], axis=-1).reshape(-1, 2)
field = fit_error(fit, x, np.zeros((len(x), 1)))[:, 0].reshape(x1.shape)
fig, ax = plt.subplots(figsize=(6, 5), layout="constrained")
shown = ax.pcolormesh(x1, x2, field, cmap="PuOr", vmin=-0.12, vmax=0.12, shading="gouraud", rasterized=True)
lines = ax.contour(x1, x2, field, levels=[-0.05, 0, 0.05, 0.1], colors=plotting.BLACK, linewidths=0.8)
ax.clabel(lines, fmt="%.2f", fontsize=8)
plotting.draw_regions(ax, case.system)
plotting.label_axes(ax, X, "error of the least-squares fit")
fig.colorbar(shown, label="$f_1 - f_{PWA,1} = f_2 - f_{PWA,2}$")
plt.show()

# %% [markdown]
# **What to see.** The error has the same shape in all nine regions. It is negative in the middle of every square and
# largest in the corners, four of which meet at each inner crossing. (Contours below zero are dashed.) The error is
# continuous here, because neighbouring parabolas are mirror images of each other; only its slope jumps. This holds only
# because the squares are equal. With unequal regions the error itself jumps:

# %%
edges = [-6.0, -3.0, 1.0, 6.0]  # along x1, unequal
uneven = [mr.Polytope.box([a, -2, -2], [b, 2, 2]) for a, b in pairwise(edges)]
other = mr.fit_pwa(plant, uneven, method="least_squares", grid=10)
fig, ax = plt.subplots(figsize=(7, 3.2), layout="constrained")
for mode, (a, b) in zip(other.modes, pairwise(edges)):
    here = (cut >= a) & (cut <= b)
    error = (bend - mode.successor(states, np.zeros((len(cut), 1)))[:, 0])[here]
    ax.plot(cut[here], error, color=plotting.BLUE)
for edge in edges[1:-1]:
    ax.axvline(edge, color=plotting.GREY, linewidth=2.2, zorder=0)
ax.set(xlabel="$x_1$ (at $x_2 = 0$, $u = 0$)", ylabel="$f_1 - f_{PWA,1}$")
plt.show()

# %% [markdown]
# **What to see.** The error is discontinuous: on the two sides of an edge it has different values, and it is largest in
# the widest region. Where regions share an edge, both maps apply (notebook 03).
#
# ## 5. What a grid cannot prove
#
# Lemma 5, RkNonlinear, and Theorem 2 assume $f(x, u) - f_{PWA}(x, u) \in \mathcal{D}^{(i)}$ for *all*
# $x \in \mathcal{X}$, $u \in \mathcal{U}$. The largest error over grid points is a statement about grid points only.
# The next cell makes the grid coarser:

# %% tags=["nbval-check-output"]
for points in (2, 3, 4, 6, 10, 20):
    result = double_integrator_fit(grid=points)
    proven = result.errors.max()
    verdict = "a bound" if result.max_error >= proven - 1e-9 else "NOT a bound"
    print(f"{points:2d} points: on the grid {result.max_error:.6f}, proven over the region {proven:.6f}: {verdict}")

# %% [markdown]
# **What to see.** With 2 points per axis the fit interpolates all of them and reports an error of 0, while the true
# error is 0.2. With 4 points the number is still too small. With 6 or more points the largest error occurs in the
# corners of the squares, which are grid points, and the number is right. The paper's number is therefore right, too.
# But the grid values alone do not show which number is right.
#
# ## 6. A proof by intervals
#
# To bound a function over all points, compute with intervals that contain all points. For intervals,
#
# $$[a, b] + [c, d] = [a + c,\, b + d], \qquad [a, b] \cdot [c, d] = [\min\{ac, ad, bc, bd\},\, \max\{\dots\}],$$
#
# and the result contains every value of the function. It may contain many more. As an example take
# $e(\xi) = \xi^3 - \xi$ on $[-1.2, 1]$. Its largest value $2 / \sqrt{27}$ is attained at $\xi = -1/\sqrt 3$.


# %% tags=["nbval-check-output"]
def product(p, q):
    """Product of intervals (lower, upper)."""
    ends = [a * b for a in p for b in q]
    return min(ends), max(ends)


def upper_naive(a, b):
    """Upper bound on x^3 - x over [a, b] by interval arithmetic."""
    x = (a, b)
    return product(product(x, x), x)[1] - a  # -x lies in [-b, -a]


truth = 2 / np.sqrt(27)
print("interval bound:", round(upper_naive(-1.2, 1.0), 4), " truth:", truth.round(4))

# %% [markdown]
# The naive bound ignores that both occurrences of $\xi$ are the same number. *Taylor forms* keep part of this
# information. With midpoint $c$, radius $r$ and any bounds on a derivative over the interval,
#
# $$e(\xi) \le e(c) + \max_{[a, b]} |e'| \cdot r \quad\text{(first order)},$$
#
# $$e(\xi) \le e(c) + \max_{|h| \le r} \big( e'(c)\, h + \tfrac12 q\, h^2 \big),
#   \quad q = \max_{[a, b]} e'' \quad\text{(second order)}.$$
#
# `mr.prove_error` uses the second form, in several variables.


# %%
def upper_first(a, b):
    """First-order Taylor bound; e' = 3 x^2 - 1."""
    c, r = (a + b) / 2, (b - a) / 2
    slope = max(3 * max(a * a, b * b) - 1, 1 - 3 * product((a, b), (a, b))[0])
    return c**3 - c + slope * r


def upper_second(a, b):
    """Second-order Taylor bound; e'' = 6 x, at most 6 b."""
    c, r = (a + b) / 2, (b - a) / 2
    slope, q = abs(3 * c * c - 1), 6 * b
    if slope + q * r >= 0:  # the parabola rises up to the end of the interval
        return c**3 - c + slope * r + q * r * r / 2
    return c**3 - c - slope**2 / (2 * q)


# %%
bounds = {"interval": upper_naive, "first order": upper_first, "second order": upper_second}
pieces = 2 ** np.arange(12)
fig, ax = plt.subplots(figsize=(6.4, 4), layout="constrained")
styles = (("o-", plotting.RED), ("s--", plotting.ORANGE), ("^-.", plotting.BLUE))
for (name, upper), (style, colour) in zip(bounds.items(), styles):
    ends = [np.linspace(-1.2, 1.0, n + 1) for n in pieces]
    excess = [max(upper(a, b) for a, b in pairwise(e)) - truth for e in ends]
    ax.loglog(pieces, excess, style, color=colour, label=name, markersize=5)
ax.set(xlabel="number of equal pieces", ylabel="bound minus true maximum")
ax.legend()
plt.show()

# %% [markdown]
# **What to see.** All three are bounds: no curve falls below zero. With twice as many pieces, the excess of the
# interval bound is halved, and that of the first-order bound is quartered (slopes $-1$ and $-2$). The second-order
# bound converges faster still, but not smoothly: it depends on how near the maximum is to the middle of its piece.
#
# Equal pieces are inefficient. *Branch and bound* splits only pieces that may still contain the maximum, i.e. pieces
# whose bound exceeds the largest value attained so far.


# %%
def branch_and_bound(upper, tol=1e-9, most=2000):
    """Proven bound on the maximum of e over [-1.2, 1], and the number of pieces looked at."""
    attained, closed, pieces, looked_at = -np.inf, -np.inf, [(-1.2, 1.0)], 0
    while pieces and looked_at < most:
        a, b = pieces.pop(0)
        looked_at += 1
        c = (a + b) / 2
        attained = max(attained, c**3 - c)
        if upper(a, b) <= attained + tol:
            closed = max(closed, upper(a, b))
        else:
            pieces += [(a, c), (c, b)]
    return max([closed, *(upper(a, b) for a, b in pieces)]), looked_at


# %%
for name, upper in bounds.items():
    bound, count = branch_and_bound(upper)
    print(f"{name:>12}: bound - truth {'below 1e-8' if bound - truth < 1e-8 else 'above 1e-8'} after {count} pieces")

# %% [markdown]
# **What to see.** The second-order form needs only a few dozen pieces. Plain intervals reach the limit of 2000 pieces,
# because many pieces around the maximum *might* contain it.
#
# This small program ignores rounding errors. `mr.prove_error` computes in *ball arithmetic* (midpoint and radius, where
# the radius covers every rounding error) and rounds its result upward:

# %% tags=["nbval-check-output"]
proof = mr.prove_error(plant, case.fit.modes)
print("boxes looked at in each region:", proof.boxes.tolist())
print(f"proven bound: {proof.bound[:, 0].max():.6f}, attained: {proof.attained[:, 0].max():.6f}")
print("gap below 1e-9:", proof.gap.max() < 1e-9, "  complete:", proof.complete.all())

# %% [markdown]
# **What to see.** One box per region is enough here: $f$ is quadratic, so the second-order form is exact. Other plants
# need more boxes, for instance $f = (\sin x_1 + x_2,\; x_2 + u)$:

# %%
sine = mr.NonlinearSystem(lambda x, u: (np.sin(x[0]) + x[1], x[1] + u[0]), X, U)
sine_fit = mr.fit_pwa(sine, [mode.region for mode in case.system.modes], grid=10)
print("boxes:", sine_fit.proof.boxes.tolist())
print(f"largest error on the grid {sine_fit.max_error:.6f}, proven {sine_fit.proven_error:.6f}")

# %% [markdown]
# ## 7. The error set: box or segment
#
# The paper uses the box $\|d\|_\infty \le 0.1186$ as error set. But both components of the error are the *same number*
# between $-0.0815$ and $0.1185$. We compare three sets that contain the error, from large to tight:

# %%
rng = np.random.default_rng(7)
samples = X.product(U).sample(rng, 400)
d = fit_error(fit, samples[:, :2], samples[:, 2:])
sets = {error: fit.with_error(error).modes[0].disturbance for error in ("ball", "box", "polytope")}
fig, ax = plt.subplots(figsize=(5.2, 5), layout="constrained")
styles = {"facecolor": "none", "edgecolor": plotting.GREY, "linewidth": 2}
plotting.draw_set(ax, sets["ball"], **styles, label=r"$\|d\|_\infty \leq 0.1186$")
plotting.draw_set(ax, sets["box"], **{**styles, "edgecolor": plotting.BLUE, "linestyle": "--"}, label="tight box")
plotting.draw_set(ax, sets["polytope"], edgecolor=plotting.RED, label="segment").set_linewidth(5)
ax.plot(*d.T, ".", color=plotting.BLACK, markersize=3, zorder=5, label="errors at 400 random points")
plotting.label_axes(ax, sets["ball"].scale(1.1))
ax.set(xlabel="$d_1$", ylabel="$d_2$")
plotting.legend_above(ax, 2)
plt.show()

# %% [markdown]
# **What to see.** All errors lie on the diagonal. A box contains many disturbances that cannot occur, among them the
# corners $(-, +)$ and $(+, -)$. Both boxes and the segment are *proven* to contain the error.
#
# Does it matter? For each set, we analyse the loop with the shipped network and compute safe and terminal sets. (We use
# eight directions. The stopping rule of the terminal set scales about the equilibrium, which is not the origin here;
# see notebooks 09 and 10.)


# %%
def analyse(result):
    """Safe and terminal set of the shipped network on a fitted system; None where none was found."""
    loop = mr.ClosedLoop(result.system(), case.network)
    safe = mr.safe_set(loop, case.directions)
    return safe, mr.terminal_set(loop, safe, case.directions, centre="equilibrium") if safe.set is not None else None


# %%
print("fit             error set   iterations  area F_max  area R_min")
for name, result in (("least squares", fit), ("minimax", minimax)):
    for error in ("ball", "box", "polytope"):
        safe, terminal = analyse(result.with_error(error))
        if terminal is None:
            print(f"{name:15} {error:9} {safe.verdict}")
        else:
            numbers = f"{safe.iterations:10d}  {safe.set.area:10.2f}  {terminal.set.area:10.3f}"
            print(f"{name:15} {error:9} {numbers}")

# %% [markdown]
# **What to see.** From the first to the third row the terminal set loses much of its area, and $\mathcal{F}_{\max}$ is
# found after fewer iterations. (It also becomes a little *smaller*. The sequence of Prop. 3, Fmax, consists of images
# of $\mathcal{X}$, and a smaller disturbance gives smaller images. So despite its name, $\mathcal{F}_{\max}$ is a safe
# set, not the largest one.)
#
# Rows two and four agree, and so do three and six. The two fits differ by a constant, and a box or segment need not be
# centred at 0, so it can compensate a constant. With a *tight* error set the choice of the fit does not matter here.
# With the paper's symmetric box it does.

# %% tags=["nbval-check-output"]
tight, tight_terminal = analyse(fit.with_error("box"))
balanced, balanced_terminal = analyse(minimax.with_error("ball"))
print("same F_max:", np.allclose(tight.set.support(case.directions), balanced.set.support(case.directions), atol=1e-6))
loose, loose_terminal = analyse(fit.with_error("ball"))
segment, segment_terminal = analyse(fit.with_error("polytope"))
print("segment needs no more iterations than the paper's box:", segment.iterations <= loose.iterations)
print("and a smaller terminal set:", segment_terminal.set.area < loose_terminal.set.area)

# %%
fig, (left, right) = plt.subplots(1, 2, figsize=(8, 4), layout="constrained")
outline = {"facecolor": "none", "linewidth": 2}
for ax, box, flat in ((left, loose, segment), (right, loose_terminal, segment_terminal)):
    plotting.draw_set(ax, box.set, **outline, edgecolor=plotting.GREY, label="box 0.1186")
    plotting.draw_set(ax, flat.set, **outline, edgecolor=plotting.RED, linestyle="--", label="segment")
    plotting.label_axes(ax, box.set.scale(1.1, box.set.chebyshev()[0]))
left.set_title(r"$\mathcal{F}_{\max}$")
right.set_title(r"$\overline{\mathcal{R}}_{\min}$")
fig.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
plt.show()

# %% [markdown]
# **What to see.** On the left the difference is moderate. On the right the segment (dashed) gives a much thinner
# terminal set, especially across the diagonal, because the segment has no extent along $(1, -1)$.
#
# ## 8. What more regions gain
#
# With $s$ squares along each axis, their side is $12 / s$. By the argument of section 3 the minimax error is
# $0.025 \cdot 2\, (6/s)^2 / 2 = 0.9 / s^2$. Least squares on ten points gives $\frac{16}{15} / s^2$. The cost is $s^2$
# modes, each with a binary variable in the mixed-integer program.

# %% tags=["nbval-check-output"]
counts = np.array([1, 2, 3, 4, 6, 8])
fits = {s: double_integrator_fit(int(s)) for s in counts}
least = np.array([fits[s].proven_error for s in counts])
best = np.array([double_integrator_fit(int(s), method="minimax").proven_error for s in counts])
for s, a, b in zip(counts, least, best):
    print(f"{s} x {s} regions: least squares {a:.4f}, minimax {b:.4f}")
print("slope in log-log scale:", np.polyfit(np.log(counts), np.log(best), 1)[0].round(3))

# %%
fig, ax = plt.subplots(figsize=(6, 4), layout="constrained")
ax.loglog(counts, least, "o-", color=plotting.BLUE, label="least squares, proven")
ax.loglog(counts, best, "s--", color=plotting.RED, label="minimax, proven")
ax.loglog(counts, 0.9 / counts**2, ":", color=plotting.BLACK, label="$0.9 / s^2$")
ax.axhline(0.1186, color=plotting.GREY, linewidth=1, label="the paper's 0.1186")
ax.set(xlabel="regions along each axis, $s$", ylabel=r"error $\|f - f_{PWA}\|_\infty$")
ax.set_xticks(counts, counts)
ax.minorticks_off()
ax.legend()
plt.show()

# %% [markdown]
# **What to see.** Straight lines of slope $-2$: twice as many regions along an axis give a quarter of the error. A
# smooth plant always gives this slope once the regions are small. The height of the line depends on its curvature.

# %%
print("regions  iterations  area F_max  area R_min")
for s in counts:
    safe, terminal = analyse(fits[s].with_error("polytope"))
    if terminal is None:
        print(f"{s * s:7d}  no safe set: {safe.verdict}")
    else:
        print(f"{s * s:7d}  {safe.iterations:10d}  {safe.set.area:10.2f}  {terminal.set.area:10.4f}")

# %% [markdown]
# **What to see.** Coarse fits give no safe set, or give one only after many iterations. With finer fits the terminal
# set shrinks with the error. So more regions reduce the effect of the approximation error. For two states the engine
# `cells` handles many regions at little cost. For a mixed-integer solver each region adds one binary variable per step.
#
# ## What you saw
#
# - A PWA fit and a set that contains its error turn a nonlinear plant into a system that the method can treat (Lemma 5,
#   RkNonlinear).
# - 0.1186 is the least-squares error in the corners of the squares. Minimax achieves 0.1 with the same number of
#   regions.
# - The largest error on a grid is not a bound. Taylor forms with branch and bound give a bound, and ball arithmetic
#   accounts for rounding.
# - The shape of the error set matters: the error of this plant lies on a segment.
# - The error decreases with the square of the number of regions along an axis.
#
# ## On your own
#
# - Use `fit.with_error("polytope", per_mode=True)`, which gives each region its own error set. Why does nothing change
#   here, and for which plant would it?
# - Fit the sine plant of section 6 with unequal regions, small ones where the sine has the largest curvature.
# - Multiply the quadratic term by 2. How many regions reduce the error to 0.1186 again, and is there a safe set then?
# - Write $f$ with an `if` statement and pass it to `mr.prove_error`. What does it report, and why?
# - Exercise set 07: misleading grids, a minimax fit by hand, your own Taylor bound.
#
# ## Further reading
#
# - D. Teichrib, M. Schulze Darup: *A mixed-integer framework for analyzing neural network-based controllers for
#   piecewise affine systems with bounded disturbances*, ECC 2025. Secs. IV.D and V.B.
# - M. Lazar, W. P. M. H. Heemels: *Optimized input-to-state stabilization of discrete-time nonlinear systems with
#   bounded inputs*, ACC 2008: the plant.
# - F. Johansson: *Arb: efficient arbitrary-precision midpoint-radius interval arithmetic*, IEEE Trans. Computers, 2017.
# - R. E. Moore, R. B. Kearfott, M. J. Cloud: *Introduction to Interval Analysis*, SIAM, 2009.
#
# **Next:** notebook 08 trains the network that controls this plant.
