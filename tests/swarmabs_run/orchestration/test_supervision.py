"""How the orchestrator gets reports and signals on the real machine, and what it concludes from reports."""

import os
import select
import signal
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from swarmabs_config.graph import CONTROLLER, OBSERVER, PLANE, RECORDER
from swarmabs_core.messages import SYSTEM_FAMILY, EventKind
from swarmabs_run.orchestration.machine import Machine, woken_by_signals
from swarmabs_run.orchestration.supervision import Failure, Supervision, how_it_ended, last_lines

ROBOTS = ("agent_001", "agent_002", "agent_003", "agent_017")
NAMES = (PLANE, OBSERVER, CONTROLLER, RECORDER, *ROBOTS)
HOSTS = {1: "agent_001", 2: "agent_002", 3: "agent_003", 17: "agent_017"}
PIDS = {name: 1000 + index for index, name in enumerate(NAMES)}


def started(**options: Any) -> Supervision:
    state = Supervision(NAMES, **options)
    for name in NAMES:
        state.take({"node": "launcher", "event": "spawned", "name": name, "child": PIDS[name]})
    return state


def exited(name: str, code: int) -> dict[str, object]:
    return {"node": "launcher", "event": "exited", "name": name, "child": PIDS[name], "code": code}


def waits(node: str, *missing: str, step: int = 803, silence: float = 5.0) -> dict[str, object]:
    return {"node": node, "event": "stalled", "step": step, "missing": missing, "silence": silence}


def test_an_end_is_put_in_words() -> None:
    ends = {0: "ended with exit code 0", -9: "was killed by SIGKILL", -99: "was killed by signal 99"}
    for code, words in ends.items():
        assert how_it_ended(code) == words
        state = started()
        state.take(exited("agent_017", code))
        assert state.failure == Failure(f"agent_017 (process {PIDS['agent_017']}) {words}", ("agent_017",))


SWARM_WAITS = [waits(robot, "swarm/desired_abstract_state", step=12) for robot in ROBOTS]
SUMS_AWAITED = [waits(robot, "swarm/abstract_state", "swarm/auxiliary_state", step=12) for robot in ROBOTS]
ALL_ROBOTS = ("agent 1", "agent 2", "agent 3", "agent 17")
ENDED = (waits("agent_002", "swarm/abstract_state"), exited("agent_002", -9))
WAITS_NO_MORE = (waits(PLANE, "agent 2"), {"node": PLANE, "event": "recovered"})


@pytest.mark.parametrize(
    ("culprits", "step", "reports"),
    [
        ("agent_017", 803, [waits(OBSERVER, "agent 17"), waits(PLANE, "agent 17"), waits("agent_001", "plane/state")]),
        (OBSERVER, 12, [*SUMS_AWAITED, waits(PLANE, *ALL_ROBOTS, step=13)]),
        (PLANE, 12, [waits(CONTROLLER, "plane_sim", step=12), *SWARM_WAITS, waits(OBSERVER, "agent 1", step=13)]),
        (CONTROLLER, 12, [*SWARM_WAITS, waits(OBSERVER, *ALL_ROBOTS[:2], step=13), waits(PLANE, "agent 1", step=13)]),
        (RECORDER, 12, [waits(CONTROLLER, "recorder", step=12), *SWARM_WAITS]),
        ("agent_002 agent_003", 803, [waits(OBSERVER, *ALL_ROBOTS[1:3]), waits("agent_001", "sums", silence=2.0)]),
        ("agent_002", 803, [*ENDED, waits(OBSERVER, "agent 2")]),
        ("agent_001", 803, [waits(OBSERVER, "agent 1"), *WAITS_NO_MORE]),
    ],
)
def test_who_does_not_answer(culprits: str, step: int, reports: list[dict[str, object]]) -> None:
    state = started(dispensable=frozenset(ROBOTS))
    for report in reports:
        state.take(report)
    shown = [f"{name.replace('agent_', 'agent ')} (process {PIDS[name]} is stopped)" for name in culprits.split()]
    words = f"{', '.join(shown)} {'has' if len(shown) == 1 else 'have'} not answered step {step} for 5 s"
    assert state.diagnose(dict.fromkeys(NAMES, "stopped")) == Failure(words, tuple(culprits.split()))


def test_many_silent_robots_are_counted_and_named_by_the_process_that_they_share() -> None:
    robots = tuple(f"agent_{index:03d}" for index in range(1, 51))
    for count, words in ((5, "agent 005 (process None is gone) have not"), (6, "is gone) and 1 more have not")):
        state = Supervision((PLANE, *robots))
        state.take(waits(PLANE, *(f"agent {index}" for index in range(1, count + 1)), step=4))
        failure = state.diagnose({})
        assert (len(failure.culprits), failure.reason.count("process None")) == (count, 5)
        assert words in failure.reason
    state = Supervision((PLANE, "agents_001_to_003"), hosts=dict.fromkeys((1, 2, 3), "agents_001_to_003"))
    state.take(waits(PLANE, "agent 1", "agent 3", step=4))
    assert state.diagnose({}).culprits == ("agents_001_to_003",)


def test_where_everybody_waits_the_waits_are_told() -> None:
    state = started()
    assert state.diagnose({}) == Failure("no progress at step 0 for 0 s: ")
    state.take(waits(OBSERVER, "agent 1", step=9))
    state.take(waits("agent_001", "swarm/abstract_state", step=8))
    assert state.diagnose({}) == Failure(
        "no progress at step 8 for 5 s: abstraction_observer waits for agent 1;"
        " agent_001 waits for swarm/abstract_state"
    )


def test_an_event_that_no_node_has_published_ends_the_run() -> None:
    state = started()
    own, foreign = ["aa", 7, 2, EventKind.DEAD], ["bb", 8, 0, EventKind.LIMIT_HIT]
    state.take({"node": OBSERVER, "event": "publishes", "events": [own]})
    state.take({"node": RECORDER, "event": "recorded", "events": [own]})
    assert state.failure is None
    state.take({"node": RECORDER, "event": "recorded", "events": [own, foreign]})
    assert state.failure == Failure(
        "recorder: swarm/events: an event 'limit hit' of step 8 that no node of this run has published; is a second "
        "swarm in this namespace?"
    )


def test_last_lines_of_logs() -> None:
    text = "\n".join(f"line {number}" for number in range(20)) + "\n\n  \n"
    assert last_lines([("agent_003", text), ("silent", ""), ("plane_sim", "one\n")], count=2) == (
        "last lines of agent_003.log:\n  line 18\n  line 19\nlast lines of plane_sim.log:\n  one"
    )
    assert last_lines([]) == ""


def test_a_few_robots_that_hang_are_named_but_not_half_of_them() -> None:
    state = started(hosts=HOSTS)
    for name in (PLANE, OBSERVER, CONTROLLER, RECORDER, *ROBOTS[:2]):
        state.take({"node": name, "event": "ready"})
    assert state.hanging() == ()
    state.take({"node": ROBOTS[2], "event": "ready"})
    assert state.hanging() == state.not_ready() == ("agent_017",)


def test_listening_ends_with_a_report_or_a_signal() -> None:
    before = signal.signal(signal.SIGUSR1, lambda *_: None)
    reports, write = os.pipe()
    os.set_blocking(reports, False)
    started = SimpleNamespace(reports=reports, start=-1, process=SimpleNamespace(pid=7, stdin=None), taken=False)
    try:
        with woken_by_signals() as wake:
            machine = Machine({}, Path("log"), processes=1, started=cast("Any", started), wake=wake)
            assert (machine.launcher, started.taken, machine.listen()) == (7, True, [])
            os.write(write, b'{"event": "ready"}\n{"event": ')
            assert machine.listen(1000.0) == [{"event": "ready"}]
            os.write(write, b'"done"}\n')
            assert machine.listen(1000.0) == [{"event": "done"}]
            signal.raise_signal(signal.SIGUSR1)
            assert machine.listen(1000.0) == []
            assert not select.select([wake], [], [], 0.0)[0], "the signal is taken note of once"
            assert machine.state_of(os.getpid()) in {"running", "sleeping"} and machine.state_of(2**22 + 1) == "dead"
        assert signal.set_wakeup_fd(-1) == -1
    finally:
        signal.signal(signal.SIGUSR1, before)
        os.close(reports)
        os.close(write)


def test_who_does_not_answer_is_found_on_any_parent_system() -> None:
    family = SYSTEM_FAMILY
    state = Supervision((family.node, OBSERVER, CONTROLLER, "agent_001"))
    state.take(waits(CONTROLLER, family.node))
    state.take(waits("agent_001", family.parent.name))
    state.take(waits(OBSERVER, family.parent.name))
    assert state.diagnose({}).culprits == ("parent_system",)
    state = Supervision((family.node, OBSERVER, CONTROLLER, "agent_001"))
    state.take(waits("agent_001", family.abstract.name))
    assert state.diagnose({}).culprits == (OBSERVER,)
