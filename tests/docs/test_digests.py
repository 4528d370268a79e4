"""The digests of the page are those of the scenarios."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.conftest import temporary_packages
from tests.docs.pages import script

DIGESTS: Any = script("docs/digests.py")


@pytest.fixture(scope="module", autouse=True)
def installed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Install the packages of the examples for the tests of this module alone."""
    with temporary_packages(DIGESTS.EXAMPLES):
        DIGESTS.install(tmp_path_factory.mktemp("packages"))
        yield


def test_every_scenario_is_on_the_page() -> None:
    assert [*DIGESTS.stated()] == DIGESTS.scenarios()


@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.full] * Path(name).stem.endswith("_40"))  # of 5 to 10 s
        for name in DIGESTS.scenarios()
    ],
)
def test_a_scenario_has_the_digest_of_the_page(name: str) -> None:
    assert DIGESTS.digest(name) == DIGESTS.stated()[name]
