"""A small run of three robots, as the messages that a bag of it holds, and bags of such messages."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from swarmabs_bag.run.writer import BagWriter
from swarmabs_core import messages as msg
from swarmabs_core.cdr import encode

AGENTS = (1, 2, 7)
PERIOD = 10_000_000
SCENARIO = """schema: 1
name: sample
duration: 0.4
seed: 5
swarm:
  agents:
    - {id: 1, kind: single_integrator, mass: 0.1, position: 0.1}
    - {id: 2, kind: single_integrator, mass: 0.2, position: -0.1}
    - {id: 7, kind: double_integrator, mass: 0.7, damping: 0.7, position: 0.2}
"""


def make_step(step: int, agents: Sequence[int] = AGENTS, period: int = PERIOD) -> Iterator[msg.Message]:
    """Return the messages of a step, whose numbers are all different and have no short binary form."""
    stamp, x = step * period, math.sqrt(step + 2)
    for agent in agents:
        kind, damping = (msg.Kind.DOUBLE_INTEGRATOR, 0.7) if agent == 7 else (msg.Kind.SINGLE_INTEGRATOR, 0.0)
        moving = (0.1 * agent, damping, x / agent, -x / 3, x / 7 + agent)
        yield msg.AgentState(stamp, step, step - 1 if step else msg.NEVER, agent, kind, msg.Status.ACTIVE, *moving)
    yield msg.PlaneState(stamp, step, x, -x / 9)
    yield msg.AbstractState(stamp, step, len(agents), x / 2, x / 4, x / 5, x / 6)
    yield msg.AuxiliaryState(stamp, step, *(x / divisor for divisor in range(11, 19)))
    yield msg.DesiredAbstractState(stamp, step, msg.Mode.RUN, *(x / divisor for divisor in range(21, 29)))


def make_run(steps: int = 20, agents: Sequence[int] = AGENTS, period: int = PERIOD) -> list[msg.Message]:
    """Return a run with an event in step 3."""
    run: list[msg.Message] = []
    for step in range(steps + 1):
        run += make_step(step, agents, period)
        if step == 3:
            run.append(msg.SwarmEvent(step * period, step, 7, msg.EventKind.LIMIT_HIT, 1 / 3, "speed limit – größer"))
    return run


def changed(run: Iterable[msg.Message], message: msg.Message, **fields: object) -> list[msg.Message]:
    """Return the run with another message in the place of one."""
    return [one._replace(**fields) if one == message else one for one in run]  # type: ignore[arg-type]


def write_bag(
    folder: Path,
    run: Iterable[msg.Message],
    attachments: Mapping[str, bytes] | None = None,
    *,
    at_end: Mapping[str, bytes] | None = None,
    aborted: str = "",
    chunk_bytes: int = 4000,
    **options: Any,
) -> Path:
    """Write a bag of a run, in several chunks, and return its folder; options are those of the writer."""
    writer = bag_writer(folder, attachments, chunk_bytes=chunk_bytes, **options)
    with writer:
        write_all(writer, run)
        if aborted:
            writer.abort(aborted)
        else:
            writer.close(dict(at_end or {}))
    return folder


def bag_writer(
    folder: Path, attachments: Mapping[str, bytes] | None = None, *, more: Sequence[msg.Topic] = (), **options: Any
) -> BagWriter:
    """Return a writer for the topics of a run, and for more of them."""
    topics = (*msg.MAIN_TOPICS, msg.EVENTS, *more)
    return BagWriter(folder, topics=topics, attachments=dict(attachments or {}), **options)


def write_all(writer: BagWriter, run: Iterable[msg.Message]) -> None:
    """Write the messages of a run."""
    for message in run:
        writer.write(msg.TOPIC_OF[type(message)], message.stamp, encode(message))


def payloads(run: Iterable[msg.Message]) -> list[bytes]:
    """Return the messages of a run as they are written."""
    return [encode(message) for message in run]
