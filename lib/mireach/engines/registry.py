"""The engines by name, and the choice between them."""

from ..checks import require_kind
from ..errors import CellLimitError
from ..systems.loop import ClosedLoop
from ..tolerances import CVXPY_RESOLUTION
from . import space
from .base import Engine
from .cells import Cells
from .cvxpy_model import Cvxpy
from .exact import Exact
from .milp.engine import Milp
from .units import own_units

FEW_CELLS = 200_000  # up to which the cells are the default for more than two states; they take about 10 s
MOST_STATES = 6  # up to which they are tried

ENGINES: dict[str, type[Engine]] = {kind.name: kind for kind in (Cells, Milp, Exact, Cvxpy)}
OF_THE_PLANE = Cells()


def engine_for(loop: ClosedLoop, engine: Engine | str | None = None, steps: int = 1) -> Engine:
    """The Engine object for a loop.

    Parameters
    ----------
    loop : ClosedLoop
    engine : Engine, str or None
        An engine; the name of one, which then has its default settings; or None, which is `Cells` if the loop has at
        most `FEW_CELLS` cells, and `Milp` otherwise. The cells are computed for this decision and kept.
    steps : int
        Of the query. For more than two states the images of many pieces take long, so that None is `Milp` for more
        than one step.

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
    (Cells(limit=500000), Exact(most_cells=20000), 60)
    """
    require_kind(loop, ClosedLoop, "loop")
    if engine is None:
        return _fastest(loop, steps)
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


def _fastest(loop: ClosedLoop, steps: int) -> Engine:
    """`Cells`, or `Milp` for loops with too many states or cells, and for several steps of more than two states."""
    n = loop.system.state_size
    if n == 2:
        return OF_THE_PLANE
    if n > MOST_STATES or steps > 1:
        return Milp()
    try:
        space.dynamics(own_units(loop).loop, FEW_CELLS)
    except CellLimitError:
        return Milp()
    return Cells(limit=FEW_CELLS)
