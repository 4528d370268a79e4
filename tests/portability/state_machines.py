"""``python state_machines.py SYSTEMS HARD_CASES``: digests of runs, with the standard library and swarmabs_core alone.

The first file holds, pickled, the nodes of some scenarios (`Node`); the second one arguments of functions. What is
printed, as JSON, depends on neither machine nor interpreter, except for what `library` says.
"""

import json
import math
import pickle
import struct
import sys
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any

from swarmabs_core import elementary
from swarmabs_core.cdr import encode
from swarmabs_core.messages import TOPIC_OF, Message

Node = tuple[type, Any, Sequence[str]]
"""The state machine of a node, its configuration, and the names of the topics to which it subscribes."""


def digest(nodes: Iterable[Node], main: Sequence[str]) -> str:
    """Run the nodes of a scenario; return the digest of the run (docs/reference/results.md)."""
    subscribers: dict[str, list[Callable[[Message], Iterable[Message]]]] = {}
    pending: deque[Message] = deque()
    for machine, configuration, topics in nodes:
        node = machine(configuration)
        for topic in topics:
            subscribers.setdefault(topic, []).append(node.handle)
        pending.extend(node.start())
    recorded = []
    while pending:
        message = pending.popleft()
        topic = TOPIC_OF[type(message)].name
        if topic in main:
            recorded.append((message.step, topic, getattr(message, "agent_id", 0), encode(message)))
        for handle in subscribers.get(topic, ()):
            pending.extend(handle(message))
    total = sha256()
    for _, topic, _, payload in sorted(set(recorded)):  # a duplicated message counts once
        total.update(topic.encode() + b"\0" + struct.pack("<I", len(payload)) + payload)
    return total.hexdigest()


def values(functions: object, cases: Sequence[tuple[str, float]]) -> str:
    """Return the hash of what functions of a module, given by their names and arguments, return."""
    total = sha256()
    for name, argument in cases:
        try:
            value = getattr(functions, name)(argument)
        except (AttributeError, OverflowError):
            continue
        total.update(struct.pack("<d", value))
    return total.hexdigest()


def main() -> None:
    with Path(sys.argv[1]).open("rb") as file:
        topics, systems = pickle.load(file)
    lines = Path(sys.argv[2]).read_text(encoding="utf-8").splitlines()
    cases = [(name, float.fromhex(x)) for name, x in (line.split() for line in lines if line[0] != "#")]
    result = {
        "digests": {name: digest(nodes, topics) for name, nodes in systems.items()},
        "elementary": values(elementary, cases),
        "library": values(math, cases),
        "numpy": "numpy" in sys.modules,
    }
    sys.stdout.write(f"{json.dumps(result)}\n")


if __name__ == "__main__":
    main()
