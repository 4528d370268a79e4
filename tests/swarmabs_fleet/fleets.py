"""Fleet files that tests write."""

from pathlib import Path

from swarmabs_config.fleet.loader import LoadedFleet, load_fleet
from swarmabs_fleet.bundle import deploy

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = {path.stem: path for path in sorted((ROOT / "examples" / "fleet").glob("*.yaml"))}

ONE_HOST = """\
schema: 1
name: one
scenario: pd_het_4
hosts: [{name: base, address: 127.0.0.1, interface: lo}]
robots:
  - {id: 1, host: base, kind: single_integrator, mass: 0.4, drive: {type: simulated, position: 0.1}}
  - {id: 2, host: base, kind: double_integrator, mass: 0.5, damping: 0.8, drive: {type: simulated, position: -0.1}}
coordinators: {plane: {host: base}, observer: {host: base}, controller: {host: base}, recorder: {host: base}}
network: {domain: 7, discovery: static}
security: {level: none}
installation: {prefix: /etc/swarmabs, checkout: /nowhere/swarmabs, user: nobody-here}
"""
"""All nodes on one host, on loopback."""


def edited(path: Path, text: str, *changes: tuple[str, str]) -> Path:
    """Write a fleet file with parts of a text replaced, each of which must be there."""
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    path.write_text(text, encoding="utf-8")
    return path


def example(name: str) -> LoadedFleet:
    return load_fleet(EXAMPLES[name])


def uses_keys(name: str) -> bool:
    return example(name).fleet.security.level != "none"


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def deployed(loaded: LoadedFleet, folder: Path, keys: Path | None = None) -> Path:
    deploy(loaded, folder, keys)
    return folder
