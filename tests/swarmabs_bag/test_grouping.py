"""Complete steps read as blocks against the same bag message by message."""

from pathlib import Path
from random import Random

import pytest
from tests.swarmabs_bag.sample_run import bag_writer, make_run, make_step, write_bag

from swarmabs_bag.errors import DamagedBagError
from swarmabs_bag.reader import BagReader, open_bag
from swarmabs_bag.run.grouping import Published
from swarmabs_bag.run.ordering import WINDOW, recorded_steps
from swarmabs_bag.run.step import Step
from swarmabs_core import messages as msg
from swarmabs_core.cdr import encode
from swarmabs_core.messages import TOPIC_OF
from swarmabs_core.record import Record


def disturbed(seed: int) -> list[msg.Message]:
    """Return a run whose robots change, with messages too late, falsified steps and times, and events in any place."""
    random = Random(seed)
    run: list[msg.Message] = []
    for step in range(60):
        run += make_step(step, agents=(1, 2, 7) if step < 20 or step > 40 else (1, 7))
    for _ in range(4):
        place = random.randrange(len(run) - 8)
        message = run.pop(place)
        run.insert(place + random.randrange(8), message)
        place = random.randrange(len(run))
        run[place] = run[place]._replace(stamp=run[place].stamp + random.choice((1, 10**9)))
        event = msg.SwarmEvent(run[place].stamp, run[place].step, 7, msg.EventKind.LIMIT_HIT, 1 / 3, "beyond")
        run.insert(place, event)
    return run


def taken_apart(bag: BagReader) -> list[Published]:
    found: list[Published] = []
    for part in bag.whole_steps():
        if isinstance(part, Step):
            found += [Published(topic, time, time, payload) for topic, time, payload in part.stored()]
        else:
            found.append(part)
    return found


@pytest.mark.parametrize("chunk_bytes", [300, 4000, 100_000])
def test_blocks_are_the_messages_of_the_bag_in_its_order(tmp_path: Path, chunk_bytes: int) -> None:
    for seed in range(3):
        bag = open_bag(write_bag(tmp_path / str(seed), disturbed(seed), chunk_bytes=chunk_bytes))
        assert taken_apart(bag) == list(bag.published())
        steps = list(recorded_steps(bag.steps(), "bag"))
        main = [single for step in steps for single in step.singly() if step.tables]
        expected = [step for step in recorded_steps(bag.records(), "bag") if step.tables]
        assert main == expected
    whole = open_bag(write_bag(tmp_path / "whole", make_run(steps=400), chunk_bytes=chunk_bytes))
    sizes = [len(part) for part in whole.whole_steps() if isinstance(part, Step)]
    assert sum(sizes) == 401, "every step is in a block, also where chunks and events cut"
    assert len(sizes) <= 2 + len(whole.index.chunks)


def test_messages_with_other_times_than_their_step_are_not_in_a_block(tmp_path: Path) -> None:
    with bag_writer(tmp_path / "bag") as writer:
        for number, message in enumerate(make_run(steps=30)):
            writer.write(TOPIC_OF[type(message)], message.stamp, encode(message), message.stamp + (number == 40))
    bag = open_bag(tmp_path / "bag")
    assert taken_apart(bag) == list(bag.published())


def test_all_before_a_damage_is_read(tmp_path: Path) -> None:
    folder = write_bag(tmp_path / "bag", make_run(steps=100))
    bag = open_bag(folder)
    for chunk in bag.index.chunks[5:0:-1]:
        with bag.files[0].path.open("r+b") as stream:
            stream.seek(chunk.chunk_start_offset + 200)
            stream.write(b"damage")
        read: list[tuple[int, str]] = []
        for found in (bag.whole_steps, bag.published):
            count = 0
            with pytest.raises(DamagedBagError) as error:  # noqa: PT012 - the messages before it are counted
                for part in found():
                    count += part.messages if isinstance(part, Step) else 1
            read.append((count, str(error.value)))
        assert read[0] == read[1]
        assert read[0][0] > 0


@pytest.mark.parametrize("late", [3, WINDOW, WINDOW + 1])
def test_a_message_after_blocks_of_its_step_is_refused(late: int) -> None:
    steps = [[Record.of(message) for message in make_step(step)] for step in range(12)]
    block = Step.whole(
        {topic: b"".join(r.payload for s in steps for r in s if r.topic is topic) for topic in msg.MAIN_TOPICS}
    )
    assert block is not None
    another = Record.of(steps[11 - late][3].message._replace(stamp=7))
    errors = []
    for run in ([block, another], [*(record for step in steps for record in step), another]):
        with pytest.raises(DamagedBagError) as error:
            list(recorded_steps(run, "bag"))
        errors.append(str(error.value))
    assert errors[0] == errors[1]
    assert errors[0].endswith("follows step 11, out of order") == (late >= WINDOW)
