"""The launch file in lockstep, as `ros2 launch` runs it; `colcon test` runs this where launch_testing is installed."""

from __future__ import annotations

import atexit
import tempfile
import unittest
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory
from launch.actions import IncludeLaunchDescription, SetEnvironmentVariable
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch_testing import post_shutdown_test
from launch_testing.actions import ReadyToTest
from launch_testing.asserts import assertExitCodes

from launch import LaunchDescription
from swarmabs_bag.reader import open_bag
from swarmabs_config.scenarios import DEFAULT, find_scenario
from swarmabs_core.messages import MAIN_TOPICS
from swarmabs_run.orchestration.network import claimed_domain
from swarmabs_run.simulation import Simulation

HELD = ExitStack()
atexit.register(HELD.close)
OUT = Path(HELD.enter_context(tempfile.TemporaryDirectory())) / "run"
NETWORK = {"ROS_DOMAIN_ID": str(HELD.enter_context(claimed_domain())), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
WITHIN = 120


def generate_test_description() -> LaunchDescription:
    """Return the launch file's own description in a domain of its own."""
    share = get_package_share_directory("swarmabs_bringup")
    source = PythonLaunchDescriptionSource(f"{share}/launch/lockstep.launch.py")
    swarm = IncludeLaunchDescription(source, launch_arguments={"out": str(OUT)}.items())
    network = [SetEnvironmentVariable(name, text) for name, text in NETWORK.items()]
    return LaunchDescription([*network, swarm, ReadyToTest()])


class TestRun(unittest.TestCase):
    def test_recorder_completes_the_bag(self, proc_info: Any) -> None:
        proc_info.assertWaitForStartup("recorder", timeout=WITHIN)
        proc_info.assertWaitForShutdown("recorder", timeout=WITHIN)


@post_shutdown_test()
class TestResult(unittest.TestCase):
    def test_every_process_ends_well(self, proc_info: Any) -> None:
        assertExitCodes(proc_info)

    def test_bag_is_that_of_simulate(self) -> None:
        records = (record for step in Simulation(find_scenario(DEFAULT)).steps() for record in step.records)
        expected = sorted((record.topic.name, record.payload) for record in records)
        recorded = sorted((topic.name, payload) for topic, _, payload in open_bag(OUT).messages(MAIN_TOPICS))
        assert recorded == expected
