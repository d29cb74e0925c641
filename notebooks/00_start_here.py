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
# # Start here: analyse a neural loop in ten lines
#
# **What you will do.** Take a system whose controller is a trained neural network, compute a set that the closed loop
# never leaves and a small set that it always enters, and let random disturbances try to break both.
#
# **What you will learn.** What the paper [Teichrib2025] proves and by which four steps; which name each of its symbols
# has in the code; what the other notebooks are for.
#
# **What you will need.** Python, and a first course in control: states, inputs, feedback. Nothing else yet.
#
# Runs in about ten seconds. Go through the cells with Shift+Enter, or choose *Run All*.

# %% [markdown]
# ## 1. Check the installation

# %% tags=["nbval-check-output"]
from importlib.util import find_spec

needed = ["matplotlib", "ipywidgets", "cvxpy", "torch", "casadi", "daqp"]
missing = [name for name in needed if find_spec(name) is None]
print("missing packages:", missing or "none")

# %% [markdown]
# If something is missing, close this notebook and start it by `python3 run.py lab`, which installs what the course
# uses.

# %%
import matplotlib.pyplot as plt
import numpy as np

import mireach as mr
from mireach import plotting

# %% [markdown]
# ## 2. The question
#
# A system has several *modes*, and the mode depends on where state and input are (eq. SysWithDis):
#
# $$x(k+1) = A^{(i)} x(k) + B^{(i)} u(k) + p^{(i)} + d(k) \quad\text{if } (x(k), u(k)) \in \mathcal{P}^{(i)},
# \qquad d(k) \in \mathcal{D}^{(i)}.$$
#
# Somebody has trained a neural network $\Phi$ that imitates a good but slow controller, and lets it act (eq. UOfK):
# $u(k) = \Phi(x(k))$. The imitation is not perfect, the disturbance $d$ is only known to be bounded, and the state
# must stay in a set $\mathcal{X}$, the input in $\mathcal{U}$. Simulating shows what *can* happen. What can *never*
# happen?
#
# The answer uses one kind of object: the set of states that are reachable within one step from a set $\mathcal{F}$
# (eq. kStepReachSet),
#
# $$\mathcal{R}_1^{\mathcal{D}}(\mathcal{F}) = \{\, f_{\text{PWA}}(x, \Phi(x)) + d
# \;:\; x\in\mathcal{F},\ d\in\mathcal{D}^{(i)} \,\}.$$
#
# A set with $\mathcal{R}_1^{\mathcal{D}}(\mathcal{F})\subseteq\mathcal{F}$ is *robustly positively invariant* (RPI,
# Def. RPI): who starts in it stays in it.

# %% [markdown]
# ## 3. Ten lines
#
# The four steps of the paper are:
#
# 1. **One step.** Enclose $\mathcal{R}_1^{\mathcal{D}}(\mathcal{F})$ in a polytope
#    $\overline{\mathcal{R}}_1^{\mathcal{D}}(\mathcal{F})$ with chosen normals $C$ (eq. Rover1); each facet is the
#    optimum of a mixed-integer linear program (Lemmas 1 and 2).
# 2. **Safe set.** Iterate $\mathcal{F}_{k+1} = \overline{\mathcal{R}}_1^{\mathcal{D}}(\mathcal{F}_k)\cap\mathcal{X}$
#    from $\mathcal{F}_0 = \mathcal{X}$ until it is RPI: $\mathcal{F}_{\max}$ (Prop. Fmax).
# 3. **Terminal set.** Go on from $\mathcal{F}_{\max}$ until almost nothing changes:
#    $\overline{\mathcal{R}}_{\min} = \overline{\mathcal{R}}_{\overline{k}}^{\mathcal{D}}(\mathcal{F}_{\max})$ (eqs.
#    RminOver, TerminationFmin).
# 4. **Conclude.** If the last set, scaled by some $\alpha > 1$, lies in the one before, it is asymptotically stable
#    (Theorem 1).

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
# These sets are *proven*: they were built from upper bounds, not from samples. Here they are, as in Figure 1 of the
# paper.

# %%
figure, ax = plt.subplots(figsize=(6, 6))
plotting.plot_sequence(ax, case.system, safe, terminal)
plt.show()

# %% [markdown]
# *What to see:* from anywhere in the green box, the loop is inside the first black outline after one step, inside the
# second after two steps, and so on. The small blue set (enlarged at the lower right) is where it ends, for every
# initial state and every disturbance.

# %% [markdown]
# ## 4. Try to break it
#
# A proof should survive an attack. Two hundred initial states all over $\mathcal{F}_{\max}$, a new random disturbance
# in every step:

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
# *What to see:* the trajectories jump across the regions (the quadrants, outlined in grey), never leave the green box,
# and all end in the blue set.

# %% [markdown]
# ## 5. And where there is nothing to prove
#
# All of $\mathcal{X}$ is not RPI. A *no* comes with a witness: a state, its input, a disturbance, and where they lead.

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
# From the corner $(-10\ \ {-10})^\top$ the second state leaves $\mathcal{X}$, whatever the network does, because $u$
# does not act on $x_2$ in this system. The iteration of step 2 therefore has to cut this corner off.

# %% [markdown]
# ## 6. A nonlinear plant
#
# A nonlinear system is handled by a piecewise-affine approximation whose error counts as the disturbance (Theorem 2).
# The second case study is a nonlinear double integrator in nine regions.

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
# | $\mathcal{P} = \{x : H x \le h\}$, eq. HRep | polytope | `mr.Polytope(H, h)` |
# | $h_{\mathcal{P}}(v)$, $h_{\mathcal{P}}(C)$ | support function, along each row of $C$ | `P.support(C)` |
# | $\mathcal{A}\cap\mathcal{B}$, $\mathcal{A}\subseteq\mathcal{B}$, $s\mathcal{A}$ | intersection, inclusion, scaling | `A & B`, `A.is_subset(B)`, `A.scale(s)` |
# | $C$, e.g. $(I\ \ {-I})^\top$ or eight unit rows | template: normals of the sets | `mr.box_directions(n)`, `mr.directions(8)` |
# | $A^{(i)}, B^{(i)}, p^{(i)}, \mathcal{P}^{(i)}, \mathcal{D}^{(i)}$ | a mode | `mr.Mode(A, B, p, region, disturbance)` |
# | $f_{\text{PWA}}$, $\mathcal{X}$, $\mathcal{U}$, eq. SysWithDis | system | `mr.PWASystem(modes, state_set, input_set)` |
# | $\Phi$; $W^{(i)}, b^{(i)}, p_i$, eqs. NN, maxout | maxout network | `mr.MaxoutNetwork`; `mr.Layer(weight, bias, pool)` |
# | layers that project onto $\mathcal{U}$ | saturation, exact | `net.saturate(lower, upper)` |
# | eq. CLSystem | closed loop | `mr.ClosedLoop(system, net)`, `.step`, `.simulate` |
# | $h_{\mathcal{R}_k^{\mathcal{D}}(\mathcal{F})}(C)$, Lemma 2 | support function of a reachable set | `mr.support(loop, F, C, steps=k)` |
# | $\overline{\mathcal{R}}_1^{\mathcal{D}}(\mathcal{F})$, eq. Rover1 | outer approximation of one step | `mr.outer_step(loop, F, C)` |
# | $\overline{\mathcal{R}}_k^{\mathcal{D}}(\mathcal{F})$, eq. ROverOver | the same, $k$ times | `mr.outer_reach(loop, F, C, k)` |
# | $\mathcal{R}_1^{\mathcal{D}}(\mathcal{F})\subseteq\mathcal{F}$, Def. RPI | invariance | `mr.check_rpi(loop, F)` |
# | $\mathcal{F}_k$, $\mathcal{F}_{\max}$, $\hat{k}$, Prop. Fmax | safe set | `mr.safe_set(loop, C)`: `.history`, `.set`, `.iterations` |
# | $\overline{\mathcal{R}}_{\min}$, $\overline{k}$, $\overline{\epsilon}$, eq. TerminationFmin | terminal set | `mr.terminal_set(loop, safe, C, epsilon)`: `.set`, `.steps`, `.criterion` |
# | $\alpha$, $\delta_{\max}$, Theorem 1 | stability | `terminal.alpha`, `.delta_max`, `.stable` |
# | $(1+\underline{\epsilon})\overline{\mathcal{R}}_{\underline{k}}^{\mathcal{D}}(\mathbf{0})$, Sec. IV.B | approximation from the inside | `mr.scaled_minimal_set(loop, C, epsilon)` |
# | $f - f_{\text{PWA}}\in\mathcal{D}^{(i)}$ | approximation and its error | `mr.fit_pwa`, `mr.prove_error` |
# | Theorem 2 | ultimate boundedness | `mr.ultimately_bounded(plant, loop, safe, terminal)` |
#
# Every function says more about itself: `mr.safe_set?` in a cell.

# %% [markdown]
# ## 8. The course
#
# | notebook | what you do | exercise |
# | --- | --- | --- |
# | 01_sets_and_support_functions | compute with sets by their support functions | ex01 |
# | 02_maxout_as_mixed_integer | write a network as a mixed-integer program, and break it | ex02 |
# | 03_pwa_systems_as_mixed_integer | the same for a system with modes | ex03 |
# | 04_disturbances_and_one_step_sets | add the disturbance, draw one step, refute an RPI claim | ex04 |
# | 05_from_mpc_to_a_maxout_net | solve optimal control problems, train the 3x3 network | ex05 |
# | 06_case_study_pwa | the first case study, set by set | ex06 |
# | 07_fit_the_double_integrator | approximate a nonlinear plant, prove the error | ex07 |
# | 08_train_the_5x5_net | data by nonlinear optimal control, train the 5x5 network | ex08 |
# | 09_case_study_double_integrator | the second case study, set by set | ex09 |
# | 10_beyond_the_paper | exact cells, other centres, tighter errors, many networks | |
# | 11_your_own_system | your own plant and your own torch network | |
# | 12_disturbance_lab | drag the disturbance and watch the sets follow | |
# | 13_the_maximal_safe_set | the set that the paper calls out of reach, by going backwards | ex10 |
# | 14_beyond_the_plane | three and four tanks: the MILP alone, and what it can prove | |
#
# The notebooks 01 to 04 build on each other. 05 and 06 belong together, and so do 07, 08 and 09; 11 needs only this
# page, 12 and 13 need 06 and 09. `python3 run.py exercises` puts your copies of the exercises into
# `notebooks/exercises/release/`. Sliders need a running kernel; every slider stands below a static figure that shows
# the same.

# %% [markdown]
# **What you saw.** A few calls turn a system and a network into a proof: a set that is never left, a set that is
# always entered, or a trajectory that shows why there is no proof.
#
# **On your own.**
#
# - Replace `mr.directions(8)` by `mr.directions(16)`. Is the terminal set smaller? Why does the sequence end now?
# - Double the disturbance: `mr.case_study("pwa").loop.with_disturbance(mr.Polytope.box([-0.3, -0.3], [0.3, 0.3]))`. Is
#   there still a safe set? If not, what does `.reason` say, and what would another template have to do?
# - Claim a set of your own: `mr.check_rpi(loop, mr.Polytope.box([-3, -3], [3, 3]))`. If it is refuted, replay the
#   witness. Which of the sets in the first figure are RPI?
#
# **Further reading.** D. Teichrib and M. Schulze Darup, *A mixed-integer framework for analyzing neural network-based
# controllers for piecewise affine systems with bounded disturbances*, ECC 2025 ([Teichrib2025] throughout the course);
# for invariant sets, F. Blanchini, *Set invariance in control*, Automatica 35, 1999.
#
# **Next:** 01_sets_and_support_functions, which shows what can be done with a set of which only $h(v)$ is known.
