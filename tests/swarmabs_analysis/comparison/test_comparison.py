"""Two runs, message by message, against a brute-force count and numpy; what is said of two bags, and how it looks."""

import json
import math
import re
import tracemalloc
from collections.abc import Callable, Iterable, Iterator
from itertools import pairwise
from math import inf, nan
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
from tests.frozen.command import swarm
from tests.swarmabs_analysis.figures.conftest import record
from tests.swarmabs_bag.mcap_files import rewritten
from tests.swarmabs_bag.realtime_bags import realtime_bag
from tests.swarmabs_bag.sample_run import AGENTS, changed, make_run, make_step, write_bag
from tests.swarmabs_core.helpers import together

from swarmabs_analysis.comparison import compare_steps, recorded_steps
from swarmabs_analysis.comparison.bags import Comparison, SettingDifference, compare_bags, setting_differences
from swarmabs_analysis.comparison.messages import FieldDeviation, MessageComparison, TopicComparison
from swarmabs_analysis.difference import Difference
from swarmabs_bag.arrays import load_arrays
from swarmabs_bag.errors import DamagedBagError
from swarmabs_bag.run.step import Step
from swarmabs_core.cdr import decode, encode
from swarmabs_core.messages import AgentState, EventKind, Message, PlaneState, SwarmEvent
from swarmabs_core.record import Record

RUN = make_run()


def message(kind: type[Message], step: int, agent: int | None = None) -> Any:
    return next(m for m in RUN if isinstance(m, kind) and (m.step, getattr(m, "agent_id", None)) == (step, agent))


STATE, PLANE, EVENT = message(AgentState, 11, 2), message(PlaneState, 4), message(SwarmEvent, 3, 7)


def compare(a: Iterable[Message], b: Iterable[Message]) -> MessageComparison:
    return compare_steps(recorded_steps(map(Record.of, a), "A"), recorded_steps(map(Record.of, b), "B"))


def shown(comparison: MessageComparison) -> str:
    assert comparison.first is not None
    return comparison.first.side_by_side()


def topic(comparison: MessageComparison, name: str) -> TopicComparison:
    return next(one for one in comparison.topics if one.topic == name)


def test_equal_runs_are_equal_and_every_message_is_counted() -> None:
    comparison = compare(RUN, RUN)
    assert comparison.equal
    assert [(one.topic, one.compared, one.differing, one.fields) for one in comparison.topics] == [
        ("swarm/agent_state", 63, 0, ()),
        ("plane/state", 21, 0, ()),
        ("swarm/abstract_state", 21, 0, ()),
        ("swarm/auxiliary_state", 21, 0, ()),
        ("swarm/desired_abstract_state", 21, 0, ()),
        ("swarm/events", 1, 0, ()),
    ]


def test_one_bit_is_found_and_named_and_the_first_difference_is_first_by_step_topic_robot_and_field() -> None:
    other = math.nextafter(STATE.command, math.inf)
    comparison = compare(RUN, changed(RUN, STATE, command=other))
    assert comparison.first == Difference("swarm/agent_state", 11, 2, "command", STATE.command, other)
    assert shown(comparison) == (
        f"/swarm/agent_state step 11 agent 2: command is {STATE.command!r} in A, {other!r} in B"
    )
    assert [one.differing for one in comparison.topics] == [1, 0, 0, 0, 0, 0]
    run = changed(RUN, message(PlaneState, 5), angle=9.0)
    assert shown(compare(RUN, run)).startswith("/plane/state step 5: angle")
    for agent in (7, 2):
        run = changed(run, message(AgentState, 5, agent), velocity=9.0, position=8.0)
        assert shown(compare(RUN, run)).startswith(f"/swarm/agent_state step 5 agent {agent}: position")


def test_deviations_are_those_of_numpy() -> None:
    draw = np.random.default_rng(5)
    other = [m._replace(position=m.position + draw.normal()) if isinstance(m, AgentState) else m for m in RUN]
    states = [[m for m in run if isinstance(m, AgentState)] for run in (RUN, other)]
    apart = {(m.step, m.agent_id): abs(m.position - n.position) for m, n in zip(*states, strict=True)}
    (field,) = topic(compare(RUN, other), "swarm/agent_state").fields
    worst = max(apart, key=lambda place: apart[place])
    assert (field.field, field.differing, field.undefined) == ("position", 63, 0)
    assert (field.step, field.agent, field.largest) == (*worst, apart[worst])
    assert field.rms == pytest.approx(np.sqrt(np.mean(np.square(list(apart.values())))))
    state = message(PlaneState, 6)  # a mean is over the messages that have a deviation
    comparison = compare(changed(RUN, PLANE, angle=math.nan), changed(RUN, state, angle=state.angle + 0.5))
    (field,) = topic(comparison, "plane/state").fields
    assert field == FieldDeviation("angle", 2, 0.5, 6, 0, pytest.approx(math.sqrt(0.25 / 20)), 1)
    run = changed(changed(RUN, STATE, velocity=STATE.velocity + 0.5), message(AgentState, 11, 1), velocity=math.inf)
    (field,) = topic(compare(RUN, run), "swarm/agent_state").fields
    assert (field.largest, field.step, field.agent, field.undefined) == (pytest.approx(0.5), 11, 2, 1)


@pytest.mark.parametrize(
    ("one", "other", "expected"),
    [
        ({"angle": math.nan}, {"angle": math.nan}, []),
        ({"angle": math.inf}, {"angle": math.inf}, []),
        ({"angle": math.nan}, {"angle": 0.5}, [FieldDeviation("angle", 1, None, None, None, None, 1)]),
        ({"angle": 0.0}, {"angle": math.inf}, [FieldDeviation("angle", 1, None, None, None, None, 1)]),
        ({"angle": 0.0}, {"angle": -0.0}, [FieldDeviation("angle", 1, 0.0, 4, 0, 0.0, 0)]),
        ({"stamp": 1}, {"stamp": 2}, [FieldDeviation("stamp", 1, None, None, None, None, 0)]),
    ],
)
def test_field_difference(one: dict[str, float], other: dict[str, float], expected: list[FieldDeviation]) -> None:
    comparison = compare(changed(RUN, PLANE, **one), changed(RUN, PLANE, **other))
    assert comparison.equal is (not expected)
    assert list(topic(comparison, "plane/state").fields) == expected


def test_what_one_run_lacks_is_said_of_both_sides() -> None:
    comparison = compare(make_run(15), make_run(20, AGENTS[:2]))
    agents, planes = topic(comparison, "swarm/agent_state"), topic(comparison, "plane/state")
    assert (agents.compared, agents.missing_in_a, agents.missing_in_b) == (32, 10, 16)
    assert (planes.compared, planes.missing_in_a, planes.missing_in_b) == (16, 5, 0)
    assert comparison.first == Difference("swarm/agent_state", 0, 7, "message", "message", None)
    assert shown(comparison) == "/swarm/agent_state step 0 agent 7: missing in B"
    assert shown(compare(make_run(20), make_run(15))) == "/swarm/agent_state step 16 agent 1: missing in B"
    comparison = compare([m for m in RUN if m != PLANE], RUN)
    assert comparison.first == Difference("plane/state", 4, None, "message", None, "message")


def test_events_are_brought_together_wherever_they_stand() -> None:
    rest = [message for message in RUN if message != EVENT]
    assert compare([EVENT, *rest], [*rest, EVENT]).equal
    comparison = compare(RUN, changed(RUN, EVENT, value=0.5))
    assert comparison.first == Difference("swarm/events", 3, 7, "value", 1 / 3, 0.5)
    assert shown(compare(RUN, changed(changed(RUN, EVENT, value=0.5), STATE, command=9.0))) == shown(comparison)
    second = SwarmEvent(50_000_000, 5, 1, EventKind.JOINED, 0.0, "")
    comparison = compare(RUN, [*RUN, second])
    assert comparison.first == Difference("swarm/events", 5, 1, "message", None, "message")


def test_topics_may_overlap_but_only_so_far_and_a_message_is_there_once() -> None:
    at = RUN.index(PLANE)
    rest = [m for m in RUN if m != PLANE]
    assert compare([*rest[: at + 50], PLANE, *rest[at + 50 :]], RUN).equal
    with pytest.raises(DamagedBagError, match="A: /plane/state at step 4 follows step 13, out of order"):
        compare([*rest[: at + 64], PLANE, *rest[at + 64 :]], RUN)
    other = STATE._replace(command=9.0)
    with pytest.raises(
        DamagedBagError, match="B: there are two different messages: /swarm/agent_state of agent 2 at st"
    ):
        compare(RUN, [*RUN[: RUN.index(STATE)], other, *RUN[RUN.index(STATE) :]])


def test_copies_of_messages_which_nodes_repeat_and_other_recorders_keep_are_skipped() -> None:
    at = RUN.index(STATE)
    assert compare(RUN, [*RUN[: at + 20], STATE, *RUN[at + 20 :]]).equal
    assert compare([message for message in RUN for _ in range(3)], RUN).equal


def in_steps(run: Iterable[Message], sizes: Iterable[int]) -> Iterator[Step]:
    """Yield a run with so many steps in one, as far as they fit."""
    return together(list(recorded_steps(map(Record.of, run), "run")), sizes)


def test_several_steps_are_compared_as_single_ones_are() -> None:
    """Numbers are changed at random, also to such that have no deviation, and single messages are missing."""
    random = Random(3)
    values = (nan, inf, -inf, 0.0, -0.0, 1e308, -1e308, 5e-324)
    for number in range(20):
        runs: list[list[Message]] = []
        for _ in "AB":
            run = [
                m
                for step in range(40)
                for m in make_step(step, agents=(1, 2, 7) if step < 20 or number % 2 else (1, 2))
            ]
            for _ in range(random.randrange(30)):
                place = random.randrange(len(run))
                changed: Any = run[place]
                field = random.choice([name for name in changed._fields if name not in {"step", "agent_id"}])
                old = getattr(changed, field)
                run[place] = changed._replace(**{field: random.choice(values) if isinstance(old, float) else old ^ 1})
            if number % 3 == 0:
                del run[random.randrange(len(run))]
            runs.append([decode(type(m), encode(m)) for m in run])
        sizes = [[random.randrange(1, 9) for _ in range(40)] for _ in "AB"]
        plain, blocks = compare(*runs), compare_steps(*map(in_steps, runs, sizes))
        assert repr(plain.first) == repr(blocks.first)
        assert repr(plain.topics) == repr(blocks.topics)


def test_a_fraction_of_the_runs_is_in_memory() -> None:
    def measured(work: Callable[[], object]) -> int:
        tracemalloc.start()
        result = work()
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        del result
        return most

    def run(angle: float) -> Iterator[Message]:
        for message in (m for step in range(800) for m in make_step(step)):
            yield message._replace(angle=angle) if isinstance(message, PlaneState) else message

    assert measured(lambda: compare(run(0.1), run(0.2))) < 0.1 * measured(lambda: [*run(0.1), *run(0.2)])


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return the folders of four simulated runs: twice the same, one with other angle, one with other period."""
    folder = tmp_path_factory.mktemp("runs")
    settings = {
        "one": ["duration=2"],
        "same": ["duration=2"],
        "other": ["duration=1.5", "plane.angle=0.2", "faults=[{at: 0.5, kind: leave, agent: 2}]"],
        "period": ["duration=2", "step=0.02"],
    }
    return {name: record(folder / name, "pd_het_4", *overrides) for name, overrides in settings.items()}


def test_figures_are_those_of_the_messages_and_other_settings_are_named_as_set_takes_them(
    runs: dict[str, Path],
) -> None:
    comparison = compare_bags(runs["one"], runs["other"])
    for side, path in ((comparison.a, runs["one"]), (comparison.b, runs["other"])):
        arrays = load_arrays(path)
        assert side.figures["rms_error"] == pytest.approx(np.sqrt(np.mean(arrays.angle**2)))
        assert side.figures["final_error"] == -arrays.angle[-1]
        assert side.figures["max_abs_position"] == np.nanmax(np.abs(arrays.agents.position))
        assert side.figures["settled_at"] is None
        assert (side.first_step, side.last_step) == (arrays.step[0], arrays.step[-1])
    assert comparison.scenario == (
        SettingDifference("duration", 2.0, 1.5),
        SettingDifference("plane.angle", 0.1, 0.2),
        SettingDifference("faults.0.kind", None, "leave", "A"),
        SettingDifference("faults.0.at", None, 0.5, "A"),
        SettingDifference("faults.0.agent", None, 2, "A"),
    )


def test_other_periods_are_compared_step_by_step(runs: dict[str, Path]) -> None:
    comparison = compare_bags(runs["one"], runs["period"])
    assert (comparison.a.period, comparison.b.period) == (0.01, 0.02)
    plane = next(topic for topic in comparison.messages.topics if topic.topic == "plane/state")
    assert (plane.compared, plane.missing_in_b) == (101, 100)
    assert [field.field for field in plane.fields] == ["stamp", "angle", "angular_velocity"]


def test_other_robots_provenance_and_settings_are_named(tmp_path: Path) -> None:
    for name, agents in (("1", AGENTS[:2]), ("2", AGENTS)):
        provenance = json.dumps({"versions": {"x": name}, "m": 1}).encode()
        write_bag(tmp_path / name, make_run(agents=agents), {"provenance.json": provenance})
    comparison = compare_bags(tmp_path / "1", tmp_path / "2")
    assert (comparison.robots_only_in_a, comparison.robots_only_in_b) == ((), (7,))
    assert (comparison.a.robots, comparison.b.robots) == (2, 3)
    assert comparison.provenance == (SettingDifference("versions.x", "1", "2"),)
    assert "contains no scenario" in (comparison.a.scenario_problem or "")
    assert comparison.a.figures["rms_error"] is None
    # Lists are taken apart only if they hold mappings.
    a = {"gains": [1, 2], "agents": [{"id": 1}, {"id": 2}], "limits": None, "none": []}
    b = {"gains": [1, 3], "agents": [{"id": 1}], "limits": 0.5}
    assert setting_differences(a, b) == (
        SettingDifference("gains", [1, 2], [1, 3]),
        SettingDifference("agents.1.id", 2, None, "B"),
        SettingDifference("limits", None, 0.5),
    )


def test_a_cut_bag_is_compared_as_far_as_it_goes_and_a_flipped_bit_found(runs: dict[str, Path], tmp_path: Path) -> None:
    whole = next((runs["one"] / "bag").glob("*.mcap")).read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: len(whole) * 3 // 4])
    comparison = compare_bags(runs["one"], cut)
    assert (comparison.equal, comparison.damaged) == (False, True)
    assert str(cut) in (comparison.b.problem or "")
    assert all(topic.differing == topic.missing_in_a == 0 for topic in comparison.messages.topics)
    a, b = (write_bag(tmp_path / name, make_run(), {"provenance.json": b"{}"}) for name in ("a", "b"))
    file = next(b.glob("*.mcap"))
    whole = file.read_bytes()
    for place in (0.1, 0.5, 0.9):
        data = bytearray(whole)
        data[int(len(data) * place)] ^= 1
        file.write_bytes(data)
        comparison = compare_bags(a, b)
        assert (comparison.equal, comparison.damaged) == (False, True), place


def test_bags_of_other_recorders_may_overlap_by_many_steps(tmp_path: Path) -> None:
    late = sorted(RUN, key=lambda message: isinstance(message, PlaneState))
    a, b = (write_bag(tmp_path / name, messages) for name, messages in (("a", RUN), ("b", late)))
    comparison = compare_bags(a, b)
    assert (comparison.messages.equal, comparison.damaged) == (True, False)


def test_a_converted_bag_of_a_run_in_real_time_is_compared_as_one(tmp_path: Path) -> None:
    bag = realtime_bag(tmp_path / "bag")
    comparison = compare_bags(bag, rewritten(bag, tmp_path / "converted.mcap", attachments=False))
    assert (comparison.equal, comparison.a.digest, comparison.b.digest) == (True, None, None)


def test_the_command_gives_exit_codes_and_one_document(runs: dict[str, Path], tmp_path: Path) -> None:
    nan = changed(run := make_run(), next(m for m in run if isinstance(m, PlaneState)), angle=float("nan"))
    bags = [write_bag(tmp_path / name, messages) for name, messages in (("a", run), ("b", nan))]
    assert swarm(("compare", runs["one"], runs["same"]), tmp_path).code == 0
    assert swarm(("compare", bags[0], tmp_path), tmp_path).code == 2
    document = json.loads(swarm(("compare", *bags, "--json"), tmp_path).out, parse_constant=pytest.fail)
    assert (document["equal"], document["first_difference"]["b"]) == (False, "nan")
    done = swarm(("compare", *bags), tmp_path)
    assert done.code == 1
    assert "first /plane/state step 0: angle is 1.4142135623730951 in A, nan in B" in done.out


def shifted(message: Message, infinite: float) -> Message:
    """Change every number of robots and plane by a little, or make it infinite."""
    if not isinstance(message, (AgentState, PlaneState)):
        return message
    values = {n: v * (1 + 1e-5) + infinite for n, v in message._asdict().items() if isinstance(v, float)}
    return message._replace(**values)


@pytest.fixture(scope="module", params=[0.0, float("inf")], ids=["finite", "infinite"])
def bags(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("bags")
    run = make_run()
    return [write_bag(folder / "a", run), write_bag(folder / "b", [shifted(m, request.param) for m in run])]


def compared(bags: list[Path], columns: int | None) -> str:
    """Return what the command prints on a terminal of some width (None: into a pipe), without colours."""
    done = swarm(("compare", *bags), bags[0].parent, columns=columns)
    assert done.code == 1
    return re.sub(r"\x1b\[[0-9;]*m", "", done.out)


def expected(comparison: Comparison) -> list[list[str]]:
    """Return the words that have to be read beside each field that differs."""
    return [
        [f.field, f"{f.differing:,}", *("-" if n is None else f"{n:.6g}" for n in (f.largest, f.rms))]
        for topic in comparison.messages.topics
        for f in topic.fields
    ]


def assert_readable(text: str, rows: list[list[str]]) -> None:
    """Assert that fields stand in their order, with all of their numbers before the next one."""
    rest = " ".join(text.split())
    assert "…" not in rest
    assert len(rows) == 7
    places = []
    for row in rows:
        place = re.compile(rf" {row[0]}\b").search(rest, places[-1] + 1 if places else rest.rindex("swarm/agent_state"))
        assert place, row
        places.append(place.start())
    for row, (begin, end) in zip(rows, pairwise([*places, len(rest)]), strict=True):
        words = re.split(r"[ :,](?!\d{3}\b)", rest[begin:end])
        assert set(row) <= set(words), (row, words)


@pytest.mark.parametrize("columns", [200, 80, 40, None])
def test_every_number_is_there_and_lines_fit_a_terminal_or_are_whole(bags: list[Path], columns: int | None) -> None:
    text, comparison = compared(bags, columns), compare_bags(*bags)
    rows, lines = expected(comparison), text.splitlines()
    assert_readable(text, rows)
    digests = [f"digest A  {comparison.a.digest or '-'}", f"digest B  {comparison.b.digest or '-'}"]
    assert [line for line in lines if line.startswith("digest")] == digests  # whole, also where the terminal is narrow
    assert columns is None or max(len(line) for line in lines if line not in digests) <= columns
    if columns == 80 and comparison.messages.topics[0].fields[0].largest is not None:
        assert re.search(r"^field +differ +largest +at step +agent +rms\s*$", text, re.MULTILINE)
        assert re.search(r"^ topic +in both +differ +not in A +not in B", text, re.MULTILINE)
    if columns is None:
        together = [*map(set, rows), {comparison.a.file, comparison.b.file}]
        assert all(any(words <= set(line.split()) for line in lines) for words in together)
