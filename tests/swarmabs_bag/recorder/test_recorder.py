"""The recorder as a state machine: what it writes, what it says of itself."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import pytest

from swarmabs_bag.recorder.node import CREDITS, Recorder
from swarmabs_bag.recording import RecordedStep
from swarmabs_config.graph import RECORDING_STEPS
from swarmabs_config.scenario import Scenario
from swarmabs_config.scenarios import find_scenario
from swarmabs_core import cdr
from swarmabs_core.behaviours.base import UnexpectedMessageError
from swarmabs_core.messages import EVENTS, MAIN_TOPICS, NEVER, Message, PlaneState, RecordingProgress
from swarmabs_core.record import Record
from swarmabs_run.simulation import Simulation

STEPS = 60
CREDIT_EVERY = RECORDING_STEPS // CREDITS


@dataclass
class Tape:
    """Keeps what is recorded."""

    steps: list[RecordedStep] = field(default_factory=list)

    def add(self, step: RecordedStep) -> None:
        self.steps.append(step)


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return find_scenario("pd_het_4", ["duration=0.6", "faults=[{at: 0.2, kind: kill, agent: 2}]"]).resolved()


@pytest.fixture(scope="module")
def steps(scenario: Scenario) -> list[RecordedStep]:
    return list(Simulation(scenario).steps())


@pytest.fixture(scope="module")
def messages(steps: list[RecordedStep]) -> list[Message]:
    """Return all messages as they are published: an event before what it explains."""
    return [
        record.message
        for step in steps
        for record in sorted(step.records, key=lambda record: record.topic is not EVENTS)
    ]


def recorder(scenario: Scenario) -> tuple[Recorder, Tape, list[int]]:
    tape, told = Tape(), list[int]()
    return Recorder(scenario, tape, told.append), tape, told  # type: ignore[arg-type]


def written(answers: list[Message]) -> list[int]:
    assert all(isinstance(answer, RecordingProgress) for answer in answers)
    return [answer.written_step for answer in answers if isinstance(answer, RecordingProgress)]


def test_it_begins_with_nothing_written_and_waits_for_everything(scenario: Scenario) -> None:
    node, _, _ = recorder(scenario)
    assert node.start() == (RecordingProgress(0, 0, NEVER),)
    assert set(node.awaits()) == {*MAIN_TOPICS, EVENTS}
    assert node.missing()[0] == 0
    assert not node.finished


def test_a_run_is_recorded_as_the_simulation_has_it(
    scenario: Scenario, steps: list[RecordedStep], messages: list[Message]
) -> None:
    node, tape, told = recorder(scenario)
    answers = [answer for message in messages for answer in node.handle(message)]
    assert tape.steps == steps
    assert written(answers) == [CREDIT_EVERY * n - 1 for n in range(1, STEPS // CREDIT_EVERY + 1)] + [STEPS]
    assert told[-1] == STEPS + 1
    assert node.finished
    assert node.awaits() == ()


def test_the_order_of_arrival_and_repetitions_do_not_matter(
    scenario: Scenario, steps: list[RecordedStep], messages: list[Message]
) -> None:
    node, tape, _ = recorder(scenario)
    jitter = random.Random(3)
    for _, message in sorted((message.step + 8 * jitter.random(), message) for message in [*messages, *messages]):
        node.handle(message)
    assert node.finished
    # An event that comes after its step is recorded behind it.
    recorded = Counter(record for step in tape.steps for record in step.records)
    assert recorded == Counter(record for step in steps for record in step.records)
    assert [step.step for step in tape.steps if len(step.records) > 1] == list(range(STEPS + 1))


def test_it_says_that_it_is_still_there_while_the_run_goes_on_without_it(
    scenario: Scenario, messages: list[Message]
) -> None:
    """It lacks the plane's state of step 5: the run may go on, so it has not stalled, and its credit stays."""
    node, _, _ = recorder(scenario)
    kept = [message for message in messages if not (isinstance(message, PlaneState) and message.step == 5)]
    answers = [answer for message in kept for answer in node.handle(message)]
    assert set(written(answers)) == {NEVER}
    assert len(answers) == STEPS - 5 - CREDIT_EVERY + 1
    assert node.missing() == (5, ("plane/state",))
    (late,) = [message for message in messages if isinstance(message, PlaneState) and message.step == 5]
    assert written(list(node.handle(late))) == [STEPS]
    assert node.finished


def test_repetitions_are_no_sign_of_life(scenario: Scenario, messages: list[Message]) -> None:
    node, _, _ = recorder(scenario)
    kept = [message for message in messages if not (isinstance(message, PlaneState) and message.step == 5)]
    for message in kept:
        node.handle(message)
    assert [node.handle(message) for message in kept] == [()] * len(kept)


def test_its_own_messages_are_refused(scenario: Scenario) -> None:
    node, _, _ = recorder(scenario)
    with pytest.raises(UnexpectedMessageError):
        node.handle(RecordingProgress(0, 0, NEVER))


def test_what_comes_from_the_wire_is_decoded_once_and_never_encoded(
    scenario: Scenario, steps: list[RecordedStep], messages: list[Message], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Though padding may hold anything, and Fast DDS rounds the size up."""
    node, tape, _ = recorder(scenario)
    noise = bytes([0xA5])
    sent = [(record.topic, record.payload) for record in map(Record.of, messages)]
    calls: Counter[str] = Counter()

    def counted(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any) -> Any:
            calls[name] += 1
            return function(*arguments)

        return call

    for name in ("decode", "encode"):
        monkeypatch.setattr(f"swarmabs_core.record.{name}", counted(name, getattr(cdr, name)))
        monkeypatch.setattr(cdr, name, counted(name, getattr(cdr, name)))
    for topic, payload in sent:
        node.hear(topic, payload[:2] + 2 * noise + payload[4:22] + 6 * noise + payload[28:] + 3 * noise)
    assert calls == {"decode": len(messages)}
    assert tape.steps == steps
