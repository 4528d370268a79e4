"""A process that writes a bag until it is killed or its disk is full; started by the tests beside it.

Usage: endless_writer.py FOLDER CHUNK_SECONDS

For every step it says on stdout when writing it began and ended; after a write error it aborts and says the error.
"""

from __future__ import annotations

import math
import os
import sys
import time
from itertools import count
from pathlib import Path

from swarmabs_bag.errors import BagWriteError
from swarmabs_bag.writer import BagWriter
from swarmabs_core.cdr import encode
from swarmabs_core.messages import MAIN_TOPICS, PLANE_STATE, PlaneState

PERIOD = 1_000_000


def say(text: str) -> None:
    os.write(sys.stdout.fileno(), f"{text}\n".encode())


def main() -> int:
    folder, chunk_seconds = Path(sys.argv[1]), float(sys.argv[2])
    try:
        with BagWriter(folder, topics=MAIN_TOPICS, attachments={}, chunk_seconds=chunk_seconds) as writer:
            for step in count():
                began = time.monotonic()
                for number in range(4):
                    state = PlaneState(step * PERIOD, step, math.sin(step + number), math.cos(step * number))
                    writer.write(PLANE_STATE, state.stamp, encode(state))
                say(f"{step} {began:.9f} {time.monotonic():.9f}")
    except BagWriteError as error:
        say(f"error {error}")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
