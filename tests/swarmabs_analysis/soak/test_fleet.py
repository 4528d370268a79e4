"""Soaks of a fleet in real time: what is drawn, that it is borne, and that what goes wrong is found."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from swarmabs_analysis.soak import draw, happenings
from swarmabs_analysis.soak.draw import drawn_scenario
from swarmabs_analysis.soak.fleet_engine import FleetEngine
from swarmabs_analysis.soak.happenings import KINDS
from swarmabs_analysis.soak.run import Extent, Soak, run_soak
from swarmabs_cli import main
from swarmabs_core.realtime.broadcasts import BroadcastInbox
from swarmabs_core.realtime.envelope import LaneEnvelope

pytestmark = pytest.mark.timeout(300)


def soaked(folder: Path, runs: int, seed: int = 4) -> Soak:
    folder.mkdir()
    return run_soak(Extent(seed, 0, runs, 4, realtime=True), FleetEngine(), folder, lambda soak: None)


def broken(soak: Soak) -> set[str]:
    return {violation.invariant for trial in soak.trials for violation in trial.violations}


def test_everything_that_may_happen_is_drawn_and_over_in_time() -> None:
    engine = FleetEngine()
    seen = set()
    for number in range(40):
        scenario = engine.prepare(drawn_scenario(1, number))
        seen.update(engine.kinds(scenario))
        assert all(0.0 < h.time <= draw.FAULTS_UNTIL for h in happenings.drawn_happenings(scenario))
    assert seen == set(KINDS)


def test_a_fleet_bears_what_happens_to_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["soak", "--realtime", "--seed", "3", "--json", "-o"]
    assert main([*words, str(tmp_path / "all"), "--runs", "2"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["status"], document["engine"], document["finished"]) == ("ok", "virtual fleet", 2)
    assert main([*words, str(tmp_path / "one"), "--only", "1"]) == 0
    (again,) = json.loads(capsys.readouterr().out)["trials"]
    assert again == document["trials"][1]


def test_a_robot_that_leaves_its_lane_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(LaneEnvelope, "apply", lambda self, position, velocity, command: 1.0)
    soak = soaked(tmp_path / "soak", 1)
    assert "lane" in broken(soak)
    assert soak.extent.command(0) == "swarm soak --realtime --seed 4 --robots 4 --only 0"


def test_a_robot_that_acts_on_old_broadcasts_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def lenient(self: BroadcastInbox, now: int) -> str:
        return "" if self.newest is not None else "nothing heard"

    monkeypatch.setattr(happenings, "KINDS", ("partition", "partition", "partition", "partition", "partition"))
    monkeypatch.setattr(BroadcastInbox, "problem", lenient)
    assert "stale data" in broken(soaked(tmp_path / "soak", 1))
