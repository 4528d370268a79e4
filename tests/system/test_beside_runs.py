"""Who takes part in a run from outside: a node that looks at it, markers, and somebody who steers it."""

import cmath
import json
import signal
import socket
from pathlib import Path
from typing import Any

import psutil
import pytest
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from tests.processes import marked_processes, until
from tests.system import helpers as runs
from tests.system.realtime import started_client
from visualization_msgs.msg import MarkerArray

from swarmabs_bag.arrays import load_arrays
from swarmabs_bag.attached import attached_scenario
from swarmabs_bag.reader import open_bag
from swarmabs_core.faults import MembershipFault
from swarmabs_core.messages import EventKind
from swarmabs_run.orchestration.run_files import environment_of_run, read_progress
from swarmabs_run.steering.client import SteeringClient

pytestmark = [pytest.mark.system, pytest.mark.timeout(400)]

BROADCASTS = ["/swarm/abstract_state", "/swarm/auxiliary_state", "/swarm/desired_abstract_state"]
EVENTS = "/swarm/events"
ROBOTS = ("agent_001", "agent_002", "agent_003", "agent_004")
ENDS = {
    "plane_sim": (["/plane/state", EVENTS], ["/swarm/agent_state", EVENTS]),
    "abstraction_observer": ([*BROADCASTS[:2], EVENTS], ["/swarm/agent_state"]),
    "parent_controller": ([BROADCASTS[2], EVENTS], ["/plane/state", "/recording/progress"]),
    "recorder": (
        ["/recording/progress"],
        ["/plane/state", *BROADCASTS[:2], "/swarm/agent_state", BROADCASTS[2], EVENTS],
    ),
    **dict.fromkeys(ROBOTS, (["/swarm/agent_state", EVENTS], BROADCASTS)),
}
"""What each node publishes and hears."""


def test_every_robot_is_a_process_that_hears_the_broadcasts_and_nothing_else(folder: Path, mark: str) -> None:
    graph = {
        name: {"publishes": sorted(publishes), "hears": sorted(hears), "serves": []}
        for name, (publishes, hears) in ENDS.items()
    }

    def look() -> None:
        processes = runs.named_processes(mark)
        assert processes.keys() == {*ROBOTS, *runs.COORDINATORS} == graph.keys()
        assert all(psutil.Process(pid).memory_info().rss > 0 for pid in processes.values())
        with started_client(environment_of_run(folder), "stock_node") as client:

            def seen() -> dict[str, Any]:
                """Return what becomes known one by one."""
                graphs = {name: client.graph(name) for name in client.nodes()}
                for entry in graphs.values():
                    entry["publishes"] = [name for name in entry["publishes"] if name != "/parameter_events"]
                return graphs

            until(lambda: seen() == graph, "all that is known of the nodes is as it should be")
        shown = runs.swarm("env", folder, "--json")
        assert environment_of_run(folder).items() <= json.loads(shown.out).items()
        refused = runs.swarm("remove", folder, 1)
        assert (refused.code, "operator commands need a realtime run" in refused.err) == (2, True)
        runs.interrupt()

    assert runs.lockstep(folder, "pd_het_4", runs.FOREVER, on_progress=runs.at({1: look})).status == "interrupted"
    for words in (("env", folder), ("remove", folder, 1), ("stop", folder), ("view", "--live", folder)):
        over = runs.swarm(*words)
        assert (over.code, f"error: {folder}: this run is over" in over.err) == (2, True), over


LENGTH = runs.seconds(150.0)
ENOUGH = 5
"""Messages of each topic that are looked at."""


def step_of(message: Any) -> int:
    stamp = message.header.stamp
    return int(stamp.sec * 10**9 + stamp.nanosec) // 10_000_000


def test_a_ros_node_sees_what_is_recorded_and_a_run_does_not_wait_for_markers(folder: Path, mark: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = int(probe.getsockname()[1])
    shown = ("--markers", "--foxglove", "--foxglove-port", port)
    with runs.started_swarm("run", "--set", LENGTH, "-o", folder, "--json", *shown) as command:
        # They have their log as soon as the run has begun.
        until((folder / "logs" / "markers.log").exists, "the markers and the run have begun")
        processes = map(psutil.Process, marked_processes(mark))
        (markers,) = (
            process for process in processes if "swarmabs_view.visualization.run_markers" in process.cmdline()
        )
        with started_client(environment_of_run(folder), "stock_node") as client:
            client.hear("/plane/joint_states", "sensor_msgs/JointState")
            client.hear("/swarm/markers", "visualization_msgs/MarkerArray")
            until(lambda: all(len(texts) >= ENOUGH for texts in client.payloads().values()), "enough")
            heard = {topic: [bytes.fromhex(text) for text in texts] for topic, texts in client.payloads().items()}
        served = [
            connection.laddr for connection in markers.net_connections("tcp") if connection.status == psutil.CONN_LISTEN
        ]
        assert served == [("127.0.0.1", port)], "Foxglove is served on this machine alone"
        markers.send_signal(signal.SIGSTOP)
        done = command.wait()
    assert done.code == 0, done.err
    assert done.summary()["digest"] == runs.simulated_digest("pd_het_4", LENGTH)
    assert "warning: the process for RViz" not in done.err  # killed at the end is not failed
    assert "Traceback" not in (folder / "logs" / "markers.log").read_text()
    recorded = load_arrays(folder)
    for data in heard["/plane/joint_states"]:
        joint = deserialize_message(data, JointState)
        assert (list(joint.name), list(joint.position)) == (["plane_tilt"], [recorded.angle[step_of(joint)]])
    ids = list(recorded.agents.ids)
    for data in heard["/swarm/markers"]:
        robots = [marker for marker in deserialize_message(data, MarkerArray).markers if marker.ns == "robots"]
        assert [robot.id for robot in robots] == ids
        for robot in robots:
            turn = cmath.exp(1j * recorded.angle[step_of(robot)])
            along = ((robot.pose.position.x + 1j * robot.pose.position.z) / turn).real
            # Best effort: of a robot the last state that came up to then, as a rule that of the step.
            before = recorded.agents.position[: step_of(robot) + 1, ids.index(robot.id)]
            assert min(abs(along - before)) < 1e-9


SLOWLY = ("--duration", 120, "--rate", 4)
"""So that all requests come before the end, also beside other load."""
SEVEN = (
    *("--set", "swarm.agents=null", "--set", "swarm.generate={single_integrator: 3, double_integrator: 4}"),
    *("--set", "faults=[{kind: join, at: null, agent: 7}, {kind: disturbance, at: 0, torque: 0.1, until: 0.01}]"),
)
REQUESTS = {
    ("reference", "0.05"): (0, EventKind.STEERING, "reference"),
    ("disturbance", "-0.1"): (0, EventKind.STEERING, "disturbance"),
    ("add", "7"): (7, EventKind.JOINED, ""),
    ("kill", "3"): (3, EventKind.DEAD, "kill"),
    ("reference", "-0.05"): (0, EventKind.STEERING, "reference"),
    ("freeze", "5"): (5, EventKind.DEAD, "freeze"),
    ("leave", "2"): (2, EventKind.LEFT, "remove"),
}
"""What is asked by the command, with the event that is recorded."""


PAUSED_LENGTH = runs.seconds(20.0)


@pytest.mark.parametrize("end", [None, signal.SIGINT, signal.SIGTERM])
def test_a_pause_is_not_recorded_and_a_paused_run_can_be_ended(folder: Path, end: signal.Signals | None) -> None:
    """It lasts longer than the silence after which the nodes report a stall, and drop silent robots."""
    stall = ("--set", "lockstep={stall_timeout: 0.5, on_stall: drop}")
    words = ("run", "pd_het_4", "--set", PAUSED_LENGTH, *stall, "--steer", "-o", folder, "--json")
    with runs.started_swarm(*words) as command:
        until((folder / "steer.sock").exists, "there is a socket")
        assert runs.swarm("steer", folder, "pause").out.startswith("paused at step ")
        until(lambda: phase_of(folder) == "paused", "the run says that it is paused")
        paused = read_progress(folder / "logs")
        assert paused is not None
        until(lambda: told_after(folder, paused.told_at + 5.0), "the pause lasts longer than ten stall times")
        assert ", paused" in runs.swarm("steer", folder, "status").out
        if end is None:
            assert runs.swarm("steer", folder, "resume").out.startswith("resumed at step ")
        else:
            command.process.send_signal(end)
        done = command.wait()
    assert (done.code, done.summary()["status"]) == ((0, "ok") if end is None else (1, "interrupted"))
    if end is None:
        assert done.summary()["digest"] == runs.simulated_digest("pd_het_4", PAUSED_LENGTH)
    assert runs.swarm("verify", folder).code == 0


def phase_of(folder: Path) -> str:
    progress = read_progress(folder / "logs")
    return "" if progress is None else progress.phase


def told_after(folder: Path, time: float) -> bool:
    progress = read_progress(folder / "logs")
    return progress is not None and progress.told_at > time


def test_a_steered_run_can_be_repeated(tmp_path: Path) -> None:
    """Also from a folder whose path is longer than that of a socket may be."""
    folder = tmp_path / ("long" * 30) / "run"
    folder.parent.mkdir()
    wanted = {(step, 0, EventKind.STEERING, "disturbance") for step in (0, 1)}  # as planned
    with runs.started_swarm("run", "pd_het_4", *SLOWLY, *SEVEN, "--steer", "-o", folder, "--json") as command:
        until((folder / "steer.sock").exists, "there is a socket")
        with SteeringClient(folder) as client:
            last = 0
            for words, event in REQUESTS.items():
                until(lambda: client.ask({"action": "status"})["step"] > last + 37, "some steps pass")  # noqa: B023
                last = runs.swarm("steer", folder, *words, "--json").summary()["step"]
                wanted.add((last, *event))
            held = client.ask({"action": "status"})
        values = [held[name] for name in ("members", "absent", "reference", "disturbance")]
        assert values == [[1, 4, 6, 7], [], -0.05, -0.1]
        assert command.wait().code == 0
    assert not (folder / "steer.sock").exists()
    told = {(event.step, event.agent_id, event.kind, event.detail) for event in runs.events(folder)}
    assert {event for event in told if event[2] not in {EventKind.LIMIT_HIT, EventKind.SAFE_STOP}} == wanted
    assert runs.run_log(folder).count("steered: ") == len(REQUESTS)

    verdict = runs.swarm("verify", folder, "--json").summary()
    assert (verdict["ok"], verdict["complete"], "from outside" in verdict["notes"][0]) == (True, True, True)
    figures = ("digest", "settled_at", "final_error", "rms_error", "max_abs_position", "messages")
    for name in ("run", "simulate"):
        again = runs.swarm(name, folder, "-o", tmp_path / name, "--json")
        assert (again.code, again.summary()["rerun_of"]["same"]) == (0, True), again.err
        assert {key: again.summary()[key] for key in figures} == {key: runs.summary_of(folder)[key] for key in figures}
    planned = {fault.agent for fault in attached_scenario(open_bag(folder)).faults_of(MembershipFault)}
    assert planned == {2, 3, 5, 7}
