"""Scenarios of older versions, with versions made up for the test."""

from __future__ import annotations

import pytest

from swarmabs_config.scenario import loader
from swarmabs_config.scenario.loader import upgraded
from swarmabs_config.scenario.yaml_tree import Plain


def _rename(data: dict[str, Plain]) -> dict[str, Plain]:
    return {("plate" if key == "plane" else key): value for key, value in data.items()}


def _double(data: dict[str, Plain]) -> dict[str, Plain]:
    duration = data["duration"]
    assert isinstance(duration, int)
    return {**data, "duration": 2 * duration}


MADE_UP = (_rename, _double)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ({"schema": 1, "plane": 7, "duration": 3}, {"schema": 3, "plate": 7, "duration": 6}),
        ({"schema": 2, "plate": 7, "duration": 3}, {"schema": 3, "plate": 7, "duration": 6}),
    ],
)
def test_each_version_goes_through_all_that_came_after_it(old: dict[str, Plain], new: dict[str, Plain]) -> None:
    before = dict(old)
    assert upgraded(old, MADE_UP) == new
    assert old == before


@pytest.mark.parametrize("version", [3, 4, 0, -1, True, "1", None, 1.0])
def test_what_is_no_older_version_is_left_alone(version: Plain) -> None:
    data: dict[str, Plain] = {"schema": version, "duration": 3}
    assert upgraded(data, MADE_UP) is data


def test_scenarios_are_upgraded_before_they_are_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    def renamed(data: dict[str, Plain]) -> dict[str, Plain]:
        return {("plane" if key == "plate" else key): value for key, value in data.items()}

    monkeypatch.setattr(loader, "upgraded", renamed)
    text = "schema: 1\nplate: {angle: 0.2}\nswarm: {generate: {single_integrator: 2}}\n"
    assert loader.parse_scenario(text).plane.angle == 0.2
