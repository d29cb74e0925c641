"""Templates."""

import numpy as np

from mireach import box_directions, directions


def test_directions_are_unit_rows_with_exact_axes():
    C = directions(8)
    np.testing.assert_allclose(np.linalg.norm(C, axis=1), 1)
    assert C[[0, 2, 4, 6]].tolist() == [[1, 0], [0, 1], [-1, 0], [0, -1]]
    assert box_directions(2).tolist() == [[1, 0], [0, 1], [-1, 0], [0, -1]]
