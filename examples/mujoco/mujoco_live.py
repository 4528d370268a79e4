"""Level a plank of MuJoCo with the nodes of real robots, by the clock: the rig is their hardware.

python examples/mujoco/mujoco_live.py [SCENARIO] [-o DIR] [--duration S] [--base BASE] [--height M] [--view]
"""

from __future__ import annotations

import argparse
import csv
import os
import sys
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from mujoco_node import RIG, TILT, RigSettings
from mujoco_setup import BASES, end_stop_of, facing_of
from mujoco_world import WHEEL_RADIUS

from swarmabs_cli.options import RunParameters
from swarmabs_cli.runs import carry_out
from swarmabs_config.graph import NODES, PLANE, PLANE_DRIVER, REALTIME, RECORDER, endpoints
from swarmabs_config.scenario import on_plane
from swarmabs_core.declaration import values_of
from swarmabs_core.errors import InputError, RunError
from swarmabs_core.realtime.instruments import PlaneInstrument
from swarmabs_run.orchestration.launcher_process import LauncherProcess
from swarmabs_run.orchestration.plan import ProcessPlan
from swarmabs_run.orchestration.realtime_run import RealtimeRun
from swarmabs_run.orchestration.run_files import epoch_of
from swarmabs_view.viewers import PageViewer

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from swarmabs_bag.run_folder import RunFolder
    from swarmabs_config.scenario import PlaneScenario, Scenario
    from swarmabs_core.parameters import Value
    from swarmabs_run.run import Outcome, RunOptions

FOLDER = Path(__file__).parent
TRUTH = "truth.csv"
"""File of the true states in the folder of a run."""
SENSORS = {"encoder": "joint_state", "imu": "imu"}
"""Sources of the plane's state by the name of their sensor."""
POSITIONS = {"odometry": "odometry", "wheel": "joint_state"}
"""Sources of a robot's motion by the name of their sensor."""
AGE_LIMIT = PlaneInstrument().age_limit
"""Age above which the reading of a sensor without delay is too old, s."""


class Arrangement:
    """Turns the processes of a run with simulated bodies into those of a run on the rig.

    Parameters
    ----------
    scenario : PlaneScenario
        The scenario with all its robots.
    rig : RigSettings
        Settings of the rig.
    sensor, position : str
        What measures the plane, of `SENSORS`, and the robots, of `POSITIONS`.
    """

    def __init__(self, scenario: PlaneScenario, rig: RigSettings, sensor: str, position: str) -> None:
        self._scenario, self._rig = scenario, rig
        self._sensor, self._position = SENSORS[sensor], POSITIONS[position]
        self._places = {agent.id: agent.position for agent in scenario.agents}

    def __call__(self, processes: Sequence[ProcessPlan]) -> tuple[ProcessPlan, ...]:
        """Return the processes of the run on the rig."""
        participant = 1 + max(process.participant for process in processes)
        rig = ProcessPlan(RIG, "mujoco_node", participant, {**values_of(self._rig), "await_epoch": True}, (), ())
        return (*map(self._arranged, processes), rig)

    def _arranged(self, process: ProcessPlan) -> ProcessPlan:
        given = process.parameters
        if process.name == PLANE:
            ends = endpoints(PLANE_DRIVER, REALTIME)
            kept = {name: given[name] for name in ("period_ns", "clock_tolerance", "await_epoch")}
            return ProcessPlan(
                PLANE_DRIVER,
                NODES[PLANE_DRIVER].modules[REALTIME],
                process.participant,
                {**kept, "source": self._sensor, "joint": TILT, "age_limit": AGE_LIMIT + self._rig.delay},
                ends.publications,
                tuple(ends.subscriptions),
            )
        if process.name == RECORDER:
            driven = sorted(self._places)
            return replace(process, parameters={**given, "simulated_plane": False, "driven": driven})
        if process.agents:
            (robot,) = process.agents
            return replace(process, parameters={**given, **self._drive(robot)})
        return process

    def _drive(self, robot: int) -> dict[str, Value]:
        """Return the parameters by which a robot's node moves its base on the rig."""
        forwards = facing_of(robot) > 0.0
        drive: dict[str, Value] = {"type": "topic", "source": self._position, "offset": self._places[robot]}
        if self._position == "odometry":
            drive["axis"] = "+x" if forwards else "-x"
        else:
            drive |= {"joint.name": self._joint, "joint.scale": WHEEL_RADIUS, "reversed": not forwards}
        return {f"drive.{name}": value for name, value in drive.items()}

    @property
    def _joint(self) -> str:
        """The wheel whose encoder measures a robot's motion."""
        return "front_left_wheel_joint" if self._rig.base == "rover" else "left_wheel_joint"


class Shown(NamedTuple):
    """What the true states of a run show: smallest and mean real-time factor, and the last angle (rad)."""

    slowest: float
    mean: float
    angle: float


def shown(states: Sequence[Mapping[str, float]]) -> Shown | None:
    """Return what true states show since the plank was released; None if it never was."""
    free = [state for state in states if not state["held"]]
    if len(free) < 2:
        return None
    first, last = free[0], free[-1]
    mean = (last["time"] - first["time"]) / ((last["stamp"] - first["stamp"]) / 1e9)
    return Shown(min(state["factor"] for state in free), mean, last["angle"])


def true_states(folder: Path, duration_ns: int) -> list[dict[str, float]]:
    """Return the true states of a run up to its last step, by the names in the first line of the file.

    Afterwards the robots stop, and the plank tilts if it is not balanced.
    """
    epoch = epoch_of(folder)
    if epoch is None or not (folder / TRUTH).exists():
        return []
    lines = (folder / TRUTH).read_text(encoding="utf-8").splitlines(keepends=True)
    rows = csv.DictReader(line for line in lines if line.endswith("\n"))  # the last one may be incomplete
    states = ({name: float(text) for name, text in row.items()} for row in rows)
    return [state for state in states if state["stamp"] <= epoch + duration_ns]


def run(asked: argparse.Namespace) -> int:
    """Run a scenario on the rig; return the exit code."""
    # The launcher forks the rig, too, and so must find its modules.
    path = os.pathsep.join(filter(None, (str(FOLDER), os.environ.get("PYTHONPATH"))))
    with ExitStack() as stack:
        launcher = stack.enter_context(LauncherProcess("realtime", {"PYTHONPATH": path}))
        page = stack.enter_context(PageViewer(0)) if asked.view else None
        runs: list[tuple[Path, int]] = []

        def execute(scenario: Scenario, folder: RunFolder, options: RunOptions) -> Outcome:
            runs.append((folder.path, scenario.duration_ns))
            rig = replace(settings(asked), scenario_file=str(folder.scenario), truth=str(folder.path / TRUTH))
            plane = on_plane(scenario, "the rig")
            if page is not None:
                page.start(folder.path)
                sys.stderr.write(f"view: {page.url}\n")
            arrange = Arrangement(plane, rig, asked.plane_sensor, asked.position)
            return RealtimeRun(plane, folder, options, arrange).run(launcher)

        options = RunParameters(
            scenario=asked.scenario,
            bag_scenario=None,
            output=asked.output,
            overrides=tuple(asked.set),
            duration=asked.duration,
            coordination=None,
            no_bag=False,
            max_bag_size=0,
            max_bag_duration=0,
            as_json=False,
        )
        code = carry_out(
            execute,
            options,
            realtime=True,
            meanwhile=True,
            check=lambda scenario: end_stop_of(on_plane(scenario, "the rig").resolved(), settings(asked).setup),
        )
        for folder, duration_ns in runs:
            print(summary(folder, duration_ns))
        if page is not None and sys.stdin.isatty():
            sys.stderr.write(f"view: {page.url} plays the bag until Ctrl-C\n")
            page.wait()
    return code


def summary(folder: Path, duration_ns: int) -> str:
    """Return a line on what a run has shown."""
    result = shown(true_states(folder, duration_ns))
    if result is None:
        return f"rig: the plank was never released; see the logs in {folder / 'logs'}"
    return (
        f"rig: real-time factor {result.mean:.2f}, at worst {result.slowest:.2f} in a second; true angle at the end "
        f"{result.angle:.4f} rad; {folder / TRUTH}"
    )


def settings(asked: argparse.Namespace) -> RigSettings:
    """Return the settings of the rig that a command line asks for."""
    return RigSettings(
        base=asked.base,
        height=asked.height,
        mass_error=asked.mass_error,
        tilt_offset=asked.tilt_offset,
        delay=asked.delay,
        grip=asked.grip,
        sim_speed_factor=asked.sim_speed_factor,
        seed=asked.seed,
    )


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    default = RigSettings()
    made = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    made.add_argument("scenario", nargs="?", default="arise_het_4", help="built-in scenario or YAML file")
    made.add_argument("-o", "--output", metavar="DIR", type=Path, help="folder of the results; default: in runs/")
    made.add_argument("--set", action="append", default=[], metavar="A.B=VALUE", help="change a value of the scenario")
    made.add_argument("--duration", default="10", help="length, s")
    made.add_argument("--base", choices=BASES, default=default.base, help="base of the robots")
    made.add_argument("--plane-sensor", choices=tuple(SENSORS), default="encoder", help="what measures the plane")
    made.add_argument("--position", choices=tuple(POSITIONS), default="odometry", help="what measures the robots")
    for name, text in numbers().items():
        kind = int if name == "seed" else float
        made.add_argument(f"--{name.replace('_', '-')}", type=kind, default=getattr(default, name), help=text)
    made.add_argument("--view", action="store_true", help="show the run in the browser")
    return made


def numbers() -> Mapping[str, str]:
    """Return the numbers among the settings of the rig, and what they mean."""
    return {
        "height": "of the robots' centres of mass, m; default: that of the scenario, 0.03 where it is 0",
        "mass_error": "largest relative error of the masses that robots know",
        "tilt_offset": "largest offset of the plane's encoder, rad",
        "delay": "of measurements and commands, s",
        "grip": "coefficient of friction of the wheels",
        "sim_speed_factor": "time of the world by time of the clock that is aimed at",
        "seed": "of the errors and of the noise",
    }


def main(arguments: list[str]) -> int:
    """Run the example and return the exit code."""
    try:
        return run(parser().parse_args(arguments))
    except (InputError, RunError) as error:
        sys.stderr.write(f"error: {error}\n")
        return 2 if isinstance(error, InputError) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
