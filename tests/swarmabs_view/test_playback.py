"""The playback of a bag, against an independent reader of it, on a clock that the test turns."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from tests.swarmabs_analysis.figures.conftest import ReadBag, record
from tests.swarmabs_analysis.report.conftest import SCENARIO, messages, write
from tests.swarmabs_bag.sample_run import write_bag
from tests.swarmabs_view.conftest import told

from swarmabs_bag.shown.swarm_state import SILENT_STEPS, STATUSES
from swarmabs_core.messages import AgentState
from swarmabs_view.facts import Shading, regions
from swarmabs_view.playback import COLUMNS, PlaybackSession, Recording, open_recording
from swarmabs_view.protocol import Curves, Frame, Message, Pause, Play, Seek, Sets, Speed, State


@pytest.fixture(scope="module")
def recording(run: Path) -> Recording:
    return open_recording(run)


@pytest.fixture
def session(recording: Recording) -> PlaybackSession:
    made = PlaybackSession(recording)
    made.poll(0.0)
    return made


def shown(said: Sequence[Message]) -> int | None:
    frames = told(said, Frame)
    return frames[-1].step if frames else None


def test_every_frame_is_what_the_bag_holds(run: Path, recording: Recording) -> None:
    read = ReadBag(run)
    angle, torque = read.column("/plane/state", "angle"), read.column("/swarm/abstract_state", "torque")
    wanted = read.column("/swarm/desired_abstract_state", "inertia")
    assert (recording.hello().last_step, recording.hello().playback) == (400, True)
    positions = {robot: read.column("/swarm/agent_state", "position", robot) for robot in (1, 2, 3, 4)}
    for step in range(401):
        frame = recording.frame(recording.row_at(step))
        assert (frame.step, frame.time, frame.values[0]) == (step, step / 100, angle[step])
        assert (frame.values[3], frame.values[6]) == (torque[step], wanted[step])
        dead, left = step > 100, step >= 200  # the robot itself says that it leaves
        assert frame.robots.status == ["dead" if dead else "active", "left" if left else "active", "active", "active"]
        # Who is dead stands still where it was last heard; who has left is nowhere.
        there = {
            robot: [] if left and robot == 2 else [found[min(step, len(found) - 1)]]
            for robot, found in positions.items()
        }
        assert frame.robots.coordinates == [*there.values()]
        assert frame.robots.position == [place or None for place in there.values()]
        if dead:
            assert (frame.robots.velocities[0], frame.robots.command[0]) == ([0.0], [])
        if left:
            assert (frame.robots.velocities[1], frame.robots.command[1]) == ([], [])
        for vector in (*frame.robots.velocities[2:], *frame.robots.command[2:]):
            assert len(vector) == 1 and None not in vector


def test_a_robot_is_silent_as_it_is_live_and_in_the_terminal(tmp_path: Path) -> None:
    said = [m for m in messages(2 * SILENT_STEPS) if not (isinstance(m, AgentState) and m.agent_id == 7 and m.step > 9)]
    recording = open_recording(write(tmp_path / "bag", said))
    for step, status in ((9, "active"), (9 + SILENT_STEPS, "active"), (10 + SILENT_STEPS, "silent")):
        assert recording.frame(recording.row_at(step)).robots.status == ["active", "active", status]


def test_the_whole_run_has_the_statuses_and_places_of_its_frames(recording: Recording) -> None:
    swarm = recording.swarm
    order = [agent.id for agent in swarm.scenario.agents]
    columns = [swarm.arrays.agents.ids.tolist().index(robot) for robot in order]
    for row in range(len(swarm)):
        for robot, column in zip(swarm.shown_robots(row), columns, strict=True):
            assert [name for name in STATUSES if swarm.have_status(name)[row, column]] == [robot.status]
            if robot.coordinates:
                assert tuple(swarm.coordinates[row, column].tolist()) == robot.coordinates


@pytest.mark.system
def test_thinned_curves_reach_as_far_as_the_whole(tmp_path: Path) -> None:
    folder = record(tmp_path / "run", "arise_het_4", "duration=21.0", "plane.sensor.noise=[0.001, 0.001]")
    recording = open_recording(folder)
    read = ReadBag(folder)
    whole = read.column("/plane/state", "angle")
    (curves,) = told(PlaybackSession(recording).poll(0.0), Curves)
    assert COLUMNS < len(curves.time) < len(whole)
    angle, torque = curves.values[0], curves.values[3]
    assert min(angle) == whole.min()  # type: ignore[type-var]
    assert max(angle) == whole.max()  # type: ignore[type-var]
    places = np.searchsorted(read.times(), np.array(curves.time) - 1e-9)
    assert angle == whole[places].tolist()
    assert torque == read.column("/swarm/abstract_state", "torque")[places].tolist()


def test_plays_at_its_speed_and_stops_at_the_end(session: PlaybackSession) -> None:
    session.control(Play(v=2, type="play"))
    assert shown(session.poll(0.5)) == 50
    assert shown(session.poll(1.25)) == 125
    session.control(Speed(v=2, type="speed", speed=2.0))
    assert shown(session.poll(1.75)) == 225
    session.control(Pause(v=2, type="pause"))
    assert shown(session.poll(2.0)) is None
    session.control(Play(v=2, type="play"))
    said = session.poll(100.0)
    assert shown(said) == 400
    assert [state.playing for state in told(said, State)] == [False]
    session.control(Play(v=2, type="play"))  # from the beginning
    assert shown(session.poll(100.1)) == 20


def test_seeks_to_any_step_and_says_something_every_second_and_nothing_twice(session: PlaybackSession) -> None:
    for step, found in ((123, 123), (10**9, 400), (0, 0), (400, 400)):
        session.control(Seek(v=2, type="seek", step=step))
        assert shown(session.poll(0.0)) == found
    said = [found for time in range(1, 31) if (found := session.poll(time / 10))]
    assert [len(found) for found in said] == [1, 1, 1]
    assert all(isinstance(message, State) for found in said for message in found)


@pytest.mark.parametrize("part", [0.1, 0.15, 0.2, 0.25])
def test_a_bag_that_has_lost_its_end_is_shown_as_far_as_it_goes(tmp_path: Path, part: float) -> None:
    bag = write(tmp_path / "bag", messages(40)) / "bag_0.mcap"
    os.truncate(bag, round(bag.stat().st_size * part))
    recording = open_recording(bag)
    assert 0 < len(recording) < 41
    (state,) = told(PlaybackSession(recording).poll(0.0), State)
    assert state.text.startswith("damaged: the end of the bag is missing")
    assert len(recording.curves) == len(recording)
    for row in range(len(recording)):  # also with robots of which nothing is left
        assert len(recording.frame(row).robots.position) == 3


def test_the_sets_are_those_of_whoever_takes_part(run: Path) -> None:
    recording = open_recording(run)
    recording.shading = Shading(recording.hello(), lambda work: work())
    agents = {agent.id: agent for agent in recording.swarm.scenario.agents}
    place = ReadBag(run).column("/swarm/agent_state", "position", 1)[-1]
    session = PlaybackSession(recording)
    found: dict[int, Sets] = {}
    for step in (0, 100, 101, 150, 200, 201, 400, 101, 50):
        session.control(Seek(v=2, type="seek", step=step))
        found.update((step, message) for message in told(session.poll(0.0), Sets))
    assert list(found) == [101, 201, 50]  # at 101 once more it is the same message
    assert found[50] == recording.shading.first
    assert found[50].regions == recording.hello().regions
    plane, manifold = recording.swarm.scenario.plane, recording.swarm.scenario.manifold
    for step, moving in ((101, [2, 3, 4]), (201, [3, 4])):
        assert (found[step].moving, found[step].standing) == (moving, [1])
        assert found[step].regions == regions(
            [agents[robot].mass for robot in moving],
            *(plane.length, plane.gravity, manifold.torque_max),
            [(agents[1].mass, place)],
        )


def test_a_robot_that_joins_later_counts_from_then_on(tmp_path: Path) -> None:
    folder = record(tmp_path / "run", "pd_het_4", "duration=1.0", "faults=[{at: 0.5, kind: join, agent: 3}]")
    recording = open_recording(folder)
    recording.shading = Shading(recording.hello(), lambda work: work())
    assert recording.shading.first.moving == [1, 2, 4]
    last = recording.sets(len(recording) - 1)
    assert last is not None
    assert last.moving == [1, 2, 3, 4]
    assert last.regions != recording.hello().regions
    before, since = recording.sets(recording.row_at(49)), recording.sets(recording.row_at(50))
    assert (before, since) == (recording.shading.first, last)


def test_a_bag_of_several_swarms_says_which_one_it_shows(tmp_path: Path) -> None:
    attached = {"scenario.yaml": SCENARIO.encode(), "provenance.json": b"{}"}
    bag = write_bag(tmp_path / "bag", messages(20), attached, namespace="/b")
    named = open_recording(bag, namespace="/b").hello()
    assert named.title == "sample, swarm /b"
    assert named.place == f"{bag / 'bag_0.mcap'}, namespace /b"
    assert open_recording(bag).hello() == named  # it is the only one, and in a namespace all the same
    plain = open_recording(write(tmp_path / "plain", messages(20))).hello()
    assert (plain.title, plain.place) == ("sample", str(tmp_path / "plain" / "bag_0.mcap"))


@pytest.mark.parametrize(
    ("reason", "text"), [("interrupted", "interrupted"), ("robot 2 is silent", "failed: robot 2 is silent")]
)
def test_a_run_that_did_not_end_by_itself_has_one_name(tmp_path: Path, reason: str, text: str) -> None:
    said = PlaybackSession(open_recording(write(tmp_path / "bag", messages(20), aborted=reason))).poll(0.0)
    assert [message.text for message in said if isinstance(message, State)] == [text]


def test_a_bag_in_which_nothing_is_is_shown_as_such(tmp_path: Path) -> None:
    recording = open_recording(write(tmp_path / "bag", []))
    assert len(recording) == 0
    session = PlaybackSession(recording)
    for wish in (Play(v=2, type="play"), Seek(v=2, type="seek", step=3)):
        session.control(wish)
        assert shown(session.poll(0.0)) is None
