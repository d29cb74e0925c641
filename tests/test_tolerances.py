"""The tiers of the tolerances: each is derived from the one below."""

from mireach import tolerances as t


def test_the_tiers_are_in_order():
    machine = (t.ROUNDOFF, t.EXPRESSION, t.CORNER, t.HALF_PLANE, t.LARGE_IMAGE, t.AROUND)
    assert list(machine) == sorted(machine)
    assert max(machine) < t.TOUCH < t.BOUND_GRID < t.FEASIBILITY  # rounding < same corner < grid of bounds < solver
    assert t.MIP_GAP < t.INTEGRALITY < t.MILP_RESOLUTION  # what a MILP resolves is coarser than what HiGHS is asked for
    assert t.INTEGRALITY + t.MIP_GAP + t.MILP_MARGIN < t.LOOSE_MILP_BOUND < t.MILP_RESOLUTION < t.CVXPY_RESOLUTION
    assert (
        t.TOUCH < t.CLEAR < t.INPUT_TOLERANCE < t.MILP_RESOLUTION
    )  # a clear excess is no rounding, yet far below a verdict
    assert t.SMALLEST < t.UNDERFLOW < t.SMALL_PRODUCTS < t.ROUNDOFF
