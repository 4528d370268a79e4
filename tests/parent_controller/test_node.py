"""The adapter of the parent controller."""

from __future__ import annotations

import pytest
from tests.swarmabs_ros.nodes import settings_from

from parent_controller.node import PARAMETERS, make
from swarmabs_config.graph import CONTROLLER, LOCKSTEP
from swarmabs_core.behaviours import Controller
from swarmabs_core.controllers import CONTROLLERS
from swarmabs_core.messages import (
    ABSTRACT_STATE,
    AUXILIARY_STATE,
    BROADCAST,
    DESIRED_ABSTRACT_STATE,
    EVENTS,
    PLANE_STATE,
    RECORDING_PROGRESS,
    DesiredAbstractState,
    PlaneState,
)
from swarmabs_core.parameters import Value
from swarmabs_ros.parameters import table_of
from swarmabs_ros.runner import Settings
from swarmabs_ros.status import StatusChannel

CHANNEL = StatusChannel("parent_controller")


def settings_of(law: str, **values: Value) -> Settings:
    return settings_from(PARAMETERS, controller__type=law, **values)


@pytest.mark.parametrize("law", CONTROLLERS.built_in)
def test_the_law_decides_which_parameters_there_are(law: str) -> None:
    names = [parameter.name for parameter in table_of({"controller.type": law}, (), PARAMETERS)]
    own = {name for name in names if name.startswith("controller.")} - {"controller.type"}
    assert own == {f"controller.{setting.name}" for setting in CONTROLLERS.built_in[law].settings}


@pytest.mark.parametrize("law", CONTROLLERS.built_in)
def test_it_hears_the_plane_and_says_what_it_wants(law: str) -> None:
    settings = settings_of(law)
    assert isinstance(make(settings, CHANNEL).behaviour, Controller)
    ends = settings.endpoints(CONTROLLER, LOCKSTEP)
    assert set(ends.publications) == {DESIRED_ABSTRACT_STATE, EVENTS}
    assert set(ends.subscriptions) == {PLANE_STATE}


def test_it_hears_a_recorder_only_if_there_is_one() -> None:
    settings = settings_of("pd", recording_window=100)
    assert set(settings.endpoints(CONTROLLER, LOCKSTEP).subscriptions) == {PLANE_STATE, RECORDING_PROGRESS}


def test_it_packs_the_broadcasts_if_asked_to() -> None:
    settings = settings_of("pd", packed=True)
    behaviour = make(settings, CHANNEL).behaviour
    behaviour.handle(PlaneState(0, 0, 0.5, 0.0))
    assert behaviour.awaits() == (ABSTRACT_STATE,)
    ends = settings.endpoints(CONTROLLER, LOCKSTEP)
    assert set(ends.publications) == {DESIRED_ABSTRACT_STATE, BROADCAST, EVENTS}
    assert set(ends.subscriptions) == {PLANE_STATE, ABSTRACT_STATE, AUXILIARY_STATE}


def test_gains_and_manifold_reach_the_law() -> None:
    settings = settings_of(
        "pd",
        controller__gains=(2.0, 0.0),
        manifold__curvature=0.5,
        manifold__offset=0.25,
        manifold__torque_max=3.0,
    )
    behaviour = make(settings, CHANNEL).behaviour
    desired = behaviour.handle(PlaneState(0, 0, 0.5, 0.0))[-1]
    assert isinstance(desired, DesiredAbstractState)
    assert desired.torque == 1.0
    assert desired.inertia == 0.5 * 1.0 + 0.25
    limited = behaviour.handle(PlaneState(10_000_000, 1, 1.4, 0.0))[-1]
    assert isinstance(limited, DesiredAbstractState)
    assert limited.torque <= 3.0
