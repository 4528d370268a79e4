"""What an answer to a damaged bag may look like, and what other readers say of it."""

import hashlib
import io
import warnings
from collections import Counter
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import TypeVar

from mcap.reader import make_reader
from rosbags.rosbag2 import Reader

from swarmabs_bag.reader import BagReader, open_bag
from swarmabs_cli import main
from swarmabs_core.errors import SwarmabsError

T = TypeVar("T")


class WrongAnswerError(Exception):
    """Something read a damaged bag and gave an answer that should not be."""


def content(path: Path, *, damaged: bool = False) -> tuple[str, dict[str, bytes | None]]:
    """Return the digest of all messages in file order, and the attachments."""
    bag = open_bag(path, damaged=damaged)
    digest = hashlib.sha256()
    for channel, message in bag.stored_messages():
        digest.update(f"{channel.name} {message.log_time} {len(message.payload)} ".encode() + message.payload)
    attachments = {entry.name: bag.attachment(entry.name) for entry in bag.index.attachments}
    bag.aborted()
    return digest.hexdigest(), attachments


def kept(bag: BagReader) -> Counter[tuple[str, int, int, bytes]]:
    """Return the messages: topic, log and publish time, bytes."""
    return Counter((c.name, m.log_time, m.publish_time, m.payload) for c, m in bag.stored_messages())


def tried(read: Callable[[], T]) -> T | SwarmabsError:
    """Return what is read, or the error: one short line that cannot steer a terminal."""
    try:
        return read()
    except SwarmabsError as error:
        if not str(error).isprintable() or len(str(error)) > 1000:
            raise WrongAnswerError(f"an error of {len(str(error))} characters: {str(error)[:300]!r}") from error
        return error


def command(*arguments: str | Path) -> tuple[int, str]:
    """Return exit code and standard output of a command.

    If it fails there is an answer on standard output, or one line of error and nothing else. What it prints cannot
    steer a terminal, and no library prints a warning.
    """
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err), warnings.catch_warnings():
        warnings.simplefilter("always")
        code = main([str(argument) for argument in arguments])
    said = [line for line in err.getvalue().split("\n") if line]
    errors = [line for line in said if line.startswith("error: ")]
    if (
        code not in {0, 1, 2}
        or len(errors) > (code != 0)
        or (code and not out.getvalue() and len(errors) != len(said))
        or any("Warning" in line or "Traceback" in line for line in said)
        or any(len(line) > 1000 for line in errors)
        or not all(line.isprintable() for line in (*said, *out.getvalue().split("\n")))
    ):
        raise WrongAnswerError(f"swarm {arguments} exits {code} and says {err.getvalue()[:500]!r}")
    return code, out.getvalue()


def check_with_mcap(files: list[Path]) -> Counter[bytes]:
    """Return the payloads of whole files as the mcap library reads them by their indexes."""
    found: Counter[bytes] = Counter()
    for file in files:
        with file.open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            found.update(message.data for _, _, message in reader.iter_messages())
            for one in (*reader.iter_attachments(), *reader.iter_metadata()):
                assert one.name is not None
    return found


def check_with_rosbags(folder: Path) -> Counter[bytes]:
    """Return the payloads of a bag as rosbags reads them."""
    with Reader(folder) as reader:
        found = Counter(bytes(data) for _, _, data in reader.messages())
        if reader.message_count != found.total():
            raise WrongAnswerError(f"metadata.yaml says {reader.message_count} messages, there are {found.total()}")
    return found


def read_everywhere(folder: Path) -> list[bytes]:
    """Check that every reader opens a bag and finds the same in it; return its payloads in file order."""
    bag = open_bag(folder)
    bag.check()
    found = [payload for _, _, payload in bag.messages()]
    assert check_with_mcap(sorted(folder.glob("*.mcap"))) == check_with_rosbags(folder) == Counter(found)
    return found
