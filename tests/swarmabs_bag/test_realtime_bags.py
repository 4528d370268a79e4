"""Every command that reads bags, on those of runs in real time: gaps, large steps and times, no digest."""

from __future__ import annotations

import csv
import json
import math
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from rich.console import Console
from tests.swarmabs_bag.realtime_bags import realtime_bag
from tests.swarmabs_core.realtime.bags import LATENCY, Stored, world
from tests.virtual_fleet import EPOCH

from swarmabs_analysis.comparison import compare_bags
from swarmabs_analysis.export.arrays import export_arrays
from swarmabs_analysis.export.tables import export_tables
from swarmabs_analysis.replay.source import open_source
from swarmabs_analysis.report import make_report
from swarmabs_analysis.report.record import read_recorded
from swarmabs_analysis.rerun import recorded_run
from swarmabs_analysis.verification.base import Verdict
from swarmabs_analysis.verification.realtime import RealtimeVerification
from swarmabs_analysis.verify import BagToVerify
from swarmabs_bag.arrays import load_arrays
from swarmabs_bag.info import bag_info, render
from swarmabs_bag.reader import open_bag
from swarmabs_bag.realtime import RealtimeWorld
from swarmabs_bag.repair import repair_bag
from swarmabs_config import realtime as configure
from swarmabs_config.configure import members
from swarmabs_core.cdr import decode
from swarmabs_core.errors import InputError
from swarmabs_core.messages import AGENT_STATE, MAIN_TOPICS, AgentState, Message, PlaneState

FAR = pytest.mark.parametrize("since_1970", [False, True], ids=["own epoch", "since 1970"])


def verified(bag: Path) -> Verdict:
    opened = BagToVerify(bag)
    return opened.verify()


def test_log_time_is_when_it_was_received_and_publish_time_the_stamp(tmp_path: Path) -> None:
    bag = realtime_bag(tmp_path / "bag")
    expected = world("quiet").bag
    with (bag / "bag_0.mcap").open("rb") as stream:
        found = list(make_reader(stream, validate_crcs=True).iter_messages(log_time_order=False))
    assert len(found) == len(expected)
    for (_, channel, message), stored in zip(found, expected, strict=True):
        assert channel.topic == f"/{stored.topic.name}"
        assert (message.log_time, message.data) == (stored.time, stored.payload)
        assert message.publish_time == stored.message.stamp
        assert 0 <= message.log_time - message.publish_time <= LATENCY + 10_000_000
    qos = {channel.topic: channel.metadata["offered_qos_profiles"] for _, channel, _ in found}
    assert "liveliness: manual_by_topic" in qos["/plane/state"]
    assert "nsec: 500000000" in qos["/plane/state"]
    assert "liveliness: automatic" in qos["/swarm/events"]


@FAR
@pytest.mark.parametrize("name", ["quiet", "deaths", "operator on a bad network"])
def test_a_bag_is_verified(tmp_path: Path, name: str, *, since_1970: bool) -> None:
    found = verified(realtime_bag(tmp_path / "bag", name, since_1970=since_1970))
    assert found.ok
    assert found.complete
    assert found.not_checkable == {}
    assert found.messages == sum(stored.topic in MAIN_TOPICS for stored in world(name).bag)
    assert found.digest is None
    assert json.loads(json.dumps(found.to_dict()))["ok"] is True


def test_a_message_published_at_another_time_than_its_stamp_is_named() -> None:
    recorded = world("quiet")
    clock = configure.schedule(recorded.scenario, EPOCH)
    simulated = RealtimeWorld(clock, members(recorded.scenario), plane=True)
    verification = RealtimeVerification(recorded.scenario, simulated)
    for number, stored in enumerate(recorded.bag):
        verification.add(stored.topic, stored.time, stored.payload, stored.message.stamp + (number == 500))
    changed = recorded.bag[500]
    found = verification.found.difference
    assert found is not None
    assert (found.topic, found.step, found.field) == (changed.topic.name, changed.message.step, "publish_time")
    assert (found.a, found.b) == (changed.message.stamp + 1, changed.message.stamp)


def test_a_bag_with_one_command_one_bit_off_is_not_ok(tmp_path: Path) -> None:
    def cheat(stored: Stored) -> Iterable[Message]:
        message = stored.message
        if isinstance(message, AgentState) and (message.step, message.agent_id) == (120, 3):
            message = message._replace(command=math.nextafter(message.command, math.inf))
        return (message,)

    found = verified(realtime_bag(tmp_path / "bag", change=cheat))
    assert not found.ok
    assert found.difference is not None
    assert (found.difference.topic, found.difference.step, found.difference.agent, found.difference.field) == (
        *("swarm/agent_state", 120),
        *(3, "command"),
    )


def test_what_the_recorder_did_not_get_is_counted(tmp_path: Path) -> None:
    def lose(stored: Stored) -> Iterable[Message]:
        message = stored.message
        return () if isinstance(message, PlaneState) and message.step == 60 else (message,)

    found = verified(realtime_bag(tmp_path / "bag", change=lose))
    assert found.ok
    assert found.not_checkable == {
        "the answer from which it goes on is not in the bag": 1,
        "the plane's state that it answers is not in the bag": 1,
    }


def test_what_was_measured_is_not_checked_and_that_is_said(tmp_path: Path) -> None:
    found = verified(realtime_bag(tmp_path / "bag", robots=(1, 2), plane=False))
    assert found.ok
    assert any("the motion of robots 3, 4" in note for note in found.notes)
    assert any("the motion of the plane" in note for note in found.notes)


def test_a_bag_that_does_not_say_how_time_became_steps_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = realtime_bag(tmp_path / "bag")
    for wrong in (None, {}, {"period_ns": "10", "epoch_ns": 0, "simulated_robots": [], "simulated_plane": True}):
        provenance = {"driver": "realtime", "realtime": wrong}
        monkeypatch.setattr("swarmabs_bag.realtime.attached_provenance", lambda _, found=provenance: found)
        with pytest.raises(InputError, match="does not say how time became steps"):
            BagToVerify(bag)


@FAR
def test_arrays_begin_with_the_first_step(tmp_path: Path, *, since_1970: bool) -> None:
    arrays = load_arrays(realtime_bag(tmp_path / "bag", since_1970=since_1970))
    assert arrays.time[0] == 0.0
    assert np.allclose(np.diff(arrays.time), 0.01, atol=0.006)
    assert arrays.step[0] == (EPOCH // 10_000_000 if since_1970 else 0)
    assert arrays.agents.position.shape == (len(arrays.step), 4)


@FAR
@pytest.mark.parametrize("name", ["quiet", "deaths", "adaptive", "operator"])
def test_a_report_has_the_figures_of_the_recorder(tmp_path: Path, name: str, *, since_1970: bool) -> None:
    recorded = read_recorded(realtime_bag(tmp_path / "bag", name, since_1970=since_1970))
    assert recorded.swarm.status == "ok"
    expected = world(name).figures.figures()
    assert {key: recorded.metrics[key] for key in expected} == expected
    assert recorded.metrics["digest"] is None
    assert recorded.realtime == world(name).figures.realtime()
    assert np.nanmax(np.abs(recorded.error)) < 0.2
    assert all(0.0 <= event.stamp / 1e9 <= recorded.arrays.time[-1] + 0.01 for event in recorded.swarm.events)


def test_a_report_is_drawn(tmp_path: Path) -> None:
    made = make_report(realtime_bag(tmp_path / "bag", "deaths", since_1970=True))
    assert "missing of swarm/agent_state" in made.html
    assert "broadcasts followed after 2 steps" in made.html
    assert made.png.startswith(b"\x89PNG")


@FAR
def test_bags_are_compared(tmp_path: Path, *, since_1970: bool) -> None:
    one = realtime_bag(tmp_path / "a", "operator", since_1970=since_1970)
    same = realtime_bag(tmp_path / "b", "operator", since_1970=since_1970)
    other = realtime_bag(tmp_path / "c", "operator on a bad network", since_1970=since_1970)
    equal, different = compare_bags(one, same), compare_bags(one, other)
    assert equal.equal
    assert equal.a.digest is None
    expected = world("operator").figures.figures()
    assert {key: equal.a.figures[key] for key in expected} == expected
    assert not different.equal
    assert not different.damaged
    assert different.messages.first is not None


def test_a_bag_is_exported(tmp_path: Path) -> None:
    bag = realtime_bag(tmp_path / "bag", "deaths", since_1970=True)
    export_tables(bag, tmp_path / "tables", "csv")
    with (tmp_path / "tables" / "agents.csv").open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    states = [m for s in world("deaths").bag if s.topic is AGENT_STATE for m in (s.message,)]
    assert len(rows) == len(states)
    assert int(rows[0]["step"]) == states[0].step + EPOCH // 10_000_000
    export_arrays(bag, tmp_path / "arrays.npz")
    with np.load(tmp_path / "arrays.npz") as arrays:
        assert arrays["time"][0] == 0.0


def test_info_tells_the_date(tmp_path: Path) -> None:
    found = bag_info(realtime_bag(tmp_path / "bag"))
    assert found.complete
    console = Console(width=200, record=True)
    console.print(render(found))
    assert re.search(r"2023-11-14 22:13:20 UTC and [12]", console.export_text())


def test_running_again_and_replaying_node_by_node_are_refused_with_the_reason(tmp_path: Path) -> None:
    bag = realtime_bag(tmp_path / "bag")
    with pytest.raises(InputError, match=r"recorded in real time.*wall clock.*cannot be repeated"):
        recorded_run(bag)
    with pytest.raises(InputError, match=r"recorded in real time.*verify recomputes"):
        open_source(bag)


def test_a_damaged_bag_is_repaired_and_verified(tmp_path: Path) -> None:
    bag = realtime_bag(tmp_path / "bag")
    file = bag / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    damaged = verified(bag)
    assert not damaged.ok
    assert damaged.difference is None
    report = repair_bag(bag, tmp_path / "repaired")
    assert report.output is not None
    again = verified(tmp_path / "repaired")
    assert again.difference is None


def test_every_message_of_the_bag_is_of_a_known_definition(tmp_path: Path) -> None:
    reader = open_bag(realtime_bag(tmp_path / "bag"))
    for topic, _, payload in reader.messages():
        assert decode(topic.message, payload).step >= 0
    unknown: list[Any] = [channel.name for channel in reader.channels if channel.topic is None]
    assert not unknown
