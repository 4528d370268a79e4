"""What a run with standbys survives, on a machine whose processes and clocks are made up."""

from pathlib import Path
from signal import SIGCONT, SIGKILL, SIGSTOP, SIGTERM, SIGUSR1
from typing import NamedTuple

import pytest
from tests.swarmabs_run.orchestration.test_runs import (
    A_SECOND,
    NAMES,
    ROBOTS,
    FakeMachine,
    Happening,
    done,
    drive,
    exited,
    noted,
    report,
)

from swarmabs_bag.run_folder import RunFolder
from swarmabs_config.graph import CONTROLLER, OBSERVER, PLANE, RECORDER, standby_name
from swarmabs_run.run import Outcome

SECOND = standby_name(RECORDER)
ALL = (*NAMES[:4], *map(standby_name, NAMES[1:4]), *ROBOTS)
KILLED = "was killed by SIGKILL"


def second_done(seconds: float, digest: str | None = "abc", problem: str | None = None) -> Happening:
    figures = {"digest": digest}
    return report(seconds, SECOND, "done", complete=problem is None, problem=problem, figures=figures)


BOTH = (*A_SECOND, second_done(1.1))


class Lost(NamedTuple):
    """What happens after the first step, what is lost, whose bag it is, and why the run failed if it has.

    `told` are the steps, nodes and roles of the changes that the summary lists; by default no standby leads.
    """

    happens: tuple[Happening, ...]
    lost: dict[str, str]
    recorder: str = RECORDER
    reason: str | None = None
    stopped: tuple[str, ...] = ()
    told: tuple[tuple[int, str, str], ...] | None = None


ENDINGS = {
    "nothing": Lost(BOTH, {}),
    "the observer": Lost(
        (
            exited(0.3, OBSERVER, -9),
            report(0.4, standby_name(OBSERVER), "leads", step=31),
            *BOTH,
        ),
        {OBSERVER: KILLED},
        told=((30, OBSERVER, "is lost"), (31, standby_name(OBSERVER), "leads")),
    ),
    "a controller that is only late": Lost(
        (
            report(0.4, standby_name(CONTROLLER), "leads", step=40),
            report(0.5, standby_name(CONTROLLER), "yields", step=43),
            *BOTH,
        ),
        {},
    ),
    "one that is stopped and replaced": Lost(
        (report(0.4, standby_name(CONTROLLER), "leads", step=40), *BOTH),
        {CONTROLLER: "was stopped"},
        stopped=(CONTROLLER,),
        told=((40, standby_name(CONTROLLER), "leads"), (40, CONTROLLER, "is silent")),
    ),
    "a standby": Lost((exited(0.3, standby_name(CONTROLLER), -9), *BOTH), {standby_name(CONTROLLER): KILLED}),
    "one that fell behind": Lost(
        (report(0.3, CONTROLLER, "behind", reason="fell behind"), exited(0.3, CONTROLLER, 0), *BOTH),
        {CONTROLLER: "fell behind"},
    ),
    "one that is stopped": Lost(BOTH, {CONTROLLER: "was stopped"}, stopped=(CONTROLLER,)),
    "one that continues": Lost(
        (
            report(0.4, standby_name(CONTROLLER), "leads", step=40),
            (0.7, lambda machine: setattr(machine, "stopped", ())),
            report(0.8, standby_name(CONTROLLER), "yields", step=43),
            *BOTH,
        ),
        {},
        stopped=(CONTROLLER,),
        told=(
            (40, standby_name(CONTROLLER), "leads"),
            (40, CONTROLLER, "is silent"),
            (43, CONTROLLER, "leads"),
            (43, standby_name(CONTROLLER), "stands by"),
        ),
    ),
    "the recorder": Lost((exited(0.3, RECORDER, -9), *A_SECOND[:-1], second_done(1.1)), {RECORDER: KILLED}, SECOND),
    "the recorder's disk": Lost(
        (
            done(0.3, complete=False, problem="disk full"),
            report(0.3, RECORDER, "failed", reason="disk full"),
            exited(0.3, RECORDER, 1),
            *A_SECOND[:-1],
            second_done(1.1),
        ),
        {RECORDER: "disk full"},
        SECOND,
    ),
    "both disks": Lost(
        (done(0.3, complete=False, problem="disk full"), second_done(0.4, None, "disk full, too")),
        {RECORDER: "disk full"},
        reason=f"{SECOND}: disk full, too",
    ),
    "both observers": Lost(
        (exited(0.3, OBSERVER, -9), exited(0.5, standby_name(OBSERVER), -9)),
        {OBSERVER: KILLED, standby_name(OBSERVER): KILLED},
        reason=f"{standby_name(OBSERVER)} (process 105) {KILLED}; {OBSERVER} (process 102) {KILLED} before",
    ),
    "nothing, but bits differ": Lost(
        (*A_SECOND, second_done(1.1, "abd")), {}, reason="the two recorders have recorded different runs"
    ),
    "the plane": Lost((exited(0.3, PLANE, -9),), {}, reason=f"{PLANE} (process 101) {KILLED}"),
}


def drive_with_standbys(machine: FakeMachine, path: Path, *overrides: str) -> Outcome:
    return drive(machine, path, *overrides, standby=True, record=False)


@pytest.mark.parametrize("name", ENDINGS)
def test_what_a_run_with_standbys_survives(tmp_path: Path, name: str) -> None:
    happens_to = ENDINGS[name]
    happens, lost, recorder, reason, stopped, _ = happens_to
    machine = FakeMachine(happens, stopped=stopped)
    outcome = drive_with_standbys(machine, tmp_path)
    assert tuple(machine.spawned) == ALL
    assert (outcome.status, (outcome.reason or "").split("\n")[0]) == ("failed" if reason else "ok", reason or "")
    assert outcome.standby is not None
    assert (outcome.standby["lost"], outcome.standby["recorder"]) == (lost, recorder)
    told = [(role["step"], role["node"], role["role"]) for role in outcome.standby["roles"]]
    gone = [] if reason else [(30, node, "is lost") for node in lost if node not in stopped]
    assert reason or told == [*(happens_to.told if happens_to.told is not None else gone)]
    news = [role["node"] for role in outcome.standby["roles"] if role["role"] == "leads"]
    assert all(f"{node} leads from step" in noted(tmp_path) for node in news)
    assert outcome.figures.get("digest") == (None if reason and "differ" not in reason else "abc")
    peers = {name: standby_name(name) for name in NAMES[1:4]} | {standby_name(name): name for name in NAMES[1:4]}
    warned = {name: how for name, how in lost.items() if name in NAMES or peers[name] not in lost}
    warnings = tuple(f"{name} {how}; the run continued with {peers[name]}" for name, how in warned.items())
    assert outcome.warnings == warnings
    ended = {what["name"] for _, what in happens if isinstance(what, dict) and what["event"] == "exited"}
    told = [name for name, number in machine.signals if number == SIGUSR1]
    assert reason or told == [peers[name] for name in peers if name in ended]


def test_the_bag_of_the_standby_recorder_becomes_that_of_the_run(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path / "run")

    def write(_: FakeMachine) -> None:
        for bag, text in ((folder.bag, "half"), (folder.standby.bag, "whole")):
            bag.mkdir(parents=True)
            (bag / "bag_0.mcap").write_text(text)

    machine = FakeMachine(((0.1, write), *ENDINGS["the recorder"].happens))
    assert drive(machine, tmp_path, standby=True).status == "ok"
    assert {path.name: (path / "bag_0.mcap").read_text() for path in folder.path.glob("bag*")} == {
        "bag": "whole",
        "bag_incomplete": "half",
    }
    assert not folder.standby.path.exists()


def test_faults_hit_coordinators_once_their_steps_are_recorded(tmp_path: Path) -> None:
    faults = (
        f"{{at: 0.3, kind: freeze_node, node: {OBSERVER}, until: 0.6}}",
        f"{{at: 0.5, kind: kill_node, node: {SECOND}}}",
    )
    machine = FakeMachine(A_SECOND)
    outcome = drive_with_standbys(machine, tmp_path, f"faults=[{', '.join(faults)}]")
    assert (outcome.status, outcome.standby and outcome.standby["lost"]) == ("ok", {SECOND: KILLED})
    hits = [(OBSERVER, SIGSTOP), (SECOND, SIGKILL), (RECORDER, SIGUSR1), (OBSERVER, SIGCONT)]
    assert machine.signals == [*hits, (RECORDER, SIGTERM), (SECOND, SIGTERM)]
    assert f"fault: SIGKILL to {SECOND} (process 107)" in noted(tmp_path)
