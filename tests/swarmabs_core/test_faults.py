from fractions import Fraction
from hashlib import blake2b

import pytest
from hypothesis import given, strategies as st
from scipy import stats
from tests.swarmabs_core.helpers import agent_state

from swarmabs_core.errors import InputError
from swarmabs_core.faults import (
    ClockOffsetFault,
    DelayFault,
    DuplicationFault,
    Falsification,
    FalsifiedStateFault,
    InjectedFault,
    LossFault,
    ReorderingFault,
    RobotFaults,
    true_state,
)
from swarmabs_core.messages import RobotState
from swarmabs_core.parameters import SettingError
from swarmabs_core.sensing import Sensor, standard_normal


def draws(steps: int = 20) -> list[str]:
    return [RobotFaults((), 1, 3).draw(step) for step in range(steps)]


def test_draws_are_frozen() -> None:
    """A recorded run with faults can be run again by every later version."""
    assert draws(2) == ["1:0:3", "1:1:3"]
    twice = DuplicationFault(probability=0.3)
    lossy, late = LossFault(probability=0.2), ReorderingFault(probability=0.3, steps=4)
    assert [step for step, draw in enumerate(draws(40)) if lossy.loses(draw)] == [1, 2, 15, 17, 24, 26]
    assert [late.late(draw) for draw in draws()] == [0, 0, 0, 4, 0, 1, 0, 1, 2, 0, 0, 0, 0, 4, 0, 4, 0, 2, 0, 0]
    doubled = [step for step, draw in enumerate(draws()) if twice.doubles(f"{draw}:state")]
    assert doubled == [0, 4, 6, 10, 12, 14, 15, 17, 18, 19]


def test_faults_that_are_sure_and_those_without_an_effect() -> None:
    for sure in (False, True):
        assert {LossFault(probability=float(sure)).loses(draw) for draw in draws(1000)} == {sure}
    assert {DelayFault(steps=2).late(draw) for draw in draws()} == {2}
    delay, loss = DelayFault(steps=2), LossFault(probability=1.0)
    assert (delay.loses(""), delay.doubles(""), delay.clock_offset(), loss.late("")) == (False, False, 0, 0)
    assert ClockOffsetFault(offset=-1.5e-9).clock_offset() == -2
    state = agent_state(3)
    assert loss.falsified(state) is state
    lie, some = FalsifiedStateFault(agent=3, mass_factor=2.0), LossFault(probability=0.5, agents=(2, 4))
    assert [agent for agent in range(1, 6) if lie.hits(agent)] == [3]
    assert [agent for agent in range(1, 6) if some.hits(agent)] == [2, 4]
    assert LossFault(probability=0.5).hits(9)


def test_faults_of_a_robot_act_and_are_announced_while_they_last() -> None:
    loss, lie = LossFault(probability=0.25), FalsifiedStateFault(agent=3, position_offset=0.1, mass_factor=2.0)
    robot = RobotFaults((InjectedFault(loss, 2, 4), InjectedFault(lie, 3)), 1, 3)
    assert [robot.acting(step) for step in range(5)] == [[], [], [loss], [loss, lie], [lie]]
    told = {step: [text for _, text in robot.announced(step, first=False)] for step in range(5)}
    assert [len(texts) for texts in told.values()] == [0, 0, 1, 2, 1]
    assert told[4] == [f"over: {told[2][0]}"]
    assert [text for _, text in robot.announced(3, first=True)] == [*told[2], *told[3]]
    double = RobotFaults((InjectedFault(DuplicationFault(probability=1.0), 2, 3),), 1, 3)
    assert [double.double(step, "state") for step in range(4)] == [False, False, True, False]


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"position_factor": 0.0}, "position_factor.*cannot be inverted"),
        ({"position_factor": 1.0}, "falsifies nothing"),
        ({"at": 2.0, "until": 2.0, "mass_factor": 2.0}, "ends at 2.0 s, before it begins"),
    ],
)
def test_lies_that_say_nothing_are_refused(settings: dict[str, float], text: str) -> None:
    with pytest.raises(SettingError, match=text):
        FalsifiedStateFault(agent=3, **settings)


@pytest.mark.parametrize(
    "fault",
    [
        InjectedFault(LossFault(probability=0.25)),
        InjectedFault(DelayFault(steps=2), 10),
        InjectedFault(ReorderingFault(probability=0.1, steps=3), 0, 20),
        InjectedFault(ClockOffsetFault(offset=-1e-9), 3, 4),
        InjectedFault(
            FalsifiedStateFault(position_offset=0.1, position_factor=-0.3333333333333333, mass_factor=1e-3), 3, 4
        ),
    ],
)
def test_a_fault_as_a_parameter(fault: InjectedFault) -> None:
    assert InjectedFault.parse(str(fault)) == fault


def test_what_is_no_fault_is_refused() -> None:
    faults = ("", "loss", "loss 0 -1", "loss 0 -1 a", "loss 0 -1 nan", "loss -2 5 0.1", "loss 0 -1 0.1 0.2")
    lies = ("3 loss 0 -1 0.1", "lie 0 -1 0 1 2", "3 lie 0 -1 0 0 1", "x lie 0 -1 0 1 2", "")
    for form, texts in ((InjectedFault, (*faults, "kill 0 -1 1")), (Falsification, lies)):
        for text in texts:
            with pytest.raises(InputError, match="is not of the form"):
                form.parse(text)


def test_a_lie_is_undone_for_its_robot_while_it_lasts() -> None:
    lie = Falsification.parse("3 lie 10 20 0.05 2.0 0.5")
    assert Falsification.parse(str(lie)) == lie
    said = agent_state(3, 10, mass=0.25, position=0.25)
    true = true_state(said, [lie])
    assert true[6:9] == (0.5, 0.0, pytest.approx(0.1, abs=1e-15))
    assert lie.injected.fault.falsified(true) == said
    for other in (agent_state(3, 9), agent_state(3, 20), agent_state(2, 10)):
        assert true_state(other, [lie]) is other


def test_a_lie_on_another_parent_system_concerns_all_coordinates() -> None:
    lie = Falsification.parse("3 lie 10 20 0.05 2.0 1.0")
    said = RobotState(0, 10, 5, 9, 3, 1, 1, (0.25, -0.15), (0.0, 0.0), (0.0, 0.0), (0.5,))
    true = true_state(said, [lie])
    assert true == said._replace(coordinates=(pytest.approx(0.1, abs=1e-15), pytest.approx(-0.1, abs=1e-15)))
    assert lie.injected.fault.falsified(true).coordinates == pytest.approx(said.coordinates)


@pytest.mark.parametrize("text", ["1:0:plane:value", "7:803:17:rate", "2:5:3:value"])
def test_draw_is_the_quantile_of_a_hash(text: str) -> None:
    """As docs/reference/imperfections.md says, with SciPy's quantile: uniform bits make normal draws."""
    bits = int.from_bytes(blake2b(text.encode(), digest_size=8).digest(), "big") >> 12
    assert standard_normal(text) == pytest.approx(stats.norm.ppf((bits + 0.5) / 2**52), rel=1e-12)


def test_noise_of_value_and_rate_are_draws_of_their_own_and_come_before_rounding() -> None:
    noise = 0.01 * standard_normal("1:5:plane:value"), 0.3 * standard_normal("1:5:plane:rate")
    assert Sensor(noise=(0.01, 0.3)).measure(1.0, -2.0, "1:5:plane") == (1.0 + noise[0], -2.0 + noise[1])
    noisy, _ = Sensor(noise=(0.3, 0.0)).measure(0.0, 0.0, "1:5:plane")
    rounded, _ = Sensor((0.3, 0.0), (0.1, 0.0)).measure(0.0, 0.0, "1:5:plane")
    assert rounded == pytest.approx(0.1 * round(noisy / 0.1), abs=1e-15) != pytest.approx(noisy, abs=1e-3)
    assert Sensor().measure(0.1, -0.2, "") == (0.1, -0.2)
    sensors = Sensor(), Sensor(noise=(0.0, 0.1)), Sensor(resolution=(0.1, 0.0))
    assert [sensor.perfect for sensor in sensors] == [True, False, False]


@given(st.floats(-1e6, 1e6), st.floats(1e-6, 10.0))
def test_resolution_rounds_to_the_nearest_multiple(value: float, step: float) -> None:
    found, rate = Sensor(resolution=(step, 0.0)).measure(value, value, "")
    multiple = Fraction(step) * round(Fraction(value) / Fraction(step))
    assert found == pytest.approx(float(multiple), rel=1e-15, abs=1e-15 * step)
    assert rate == value
    assert Sensor(resolution=(0.0, step)).measure(value, value, "") == (value, found)
