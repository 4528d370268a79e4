"""What the orchestrator concludes from the reports it gets."""

from __future__ import annotations

from typing import Any

import pytest

from swarmabs_config.graph import CONTROLLER, OBSERVER, PLANE, RECORDER
from swarmabs_run.orchestration.supervision import RESTARTS, Failure, Supervision, how_it_ended, last_lines

ROBOTS = ("agent_001", "agent_002", "agent_003", "agent_017")
NAMES = (PLANE, OBSERVER, CONTROLLER, RECORDER, *ROBOTS)
PIDS = {name: 1000 + index for index, name in enumerate(NAMES)}


def started(**options: Any) -> Supervision:
    state = Supervision(NAMES, **options)
    for name in NAMES:
        state.take({"node": "launcher", "event": "spawned", "name": name, "child": PIDS[name]})
    return state


def exited(name: str, code: int) -> dict[str, object]:
    return {"node": "launcher", "event": "exited", "name": name, "child": PIDS[name], "code": code}


def stalled(node: str, missing: list[str], step: int = 803, silence: float = 5.0) -> dict[str, object]:
    return {
        "node": node,
        "event": "stalled",
        "step": step,
        "missing": missing,
        "count": len(missing),
        "silence": silence,
    }


def test_a_run_is_ready_when_every_process_is() -> None:
    state = started()
    for name in NAMES[:-1]:
        state.take({"node": name, "event": "ready"})
        assert not state.all_ready()
    assert state.not_ready() == (NAMES[-1],)
    state.take({"node": NAMES[-1], "event": "ready"})
    assert state.all_ready()
    assert state.not_ready() == ()


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (0, "ended with exit code 0"),
        (1, "ended with exit code 1"),
        (-9, "was killed by SIGKILL"),
        (-11, "was killed by SIGSEGV"),
        (-99, "was killed by signal 99"),
    ],
)
def test_an_unexpected_end_fails_the_run_and_names_process_and_cause(code: int, words: str) -> None:
    assert how_it_ended(code) == words
    state = started()
    state.take(exited("agent_017", code))
    assert state.failure == Failure(f"agent_017 (process {PIDS['agent_017']}) {words}", ("agent_017",))


def test_a_planned_end_is_no_failure() -> None:
    state = started()
    state.expect_end("agent_002")
    state.take(exited("agent_002", -9))
    assert state.failure is None
    assert state.exited == {"agent_002": -9}


def test_the_recorder_may_end_when_it_is_done() -> None:
    state = started()
    state.take({"node": RECORDER, "event": "done", "complete": True, "problem": None, "figures": {"digest": "x"}})
    state.take(exited(RECORDER, 0))
    assert state.failure is None
    assert state.done is not None


def test_a_recorder_that_ends_with_a_problem_says_which() -> None:
    state = started()
    state.take({"node": RECORDER, "event": "done", "complete": False, "problem": "disk full", "figures": {}})
    state.take({"node": RECORDER, "event": "failed", "reason": "disk full"})
    assert state.failure == Failure("recorder: disk full")
    assert state.done is not None


def test_a_recorder_that_ends_before_it_is_done_fails_the_run() -> None:
    state = started()
    state.take(exited(RECORDER, 1))
    assert state.failure is not None
    assert state.failure.culprits == (RECORDER,)


def test_the_first_failure_stands_and_a_nodes_own_words_come_before_its_end() -> None:
    state = started()
    state.take({"node": CONTROLLER, "event": "failed", "reason": "step 7: the plane turns over"})
    state.take(exited(CONTROLLER, 1))
    state.take(exited("agent_001", -9))
    assert state.failure == Failure("parent_controller: step 7: the plane turns over")


def test_robots_that_may_be_dropped_may_end_but_coordinators_may_not() -> None:
    state = started(dispensable=frozenset(ROBOTS))
    state.take({"node": "agent_001", "event": "failed", "reason": "out of memory"})
    state.take(exited("agent_001", 1))
    state.take(exited("agent_002", -9))
    assert state.failure is None
    state.take(exited(OBSERVER, -9))
    assert state.failure is not None
    assert state.failure.culprits == (OBSERVER,)


@pytest.mark.parametrize(
    ("reports", "culprits", "words"),
    [
        pytest.param(
            [stalled(OBSERVER, ["agent 17"]), stalled(PLANE, ["agent 17"]), stalled("agent_001", ["plane/state"])],
            ("agent_017",),
            f"agent 017 (process {PIDS['agent_017']} is stopped) has not answered step 803 for 5 s",
            id="a robot is silent",
        ),
        pytest.param(
            [
                *(stalled(robot, ["swarm/abstract_state", "swarm/auxiliary_state"], 12) for robot in ROBOTS),
                stalled(PLANE, ["agent 1", "agent 2", "agent 3", "agent 17"], 13),
            ],
            (OBSERVER,),
            f"abstraction_observer (process {PIDS[OBSERVER]} is stopped) has not answered step 12 for 5 s",
            id="the observer is silent",
        ),
        pytest.param(
            [
                stalled(CONTROLLER, ["plane_sim"], 12),
                *(stalled(robot, ["swarm/desired_abstract_state"], 12) for robot in ROBOTS),
                stalled(OBSERVER, ["agent 1"], 13),
            ],
            (PLANE,),
            f"plane_sim (process {PIDS[PLANE]} is stopped) has not answered step 12 for 5 s",
            id="the plane is silent",
        ),
        pytest.param(
            [
                *(stalled(robot, ["swarm/desired_abstract_state"], 12) for robot in ROBOTS),
                stalled(OBSERVER, ["agent 1", "agent 2"], 13),
                stalled(PLANE, ["agent 1", "agent 2"], 13),
            ],
            (CONTROLLER,),
            f"parent_controller (process {PIDS[CONTROLLER]} is stopped) has not answered step 12 for 5 s",
            id="the controller is silent",
        ),
        pytest.param(
            [
                stalled(CONTROLLER, ["recorder"], 110),
                *(stalled(robot, ["swarm/desired_abstract_state"], 110) for robot in ROBOTS),
            ],
            (RECORDER,),
            f"recorder (process {PIDS[RECORDER]} is stopped) has not answered step 110 for 5 s",
            id="the recorder is silent",
        ),
        pytest.param(
            [stalled(OBSERVER, ["agent 2", "agent 3"], silence=6.5), stalled("agent_001", ["swarm/abstract_state"])],
            ("agent_002", "agent_003"),
            f"agent 002 (process {PIDS['agent_002']} is stopped), agent 003 (process {PIDS['agent_003']} is stopped)"
            " have not answered step 803 for 6.5 s",
            id="two robots are silent",
        ),
    ],
)
def test_who_does_not_answer(reports: list[dict[str, object]], culprits: tuple[str, ...], words: str) -> None:
    state = started()
    for report in reports:
        state.take(report)
    assert state.diagnose(dict.fromkeys(NAMES, "stopped")) == Failure(words, culprits)


def test_many_silent_robots_are_counted() -> None:
    robots = tuple(f"agent_{index:03d}" for index in range(1, 51))
    state = Supervision((PLANE, *robots))
    state.take(stalled(PLANE, [f"agent {index}" for index in range(1, 21)], 4))
    failure = state.diagnose({})
    assert len(failure.culprits) == 20
    assert "agent 005 (process None is gone) and 15 more have not answered step 4" in failure.reason


def test_where_everybody_waits_the_waits_are_told() -> None:
    state = started()
    state.take(stalled(OBSERVER, ["agent 1"], 9))
    state.take(stalled("agent_001", ["swarm/abstract_state"], 8))
    failure = state.diagnose({})
    assert failure.culprits == ()
    assert failure.reason == (
        "nothing has moved at step 8 for 5 s: abstraction_observer waits for agent 1;"
        " agent_001 waits for swarm/abstract_state"
    )


def test_who_recovers_is_no_longer_waited_for() -> None:
    state = started()
    state.take(stalled(OBSERVER, ["agent 17"]))
    state.take({"node": OBSERVER, "event": "recovered"})
    assert state.stalls == {}


def test_the_latest_progress_stands() -> None:
    state = started()
    for step in (10, 20):
        state.take({"node": RECORDER, "event": "progress", "step": step, "angle": 0.1, "error": -0.1})
    assert state.progress is not None
    assert state.progress["step"] == 20


def test_last_lines_of_logs() -> None:
    text = "\n".join(f"line {number}" for number in range(20)) + "\n\n  \n"
    assert last_lines([("agent_003", text), ("silent", ""), ("plane_sim", "one\n")], count=2) == (
        "last lines of agent_003.log:\n  line 18\n  line 19\nlast lines of plane_sim.log:\n  one"
    )
    assert last_lines([]) == ""


HOSTS = {1: "agent_001", 2: "agent_002", 3: "agent_003", 17: "agent_017"}


def test_a_robot_that_does_not_come_up_is_started_again_but_not_for_ever() -> None:
    state = started(hosts=HOSTS)
    for _ in range(RESTARTS):
        state.take({"node": "agent_002", "event": "ready"})
        state.take(exited("agent_002", -11))
        assert state.failure is None
        assert state.to_restart() == ("agent_002",)
        assert state.to_restart() == ()
        assert "agent_002" in state.not_ready()
    state.take(exited("agent_002", -11))
    assert state.failure is not None
    assert state.failure.culprits == ("agent_002",)


@pytest.mark.parametrize("name", [OBSERVER, RECORDER])
def test_a_coordinator_is_not_started_again(name: str) -> None:
    state = started(hosts=HOSTS)
    state.take(exited(name, 1))
    assert state.failure is not None
    assert state.to_restart() == ()


def test_nobody_is_started_again_once_the_run_has_begun() -> None:
    state = started(hosts=HOSTS, started=True)
    state.take(exited("agent_002", -11))
    assert state.failure is not None
    assert state.to_restart() == ()


def test_a_few_that_hang_are_named_but_not_a_majority() -> None:
    state = started(hosts=HOSTS)
    for name in (PLANE, OBSERVER, CONTROLLER, RECORDER, *ROBOTS[:1]):
        state.take({"node": name, "event": "ready"})
    assert state.hanging() == ()
    for name in ROBOTS[1:3]:
        state.take({"node": name, "event": "ready"})
    assert state.hanging() == ("agent_017",)


def test_robots_that_share_a_process_are_named_by_it() -> None:
    state = Supervision((PLANE, "agents_001_to_003"), hosts=dict.fromkeys((1, 2, 3), "agents_001_to_003"))
    state.take({"node": "launcher", "event": "spawned", "name": "agents_001_to_003", "child": 77})
    state.take(stalled(PLANE, ["agent 1", "agent 3"], 4))
    assert state.diagnose({}).culprits == ("agents_001_to_003",)


def test_a_robot_that_has_ended_does_not_wait_any_more() -> None:
    state = started(dispensable=frozenset(ROBOTS))
    state.take(stalled("agent_002", ["swarm/abstract_state"]))
    state.take(exited("agent_002", -9))
    assert not state.stalls
    state.take(stalled(OBSERVER, ["agent 2"]))
    assert state.diagnose({}).culprits == ("agent_002",)
