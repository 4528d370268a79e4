"""Small runs of three robots, as the messages that a bag of them holds."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from swarmabs_bringup.bag import BagWriter
from swarmabs_core.cdr import encode
from swarmabs_core.messages import (
    EVENTS,
    MAIN_TOPICS,
    NEVER,
    TOPIC_OF,
    AbstractState,
    AgentState,
    AuxiliaryState,
    DesiredAbstractState,
    EventKind,
    Kind,
    Message,
    Mode,
    PlaneState,
    Status,
    SwarmEvent,
    Topic,
)

AGENTS = (1, 2, 7)
PERIOD = 10_000_000


def make_step(step: int, agents: Sequence[int] = AGENTS, period: int = PERIOD) -> Iterator[Message]:
    stamp, x = step * period, 1.0 + step / 7
    for agent in agents:
        sent = step - 1 if step else NEVER
        moving = (0.1 * agent, 0.0, x / agent / 10, -x / 3, x / 7 + agent)
        yield AgentState(stamp, step, sent, agent, Kind.SINGLE_INTEGRATOR, Status.ACTIVE, *moving)
    yield PlaneState(stamp, step, x / 20, -x / 9)
    yield AbstractState(stamp, step, len(agents), x / 2, x / 4, x / 5, x / 6)
    yield AuxiliaryState(stamp, step, *(x / divisor for divisor in range(11, 19)))
    yield DesiredAbstractState(stamp, step, Mode.RUN, *(x / divisor for divisor in range(21, 29)))


def make_run(last_step: int = 20, agents: Sequence[int] = AGENTS, period: int = PERIOD) -> list[Message]:
    run = [message for step in range(last_step + 1) for message in make_step(step, agents, period)]
    return [*run, SwarmEvent(3 * period, 3, 7, EventKind.LIMIT_HIT, 0.25, "speed")]


def changed(run: Iterable[Message], message: Message, **fields: object) -> list[Message]:
    """Return the run with another message in the place of one."""
    return [one._replace(**fields) if one == message else one for one in run]  # type: ignore[arg-type]


def of_bag(run: Iterable[Message]) -> Iterator[tuple[Topic, int, Message]]:
    """Return what `BagReader.decoded` yields of a bag of the run."""
    return ((TOPIC_OF[type(message)], message.stamp, message) for message in run)


def write_bag(
    folder: Path, run: Iterable[Message], attachments: dict[str, bytes] | None = None, *, chunk_bytes: int = 4000
) -> Path:
    topics = (*MAIN_TOPICS, EVENTS)
    with BagWriter(folder, topics=topics, attachments=attachments or {}, chunk_bytes=chunk_bytes) as writer:
        for message in run:
            writer.write(TOPIC_OF[type(message)], message.stamp, encode(message))
        writer.close()
    return folder
