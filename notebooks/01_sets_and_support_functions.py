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
# # Compute with sets by their support functions
#
# **What you will do.** Draw polytopes and their support functions. Add and compare sets without drawing them. Enclose a
# nonconvex set in a template. See how the sets of a badly chosen template grow without bound.
#
# **What you will learn.** Why the paper's method needs only one number per direction to describe a set. By how much a
# template with normals $C$ over-approximates a set, and how this error accumulates over several steps.
#
# **What you need.** Matrices, the maximum of a linear function, and notebook 00.
#
# The notebook runs in about ten seconds.

# %%
import matplotlib.pyplot as plt
import numpy as np
from scipy.optimize import linprog

import mireach as mr
from mireach import plotting
from mireach.lab import step_viewer
from mireach.systems.plants import pwa_plant

# %% [markdown]
# ## 1. A polytope is a list of half-spaces
#
# Eq. (2), HRep, describes a polyhedral set by its facets. Each row of $H$ is the outward normal of a facet. The
# corresponding entry of $h$ is the offset of this facet:
#
# $$\mathcal{P} = \{\, x\in\mathbb{R}^n : H x \le h \,\}.$$

# %% tags=["nbval-check-output"]
H = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, -2.0], [-1.0, 2.0]])  # eq. (2), HRep, four facets
h = np.array([2.0, 1.5, 2.0, 2.0])
P = mr.Polytope(H, h)

print("corners:", P.vertices().round(3).tolist())
print("holds the origin:", P.contains([0, 0]), "  holds (2, 1.6):", P.contains([2, 1.6]))


# %%
def draw_facets(ax, P):
    """Draw the line v x = h of every row of a polytope, numbered."""
    t = np.array([[-6.0], [6.0]])
    for i, (v, offset) in enumerate(zip(P.H, P.h), start=1):
        foot, along = v * offset / (v @ v), np.array([-v[1], v[0]]) / np.linalg.norm(v)
        ax.plot(*(foot + t * along).T, "--", color=plotting.GREY, linewidth=1)
        facet = P.vertices()[np.isclose(P.vertices() @ v, offset)]
        middle = facet.mean(axis=0) if len(facet) else foot
        ax.annotate("", middle + 0.45 * v / np.linalg.norm(v), middle, arrowprops={"arrowstyle": "->"})
        text = {"ha": "center", "va": "center", "bbox": {"facecolor": "white", "edgecolor": "none", "pad": 1}}
        ax.annotate(f"row {i}", middle + 0.8 * v / np.linalg.norm(v), **text)


# %%
figure, ax = plt.subplots(figsize=(5.5, 5))
draw_facets(ax, P)
plotting.draw_set(ax, P, **plotting.SAFE)
plotting.label_axes(ax, P.scale(1.6))
plt.show()

# %% [markdown]
# *What to see:* each dashed line is one row of $H x \le h$, and its arrow is the normal. The set is the intersection of
# the half-spaces behind these lines.

# %% [markdown]
# ## 2. The support function
#
# For a row $v$ (Sec. I.A), the support function is the largest value of $v x$ on the set:
#
# $$h_{\mathcal{P}}(v) = \sup_{x\in\mathcal{P}} v x .$$
#
# For a polytope this is a linear program: maximise $v x$ subject to $H x \le h$.


# %% tags=["nbval-check-output"]
def support_by_lp(P, v):
    """h_P(v) = max {v x : H x <= h}, and a point that attains it."""
    answer = linprog(-v, A_ub=P.H, b_ub=P.h, bounds=(None, None))  # linprog minimises
    return -answer.fun, answer.x


V = np.array([[0.6, 0.8], [-0.6, 0.8], [0.0, -1.0], [1.0, 1.0]])
for v, built_in in zip(V, P.support(V)):
    value, point = support_by_lp(P, v)
    point = (point.round(3) + 0.0).tolist()
    print(f"v = {v.tolist()}: h(v) = {value:.3f} at x = {point}   (P.support: {built_in:.3f})")

# %% [markdown]
# In the next figure, $v = (\cos\varphi\ \ \sin\varphi)$ makes one full turn. Left: the supporting lines $v x = h(v)$
# for a few $\varphi$. Right: $h$ for all $\varphi$.


# %%
def unit(angle):
    """Unit rows (cos, sin) for an array of angles."""
    return np.column_stack([np.cos(angle), np.sin(angle)])


angles = np.linspace(0, 2 * np.pi, 361)
few = np.deg2rad([20, 75, 130, 200, 320])

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(8, 4), layout="constrained")
plotting.draw_set(left, P, **plotting.SAFE)
for v in unit(few):
    touch = P.vertices()[np.argmax(P.vertices() @ v)]  # where v x is largest
    left.plot(*(touch + np.outer([-2.5, 2.5], [-v[1], v[0]])).T, "--", color=plotting.BLUE, linewidth=1.2)
    left.annotate("", touch + 0.7 * v, touch, arrowprops={"arrowstyle": "->", "color": plotting.BLUE})
plotting.label_axes(left, P.scale(1.6))
right.plot(np.rad2deg(angles), P.support(unit(angles)), color=plotting.GREEN)
right.plot(np.rad2deg(few), P.support(unit(few)), "o", color=plotting.BLUE)
right.set(xlabel=r"angle $\varphi$ of $v$ in degrees", ylabel=r"$h_{\mathcal{P}}(v)$", xticks=range(0, 361, 90))
plt.show()

# %% [markdown]
# *What to see:* a supporting line touches the set but does not cut it. As long as the same vertex maximises $v x$, the
# curve is a piece of a cosine. It has a kink where $v$ is the normal of a facet.

# %% [markdown]
# ## 3. Rules for support functions
#
# In one step, the closed loop multiplies a set by a matrix, shifts it, adds a disturbance, and takes the union of
# several pieces. For support functions, each operation is one line, and none of them needs the vertices:
#
# $$h_{A\mathcal{P}}(v) = h_{\mathcal{P}}(v A), \qquad
# h_{\mathcal{P}\oplus\mathcal{D}}(v) = h_{\mathcal{P}}(v) + h_{\mathcal{D}}(v),$$
#
# $$h_{s\mathcal{P}}(v) = s\,h_{\mathcal{P}}(v)\ (s>0), \qquad
# h_{\mathcal{P}\cup\mathcal{Q}}(v) = \max\{h_{\mathcal{P}}(v), h_{\mathcal{Q}}(v)\}.$$
#
# We compare the first two rules with the vertices of $A\mathcal{P}\oplus\mathcal{D}$:

# %% tags=["nbval-check-output"]
A = np.array([[0.5, -0.6], [0.4, 0.7]])
D = mr.Polytope.box([-0.15, -0.15], [0.15, 0.15])
C = mr.directions(8)  # the paper's C_i, eight unit rows

by_rules = P.support(C @ A) + D.support(C)  # h of A P + D along C
corners = (P.vertices() @ A.T)[:, None] + D.vertices()[None]  # every vertex of A P plus every vertex of D
by_corners = (corners.reshape(-1, 2) @ C.T).max(axis=0)
print("by the rules:  ", by_rules.round(3))
print("by the corners:", by_corners.round(3))

# %% [markdown]
# ## 4. Inclusion is a comparison of numbers
#
# $$\mathcal{P}\subseteq\mathcal{Q} = \{x : H^{(\mathcal{Q})} x \le h^{(\mathcal{Q})}\} \quad\Longleftrightarrow\quad
# h_{\mathcal{P}}(H^{(\mathcal{Q})}) \le h^{(\mathcal{Q})}.$$
#
# The invariance check is exactly this test, with a reachable set on the left-hand side. One violated row disproves the
# inclusion. The point of $\mathcal{P}$ that maximises this row (the support vector) is a witness.

# %% tags=["nbval-check-output"]
Q = mr.Polytope.box([-2.2, -2.2], [2.2, 1.4])
excess = P.support(Q.H) - Q.h  # positive where P violates a facet of Q
row = int(np.argmax(excess))
value, witness = support_by_lp(P, Q.H[row])
print("h_P - h_Q along the rows of Q:", excess.round(3))
print("P lies in Q:", P.is_subset(Q), "  a point of P outside Q reaches", round(value, 3), "along", Q.H[row].tolist())

# %% [markdown]
# ## 5. What a template over-approximates
#
# The set of reachable states of a piecewise-affine loop is not convex. An example: take the box $[-4, 4]\times[-3, 3]$
# after one step of the four-mode system of the first case study with $u = 0$. Each quadrant is mapped by its own matrix
# $A^{(i)}$, and the disturbance adds $\mathcal{D}$.

# %%
start = mr.Polytope.box([-4, -3], [4, 3])
system = pwa_plant(disturbance_bound=0.15)

images = []
for mode in system.modes:
    quadrant = mr.Polytope(mode.region.H[:, :2], mode.region.h) & start
    moved = (quadrant.vertices() @ mode.A.T)[:, None] + mode.disturbance.vertices()[None]
    images.append(mr.Polytope.from_points(moved.reshape(-1, 2)))  # A^(i) (quadrant) + D

# %% [markdown]
# The paper encloses every such set $\mathcal{R}$ with the same normals $C$ (eq. (18), Rover1):
#
# $$\overline{\mathcal{R}} = \{\, x : C x \le h_{\mathcal{R}}(C) \,\}.$$


# %%
def template(C):
    """Eq. (18), Rover1: the smallest polytope with normals C around all the images."""
    return mr.Polytope(C, np.max([image.support(C) for image in images], axis=0))


hull = mr.Polytope.from_points(np.vstack([image.vertices() for image in images]))
outline, truth = {"facecolor": "none", "linewidth": 1.8}, {"facecolor": "#9A9A9A66", "edgecolor": plotting.BLACK}
four, eight = template(mr.box_directions(2)), template(mr.directions(8))

# %%
figure, ax = plt.subplots(figsize=(6, 5.5))
for i, image in enumerate(images):
    label = r"$\mathcal{R}$, one piece a mode" if i == 0 else None
    plotting.draw_set(ax, image, **truth, label=label)
plotting.draw_set(ax, hull, **outline, edgecolor=plotting.BLACK, linestyle=":", label="convex hull")
plotting.draw_set(ax, eight, **outline, edgecolor=plotting.BLUE, label="8 directions")
plotting.draw_set(ax, four, **outline, edgecolor=plotting.RED, linestyle="--", label="4 directions")
plotting.label_axes(ax, four.scale(1.1, four.chebyshev()[0]))
plotting.legend_above(ax, 4)
plt.show()

# %% [markdown]
# *What to see:* both templates touch the grey set along each of their normals. They over-approximate it in two ways.
# They fill the corners between two normals; more rows reduce this error. They also fill the gaps between the pieces;
# more rows do not help here, because a template set is convex.


# %% tags=["nbval-check-output"]
for count in (4, 8, 16, 32):
    excess = template(mr.directions(count)).area / hull.area - 1
    print(f"{count:2} directions: {excess:6.1%} more area than the convex hull")

# %% [markdown]
# Along the rows of $C$ the template is exact: $h_{\overline{\mathcal{R}}}(C) = h_{\mathcal{R}}(C)$. Between them it is
# not.

# %%
exact = np.max([image.support(unit(angles)) for image in images], axis=0)
figure, ax = plt.subplots(figsize=(7, 3.8))
ax.plot(np.rad2deg(angles), four.support(unit(angles)), "--", color=plotting.RED, label="4 directions")
ax.plot(np.rad2deg(angles), eight.support(unit(angles)), color=plotting.BLUE, label="8 directions")
ax.plot(np.rad2deg(angles), exact, ":", color=plotting.BLACK, linewidth=2, label=r"$\mathcal{R}$ itself")
ax.plot(np.arange(0, 360, 45), eight.h, "o", color=plotting.BLUE)
ax.set(xlabel=r"angle $\varphi$ of $v$ in degrees", ylabel="$h(v)$", xticks=range(0, 361, 45))
plotting.legend_above(ax, 3)
plt.show()

# %% [markdown]
# *What to see:* the curve for eight directions meets the dotted one at the dots (every 45 degrees). The dashed curve
# meets them only at every second dot. The dotted curve is also the support function of the convex hull of
# $\mathcal{R}$, because a set and its convex hull have the same support function.

# %% [markdown]
# ## 6. Repeated steps: the wrapping effect
#
# The paper applies the template after every step (eq. (19), ROverOver),
# $\overline{\mathcal{R}}_k = \overline{\mathcal{R}}_1(\overline{\mathcal{R}}_1(\dots))$. Each step propagates the
# over-approximation of the step before. Consider a simple stable system: a rotation by 45 degrees with a contraction by
# 0.8,
#
# $$x^+ = A x, \qquad A = 0.8 \begin{pmatrix} \cos 45° & -\sin 45° \\ \sin 45° & \cos 45° \end{pmatrix}.$$
#
# One step of the template uses the first rule above, $h_{A\mathcal{F}}(C) = h_{\mathcal{F}}(C A)$.

# %% tags=["nbval-check-output"]
turn = 0.8 * np.array([[1.0, -1.0], [1.0, 1.0]]) / np.sqrt(2)


def outer_sequence(F, C, steps):
    """Eq. (19), ROverOver: F, R1-bar(F), R2-bar(F), ... for x+ = turn x."""
    sets = [F]
    for _ in range(steps):
        sets.append(mr.Polytope(C, sets[-1].support(C @ turn)))
    return sets


boxes = outer_sequence(mr.Polytope.box([-1, -1], [1, 1]), mr.box_directions(2), 8)
octagons = outer_sequence(mr.Polytope.box([-1, -1], [1, 1]), mr.directions(8), 8)
print("x1 max, 4 directions:", [round(float(R.support([[1, 0]])[0]), 3) for R in boxes])
print("x1 max, 8 directions:", [round(float(R.support([[1, 0]])[0]), 3) for R in octagons])

# %%
square = mr.Polytope.box([-1, -1], [1, 1]).vertices()


def draw_step(ax, k):
    """Draw the true set and both templates after k steps."""
    turned = mr.Polytope.from_points(square @ np.linalg.matrix_power(turn, k).T)
    plotting.draw_set(ax, turned, **truth, label=r"$A^k\mathcal{F}$")
    plotting.draw_set(ax, octagons[k], **outline, edgecolor=plotting.BLUE, label="8 directions")
    plotting.draw_set(ax, boxes[k], **outline, edgecolor=plotting.RED, linestyle="--", label="4 directions")
    plotting.label_axes(ax, boxes[-1], f"$k = {k}$")


# %%
figure, axes = plt.subplots(2, 3, figsize=(8, 5.8), layout="constrained")
for ax, k in zip(axes.flat, (0, 1, 2, 4, 6, 8)):
    draw_step(ax, k)
    ax.label_outer()
figure.legend(*axes[0, 1].get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False)
plt.show()

# %% [markdown]
# *What to see:* the true set (grey) shrinks by a factor of 0.8 per step. With eight directions the sets are exact here,
# because the rotation maps these directions onto themselves. With four directions each step over-approximates the image
# by a factor of $\sqrt2$. This outweighs the contraction by 0.8, so the box grows without bound while the true set
# shrinks to a point.
#
# The next cell shows the same with a slider. It needs a running kernel; without one, use the figure above.

# %%
step_viewer(draw_step, len(boxes))

# %% [markdown]
# So the template is a design parameter. With an unsuitable template the method may fail although a safe set exists. The
# second case study of the paper is an example:

# %% tags=["nbval-check-output"]
case = mr.case_study("double_integrator")
for name, C in (("(I, -I)", mr.box_directions(2)), ("eight directions", mr.directions(8))):
    safe = mr.safe_set(case.loop, C)
    print(f"{name}: {'a safe set' if safe.set is not None else 'no safe set found'} ({safe.verdict})")

# %% [markdown]
# **What you saw.** The support function describes a convex set completely. Images, sums, unions and inclusion are
# simple to compute with it. A template turns any bounded set into a polytope with few facets. This polytope is exact
# along the rows of the template and too large between them. Over repeated steps the over-approximation can accumulate.
#
# **On your own.**
#
# - Give `draw_facets` a polytope with a redundant row, i.e. a row whose line does not touch the set. What is
#   $h_{\mathcal{P}}$ along it?
# - How do the widths in section 6 change for a rotation by 30 degrees? For which number of directions is the template
#   exact?
# - Take `mr.directions(8)` and double the length of every second row. Does the template set change? Why not?
#
# **Exercise:** ex01 (`python3 run.py exercises` makes your copy in `exercises/release/ex01`).
#
# **Further reading.** F. Blanchini and S. Miani, *Set-Theoretic Methods in Control*, Birkhäuser, chapter 3, for support
# functions. A. Girard, *Reachability of uncertain linear systems using zonotopes*, HSCC 2005, on the wrapping effect.
# [Teichrib2025], Sec. I.A, eq. (18), Rover1, and eq. (19), ROverOver.
#
# **Next:** 02_maxout_as_mixed_integer computes the support function of the image of a set under a neural network.
