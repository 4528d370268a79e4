"""The digests of the page are those of the scenarios."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.conftest import temporary_packages
from tests.docs.pages import script
from tests.frozen.digests import CASES

from swarmabs_config.scenarios import builtin_scenarios

DIGESTS: Any = script("docs/digests.py")
LONG = "_40", "payload_8", "overloaded"
"""Ends of the names of examples that take 2 to 10 s."""


@pytest.fixture(scope="module", autouse=True)
def installed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Install the packages of the examples for the tests of this module alone."""
    with temporary_packages(DIGESTS.EXAMPLES):
        DIGESTS.install(tmp_path_factory.mktemp("packages"))
        yield


def test_every_scenario_is_on_the_page() -> None:
    assert [*DIGESTS.stated()] == DIGESTS.scenarios()


@pytest.mark.parametrize("name", builtin_scenarios())
def test_a_built_in_scenario_has_its_frozen_digest(name: str) -> None:
    (frozen,) = (case["summary"] for case in CASES.values() if case["scenario"] == name and not case["set"])
    assert DIGESTS.stated()[name] == frozen["digest"]


@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.full] * Path(name).stem.endswith(LONG))
        for name in DIGESTS.scenarios()
        if name not in builtin_scenarios()
    ],
)
@pytest.mark.system
def test_an_example_has_the_digest_of_the_page(name: str) -> None:
    assert DIGESTS.digest(name) == DIGESTS.stated()[name]
