"""The paths of one checkout."""

from __future__ import annotations

import os
from typing import NamedTuple

from _setup import state


class Checkout(NamedTuple):
    """The folders and files of one checkout."""

    root: str

    @property
    def source(self) -> str:
        """The folder of the ROS packages."""
        return os.path.join(self.root, "src")

    @property
    def venv(self) -> str:
        """The virtual environment, which is also a ROS prefix."""
        return os.path.join(self.root, ".venv")

    @property
    def python(self) -> str:
        """The virtual environment's interpreter."""
        return os.path.join(self.venv, "bin", "python")

    @property
    def build(self) -> str:
        """Intermediate files of colcon."""
        return os.path.join(self.root, "build")

    @property
    def install(self) -> str:
        """The install folder of colcon: a second ROS prefix."""
        return os.path.join(self.root, "install")

    @property
    def environment_stamp(self) -> str:
        """Stamp of the virtual environment and its packages."""
        return os.path.join(self.venv, state.STAMPS, "environment")

    @property
    def snapshot(self) -> str:
        """Stamp of the whole set-up, which makes later starts fast."""
        return os.path.join(self.install, state.STAMPS, "snapshot")

    def lock(self, name: str) -> str:
        """Path of a lock file."""
        return os.path.join(self.root, "scripts", "requirements", name)

    def extra_stamp(self, lock: str) -> str:
        """Stamp of the packages that only some commands need, by the name of their lock file."""
        return os.path.join(self.venv, state.STAMPS, lock)

    def log(self, name: str) -> str:
        """Path of a log of the set-up."""
        return os.path.join(self.root, "log", name)

    def package_stamp(self, package: str) -> str:
        """Stamp of one installed package."""
        return os.path.join(self.install, state.STAMPS, f"{package}.package")
