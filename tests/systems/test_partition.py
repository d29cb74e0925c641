"""The regions of a system must cover X x U without overlap, whatever the units."""

import re
import warnings

import numpy as np
import pytest
from loops import cut_regions, random_loop
from modes import U, X, halves, mode

from mireach import Polytope, PWASystem


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("with_input", [False, True])
@pytest.mark.parametrize(("n", "m"), [(1, 1), (2, 1), (2, 2), (3, 1)])
def test_random_partitions_are_accepted_and_a_missing_region_is_not(seed, with_input, n, m):
    rng = np.random.default_rng(seed)
    X, U = Polytope.box(-3 * np.ones(n), 3 * np.ones(n)), Polytope.box(-np.ones(m), np.ones(m))
    regions = cut_regions(rng, n, m, 3, with_input, 3.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        PWASystem([mode(region, n=n, m=m) for region in regions], X, U)
        fat = [(X.product(U) & region).chebyshev()[1] > 1e-6 for region in regions]
        kept = [mode(region, n=n, m=m) for i, region in enumerate(regions) if i != np.argmax(fat)]
        with pytest.raises(ValueError, match="no region contains x = "):
            PWASystem(kept, X, U)
        with pytest.raises(ValueError, match="overlap around x = "):
            PWASystem([*kept, *2 * [mode(regions[int(np.argmax(fat))], n=n, m=m)]], X, U)


@pytest.mark.parametrize("normal", [[1, 0, 0], [0, 0, 1], [0.3, -1, 0.5]], ids=["x", "u", "x and u"])
def test_gaps_and_overlaps_are_found_and_shown(normal):
    PWASystem(halves(normal, 0.1, 0.1), X, U)
    with pytest.raises(ValueError, match=r"modes 1 and 2 overlap around x = \[.*\], u = \["):
        PWASystem(halves(normal, 0.1, 0.09), X, U)
    with pytest.raises(ValueError, match="must cover all") as error:
        PWASystem(halves(normal, 0.1, 0.11), X, U)
    assert 0.1 < np.dot(normal, shown_numbers(error)[:3]) < 0.11


def test_shown_gap_is_a_gap():
    with pytest.raises(ValueError) as error:
        PWASystem(halves([1, 1, 4], 0.0, 0.2), X, U)
    x1, x2, u = shown_numbers(error)[:3]
    assert 0 < x1 + x2 + 4 * u < 0.2 and X.contains([x1, x2]) and U.contains([u])


def shown_numbers(error):
    """The numbers of x = [...], u = [...] in a message."""
    return [float(number) for number in re.findall(r"-?\d+\.\d+", str(error.value))]


@pytest.mark.parametrize("scale", [2.0**-60, 1.0, 2.0**60])
@pytest.mark.parametrize("width", [2e-7, 1e-12, 2.0**-52])
def test_a_gap_is_found_however_narrow_and_its_rows_are_named(width, scale):
    X, far, edge = Polytope.box([-2 * scale] * 2, [2 * scale] * 2), 9 * scale, scale * (1 + width)
    below, above = Polytope([[1.0, 0, 0], [0, 1, 0]], [far, scale]), Polytope([[-1.0, 0, 0], [0, -1, 0]], [far, -edge])
    with pytest.raises(
        ValueError, match=r"between row 2 of mode 1 and row 2 of mode 2, in a gap of width .*same numbers"
    ):
        PWASystem([mode(below), mode(above)], X, U)


def test_a_boundary_has_to_be_written_with_the_same_numbers():
    """1/3 as a float lies below one third, so that x1 <= 1/3 and 3 x1 >= 1 leave a gap; the other way they overlap."""
    third = mode(Polytope([[1.0, 0, 0]], [1 / 3])), mode(Polytope([[-3.0, 0, 0]], [-1.0]))
    with pytest.raises(ValueError, match="write it with the same numbers"):
        PWASystem(third, X, U)
    PWASystem([mode(Polytope([[3.0, 0, 0]], [1.0])), mode(Polytope([[-1.0, 0, 0]], [-1 / 3]))], X, U)
    short = float(np.float32(0.3))  # lies above 0.3
    PWASystem([mode(Polytope([[1.0, 0, 0]], [short])), mode(Polytope([[-1.0, 0, 0]], [-0.3]))], X, U)
    with pytest.raises(ValueError, match="write it with the same numbers"):
        PWASystem([mode(Polytope([[1.0, 0, 0]], [0.3])), mode(Polytope([[-1.0, 0, 0]], [-short]))], X, U)


def test_a_row_of_zeros_bounds_nothing():
    PWASystem([mode(Polytope([[0.0, 0, 0], [1, 0, 0]], [0.0, 9]))], X, U)


def test_regions_need_to_cover_only_what_is_in_the_domain():
    PWASystem([mode(Polytope([[1.0, 0, 0]], [2.0]))], X, U)
    with pytest.raises(ValueError, match="must cover all"):
        PWASystem([mode(Polytope([[1.0, 0, 0]], [1.9]))], X, U)


def test_mode_that_misses_the_domain_only_warns():
    far = mode(Polytope([[-1.0, 0, 0]], [-50.0]))
    everywhere = mode(Polytope([[1.0, 0, 0]], [50.0]))
    with pytest.warns(UserWarning, match=r"mode 2 does not meet X x U") as caught:
        system = PWASystem([everywhere, far], X, U)
    assert len(system.modes) == 2 and caught[0].filename == __file__


def test_flat_state_set_is_accepted():
    segment = Polytope.box([-1, 0], [1, 0])
    assert PWASystem(halves([1, 0, 0], 0, 0), segment, U).state_size == 2


def test_regions_on_which_the_dual_simplex_stalls_are_checked_all_the_same():
    loop = random_loop(2275, cuts=3, with_input=True, saturated=True, layers=1, width=2, pool=1)  # "Unknown" by HiGHS
    assert len(loop.system.modes) == 4
