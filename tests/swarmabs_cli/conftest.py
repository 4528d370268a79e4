"""The command line in this process, in a folder of the test, and bags as other writers would have written them."""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from tests.frozen.command import Finished, swarm
from tests.swarmabs_analysis.figures.conftest import record

from swarmabs_bag.run.writer import BAG_FILE

Change = Callable[[str, int, bytes], bytes | None]
"""Topic, number of the message on it, and bytes in; the bytes that are to be there out, None to leave them out."""


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Be in a folder of the test."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a run of 0.3 s with four robots; not to be changed."""
    return record(tmp_path_factory.mktemp("runs") / "run", "pd_het_4")


def ran(*words: object, code: int = 0) -> Finished:
    """Run a command that ends with this exit code."""
    done = swarm(words, Path.cwd())
    assert done.code == code, done.err
    return done


def document(*words: object, code: int = 0) -> Any:
    """Run a command and return the one JSON document that it printed."""
    return json.loads(ran(*words, "--json", code=code).out, parse_constant=pytest.fail)


def refused(*words: object) -> str:
    """Run a command that refuses in one line, prints nothing else and leaves the folder as it is; return the line."""
    before = _listing()
    done = ran(*words, code=2)
    assert done.out == "" and done.err.startswith("error: ") and done.err.count("\n") == 1, done
    assert _listing() == before
    return done.err


def _listing() -> list[tuple[Path, int]]:
    """Return everything in the folder, with sizes."""
    return sorted((path, path.stat().st_size) for path in Path.cwd().rglob("*"))


def unchanged(_topic: str, _number: int, data: bytes) -> bytes:
    return data


def rewritten(
    run: Path,
    target: Path,
    change: Change = unchanged,
    attachments: Mapping[str, bytes | None] = {},
    published: Callable[[str, int], int] = lambda _topic, _number: 0,
    more: Mapping[str, bytes] = {},
    namespaces: Sequence[str] = ("",),
    *,
    publish_times: bool = True,
    **options: Any,
) -> Path:
    """Write the messages and attachments of a bag with the mcap library, into each of some namespaces.

    Messages and attachments may be changed, left out (None), or published later, by ns, or at no known time; there may
    be more attachments.
    """
    with (run / "bag" / BAG_FILE).open("rb") as source, target.open("wb") as sink:
        reader, writer = make_reader(source), Writer(sink, **options)
        writer.start(profile="ros2", library="another")
        kept = {attachment.name: attachment.data for attachment in reader.iter_attachments()}
        for name, data in (*{**kept, **attachments}.items(), *more.items()):
            if data is not None:
                writer.add_attachment(0, 0, name, "text/plain", data)
        channels: dict[str, int] = {}
        numbers: dict[str, int] = {}
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            assert schema is not None
            for topic in (namespace + channel.topic for namespace in namespaces):
                number = numbers[topic] = numbers.get(topic, -1) + 1
                data = change(topic, number, message.data)
                if data is None:
                    continue
                if topic not in channels:
                    made = writer.register_schema(schema.name, schema.encoding, schema.data)
                    channels[topic] = writer.register_channel(topic, "cdr", made, dict(channel.metadata))
                time = message.publish_time + published(topic, number) if publish_times else 0
                writer.add_message(channels[topic], message.log_time, data, time)
        writer.finish()
    return target


def flipped(data: bytes, bit: int) -> bytes:
    """Return bytes with one bit changed."""
    changed = bytearray(data)
    changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)


def last_command(topic: str, number: int, data: bytes, namespace: str = "") -> bytes:
    """Change the lowest bit of the command, which is the last field, of robot 3 in step 7 of four robots."""
    changed = (topic, number) == (f"{namespace}/swarm/agent_state", 4 * 7 + 2)
    return flipped(data, 8 * (len(data) - 8)) if changed else data
