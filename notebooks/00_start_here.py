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
# # Start here: analyse a neural-network control loop in ten lines
#
# **What you will do.** You take a system whose controller is a trained neural network. You compute a set that the state
# of the closed loop never leaves, and a small set that it always enters. Then you test both sets with random
# disturbances.
#
# **What you will learn.** What the paper [Teichrib2025] proves, and how the four steps of its method work. How the
# paper's symbols are named in the code. What the other notebooks cover.
#
# **What you need.** Python, and a first course in control: states, inputs, feedback.
#
# The notebook runs in about ten seconds. Run the cells one by one with Shift+Enter, or choose *Run All*.

# %% [markdown]
# ## 1. Check the installation

# %% tags=["nbval-check-output"]
from importlib.util import find_spec

needed = ["matplotlib", "ipywidgets", "cvxpy", "torch", "casadi", "daqp"]
missing = [name for name in needed if find_spec(name) is None]
print("missing packages:", missing or "none")

# %% [markdown]
# If a package is missing, close this notebook and run `python3 run.py lab`. This command installs all packages that the
# course uses.

# %%
import matplotlib.pyplot as plt
import numpy as np

import mireach as mr
from mireach import plotting

# %% [markdown]
# ## 2. The question
#
# The system has several *modes*. The state and the input determine which mode is active (eq. (1), SysWithDis):
#
# $$x(k+1) = A^{(i)} x(k) + B^{(i)} u(k) + p^{(i)} + d(k) \quad\text{if } (x(k), u(k)) \in \mathcal{P}^{(i)},
# \qquad d(k) \in \mathcal{D}^{(i)}.$$
#
# The controller is a neural network $\Phi$ that was trained to imitate a good but slow controller: $u(k) = \Phi(x(k))$
# (eq. (3), UOfK). The imitation is not exact. The disturbance $d$ is unknown but bounded. The state must stay in a set
# $\mathcal{X}$, and the input in a set $\mathcal{U}$. A simulation shows what *can* happen. What can *never* happen?
#
# The answer uses one kind of object: the set of states that are reachable in one step from a set $\mathcal{F}$
# (eq. (4), kStepReachSet),
#
# $$\mathcal{R}_1^{\mathcal{D}}(\mathcal{F}) = \{\, f_{\text{PWA}}(x, \Phi(x)) + d
# \;:\; x\in\mathcal{F},\ d\in\mathcal{D}^{(i)} \,\}.$$
#
# A set with $\mathcal{R}_1^{\mathcal{D}}(\mathcal{F})\subseteq\mathcal{F}$ is *robustly positively invariant* (RPI,
# Def. 1): every trajectory that starts in it stays in it.

# %% [markdown]
# ## 3. Ten lines
#
# The method of the paper has four steps:
#
# 1. **One step.** Enclose $\mathcal{R}_1^{\mathcal{D}}(\mathcal{F})$ in a polytope
#    $\overline{\mathcal{R}}_1^{\mathcal{D}}(\mathcal{F})$ with chosen normals $C$ (eq. (18), Rover1). The offset of
#    each facet is the optimal value of a mixed-integer linear program (Lemmas 1 and 2).
# 2. **Safe set.** Iterate $\mathcal{F}_{k+1} = \overline{\mathcal{R}}_1^{\mathcal{D}}(\mathcal{F}_k)\cap\mathcal{X}$
#    from $\mathcal{F}_0 = \mathcal{X}$ until the set is RPI. This set is $\mathcal{F}_{\max}$ (Prop. 3, Fmax).
# 3. **Terminal set.** Apply step 1 repeatedly, starting from $\mathcal{F}_{\max}$, until the set hardly changes:
#    $\overline{\mathcal{R}}_{\min} = \overline{\mathcal{R}}_{\overline{k}}^{\mathcal{D}}(\mathcal{F}_{\max})$ (eq.
#    (24), RminOver, and eq. (25), TerminationFmin).
# 4. **Stability.** If the terminal set, scaled by some $\alpha > 1$, lies in the set of the previous step, the terminal
#    set is asymptotically stable (Theorem 1).

# %%
case = mr.case_study("pwa")  # system and network of the first case study
loop = mr.ClosedLoop(case.system, case.network)  # x+ = f_PWA(x, Phi(x)) + d

safe = mr.safe_set(loop, mr.box_directions(2))  # F_max, with C = (I, -I)
terminal = mr.terminal_set(loop, safe, mr.directions(8), epsilon=1e-3)  # R_min-bar, with eight normals

print("safe set:    ", safe.verdict, "after", safe.iterations, "iteration(s)")
print("terminal set:", terminal.reason)
print("Theorem 1:    alpha =", terminal.alpha, "-> asymptotically stable:", terminal.stable)

# %% tags=["nbval-check-output"]
for name, P in (("F_max", safe.set), ("R_min-bar", terminal.set)):
    lower, upper = (bound.round(2) + 0.0 for bound in P.bounding_box())
    print(f"{name:9} lies in [{lower[0]}, {upper[0]}] x [{lower[1]}, {upper[1]}]")

# %% [markdown]
# These sets are *proven*: they are built from upper bounds, not from samples. The next figure shows them as Figure 1 of
# the paper does.

# %%
figure, ax = plt.subplots(figsize=(6, 6))
plotting.plot_sequence(ax, case.system, safe, terminal)
plt.show()

# %% [markdown]
# *What to see:* for every initial state in the green box, the state lies inside the first black outline after one step,
# inside the second after two steps, and so on. After the last step it lies in the small blue set (enlarged at the lower
# right). This holds for every admissible disturbance.

# %% [markdown]
# ## 4. Try to break it
#
# We test the proof by simulation. We draw two hundred initial states from $\mathcal{F}_{\max}$, and a new random
# disturbance in every step.

# %% tags=["nbval-check-output"]
rng = np.random.default_rng(0)
paths = loop.simulate(safe.set.sample(rng, 200), terminal.steps, rng)  # (200, steps + 1, 2)
print("stayed in F_max:       ", safe.set.contains(paths, tol=1e-9).all(axis=1).sum(), "of", len(paths))
print("ended in R_min-bar:    ", terminal.set.contains(paths[:, -1], tol=1e-9).sum(), "of", len(paths))

# %%
figure, ax = plt.subplots(figsize=(6, 6))
plotting.draw_regions(ax, case.system)
plotting.draw_set(ax, safe.set, **plotting.SAFE, label=r"$\mathcal{F}_{\max}$")
plotting.draw_trajectories(ax, paths[:40], color=plotting.BLACK, linewidth=0.5, label="40 of the trajectories")
plotting.draw_set(ax, terminal.set, **plotting.TERMINAL, label=r"$\overline{\mathcal{R}}_{\min}$", zorder=3)
plotting.label_axes(ax, case.system.state_set)
plotting.legend_above(ax, 3)
plt.show()

# %% [markdown]
# *What to see:* the trajectories jump between the regions (the quadrants, outlined in grey). They never leave the green
# box, and all of them end in the blue set.

# %% [markdown]
# ## 5. A claim that is false
#
# The whole set $\mathcal{X}$ is not RPI. The check refutes the claim and returns a witness: a state, its input, a
# disturbance, and the successor.

# %%
check = mr.check_rpi(loop, case.system.state_set)
print(check.verdict)
print(check.witness)

# %% tags=["nbval-check-output"]
x, d = check.witness.states[0], check.witness.disturbances[0]
after = loop.step(x, d)  # replay it, without any optimisation
print(check.verdict, "- replayed x+ is in X:", case.system.state_set.contains(after))
print("x2 after the step:", round(after[1], 2))

# %% [markdown]
# From the corner $(-10\ \ {-10})^\top$ the loop leaves $\mathcal{X}$ for every network: $x_2$ falls below $-10$,
# because $u$ does not act on $x_2$ in this system. Step 2 of the method must therefore remove this corner.

# %% [markdown]
# ## 6. A nonlinear plant
#
# A nonlinear system is approximated by a piecewise-affine one. The approximation error is treated as the disturbance
# (Theorem 2). The second case study is a nonlinear double integrator with nine regions.

# %% tags=["nbval-check-output"]
second = mr.case_study("double_integrator")
safe2 = mr.safe_set(second.loop, second.directions)
terminal2 = mr.terminal_set(second.loop, safe2, second.directions)
answer = mr.ultimately_bounded(second.plant, second.loop, safe2, terminal2)
print("Theorem 2:", answer.verdict)
for condition, holds in answer.conditions.items():
    print(f"  {condition}: {holds}")

# %% [markdown]
# ## 7. From the paper's symbols to the code
#
# | paper | meaning | code |
# | --- | --- | --- |
# | $\mathcal{P} = \{x : H x \le h\}$, eq. (2), HRep | polytope | `mr.Polytope(H, h)` |
# | $h_{\mathcal{P}}(v)$, $h_{\mathcal{P}}(C)$ | support function, along each row of $C$ | `P.support(C)` |
# | $\mathcal{A}\cap\mathcal{B}$, $\mathcal{A}\subseteq\mathcal{B}$, $s\mathcal{A}$ | intersection, inclusion, scaling | `A & B`, `A.is_subset(B)`, `A.scale(s)` |
# | $C$, e.g. $(I\ \ {-I})^\top$ or eight unit rows | template: facet normals | `mr.box_directions(n)`, `mr.directions(8)` |
# | $A^{(i)}, B^{(i)}, p^{(i)}, \mathcal{P}^{(i)}, \mathcal{D}^{(i)}$ | a mode | `mr.Mode(A, B, p, region, disturbance)` |
# | $f_{\text{PWA}}$, $\mathcal{X}$, $\mathcal{U}$, eq. (1), SysWithDis | system | `mr.PWASystem(modes, state_set, input_set)` |
# | $\Phi$; $W^{(i)}, b^{(i)}, p_i$, eq. (6), NN; eq. (8), maxout | maxout network | `mr.MaxoutNetwork`; `mr.Layer(weight, bias, pool)` |
# | layers that project onto $\mathcal{U}$ | saturation, exact | `net.saturate(lower, upper)` |
# | eq. (16a), CLSystem | closed loop | `mr.ClosedLoop(system, net)`, `.step`, `.simulate` |
# | $h_{\mathcal{R}_k^{\mathcal{D}}(\mathcal{F})}(C)$, Lemma 2 | support function of a reachable set | `mr.support(loop, F, C, steps=k)` |
# | $\overline{\mathcal{R}}_1^{\mathcal{D}}(\mathcal{F})$, eq. (18), Rover1 | outer approximation of one step | `mr.outer_step(loop, F, C)` |
# | $\overline{\mathcal{R}}_k^{\mathcal{D}}(\mathcal{F})$, eq. (19), ROverOver | the same, $k$ times | `mr.outer_reach(loop, F, C, k)` |
# | $\mathcal{R}_1^{\mathcal{D}}(\mathcal{F})\subseteq\mathcal{F}$, Def. 1, RPI | invariance | `mr.check_rpi(loop, F)` |
# | $\mathcal{F}_k$, $\mathcal{F}_{\max}$, $\hat{k}$, Prop. 3, Fmax | safe set | `mr.safe_set(loop, C)`: `.history`, `.set`, `.iterations` |
# | $\overline{\mathcal{R}}_{\min}$, $\overline{k}$, $\overline{\epsilon}$, eq. (25), TerminationFmin | terminal set | `mr.terminal_set(loop, safe, C, epsilon)`: `.set`, `.steps`, `.criterion` |
# | $\alpha$, $\delta_{\max}$, Theorem 1 | stability | `terminal.alpha`, `.delta_max`, `.stable` |
# | $(1+\underline{\epsilon})\overline{\mathcal{R}}_{\underline{k}}^{\mathcal{D}}(\mathbf{0})$, Sec. IV.B | approximation from inside | `mr.scaled_minimal_set(loop, C, epsilon)` |
# | $f - f_{\text{PWA}}\in\mathcal{D}^{(i)}$ | approximation and its error | `mr.fit_pwa`, `mr.prove_error` |
# | Theorem 2 | ultimate boundedness | `mr.ultimately_bounded(plant, loop, safe, terminal)` |
#
# The numbers of equations are those of the paper's preprint; the names are the labels in its LaTeX source. The preprint
# counts theorems, lemmas and propositions together. Theorem 1 of this course (label BoundedStab) is its Theorem 4, and
# Theorem 2 (label UUB) is its Theorem 6.
#
# For the documentation of a function, run e.g. `mr.safe_set?` in a cell.

# %% [markdown]
# ## 8. The course
#
# | notebook | what you do | exercise |
# | --- | --- | --- |
# | 01_sets_and_support_functions | compute with sets by their support functions | ex01 |
# | 02_maxout_as_mixed_integer | write a network as a mixed-integer program, and break it | ex02 |
# | 03_pwa_systems_as_mixed_integer | do the same for a system with modes | ex03 |
# | 04_disturbances_and_one_step_sets | add the disturbance, draw a one-step set, refute an RPI claim | ex04 |
# | 05_from_mpc_to_a_maxout_net | solve optimal control problems, train the 3x3 network | ex05 |
# | 06_case_study_pwa | compute the sets of the first case study one by one | ex06 |
# | 07_fit_the_double_integrator | approximate a nonlinear plant, prove the error | ex07 |
# | 08_train_the_5x5_net | generate data by nonlinear optimal control, train the 5x5 network | ex08 |
# | 09_case_study_double_integrator | compute the sets of the second case study one by one | ex09 |
# | 10_beyond_the_paper | use exact cells, other centres, tighter errors, many networks | |
# | 11_your_own_system | analyse your own plant and your own torch network | |
# | 12_disturbance_lab | drag the disturbance and see how the sets change | |
# | 13_the_maximal_safe_set | compute the maximal safe set, which the paper's method cannot compute, by backward steps | ex10 |
# | 14_beyond_the_plane | look at cells and sets in space, for three and four tanks, and compare them with the MILP | ex14 |
#
# Notebooks 01 to 04 build on each other. 05 and 06 belong together, and so do 07, 08 and 09. 11 needs only this
# notebook; 12 and 13 need 06 and 09, and 14 needs 06. `python3 run.py exercises` writes your copies of the exercises to
# `notebooks/exercises/release/`. Sliders need a running kernel. Above every slider a static figure shows the same
# content.

# %% [markdown]
# **What you saw.** A few calls compute the sets for a given system and network, and prove their properties. The result
# is a safe set and a terminal set, or a trajectory that refutes the claim.
#
# **On your own.**
#
# - Replace `mr.directions(8)` by `mr.directions(16)`. Is the terminal set smaller? After how many steps does the
#   sequence stop, and why (`terminal.reason`)?
# - Double the disturbance: `mr.case_study("pwa").loop.with_disturbance(mr.Polytope.box([-0.3, -0.3], [0.3, 0.3]))`.
#   Does `mr.safe_set` still find a safe set? If not, what does `.reason` say? Which part of the set must another
#   template cut off?
# - Check a set of your own: `mr.check_rpi(loop, mr.Polytope.box([-3, -3], [3, 3]))`. If the claim is refuted, replay
#   the witness. Which of the sets in the first figure are RPI?
#
# **Further reading.** D. Teichrib and M. Schulze Darup, *A mixed-integer framework for analyzing neural network-based
# controllers for piecewise affine systems with bounded disturbances*, ECC 2025 ([Teichrib2025] throughout the course).
# For invariant sets, F. Blanchini, *Set invariance in control*, Automatica 35, 1999.
#
# **Next:** 01_sets_and_support_functions shows how to compute with a set if you know only its support function $h(v)$.
