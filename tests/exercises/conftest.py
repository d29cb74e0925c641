"""The solved answers of a set, for the tests of that set."""

import pytest
from helpers import run_source


@pytest.fixture(scope="module")
def solved(request):
    """The namespace of the set after which the test's module is named: test_ex06 gets that of ex06."""
    return run_source(int(request.module.__name__[-2:]))
