"""Runs with standbys, as processes over DDS, in which coordinators are killed or stopped."""

import asyncio
import json
import os
import signal
from pathlib import Path
from typing import Any

import pytest
from tests.system import helpers as runs
from tests.system.test_view import look
from tests.systems import BEAM_SCENARIO

from swarmabs_bag.merge import merge_bags
from swarmabs_bag.reader import open_bag
from swarmabs_config.graph import CONTROLLER, OBSERVER, RECORDER, standby_name
from swarmabs_core.messages import EventKind

pytestmark = [pytest.mark.system, pytest.mark.timeout(300)]

SCENARIOS = {"pd_het_4": 10.0, "arise_het_20": 4.0}
"""With the simulated time, s: four robots, and twenty with packed messages."""
KILLED = "was killed by SIGKILL"


def fault(node: str, kind: str = "kill_node", **times: float) -> str:
    return "{" + ", ".join(f"{k}: {v}" for k, v in {"kind": kind, "node": node, **times}.items()) + "}"


@pytest.mark.parametrize("scenario", SCENARIOS)
@pytest.mark.parametrize("node", [OBSERVER, CONTROLLER, RECORDER])
def test_a_coordinator_dies(folder: Path, scenario: str, node: str) -> None:
    overrides = (runs.seconds(SCENARIOS[scenario]), f"faults=[{fault(node, at=1.5)}]")
    outcome = runs.lockstep(folder, scenario, *overrides, standby=True)
    assert (outcome.status, outcome.reason) == ("ok", None)
    assert outcome.warnings == (f"{node} {KILLED}; the run continued with {standby_name(node)}",)
    assert outcome.figures["digest"] == runs.simulated_digest(scenario, overrides[0])
    assert outcome.figures["digest"] == runs.bag_digest(runs.bag_messages(folder))
    assert outcome.standby is not None
    assert outcome.standby["lost"] == {node: KILLED}
    roles = outcome.standby["roles"]
    assert (node, "is lost") in {(role["node"], role["role"]) for role in roles}
    assert (folder / "bag_incomplete").exists() == (node == RECORDER)
    if node == RECORDER:
        assert outcome.standby["recorder"] == standby_name(RECORDER)
        assert not (folder / "standby").exists()
    else:
        assert list(open_bag(folder / "standby").messages()) == list(open_bag(folder).messages())
        leads = next(role for role in reversed(roles) if role["node"] == standby_name(node))
        assert leads["role"] == "leads"
        assert leads["step"] >= 150
        assert f"{standby_name(node)} leads from step {leads['step']}: {node} " in runs.run_log(folder)
        assert merge_bags([folder, folder / "standby"], folder / "both" / "bag").complete
        assert outcome.figures["digest"] == runs.bag_digest(runs.bag_messages(folder / "both"))


@pytest.mark.usefixtures("systems")
@pytest.mark.parametrize("node", [CONTROLLER, RECORDER])
def test_a_view_of_another_parent_system_shows_the_takeover(
    folder: Path, tmp_path: Path, packages: Path, monkeypatch: pytest.MonkeyPatch, node: str
) -> None:
    scenario = tmp_path / "beam.yaml"
    scenario.write_text(BEAM_SCENARIO, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(packages), prepend=os.pathsep)
    length = runs.seconds(20.0)
    words = ("--view", "--standby", "--set", length, "--set", f"faults=[{fault(node, at=1.5)}]")

    def takeovers(found: list[dict[str, Any]]) -> list[dict[str, Any]]:
        events = [event for message in found if message["type"] == "events" for event in message["events"]]
        return [event for event in events if event["kind"] == EventKind.LEADING.name]

    with runs.started_swarm("run", scenario, "-o", folder, *words) as command:
        (told,) = takeovers(asyncio.run(look(runs.view_address(command), takeovers)))
        finished = command.wait()
    assert finished.code == 0, finished.err
    assert told["detail"].startswith(f"{standby_name(node)}: {node} ")
    assert told["step"] >= 150
    assert runs.summary_of(folder)["digest"] == runs.simulated_digest(str(scenario), length)


def test_three_are_stopped_and_two_of_them_continue(folder: Path) -> None:
    faults = (
        fault(OBSERVER, "freeze_node", at=1.0, until=1.2),
        fault(RECORDER, "freeze_node", at=2.0),
        fault(standby_name(CONTROLLER), "freeze_node", at=3.0, until=6.0),
    )
    overrides = (runs.seconds(10.0), f"faults=[{', '.join(faults)}]")
    outcome = runs.lockstep(folder, "pd_het_4", *overrides, standby=True)
    assert (outcome.status, outcome.reason) == ("ok", None)
    assert outcome.figures["digest"] == runs.simulated_digest("pd_het_4", overrides[0])
    assert outcome.standby is not None
    assert outcome.standby["lost"][RECORDER] == "was stopped"
    assert outcome.figures["digest"] == runs.bag_digest(runs.bag_messages(folder))


def test_both_of_a_pair_are_killed_by_hand(folder: Path) -> None:
    pids: dict[str, int] = {}

    def kill(name: str) -> None:
        pids.update(json.loads((folder / "logs" / "processes.json").read_text(encoding="utf-8")))
        os.kill(pids[name], signal.SIGKILL)

    watch = runs.at({100: lambda: kill(OBSERVER), 300: lambda: kill(standby_name(OBSERVER))})
    outcome = runs.lockstep(folder, "pd_het_4", runs.FOREVER, standby=True, on_progress=watch)
    assert outcome.status == "failed"
    assert outcome.reason is not None
    first, second = f"(process {pids[OBSERVER]}) {KILLED}", f"(process {pids[standby_name(OBSERVER)]}) {KILLED}"
    assert outcome.reason.startswith(f"{standby_name(OBSERVER)} {second}; {OBSERVER} {first} before")


def test_faults_of_coordinators_need_standbys(folder: Path) -> None:
    done = runs.swarm("run", "--set", f"faults=[{fault(OBSERVER, at=1.0)}]", "-o", folder)
    assert done.code == 2
    assert done.err == (
        "error: faults: a run does not survive 'kill_node' of abstraction_observer without standbys; "
        "run with --standby, or remove the fault\n"
    )
    assert not folder.exists()
