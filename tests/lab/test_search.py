"""The largest disturbance: bisection against limits that are known."""

import numpy as np
import pytest

import mireach as mr
from mireach import lab
from mireach.lab.search import ACCURACY


@pytest.mark.parametrize(("limit", "wanted"), [(0.3, 0.3), (0.0, 0.0), (-1, None), (5, 2.0)])
def test_bisection_closes_in_on_the_largest_amount(limit, wanted):
    known, tries = {}, 0
    while (amount := lab.next_amount(known, 0.0, 2.0)) is not None:
        known[amount] = mr.Polytope.box([0], [1]) if amount <= limit else None
        tries += 1
    found = lab.largest_amount(known)
    assert tries < 40 and (found is None if wanted is None else wanted - 2 * ACCURACY <= found <= wanted)


def test_largest_disturbance_of_a_contraction_is_known_by_hand():
    # x+ = x / 2 + d with |d| <= 0.1 a: X = [-1, 1]^2 is invariant up to a = 5
    X, U = mr.Polytope.box([-1, -1], [1, 1]), mr.Polytope.box([-1], [1])
    mode = mr.Mode(0.5 * np.eye(2), [[0], [0]], [0, 0], X.product(U), mr.Polytope.box([-0.2, -0.2], [0.2, 0.2]))
    network = mr.MaxoutNetwork([], np.zeros((1, 2)), np.zeros(1))
    subject, known = lab.subject(mr.ClosedLoop(mr.PWASystem([mode], X, U), network)), {}
    while (amount := lab.next_amount(known, 0.0, 3.0)) is not None:
        known[amount] = lab.safe_set_at(subject, {}, amount)
    assert lab.largest_amount(known) == pytest.approx(2.5, abs=3 * ACCURACY)
