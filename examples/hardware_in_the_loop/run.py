"""Hardware in the loop without hardware: the nodes of a swarm drive robots simulated by another process.

python examples/hardware_in_the_loop/run.py [-o DIR] [--duration S]
"""

from __future__ import annotations

import argparse
import csv
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from rig import END_STOP, LENGTH, ROBOTS, Robot

from swarmabs_config.graph import COORDINATORS
from swarmabs_core.errors import InputError, RunError
from swarmabs_run.ending import die_with_parent
from swarmabs_run.orchestration.network import PARTICIPANT_VARIABLE, claimed_domain, dds_environment, profile_xml
from swarmabs_run.tracing_files import tracing_files_removed

FOLDER = Path(__file__).parent
PATIENCE = 60.0
"""Time within which the robots must move, s."""
ENDING = 5.0
"""Time within which a process must end, s."""
COORDINATING = ("plane_driver", "abstraction_observer", "parent_controller", "rig")
"""Processes that all others must discover."""
MASS = sum(robot.mass for robot in ROBOTS)


def drive(robot: Robot) -> dict[str, object]:
    """Return the parameters of a robot's drive, which connects its law to the rig."""
    found: dict[str, object] = {"drive.type": "topic"}
    if robot.source == "wheel":
        found |= {
            "drive.source": "joint_state",
            "drive.command": "joint",
            "drive.joint.name": "wheel",
            "drive.joint.scale": robot.wheel_radius,
            "drive.reversed": robot.facing < 0.0,
            "drive.offset": robot.position,
        }
    elif robot.source == "localisation":
        found |= {"drive.frame": "plane"}
    else:
        found |= {"drive.axis": "+x" if robot.facing > 0.0 else "-x", "drive.offset": robot.position}
    return found


def agent(robot: Robot) -> dict[str, object]:
    """Return the parameters of a robot's node."""
    return {
        "agent_id": robot.id,
        "kind": robot.kind,
        "mass": robot.mass,
        "damping": robot.damping,
        "plane_length": LENGTH,
        "swarm_mass": MASS,
        "limits.velocity": 1.0,
        "limits.force": 10.0,
        **drive(robot),
    }


def commands(truth: Path) -> dict[str, list[str]]:
    """Return the command lines of the processes by name, those of `COORDINATING` first."""
    swarm: dict[str, object] = {"swarm_mass": MASS, "members": [robot.id for robot in ROBOTS]}
    return {
        "plane_driver": node("plane_sim.driver", "plane_driver", {}),
        "abstraction_observer": node("abstraction_observer.realtime", "abstraction_observer", swarm),
        "parent_controller": node("parent_controller.realtime", "parent_controller", {}),
        "rig": [sys.executable, str(FOLDER / "rig_node.py"), str(truth)],
        **{
            f"agent_{robot.id:03d}": node("agent_node.realtime", f"agent_{robot.id:03d}", agent(robot))
            for robot in ROBOTS
        },
    }


def node(module: str, name: str, parameters: dict[str, object]) -> list[str]:
    """Return the command line of a node."""
    given = [word for key, value in parameters.items() for word in ("-p", f"{key}:={str(value).lower()}")]
    return [sys.executable, "-m", module, "--ros-args", "-r", f"__node:={name}", *given]


class Run:
    """The processes of a run, started and ended by `running`.

    Parameters
    ----------
    folder : Path
        Existing folder for the results.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.truth = folder / "truth.csv"
        self._processes: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, domain: int) -> None:
        """Start all processes in a ROS domain, on loopback."""
        profile = self.folder / "fastdds.xml"
        profile.write_text(profile_xml(domain, realtime=True), encoding="utf-8")
        environment = {**os.environ, **dds_environment(domain, str(profile.resolve()))}
        environment["ROS_LOG_DIR"] = str(self.folder.resolve() / "ros_log")
        for number, (name, words) in enumerate(commands(self.truth).items()):
            participant = number if name in COORDINATING else COORDINATORS + number - len(COORDINATING)
            self._start(name, words, {**environment, PARTICIPANT_VARIABLE: str(participant)})

    def _start(self, name: str, words: list[str], environment: dict[str, str]) -> None:
        with (self.folder / f"{name}.log").open("wb") as log:
            self._processes[name] = subprocess.Popen(
                words,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                preexec_fn=partial(die_with_parent, os.getpid()),  # noqa: PLW1509 - there are no threads here
            )

    def kill(self, name: str) -> None:
        """Kill a process, like a power failure."""
        process = self._processes.pop(name)
        process.kill()
        process.wait()

    def wait(self, duration: float) -> None:
        """Wait until the plane has been free for a time, s.

        Raises
        ------
        RunError
            If a process ends, or no robot moves.
        """
        begun = time.monotonic()
        while self.time() < duration:
            time.sleep(0.1)
            for name, process in self._processes.items():
                if process.poll() is not None:
                    raise RunError(f"{name} has ended; see {self.folder / name}.log")
            if not self.time() and time.monotonic() - begun > PATIENCE:
                raise RunError(f"no robot has moved for {PATIENCE:g} s; see the logs in {self.folder}")

    def time(self) -> float:
        """Return the time since the plane was released, s."""
        found = rows(self.truth)
        return found[-1]["time"] if found else 0.0

    def end(self) -> None:
        """End all processes, the robots first, because each stops its base."""
        for name in reversed(list(self._processes)):
            self._processes[name].send_signal(signal.SIGINT if name == "rig" else signal.SIGTERM)
        for process in self._processes.values():
            try:
                process.wait(ENDING)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


@contextmanager
def running(folder: Path) -> Iterator[Run]:
    """Yield a run with started processes, which are ended with the block."""
    run = Run(folder)
    with tracing_files_removed(), claimed_domain() as domain:
        try:
            run.start(domain)
            yield run
        finally:
            run.end()


def empty_folder(path: Path) -> Path:
    """Create a folder for the results.

    Raises
    ------
    InputError
        If it is not empty, or cannot be created.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        if any(path.iterdir()):
            raise InputError(f"{path} is not empty; give another folder with -o")
    except OSError as error:
        raise InputError(f"{path} cannot be used: {error.strerror}; give another folder with -o") from error
    return path


def rows(truth: Path) -> list[dict[str, float]]:
    """Return the complete lines that the rig has written so far."""
    if not truth.exists():
        return []
    lines = truth.read_text(encoding="utf-8").splitlines(keepends=True)
    found = csv.DictReader(line for line in lines if line.endswith("\n"))
    return [{name: float(text) for name, text in row.items()} for row in found]


def judged(found: list[dict[str, float]]) -> int:
    """Return the exit code of a run with these true states: 1 if the plane has hit its end stop."""
    hit = next((row["time"] for row in found if abs(row["angle"]) >= END_STOP), None)
    if hit is not None:
        sys.stderr.write(f"error: the plane has hit its end stop at {END_STOP:g} rad after {hit:.2f} s\n")
    return 0 if hit is None else 1


def main(arguments: list[str]) -> int:
    """Run the example and return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("-o", "--output", metavar="DIR", type=Path, default=Path("runs/hardware_in_the_loop"))
    parser.add_argument("--duration", type=float, default=15.0, help="time for which the plane is free, s")
    asked = parser.parse_args(arguments)
    try:
        with running(empty_folder(asked.output)) as run:
            run.wait(asked.duration)
    except KeyboardInterrupt:
        return 1
    except (InputError, RunError) as error:
        sys.stderr.write(f"error: {error}\n")
        return 2 if isinstance(error, InputError) else 1
    found = rows(run.truth)
    last = [abs(row["angle"]) for row in found if row["time"] > found[-1]["time"] - 1.0]
    farthest = max(abs(row[name]) for row in found for name in row if name.startswith("position"))
    print(f"angle {found[0]['angle']:.3f} rad initially, at most {max(last):.4f} rad in the last second")
    print(f"no robot was more than {farthest:.3f} m from the axis; true state of the rig: {run.truth}")
    return judged(found)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
