"""What the search has found in the nodes: each case once broke a property."""

import pytest
from tests.virtual.schedule import Case, Fault
from tests.virtual.search import run

FOUND = {
    "an observer that is heard and hears nothing leads on": Case(
        5061, robots=3, hertz=50, paired=True, faults=(Fault(3.195, "cut", "*>abstraction_observer", 3.0),)
    ),
}


@pytest.mark.parametrize("case", FOUND.values(), ids=FOUND)
def test_what_once_broke_holds(case: Case) -> None:
    assert str(run(case).broken) == "None"
