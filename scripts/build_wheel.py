"""Build the wheel of the packages that need no ROS: ``python -m scripts.build_wheel FOLDER``.

It runs in a checkout that is set up, because the descriptions of the message types come from the ROS workspace.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Iterable
from xml.etree import ElementTree as ET

from swarmabs_config.installation import WHEEL_FILES, shared
from swarmabs_core.errors import RunError, SwarmabsError

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ROOT / "src"
METADATA = ROOT / "scripts" / "wheel"
PACKAGES = (
    "swarmabs_analysis",
    "swarmabs_bag",
    "swarmabs_cli",
    "swarmabs_config",
    "swarmabs_core",
    "swarmabs_fleet",
    "swarmabs_run",
    "swarmabs_view",
)
BRINGUP = ("foxglove", "rviz", "scenarios", "urdf")
"""Folders of `swarmabs_bringup` that need no ROS."""
EARLIEST = "315532800"
"""The first second of 1980, the earliest time of a file in a wheel; s since 1970."""


def message_files() -> Iterable[Path]:
    """Yield the definition and the description of the messages and of all types in them, such as std_msgs/Header.

    Raises
    ------
    RunError
        If the workspace is older than the sources, or lacks one of them.
    """
    names = {f"swarmabs_msgs/msg/{path.stem}" for path in (SOURCES / "swarmabs_msgs" / "msg").glob("*.msg")}
    done = set()
    while names:
        name = names.pop()
        done.add(name)
        definition, description = (shared(f"{name}.{suffix}") for suffix in ("msg", "json"))
        if definition is None or description is None:
            raise RunError(f"no share/{name}.msg and .json in the workspace", "build it with ./scripts/swarm")
        source = SOURCES / f"{name}.msg"
        if source.exists() and source.read_bytes() != definition.read_bytes():
            raise RunError(f"{definition} is not that of {source}", "build the workspace with ./scripts/swarm")
        yield definition
        yield description
        message = json.loads(description.read_text(encoding="utf-8"))["type_description_msg"]
        names |= {entry["type_name"] for entry in message["referenced_type_descriptions"]} - done


def copied(source: Path, target: Path) -> None:
    """Copy a file or a folder without compiled modules; all files get the same mode."""
    for path in [source] if source.is_file() else sorted(source.rglob("*")):
        if path.is_file() and "__pycache__" not in path.parts:
            place = target / path.relative_to(source)
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, place)
            place.chmod(0o644)


def stage(folder: Path) -> None:
    """Lay out in a folder what setuptools builds the wheel from."""
    for name in PACKAGES:
        copied(SOURCES / name / name, folder / name)
    share = folder / "swarmabs_config" / WHEEL_FILES.name / "share"
    for name in BRINGUP:
        copied(SOURCES / "swarmabs_bringup" / name, share / "swarmabs_bringup" / name)
    for path in message_files():
        copied(path, share / Path(*path.parts[-3:]))
    for path in (*METADATA.iterdir(), ROOT / "LICENSE"):
        copied(path, folder / path.name)
    version = ET.parse(SOURCES / "swarmabs_core" / "package.xml").findtext("version")  # noqa: S314 - our own file
    (folder / "VERSION").write_text(f"{version}\n", encoding="utf-8")


def build(folder: Path) -> Path:
    """Build the wheel in a folder, replacing an earlier one of this version, and return its path."""
    with tempfile.TemporaryDirectory(prefix="swarmabs-wheel-") as temporary:
        staged, built = Path(temporary, "sources"), Path(temporary, "built")
        stage(staged)
        command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
        command += ["--disable-pip-version-check", "--wheel-dir", str(built), str(staged)]
        subprocess.run(command, env={**os.environ, "SOURCE_DATE_EPOCH": EARLIEST}, umask=0o022, check=True)
        (wheel,) = built.glob("*.whl")
        folder.mkdir(parents=True, exist_ok=True)
        return Path(shutil.copy(wheel, folder))


def main() -> int:
    """Build the wheel in the folder that is the only argument, and print its path."""
    try:
        print(build(Path(sys.argv[1])))
    except (SwarmabsError, OSError, subprocess.CalledProcessError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
