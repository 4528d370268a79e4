"""What an installation lacks is told with the way to get it; everything else stays an error."""

import sys

import pytest

from swarmabs_config import installation
from swarmabs_config.installation import lacking
from swarmabs_core.errors import InputError


@pytest.mark.parametrize("module", ["rclpy", "rclpy.node", "swarmabs_ros.status", "std_msgs.msg", "rosidl_runtime_py"])
def test_what_needs_ros_says_so(module: str) -> None:
    found = lacking(ModuleNotFoundError(name=module), "swarm run")
    assert isinstance(found, InputError)
    top = module.partition(".")[0]
    assert str(found).startswith(
        f"swarm run needs ROS 2, which this Python does not have (no module {top}); use ./scripts"
    )
    assert "\n" not in str(found)


def test_what_needs_a_package_names_the_command_that_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    error = ModuleNotFoundError(name="pyarrow.parquet")
    assert str(lacking(error, "Parquet")) == (
        "Parquet needs the Python package pyarrow; ./scripts/swarm installs it by itself; elsewhere: "
        f"{sys.executable} -m pip install pyarrow"
    )
    monkeypatch.setattr(installation, "IS_WHEEL", True)
    assert str(lacking(error, "Parquet")) == (
        f'Parquet needs the Python package pyarrow; {sys.executable} -m pip install "swarmabs[sweeps]"'
    )


@pytest.mark.parametrize("module", ["swarmabs_core.nothing", "numpy", "a_module_of_the_user", None])
def test_other_missing_modules_are_errors_with_their_traceback(module: str | None) -> None:
    error = ModuleNotFoundError(name=module)
    assert lacking(error, "swarm run") is error
