"""Which swarmabs computes a case: workers elsewhere must have the very one that the sweep was started with."""

from __future__ import annotations

from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import swarmabs_bag
import swarmabs_config
import swarmabs_core
import swarmabs_run
from swarmabs_core.fingerprint import libm_fingerprint

if TYPE_CHECKING:
    from collections.abc import Mapping

_PACKAGES = (swarmabs_core, swarmabs_config, swarmabs_bag, swarmabs_run)
_SOURCES = {package.__name__: Path(package.__path__[0]) for package in _PACKAGES} | {"sweep": Path(__file__).parent}
"""What a case's results depend on: mathematics, scenarios, simulation, figures, and how cases are evaluated."""


class Identity(NamedTuple):
    """What a worker computes with: version, a short hash of the sources, and that of the mathematical library."""

    version: str
    sources: str
    libm: str


def identity() -> Identity:
    """Return what this process computes with."""
    try:
        installed = version("swarmabs_core")
    except PackageNotFoundError:
        installed = "not installed"
    total = sha256()
    for name, folder in _SOURCES.items():
        for path in sorted(folder.rglob("*.py")):
            content = path.read_bytes()
            total.update(f"{name}/{path.relative_to(folder).as_posix()}\0{len(content)}\0".encode() + content)
    return Identity(installed, total.hexdigest()[:16], libm_fingerprint())


def stranger(mine: Identity, workers: Mapping[str, Identity]) -> str | None:
    """Say which worker has another swarmabs than this one; None if none has.

    Parameters
    ----------
    mine : Identity
        What this process computes with.
    workers : mapping
        What the workers do, by their names.
    """
    for name, theirs in sorted(workers.items()):
        if theirs[:2] != mine[:2]:
            return (
                f"worker {name} has swarmabs {theirs.version}, sources {theirs.sources}, and this is {mine.version},"
                f" sources {mine.sources}"
            )
    return None
