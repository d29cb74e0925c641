"""The engines by name, and the choice between them."""

from ..checks import require_kind
from ..systems.loop import ClosedLoop
from ..tolerances import CVXPY_RESOLUTION
from .base import Engine
from .cells import Cells
from .cvxpy_model import Cvxpy
from .exact import Exact
from .milp.engine import Milp

ENGINES: dict[str, type[Engine]] = {kind.name: kind for kind in (Cells, Milp, Exact, Cvxpy)}


def engine_for(loop: ClosedLoop, engine: Engine | str | None = None) -> Engine:
    """The Engine object for a loop.

    Parameters
    ----------
    loop : ClosedLoop
    engine : Engine, str or None
        An engine; the name of one, which then has its default settings; or None, which is `Cells` for two states and
        `Milp` for more.

    Raises
    ------
    TypeError
        If it is none of these.
    ValueError
        If there is no engine of that name (the message lists them), or its resolution is no tolerance.

    Examples
    --------
    >>> from mireach import Milp, case_study
    >>> loop = case_study("pwa").loop
    >>> engine_for(loop), engine_for(loop, "exact"), engine_for(loop, Milp(time_limit=60)).time_limit
    (Cells(), Exact(most_cells=20000), 60)
    """
    require_kind(loop, ClosedLoop, "loop")
    if engine is None:
        return Cells() if loop.system.state_size == 2 else Milp()
    if isinstance(engine, str):
        if engine not in ENGINES:
            raise ValueError(f"engine must be one of {', '.join(ENGINES)} or an Engine; got {engine!r}")
        return ENGINES[engine]()
    require_kind(engine, Engine, "engine")
    if not 0 <= engine.resolution <= CVXPY_RESOLUTION:
        raise ValueError(
            f"the resolution of the engine {engine.name} must lie between 0 and {CVXPY_RESOLUTION:g}; "
            f"got {engine.resolution!r}; an engine with loose bounds keeps 0"
        )
    return engine
