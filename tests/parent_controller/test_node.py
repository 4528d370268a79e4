"""The adapters of the parent controller."""

from pathlib import Path
from typing import cast

import pytest
from tests.plugin_packages import BANG_BANG, install
from tests.swarmabs_ros.nodes import realtime_settings_from, settings_from

from parent_controller import realtime
from parent_controller.node import PARAMETERS, make
from swarmabs_core.controllers import CONTROLLERS
from swarmabs_core.errors import InputError
from swarmabs_core.messages import PLANE_STATE, AbstractState, DesiredAbstractState, Mode, PlaneState
from swarmabs_core.parameters import Value
from swarmabs_core.realtime.base import CONTROLLER_PHASE
from swarmabs_ros.managed import RealtimeNode, RealtimeSpec
from swarmabs_ros.parameters import table_of
from swarmabs_ros.status import StatusChannel

CHANNEL = StatusChannel("parent_controller")
PERIOD = 10_000_000


def test_the_law_decides_which_parameters_there_are_and_whether_there_may_be_offsets(packages: Path) -> None:
    for name, law in CONTROLLERS.built_in.items():
        names = [parameter.name for parameter in table_of({"controller.type": name}, (), PARAMETERS)]
        own = {name for name in names if name.startswith("controller.")} - {"controller.type"}
        assert own == {f"controller.{setting.name}" for setting in law.settings}
    install(packages, "controller", "bang_bang", BANG_BANG)
    with pytest.raises(InputError, match="parameter offsets: the law has no method offset_torque"):
        make(settings_from(PARAMETERS, controller__type="bang_bang", offsets=("5 0.1",)), CHANNEL)
    make(settings_from(PARAMETERS, controller__type="pd", offsets=("5 0.1",)), CHANNEL)


def test_gains_period_and_manifold_reach_the_law() -> None:
    manifold = {"manifold__curvature": 0.5, "manifold__offset": 0.25, "manifold__torque_max": 3.0}
    behaviour = make(settings_from(PARAMETERS, controller__gains=(2.0, 0.0), **manifold), CHANNEL).behaviour
    desired = behaviour.handle(PlaneState(0, 0, 0.5, 0.0))[-1]
    assert isinstance(desired, DesiredAbstractState)
    assert (desired.torque, desired.inertia) == (1.0, 0.5 * 1.0 + 0.25)
    limited = behaviour.handle(PlaneState(10_000_000, 1, 1.4, 0.0))[-1]
    assert isinstance(limited, DesiredAbstractState)
    assert limited.torque <= 3.0


def in_real_time(**values: Value) -> RealtimeSpec:
    return realtime.make(realtime_settings_from(realtime.PARAMETERS, **values), cast("RealtimeNode", None))


def modes(spec: RealtimeSpec, *services: str) -> list[int]:
    """Return the modes that are published when the plane is heard at first, and after each command of an operator."""
    modes = []
    observed = AbstractState(0, 0, 4, 0.1, 0.03, 0.01, 0.002)
    spec.behaviour.hear(observed, 0)
    for step, service in enumerate(("", *services), start=1):
        now = step * PERIOD
        told = spec.services[service](now) if service else ()
        told += spec.behaviour.hear(observed._replace(stamp=now, step=step), now)
        told += spec.behaviour.hear(PlaneState(now, step, 0.1, 0.0), now)
        modes.append(next(message.mode for message in reversed(told) if isinstance(message, DesiredAbstractState)))
    return modes


def test_in_real_time_it_answers_the_plane_unless_it_is_too_old_and_takes_an_operators_commands() -> None:
    spec = in_real_time()
    assert (spec.wakes, spec.phase) == ((PLANE_STATE,), CONTROLLER_PHASE)
    assert modes(spec, "swarm/stop", "swarm/reset") == [Mode.RUN, Mode.STOP, Mode.RESET]
    assert modes(in_real_time(start_mode="stop")) == [Mode.STOP]
    assert [[*in_real_time(pair=rank).services] for rank in ("single", "primary", "standby")] == [
        ["swarm/stop", "swarm/reset"],
        ["swarm/stop", "swarm/reset", "~/release"],
        ["standby/swarm/stop", "standby/swarm/reset", "~/release"],
    ]
    behaviour = in_real_time(plane_age_limit=0.05, clock_tolerance=0.02).behaviour
    for step, refused in ((95, False), (94, True), (102, False), (103, True)):
        events = behaviour.hear(PlaneState(0, step, 0.1, 0.0), 100 * PERIOD)
        assert bool(events) == refused, step
