"""Environment variables of child processes, without those of another ROS or Python installation."""

from __future__ import annotations

import glob
import os
from typing import Dict, List, Mapping

# Variables of another sourced ROS installation and its middleware.
FOREIGN_PREFIXES = ("AMENT_", "COLCON_", "CYCLONEDDS_", "FASTDDS_", "FASTRTPS_", "RMW_", "ROS_", "SWARMABS_SOURCED_")
FOREIGN = (
    "CMAKE_PREFIX_PATH",
    "PIP_PREFIX",
    "PIP_ROOT",
    "PIP_TARGET",
    "PIP_USER",
    "PYTHONHOME",
    "PYTHONPATH",
)
KEPT = ("ROS_DOMAIN_ID", "ROS_LOG_DIR")
SYSTEM_FOLDERS = ("", "/usr", "/usr/local")  # may contain ROS, but also everything else
SEARCH_PATHS = ("PATH", "LD_LIBRARY_PATH")
SOURCED = "SWARMABS_SOURCED_"  # prefix of variables with which a sourced ROS also finds this workspace


def foreign_folders(environ: Mapping[str, str]) -> List[str]:
    """Prefixes of sourced ROS installations, each ending in a slash."""
    listed = (environ.get(name, "").split(os.pathsep) for name in ("AMENT_PREFIX_PATH", "COLCON_PREFIX_PATH"))
    folders = {folder.rstrip("/") for folders in listed for folder in folders} - set(SYSTEM_FOLDERS)
    return [f"{folder}/" for folder in sorted(folders | {"/opt/ros"})]


def clean(environ: Mapping[str, str], venv: str) -> Dict[str, str]:
    """Return the user's environment without variables of another ROS or Python, and with the venv active."""
    kept = {
        name: value
        for name, value in environ.items()
        if name in KEPT or not (name in FOREIGN or name.startswith(FOREIGN_PREFIXES))
    }
    foreign = tuple(foreign_folders(environ))
    for name in SEARCH_PATHS:
        folders = filter(None, kept.pop(name, "").split(os.pathsep))
        kept[name] = os.pathsep.join(folder for folder in folders if not f"{folder}/".startswith(foreign))
    kept["PATH"] = os.pathsep.join([os.path.join(venv, "bin"), kept["PATH"]])
    kept["VIRTUAL_ENV"] = venv
    kept["PYTHONNOUSERSITE"] = "1"
    kept["PIP_ROOT_USER_ACTION"] = "ignore"
    # Without this, the ROS wheels restart Python to set the library path, which is already set here.
    kept["_ROS_WHEELS_BOOTSTRAP_COMPLETE"] = "1"
    return kept


def site_packages(prefix: str, series: str) -> str:
    """Folder of Python modules below a prefix."""
    return os.path.join(prefix, "lib", f"python{series}", "site-packages")


def build_environment(environ: Mapping[str, str], venv: str, series: str) -> Dict[str, str]:
    """Environment in which colcon builds against the ROS prefix in the venv."""
    built = clean(environ, venv)
    bundled = sorted(glob.glob(os.path.join(site_packages(venv, series), "ros_*.libs")))
    inherited = [built["LD_LIBRARY_PATH"]] if built["LD_LIBRARY_PATH"] else []
    built.update(
        AMENT_PREFIX_PATH=venv,
        CMAKE_PREFIX_PATH=venv,
        LD_LIBRARY_PATH=os.pathsep.join([os.path.join(venv, "lib"), *bundled, *inherited]),
        ROS_DISTRO="jazzy",
        ROS_PYTHON_VERSION="3",
        ROS_VERSION="2",
    )
    return built


def run_environment(environ: Mapping[str, str], venv: str, install: str, series: str) -> Dict[str, str]:
    """Environment in which the command line and the nodes run."""
    running = build_environment(environ, venv, series)
    running.update(
        AMENT_PREFIX_PATH=os.pathsep.join([install, venv]),
        CMAKE_PREFIX_PATH=os.pathsep.join([install, venv]),
        LD_LIBRARY_PATH=os.pathsep.join([os.path.join(install, "lib"), running["LD_LIBRARY_PATH"]]),
        OPENBLAS_NUM_THREADS="1",
        PYTHONPATH=site_packages(install, series),
        PYTHONSAFEPATH="1",
        RMW_IMPLEMENTATION="rmw_fastrtps_cpp",
    )
    return running


def sourced_environment(environ: Mapping[str, str], venv: str, install: str, series: str) -> Dict[str, str]:
    """Variables, prefixed with `SOURCED`, with which a sourced ROS installation also finds the packages in install.

    Tools that inspect a run use them. The sourced installation comes first, and the venv is left out, because its
    libraries must not be mixed with those of the wheels. Empty if no ROS is sourced.
    """
    if not set(environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)) - {"", install, venv}:
        return {}
    added = {
        "AMENT_PREFIX_PATH": install,
        "LD_LIBRARY_PATH": os.path.join(install, "lib"),
        "PYTHONPATH": site_packages(install, series),
    }
    sourced = {"RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"}
    for name, folder in added.items():
        folders = [*filter(None, environ.get(name, "").split(os.pathsep)), folder]
        sourced[name] = os.pathsep.join(dict.fromkeys(folders))
    return {SOURCED + name: value for name, value in sourced.items()}
