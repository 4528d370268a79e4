"""The firmware of a robot, compiled for this computer, and the drive that talks to it through a pseudo-terminal.

Time of the firmware passes only when a test says so; its true wheels come from its standard output.
"""

import importlib.util
import os
import select
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from itertools import pairwise
from math import exp
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from tests.docs.pages import ROOT
from tests.plugin_packages import install

from swarmabs_config import configure, realtime
from swarmabs_config.graph import CONTROLLER, OBSERVER, PLANE, REALTIME, ROBOT, endpoints
from swarmabs_config.scenario import load_scenario
from swarmabs_core.errors import InputError, RunError
from swarmabs_core.messages import TOPIC_OF, Kind, PlaneState
from swarmabs_core.realtime.agent import RealtimeAgent, RealtimeAgentConfig
from swarmabs_core.realtime.base import Schedule
from swarmabs_core.realtime.controller import RealtimeController
from swarmabs_core.realtime.drives import DRIVES, Body
from swarmabs_core.realtime.observer import RealtimeObserver
from swarmabs_core.realtime.plane import RealtimePlane
from swarmabs_run.orchestration.network import PARTICIPANT_VARIABLE, claimed_domain, dds_environment, profile_xml
from swarmabs_run.tracing_files import tracing_files_removed

FOLDER = ROOT / "examples" / "build_one"
FIRMWARE = FOLDER / "firmware"
STRICT = ("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror")
LONGEST = 100.0  # s, for a compiler or an answer on a busy machine
NOW = 1_700_000_000_000_000_000  # ns
MS = 1_000_000  # ns
BODY = Body(1, Kind.SINGLE_INTEGRATOR, Schedule(10 * MS), 0.5)


def compiler(name: str) -> str:
    found = shutil.which(name)
    if found is None:
        pytest.skip(f"there is no {name} to compile the firmware")
    return found


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Compile the firmware for this computer, with every undefined behaviour an error."""
    path = tmp_path_factory.mktemp("firmware") / "posix_base"
    sources = (FIRMWARE / "posix_base.c", FIRMWARE / "robot" / "base.c")
    checked = ("-fsanitize=undefined,float-cast-overflow", "-fno-sanitize-recover=all")
    words = [compiler("cc"), "-std=c99", *STRICT, *checked, "-O1", *map(str, sources), "-lm", "-o", str(path)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=LONGEST, check=False)
    assert done.returncode == 0, done.stderr
    return path


class Truth(NamedTuple):
    """The true state of the simulated base: us; um/s and um of the left and right wheels; numbers of lines."""

    time: int
    speeds: tuple[float, float]
    ways: tuple[float, float]
    accepted: int
    rejected: int


class Firmware:
    """The running firmware."""

    def __init__(self, program: Path) -> None:
        self.process = subprocess.Popen(
            [program, "--stepped"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
        )
        self.device = self._said().strip()

    def _said(self) -> str:
        assert self.process.stdout is not None
        assert select.select([self.process.stdout], [], [], LONGEST)[0], "the firmware is silent"
        return self.process.stdout.readline()

    def step(self, milliseconds: float = 0, *, stopped: bool = False, place: bool = False) -> Truth:
        """Let time pass after the firmware has read what has arrived; return the true state."""
        assert self.process.stdin is not None
        self.process.stdin.write(f"{round(1000 * milliseconds)} {stopped:d} {place:d}\n")
        time, v1, v2, x1, x2, accepted, rejected = self._said().split()
        return Truth(int(time), (float(v1), float(v2)), (float(x1), float(x2)), int(accepted), int(rejected))

    def heard(self, accepted: int, rejected: int = 0) -> None:
        """Wait until the firmware has read so many lines; no time passes."""
        for _ in range(1_000_000):
            truth = self.step()
            if (truth.accepted, truth.rejected) == (accepted, rejected):
                return
        pytest.fail(f"the firmware counts {truth} instead of {accepted} and {rejected}")

    def unplug(self) -> None:
        """End the firmware, and its pseudo-terminal with it."""
        self.process.communicate(timeout=LONGEST)


@pytest.fixture
def started(program: Path) -> Iterator[Callable[[], Firmware]]:
    """Start further firmware."""
    running: list[Firmware] = []

    def start() -> Firmware:
        running.append(Firmware(program))
        return running[-1]

    yield start
    for firmware in running:
        firmware.unplug()


@pytest.fixture
def firmware(started: Callable[[], Firmware]) -> Firmware:
    return started()


def load(name: str, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Import a module of the example."""
    spec = importlib.util.spec_from_file_location(name, FOLDER / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, name, module)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def module(monkeypatch: pytest.MonkeyPatch) -> Any:
    return load("swarmabs_serial_base", monkeypatch)


@pytest.fixture
def opened(module: Any, firmware: Firmware, packages: Path) -> Iterator[Callable[..., Any]]:
    """Open drives at the device of the firmware, as the node of a robot does."""
    install(packages, "drive", "serial_base", "", target="swarmabs_serial_base:SERIAL_BASE")
    drives = []

    def made(body: Body = BODY, **settings: Any) -> Any:
        drive: Any = DRIVES.make("serial_base", {"device": firmware.device, **settings}, body)
        drives.append(drive)
        return drive

    yield made
    for drive in drives:
        drive.base.close()


def until(read: Callable[[], Any], reached: Callable[[Any], bool]) -> Any:
    """Read until the kernel has delivered what was written."""
    for _ in range(1_000_000):
        value = read()
        if reached(value):
            return value
    pytest.fail(f"not reached: {value}")


def newest(drive: Any, now: int, truth: Truth) -> Any:
    """Return the measurement after the drive has read all that the firmware wrote; it answers every 7 ms."""
    last = truth.time // 7000 * 7000
    return until(lambda: drive.read(now), lambda _: drive.last is not None and drive.last.time == last)


def driven(firmware: Firmware, drive: Any, velocity: float, periods: int, now: int = NOW) -> tuple[Truth, int]:
    """Command a velocity, m/s, for periods of 10 ms; return the true state and the time at the end."""
    accepted, rejected = firmware.step()[-2:]
    for period in range(periods):
        drive.write(velocity, now)
        firmware.heard(accepted + period + 1, rejected)
        truth = firmware.step(10)
        now += 10 * MS
    return truth, now


def test_commands_go_in_and_odometry_comes_out(firmware: Firmware, opened: Any) -> None:
    drive = opened(offset=0.125)
    firmware.step(place=True)
    truth, now = driven(firmware, drive, 0.2, 100)
    assert truth.speeds == pytest.approx((200_000, 200_000), rel=0.01)  # motors of 620 and 560 mm/s at full power
    left, right = truth.ways
    assert left == pytest.approx(right, abs=2000)  # um: otherwise the robot would leave its lane
    measured = newest(drive, now, truth)
    assert measured.velocity == pytest.approx(0.2, rel=0.02)
    behind = (truth.time - truth.time // 7000 * 7000) * 1e-6  # s, since the last answer
    assert measured.position == pytest.approx(0.125 + (left + right) / 2e6 - 0.2 * behind, abs=0.0005)
    assert now - measured.stamp == pytest.approx(behind * 1e9 + 1 * MS, abs=1 * MS)  # measured before the last step


def test_a_robot_that_faces_against_the_lane_and_a_scaled_wheel(firmware: Firmware, opened: Any) -> None:
    drive = opened(offset=-0.2, reversed=True, scale=1.25)
    firmware.step(place=True)
    truth, now = driven(firmware, drive, 0.1, 100)
    assert truth.speeds == pytest.approx((-80_000, -80_000), rel=0.01)  # 0.1 m/s forwards in the lane
    measured = newest(drive, now, truth)
    assert measured.velocity == pytest.approx(0.1, rel=0.02)
    assert measured.position == pytest.approx(-0.2 - 1.25 * sum(truth.ways) / 2e6, abs=0.001)


def test_the_watchdog_stops_the_wheels_when_commands_cease(firmware: Firmware, opened: Any) -> None:
    drive = opened()
    firmware.step(place=True)
    driven(firmware, drive, 0.3, 50)
    assert firmware.step(180).speeds == pytest.approx((300_000, 300_000), rel=0.01)
    assert firmware.step(20).speeds == pytest.approx((300_000, 300_000), rel=0.05)
    halted = firmware.step(500)
    assert halted.speeds == pytest.approx((0, 0), abs=1000)
    truth = firmware.step(4_294_800)  # the time begins again at 0
    assert truth.time < halted.time
    assert truth.ways == pytest.approx(halted.ways, abs=300)  # it holds its place
    drive.read(NOW)
    again, _ = driven(firmware, drive, 0.1, 50, NOW + 4_294_800 * MS)
    assert again.speeds == pytest.approx((100_000, 100_000), rel=0.02)  # a command revives it


def test_a_base_that_has_heard_nothing_gives_no_fresh_measurement(firmware: Firmware, opened: Any) -> None:
    drive = opened()
    firmware.step(place=True)
    measured = newest(drive, NOW, firmware.step(70))
    assert NOW - measured.stamp > 1e9 * 3600  # no command of this computer dates it
    assert ("base", "silent: it hears no commands") in drive.report()


def test_garbage_and_torn_lines_change_nothing_and_are_counted(module: Any, firmware: Firmware) -> None:
    line = module.framed("V,1,200000")
    wrong = [
        b"\n",
        b"hello\n",
        line[:5] + b"\n",
        line[3:],
        line.replace(b"2", b"3", 1),
        line.lower(),
        line[:-2] + bytes([line[-2] ^ 1]) + b"\n",
        line[:-1] + b"0\n",
        line[:-1] + b"\x00 \n",
        b"x" * 5000 + b"\n",
        b"\x00" + line,
        line[:4] + b"\xff\x00" + line[4:],
        module.framed("V,1,500001"),  # faster than it can
        module.framed("V,1,-500001"),
        module.framed("V,-1,1000"),
        module.framed("V,4294967296,1000"),
        module.framed("V,1,"),
        module.framed("V,1,1,1"),
        module.framed("V,1,1e3"),
        module.framed("V,1,99999999999999999999999"),
        module.framed("W,1,1000"),
        module.framed(""),
        b"*\n",
        b"**FFFF\n",
    ]
    with os.fdopen(os.open(firmware.device, os.O_RDWR | os.O_NOCTTY), "wb", buffering=0) as port:
        firmware.step(place=True)
        for number, text in enumerate(wrong, 1):
            port.write(text)
            firmware.heard(0, number)
        assert firmware.step(100).speeds == (0.0, 0.0)
        port.writelines((line[:4], line[4:9], line[9:]))  # a line may come in parts
        firmware.heard(1, len(wrong))
        assert firmware.step(100).speeds[0] > 100_000


def crc(data: bytes) -> int:
    """Return CRC-16/CCITT-FALSE by its definition: the remainder of a division of polynomials."""
    number = (int.from_bytes(data, "big") ^ (0xFFFF << (8 * len(data) - 16))) << 16
    for bit in range(number.bit_length() - 1, 15, -1):
        if number >> bit & 1:
            number ^= 0x11021 << (bit - 16)
    return number


def test_the_checksum_is_that_of_the_catalogue(module: Any, firmware: Firmware, opened: Any) -> None:
    assert crc(b"123456789") == 0x29B1
    assert module.framed("123456789") == b"123456789*29B1\n"


def test_the_drive_ignores_and_counts_what_no_base_says(module: Any, opened: Any) -> None:
    good = module.framed("O,7000,250000,1000,5,20,0,7400,3")
    wrong = [
        b"O,1200,10*",  # the rest of a line that began before the device was opened
        b"",
        b"x",
        good[5:-1],
        good[:-1].replace(b"25", b"52"),
        good[:-1].lower(),
        *(
            module.framed(text)[:-1]
            for text in ("O,7000,nan,1000,5,20,0,7400,0", "O,7,2,1,5,20,3,7400,0", "V,1,200000")
        ),
        b"\xff" + good[:-1],
        b"x" * 3000,
    ]
    board, device = os.openpty()
    drive = opened(device=os.ttyname(device), offset=0.1)
    os.write(board, b"\n".join(wrong) + b"\n" + good)
    until(lambda: drive.read(NOW), lambda measured: measured is not None)
    assert drive.last == (7000, 250000, 1000, 5, 20, 0, 7400, 3)
    assert drive.read(NOW)[1:] == pytest.approx((0.35, 0.001))
    report = dict(drive.report())
    assert report["lines of the base rejected"] == str(len(wrong))
    assert report["commands rejected by the base"] == "3"
    assert report["battery, V"] == "7.40"
    os.close(board)
    os.close(device)


def test_a_base_rejects_what_it_cannot_do(firmware: Firmware, opened: Any) -> None:
    drive = opened()
    firmware.step(place=True)
    drive.write(0.6, NOW)
    firmware.heard(0, 1)
    newest(drive, NOW, firmware.step(70))
    assert dict(drive.report())["commands rejected by the base"] == "1"


def test_the_emergency_stop_takes_effect_until_the_robot_is_placed(firmware: Firmware, opened: Any) -> None:
    drive = opened()
    firmware.step(place=True)
    before, now = driven(firmware, drive, 0.2, 50)
    measured = newest(drive, now, before)
    slower = firmware.step(40, stopped=True)
    assert slower.speeds == pytest.approx([speed * exp(-4 / 3) for speed in before.speeds], rel=0.05)  # no power
    still = firmware.step(400, stopped=True)
    assert still.speeds == pytest.approx((0, 0), abs=500)
    truth, now = driven(firmware, drive, 0.2, 50, now)  # released: commands alone do not move it
    assert truth.ways == pytest.approx(still.ways, abs=100)
    assert newest(drive, now, truth) == measured  # what it measures does not count, so that its node stops it
    assert ("base", "unplaced: put the robot on its mark and press its button") in drive.report()
    firmware.step(place=True)
    truth, now = driven(firmware, drive, 0.2, 50, now)
    assert truth.speeds == pytest.approx((200_000, 200_000), rel=0.02)
    assert newest(drive, now, truth).position == pytest.approx((truth.ways[0] - still.ways[0]) / 1e6, abs=0.003)
    firmware.step(place=True)  # the button of a moving robot
    truth, now = driven(firmware, drive, 0.2, 10, now)
    assert newest(drive, now, truth).position == pytest.approx((truth.ways[0] - still.ways[0]) / 1e6, abs=0.003)


def test_a_node_reports_an_unplugged_base_and_a_missing_one(firmware: Firmware, opened: Any, module: Any) -> None:
    drive = opened()
    firmware.step(place=True)
    driven(firmware, drive, 0.1, 5)
    drive.read(NOW)
    firmware.unplug()
    gone = f"the base at {firmware.device} is gone; plug it in"
    with pytest.raises(RunError, match=gone):
        until(lambda: drive.read(NOW), lambda _: False)
    with pytest.raises(RunError, match=gone):
        drive.write(0.1, NOW)
    drive.stop()  # what is gone stops by itself
    agent = RealtimeAgent(RealtimeAgentConfig(agent_id=1), drive)
    with pytest.raises(RunError, match=gone):  # which halts the node with this text
        agent.tick(NOW)
    agent.halt()
    with pytest.raises(RunError, match=r"cannot be opened: .*; plug it in"):
        opened()


def test_devices_that_are_unsuitable_are_refused(firmware: Firmware, opened: Any, module: Any, tmp_path: Path) -> None:
    opened()
    with pytest.raises(RunError, match="in use by another process"):
        opened()
    file = tmp_path / "file"
    file.touch()
    with pytest.raises(InputError, match="is no serial device"):
        opened(device=str(file))
    with pytest.raises(InputError, match="takes velocities; use the kind single_integrator"):
        opened(Body(1, Kind.DOUBLE_INTEGRATOR, Schedule(10 * MS), 0.5, 1.0))


def test_a_full_line_drops_commands_and_recovers(firmware: Firmware, opened: Any) -> None:
    """The firmware reads nothing while no time passes: the terminal of 4 KiB fills up."""
    drive = opened()
    firmware.step(place=True)
    for number in range(2000):
        drive.write(0.1, NOW + number * MS)
    dropped = int(dict(drive.report())["commands dropped"])
    assert 0 < dropped < 2000
    firmware.heard(2000 - dropped, firmware.step().rejected)
    drive.write(0.1, NOW + 3000 * MS)
    until(firmware.step, lambda truth: truth.accepted == 2001 - dropped)
    assert firmware.step(100).speeds[0] > 50_000


def test_the_sketch_compiles(tmp_path: Path) -> None:
    """Against the declarations of Arduino's functions that it uses."""
    (tmp_path / "Arduino.h").write_text(ARDUINO, encoding="utf-8")
    sketch = FIRMWARE / "robot" / "robot.ino"
    for more in ((), ("-DPLANE",)):
        words = [compiler("g++"), "-std=c++11", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", f"-I{tmp_path}"]
        words += [f"-I{sketch.parent}", *more, "-x", "c++", str(sketch)]
        done = subprocess.run(words, capture_output=True, text=True, timeout=LONGEST, check=False)
        assert done.returncode == 0, done.stderr


ARDUINO = """
#pragma once
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
enum { LOW, HIGH, INPUT_PULLUP, OUTPUT, CHANGE, A0 };
struct SerialPort {
    void begin(unsigned long);
    int available();
    int read();
    size_t write(const uint8_t *, size_t);
};
extern SerialPort Serial;
unsigned long micros();
void pinMode(uint8_t, uint8_t);
int digitalRead(uint8_t);
int analogRead(uint8_t);
void analogWrite(uint8_t, int);
int digitalPinToInterrupt(uint8_t);
void attachInterrupt(int, void (*)(), int);
void noInterrupts();
void interrupts();
"""


@pytest.fixture
def calibrate(module: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    return load("calibrate", monkeypatch)


def test_calibrations_talk_to_the_base(
    calibrate: Any, program: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with subprocess.Popen([program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as running:
        assert running.stdout is not None
        device = running.stdout.readline().strip()
        assert calibrate.main(["delay", device, "--count", "5"]) == 0
        assert capsys.readouterr().out.startswith("delay of command and answer together: ")
        moved = []
        for speed in ("0.2", "-0.2"):
            assert calibrate.main(["drive", device, "--speed", speed, "--duration", "0.3"]) == 0
            moved.append(float(capsys.readouterr().out.split()[1]))
        file = tmp_path / "record.csv"
        assert calibrate.main(["record", device, "-o", str(file), "--duration", "0.1"]) == 0
        header, *lines = file.read_text(encoding="utf-8").splitlines()
        rows = [tuple(map(float, line.split(","))) for line in lines]
        assert header == "time,position,velocity"
        assert rows[0][0] == 0.0
        assert rows[-1][0] >= 0.1
        assert {round(after - before, 6) for (before, *_), (after, *_) in pairwise(rows)} == {0.007}
        assert moved[0] > 0.01 > -0.01 > moved[1]
        # After each drive the base may roll on until its watchdog stops it: 0.2 s at 0.2 m/s.
        assert rows[-1][1] == pytest.approx(sum(moved), abs=0.04)
        running.communicate(timeout=LONGEST)
    assert calibrate.main(["delay", device]) == 1
    assert "cannot be opened" in capsys.readouterr().err


def test_calibrations_refuse_a_base_that_is_not_on_its_mark_or_silent(
    calibrate: Any, firmware: Firmware, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(calibrate, "PATIENCE", 0.01)
    for method, said in (("drive", "nothing was received from"), ("delay", "does not answer commands")):
        assert calibrate.main([method, firmware.device]) == 1
        assert said in capsys.readouterr().err
    monkeypatch.setattr(calibrate, "PATIENCE", LONGEST)
    monkeypatch.setattr(calibrate.SerialBase, "wait", lambda base, longest: firmware.step(7))
    assert calibrate.main(["drive", firmware.device]) == 1
    assert "the base is not on its mark; put it there" in capsys.readouterr().err


def test_two_bases_level_the_plank(started: Callable[[], Firmware], firmware: Firmware, opened: Any) -> None:
    """The nodes of the swarm, and the plane that they simulate, with two robots whose wheels are those of firmware."""
    scenario = load_scenario(FOLDER / "plank.yaml")
    clock = realtime.schedule(scenario, NOW)
    firmwares = [firmware, started()]
    drives = [
        opened(device=board.device, offset=robot.position, reversed=robot.position < 0.0)
        for board, robot in zip(firmwares, scenario.agents, strict=True)
    ]
    configs = realtime.agent_configs(scenario, clock)
    agents = [RealtimeAgent(config, drive) for config, drive in zip(configs, drives, strict=True)]
    controller = realtime.controller_config(scenario, clock)
    coordinators: list[Any] = [
        RealtimePlane(realtime.plane_config(scenario, clock)),
        RealtimeObserver(realtime.observer_config(scenario, clock), {}),
        RealtimeController(controller, lambda: configure.parent_controller(scenario)),
    ]
    roles = (ROBOT, ROBOT, PLANE, OBSERVER, CONTROLLER)
    heard_by = [{topic.name for topic in endpoints(role, REALTIME, robots=2).subscriptions} for role in roles]
    nodes = list(zip([*agents, *coordinators], heard_by, strict=True))
    angles = []

    def send(messages: Any, now: int) -> None:
        waiting = list(messages)
        while waiting:
            message = waiting.pop(0)
            if isinstance(message, PlaneState):
                angles.append(message.angle)
            for node, topics in nodes:
                if TOPIC_OF[type(message)].name in topics:
                    waiting.extend(node.hear(message, now))

    truths = [board.step(place=True) for board in firmwares]
    for step in range(500):
        now = NOW + step * 10 * MS
        for agent, drive, truth in zip(agents, drives, truths, strict=True):
            if step:
                newest(drive, now, truth)
            send(agent.tick(now), now)
        for node in coordinators:
            send(node.tick(now + 5 * MS), now + 5 * MS)
        for board in firmwares:
            board.heard(step + 1)
        truths = [board.step(10) for board in firmwares]
    assert angles[0] == pytest.approx(0.05, abs=0.0001)
    assert max(map(abs, angles[-100:])) < 0.005
    assert max(abs(truth.ways[0]) for truth in truths) > 3000  # um: they have moved


LISTENER = """
import sys

import rclpy
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data

from swarmabs_msgs.msg import AgentState, PlaneState

rclpy.init()
node = Node("listener")
waiting = {"plane/state", "swarm/agent_state"}
for topic, kind in (("plane/state", PlaneState), ("swarm/agent_state", AgentState)):
    node.create_subscription(kind, topic, lambda message, topic=topic: waiting.discard(topic), qos_profile_sensor_data)
while waiting:
    rclpy.spin_once(node)
print("heard both")
"""


@pytest.mark.system
@pytest.mark.timeout(240)
@pytest.mark.usefixtures("nothing_survives")
def test_nodes_publish_what_boards_measure(program: Path, module: Any, packages: Path, tmp_path: Path) -> None:
    """A board at the axis and one in a robot reach the swarm; the nodes of those that are unplugged report it."""
    install(packages, "drive", "serial_base", "", target="swarmabs_serial_base:SERIAL_BASE")
    with tracing_files_removed(), claimed_domain() as domain, ExitStack() as stack:
        profile = tmp_path / "fastdds.xml"
        profile.write_text(profile_xml(domain, realtime=True), encoding="utf-8")
        shared = {**os.environ, **dds_environment(domain, str(profile)), "ROS_LOG_DIR": str(tmp_path / "log")}
        shared["PYTHONPATH"] = os.pathsep.join((str(packages), str(FOLDER), os.environ["PYTHONPATH"]))
        participants = iter("0123456")

        def started(*words: object) -> subprocess.Popen[str]:
            process = subprocess.Popen(
                [str(word) for word in words],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                env={**shared, PARTICIPANT_VARIABLE: next(participants)},
            )
            stack.callback(ended, process)
            return process

        boards = [started(program) for _ in range(2)]
        devices = [board.stdout.readline().strip() for board in boards]  # type: ignore[union-attr]
        encoder = started(sys.executable, FOLDER / "plane_encoder.py", "--ros-args", "-p", f"device:={devices[0]}")
        started(sys.executable, "-m", "plane_sim.driver", "--ros-args", "-r", "__node:=plane_driver")
        settings = ("agent_id:=1", "mass:=0.5", "drive.type:=serial_base", f"drive.device:={devices[1]}")
        words = [word for setting in settings for word in ("-p", setting)]
        robot = started(sys.executable, "-m", "agent_node.realtime", "--ros-args", "-r", "__node:=agent_001", *words)
        assert started(sys.executable, "-c", LISTENER).communicate(timeout=LONGEST)[0] == "heard both\n"
        for board, device in zip(boards, devices, strict=True):
            board.communicate(timeout=LONGEST)
            gone = f"the base at {device} is gone; plug it in, and start this node again"
            node = encoder if device == devices[0] else robot
            until(node.stdout.readline, lambda line, gone=gone: gone in line)  # type: ignore[union-attr]
        robot.terminate()  # its node stays, halted, for an operator
        assert [process.wait(LONGEST) for process in (encoder, robot)] == [1, 1]


def ended(process: subprocess.Popen[str]) -> None:
    """End a process of a test that is still there."""
    if process.poll() is None:
        process.terminate()
    process.communicate(timeout=LONGEST)
