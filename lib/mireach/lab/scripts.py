"""The Python that a disturbance lab saves: it computes the same sets without the lab."""

from .answers import MAX_ITERATIONS, MAX_STEPS
from .controls import Settings, Subject, epsilon_of


def script(subject: Subject, settings: Settings) -> str:
    """Lines of Python that compute `safe` and `terminal` of these settings without the lab.

    Raises
    ------
    TypeError, ValueError
        As `Subject.settle`.

    Examples
    --------
    >>> from mireach.lab import subject
    >>> script(subject("pwa"), {}).splitlines()[0]
    'import mireach as mr'
    """
    settings = subject.settle(settings)
    safe, other = (subject.template(name, settings).source for name in ("safe_directions", "directions"))
    lines = [
        *subject.source(settings),
        "D = [mode.disturbance for mode in loop.system.modes]",
        f"loop = loop.with_disturbance([mr.Polytope(one.H, {settings['amount']} * one.h) for one in D])",
        f"safe = mr.safe_set(loop, {safe}, max_iterations={MAX_ITERATIONS})",
        "print(safe.verdict, safe.iterations, safe.reason)",
        "if safe.set:",
        f"    C, epsilon = {other}, {epsilon_of(settings)}",
        f"    terminal = mr.terminal_set(loop, safe, C, epsilon, {settings['centre']!r}, max_steps={MAX_STEPS})",
        "    print(terminal.steps, terminal.alpha, terminal.reason)",
    ]
    return "\n".join(lines) + "\n"
