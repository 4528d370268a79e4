"""Every command that reads bags, on those of runs in real time: gaps, large steps and times, no digest."""

import csv
import json
import re
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path
from typing import TypeAlias

import numpy as np
import pytest
from mcap.reader import make_reader
from rich.console import Console
from tests.swarmabs_bag.realtime_bags import realtime_bag
from tests.swarmabs_core.realtime.bags import LATENCY, Stored, world
from tests.virtual.fleet import EPOCH

from swarmabs_analysis.comparison import compare_bags
from swarmabs_analysis.export.arrays import export_arrays
from swarmabs_analysis.export.tables import export_tables
from swarmabs_analysis.replay.answers import Answers
from swarmabs_analysis.report import make_report
from swarmabs_analysis.report.record import read_recorded
from swarmabs_analysis.rerun import recorded_run
from swarmabs_analysis.verification.realtime import RealtimeVerification
from swarmabs_analysis.verify import BagToVerify
from swarmabs_bag.arrays import load_arrays
from swarmabs_bag.info import bag_info, render
from swarmabs_bag.reader import open_bag
from swarmabs_bag.realtime_world import RealtimeWorld
from swarmabs_bag.recorder.recording import RealtimeRecording
from swarmabs_bag.repair import repair_bag
from swarmabs_config import realtime as configure
from swarmabs_config.configure import members
from swarmabs_core.errors import InputError
from swarmabs_core.messages import AGENT_STATE, MAIN_TOPICS, STANDING, Message, PlaneState
from swarmabs_core.nodes import CONTROLLER
from swarmabs_core.record import Record

MakeBag: TypeAlias = Callable[..., Path]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> MakeBag:
    """Return a function that returns the bag of a world, not to be changed."""

    @cache
    def make(name: str = "quiet", *, since_1970: bool = False) -> Path:
        return realtime_bag(tmp_path_factory.mktemp("made") / "bag", name, since_1970=since_1970)

    return make


def test_log_time_is_when_it_was_received_and_publish_time_the_stamp(made: MakeBag) -> None:
    bag = made()
    with (bag / "bag_0.mcap").open("rb") as stream:
        found = list(make_reader(stream, validate_crcs=True).iter_messages(log_time_order=False))
    for (_, channel, message), stored in zip(found, world("quiet").bag, strict=True):
        assert channel.topic == f"/{stored.topic.name}"
        assert (message.log_time, message.data) == (stored.time, stored.payload)
        assert message.publish_time == stored.message.stamp
        assert 0 <= message.log_time - message.publish_time <= LATENCY + 10_000_000
    qos = {channel.topic: channel.metadata["offered_qos_profiles"] for _, channel, _ in found}
    assert "liveliness: manual_by_topic" in qos["/plane/state"]
    assert "nsec: 500000000" in qos["/plane/state"]
    assert "liveliness: automatic" in qos["/swarm/events"]


def test_log_times_do_not_go_back_with_the_clock(tmp_path: Path) -> None:
    recorded = world("quiet")
    clock = configure.schedule(recorded.scenario, EPOCH)
    simulated = RealtimeWorld(clock, members(recorded.scenario), plane=True)
    recording = RealtimeRecording(recorded.scenario, tmp_path / "bag", simulated)
    planes = [Record.of(PlaneState(clock.begin(step), step, 0.1, 0.0)) for step in range(4)]
    received = [clock.begin(step) for step in (7, 5, 6, 9)]
    for record, now in zip(planes, received, strict=True):
        recording.add(record, now)
    recording.close()
    found = list(open_bag(tmp_path / "bag").published())
    assert [message.time for message in found] == [clock.begin(step) for step in (7, 7, 7, 9)]
    assert [message.published for message in found] == [clock.begin(step) for step in range(4)]


def test_the_date_is_told_a_repetition_is_refused_and_damage_is_repaired(tmp_path: Path, made: MakeBag) -> None:
    console = Console(width=200, record=True)
    console.print(render(bag_info(made())))
    assert re.search(r"2023-11-14 22:13:20 UTC and \d(\.\d+)? s more", console.export_text())
    with pytest.raises(InputError, match=r"recorded in real time.*wall clock.*cannot be repeated"):
        recorded_run(made())
    with pytest.raises(InputError, match=r"recorded in real time.*leave out --node"):
        BagToVerify(made()).trial((CONTROLLER,))
    with pytest.raises(InputError, match=r"recorded in real time.*leave out --node"):
        Answers(open_bag(made()), (CONTROLLER,))
    cut = tmp_path / "cut.mcap"
    data = (made() / "bag_0.mcap").read_bytes()
    cut.write_bytes(data[: len(data) // 2])
    damaged = BagToVerify(cut).verify()
    assert (damaged.ok, damaged.difference) == (False, None)
    assert repair_bag(cut, tmp_path / "repaired").output is not None
    assert BagToVerify(tmp_path / "repaired").verify().difference is None


def test_a_message_published_at_another_time_than_its_stamp_is_named() -> None:
    recorded = world("quiet")
    simulated = RealtimeWorld(configure.schedule(recorded.scenario, EPOCH), members(recorded.scenario), plane=True)
    verification = RealtimeVerification(recorded.scenario, simulated)
    for number, stored in enumerate(recorded.bag):
        verification.add(stored.topic, stored.time, stored.payload, stored.message.stamp + (number == 500))
    changed = recorded.bag[500]
    found = verification.result.difference
    assert found is not None
    assert (found.topic, found.step, found.field) == (changed.topic.name, changed.message.step, "publish_time")
    assert (found.a, found.b) == (changed.message.stamp + 1, changed.message.stamp)


@pytest.mark.parametrize(
    ("name", "since_1970"), [("quiet", False), ("deaths", True), ("operator on a bad network", False)]
)
def test_a_bag_is_verified_and_arrays_begin_at_the_first_step(made: MakeBag, name: str, *, since_1970: bool) -> None:
    bag = made(name, since_1970=since_1970)
    found = BagToVerify(bag).verify()
    assert (found.ok, found.complete, found.digest, found.not_checkable) == (True, True, None, {})
    assert all(channel.topic is not None for channel in open_bag(bag).channels)
    assert found.messages == sum(stored.topic in {*MAIN_TOPICS, STANDING} for stored in world(name).bag)
    assert json.loads(json.dumps(found.to_dict()))["ok"] is True
    arrays = load_arrays(bag)
    assert (arrays.time[0], arrays.step[0]) == (0.0, EPOCH // 10_000_000 if since_1970 else 0)
    assert np.allclose(np.diff(arrays.time), 0.01, atol=0.006)
    assert arrays.agents.position.shape == (len(arrays.step), 4)


def test_what_was_lost_or_measured_is_not_checked_and_that_is_said(tmp_path: Path) -> None:
    def lose(stored: Stored) -> Iterable[Message]:
        message = stored.message
        return () if isinstance(message, PlaneState) and message.step == 60 else (message,)

    found = BagToVerify(realtime_bag(tmp_path / "lost", change=lose)).verify()
    assert found.ok
    assert found.not_checkable == {
        "the answer from which it continues is not in the bag": 1,
        "the plane's state that it answers is not in the bag": 1,
    }
    found = BagToVerify(realtime_bag(tmp_path / "measured", robots=(1, 2), plane=False)).verify()
    assert found.ok
    for measured in ("the motion of robots 3, 4", "the motion of the plane"):
        assert any(measured in note for note in found.notes)


WORLD = {"period_ns": 10, "epoch_ns": 0, "simulated_robots": [], "simulated_plane": True, "own_limits": []}


@pytest.mark.parametrize(
    "wrong",
    [None, {}, *(WORLD | {name: 1.5} for name in WORLD), WORLD | {"period_ns": 0}, WORLD | {"own_limits": [-1]}],
)
def test_a_bag_without_its_time_base_is_refused(wrong: object, made: MakeBag, monkeypatch: pytest.MonkeyPatch) -> None:
    provenance = {"driver": "realtime", "realtime": wrong}
    monkeypatch.setattr("swarmabs_bag.realtime_world.attached_provenance", lambda _: provenance)
    with pytest.raises(InputError, match="lacks a valid entry realtime"):
        BagToVerify(made())


@pytest.mark.parametrize(("name", "since_1970"), [("deaths", True), ("adaptive", False), ("operator", True)])
def test_a_report_has_the_figures_of_the_recorder(made: MakeBag, name: str, *, since_1970: bool) -> None:
    recorded = read_recorded(made(name, since_1970=since_1970))
    expected = world(name).figures.figures()
    assert (recorded.swarm.status, recorded.metrics["digest"]) == ("ok", None)
    assert {key: recorded.metrics[key] for key in expected} == expected
    assert recorded.realtime == world(name).figures.realtime()
    assert np.nanmax(np.abs(recorded.error)) < 0.2
    assert all(0.0 <= event.stamp / 1e9 <= recorded.arrays.time[-1] + 0.01 for event in recorded.swarm.events)


@pytest.mark.system
def test_a_bag_is_reported_compared_and_exported(tmp_path: Path, made: MakeBag) -> None:
    bag = made("deaths", since_1970=True)
    report = make_report(bag)
    assert "missing messages of swarm/agent_state" in report.html
    assert "broadcasts followed at an age of 2 steps" in report.html
    assert report.png.startswith(b"\x89PNG")
    same = realtime_bag(tmp_path / "b", "deaths", since_1970=True)
    equal, different = compare_bags(bag, same), compare_bags(bag, made("operator", since_1970=True))
    assert (equal.equal, equal.a.digest, different.equal, different.damaged) == (True, None, False, False)
    export_tables(bag, tmp_path / "tables", "csv")
    with (tmp_path / "tables" / "agents.csv").open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    states = [m for s in world("deaths").bag if s.topic is AGENT_STATE for m in (s.message,)]
    assert len(rows) == len(states)
    assert int(rows[0]["step"]) == states[0].step + EPOCH // 10_000_000
    export_arrays(bag, tmp_path / "arrays.npz")
    with np.load(tmp_path / "arrays.npz") as arrays:
        assert arrays["time"][0] == 0.0
