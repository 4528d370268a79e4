"""A small run of three robots, as the messages that a bag of it holds, and bags of such messages."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from swarmabs_bag.writer import BagWriter
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
)

AGENTS = (1, 2, 7)
PERIOD = 10_000_000


def make_step(step: int, agents: Sequence[int] = AGENTS, period: int = PERIOD) -> Iterator[Message]:
    """Return the messages of a step, whose numbers are all different and have no short binary form."""
    stamp, x = step * period, math.sqrt(step + 2)
    for agent in agents:
        kind, damping = (Kind.DOUBLE_INTEGRATOR, 0.7) if agent == 7 else (Kind.SINGLE_INTEGRATOR, 0.0)
        moving = (0.1 * agent, damping, x / agent, -x / 3, x / 7 + agent)
        yield AgentState(stamp, step, step - 1 if step else NEVER, agent, kind, Status.ACTIVE, *moving)
    yield PlaneState(stamp, step, x, -x / 9)
    yield AbstractState(stamp, step, len(agents), x / 2, x / 4, x / 5, x / 6)
    yield AuxiliaryState(stamp, step, *(x / divisor for divisor in range(11, 19)))
    yield DesiredAbstractState(stamp, step, Mode.RUN, *(x / divisor for divisor in range(21, 29)))


def make_run(steps: int = 20, agents: Sequence[int] = AGENTS, period: int = PERIOD) -> list[Message]:
    """Return a run with an event in step 3."""
    run: list[Message] = []
    for step in range(steps + 1):
        run += make_step(step, agents, period)
        if step == 3:
            run.append(SwarmEvent(step * period, step, 7, EventKind.LIMIT_HIT, 1 / 3, "speed limit – größer"))
    return run


def changed(run: Iterable[Message], message: Message, **fields: object) -> list[Message]:
    """Return the run with another message in the place of one."""
    return [one._replace(**fields) if one == message else one for one in run]  # type: ignore[arg-type]


def write_bag(
    folder: Path,
    run: Iterable[Message],
    attachments: Mapping[str, bytes] | None = None,
    *,
    at_end: Mapping[str, bytes] | None = None,
    aborted: str = "",
    chunk_bytes: int = 4000,
    namespace: str = "/",
) -> Path:
    """Write a bag of a run, in several chunks, and return its folder."""
    with BagWriter(
        folder,
        topics=(*MAIN_TOPICS, EVENTS),
        attachments=dict(attachments or {}),
        chunk_bytes=chunk_bytes,
        namespace=namespace,
    ) as writer:
        for message in run:
            writer.write(TOPIC_OF[type(message)], message.stamp, encode(message))
        if aborted:
            writer.abort(aborted)
        else:
            writer.close(dict(at_end or {}))
    return folder
