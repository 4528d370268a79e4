"""A small run and bags of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeAlias

import pytest

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
)

Run: TypeAlias = Sequence[Message]
WriteBag: TypeAlias = Callable[..., Path]

STEPS = 40
AGENTS = (1, 2, 7)
PERIOD = 10_000_000

SCENARIO = b"""schema: 1
name: sample
duration: 0.4
seed: 5
swarm:
  agents:
    - {id: 1, kind: single_integrator, mass: 0.4, position: 0.1}
    - {id: 2, kind: single_integrator, mass: 0.5, position: -0.1}
    - {id: 7, kind: double_integrator, mass: 0.6, damping: 0.7, position: 0.2}
"""
PROVENANCE = b'{"versions": {"swarmabs": "1.2.3"}, "libm_fingerprint": "abc123"}'


def make_run(steps: int = STEPS, agents: Sequence[int] = AGENTS) -> list[Message]:
    """Return a run whose numbers are all different and have no short binary form."""
    run: list[Message] = []
    for step in range(steps + 1):
        stamp, x = step * PERIOD, math.sqrt(step + 2)
        run += [
            AgentState(
                stamp,
                step,
                step - 1 if step else NEVER,
                agent,
                Kind.DOUBLE_INTEGRATOR if agent == 7 else Kind.SINGLE_INTEGRATOR,
                Status.ACTIVE,
                0.1 * agent,
                0.7 if agent == 7 else 0.0,
                x / agent,
                -x / 3,
                x / 7 + agent,
            )
            for agent in agents
        ]
        run += [
            PlaneState(stamp, step, x, -x / 9),
            AbstractState(stamp, step, len(agents), x / 2, x / 4, x / 5, x / 6),
            AuxiliaryState(stamp, step, *(x / divisor for divisor in range(11, 19))),
            DesiredAbstractState(stamp, step, Mode.RUN, *(x / divisor for divisor in range(21, 29))),
        ]
        if step == 3:
            run.append(SwarmEvent(stamp, step, 7, EventKind.LIMIT_HIT, 1 / 3, "speed limit – größer"))
    return run


@pytest.fixture(scope="session")
def run() -> Run:
    return make_run()


@pytest.fixture(scope="session")
def write_bag(run: Run) -> WriteBag:
    """Return a function that writes the run, or another one, and returns the bag's folder."""

    def write(folder: Path, messages: Run = run, *, chunk_bytes: int = 4000, namespace: str = "/") -> Path:
        with BagWriter(
            folder,
            topics=(*MAIN_TOPICS, EVENTS),
            attachments={"scenario.yaml": SCENARIO, "provenance.json": PROVENANCE},
            chunk_bytes=chunk_bytes,
            namespace=namespace,
        ) as writer:
            for message in messages:
                writer.write(TOPIC_OF[type(message)], message.stamp, encode(message))
            writer.close({"run.log": b"all went well\n"})
        return folder

    return write


@pytest.fixture(scope="session")
def bag(tmp_path_factory: pytest.TempPathFactory, write_bag: WriteBag) -> Path:
    """Return the folder of a complete bag of the run, in several chunks; not to be changed."""
    return write_bag(tmp_path_factory.mktemp("complete") / "bag")
