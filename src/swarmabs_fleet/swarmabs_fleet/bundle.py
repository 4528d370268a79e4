"""The bundles of a fleet: one folder per host with everything that its nodes need, and a manifest of it."""

from __future__ import annotations

import json
import shutil
import tempfile
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

from swarmabs_config.fleet.loader import FLEET_FILE, SCENARIO_FILE
from swarmabs_config.fleet.participants import nodes_on
from swarmabs_config.fleet.parts import Sros2Security
from swarmabs_config.graph import RECORDER
from swarmabs_core.errors import InputError, RunError
from swarmabs_fleet import scripts
from swarmabs_fleet.environment import environment_file, node_environment, tool_environment
from swarmabs_fleet.keys import Keys
from swarmabs_fleet.manifest import MANIFEST, SUMS, FileFacts, manifest_of
from swarmabs_fleet.parameters import parameter_file, parameters
from swarmabs_fleet.places import Places
from swarmabs_fleet.profile import fleet_profile, profile_roles
from swarmabs_fleet.units import units

if TYPE_CHECKING:
    from swarmabs_config.fleet.loader import LoadedFleet
    from swarmabs_config.fleet.model import Fleet

SECRET, PLAIN, PROGRAM = 0o600, 0o644, 0o755
_FOLDER, _SECRET_FOLDER = 0o755, 0o700


@dataclass(frozen=True, slots=True)
class BundleFile:
    """A file of a bundle."""

    content: bytes
    mode: int = PLAIN


def deploy(loaded: LoadedFleet, output: Path, keys: Path | None) -> list[Path]:
    """Write the bundles of a fleet.

    Parameters
    ----------
    loaded : LoadedFleet
        The fleet and its scenario.
    output : Path
        Folder to write, which must not exist or be empty; it appears whole or not at all.
    keys : Path, optional
        Folder of keys, needed with security by a tunnel or by sros2.

    Returns
    -------
    list of Path
        The folders of the hosts.

    Raises
    ------
    InputError
        If the output or the keys cannot be used; nothing is left behind.
    RunError
        If writing fails; no output is left behind.
    """
    fleet = loaded.fleet
    part = _beside(output)
    try:
        store = _keys(loaded, output, keys)
        _write(part / FLEET_FILE, BundleFile(loaded.fleet_text.encode()))
        _write(part / SCENARIO_FILE, BundleFile(loaded.scenario_text.encode()))
        names = [host.name for host in fleet.hosts if nodes_on(fleet, host.name)]
        for name in names:
            for path, file in host_bundle(loaded, name, store).items():
                _write(part / name / path, file)
        part.chmod(_FOLDER)
        if output.exists():
            output.rmdir()
        part.rename(output)
    except OSError as error:
        raise RunError(f"{output}: {error.strerror}; free space or choose another folder with -o") from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return [output / name for name in names]


def host_bundle(loaded: LoadedFleet, host: str, keys: Keys | None) -> dict[str, BundleFile]:
    """Return the files of a host's bundle by path, the manifest last; without keys those that need some are missing."""
    fleet = loaded.fleet
    places = Places.of(fleet, host)
    nodes = nodes_on(fleet, host)
    files: dict[str, BundleFile] = {}
    if any(node.name == RECORDER for node in nodes):
        files[SCENARIO_FILE] = _text(loaded.scenario_text)
    for node in nodes:
        values = parameters(fleet, loaded.scenario, node, installed=places.installed, state=places.state)
        files[f"nodes/{node.name}.yaml"] = _text(parameter_file(values))
        files[f"nodes/{node.name}.env"] = _text(environment_file(node_environment(fleet, node)))
    for role in profile_roles(fleet, host):
        files[f"dds/{role}.xml"] = _text(fleet_profile(fleet, host, role))
        if role in {"operator", "driver"}:
            files[f"nodes/{role}.env"] = _text(environment_file(tool_environment(fleet, host, role)))
    made = units(fleet, host, nodes)
    files |= {f"systemd/{name}": _text(text) for name, text in made.items()}
    files["units.txt"] = _text("".join(f"{name}\n" for name in made))
    if keys is not None:
        files |= _secrets(fleet, host, keys)
    files |= {name: BundleFile(text.encode(), PROGRAM) for name, text in scripts.scripts(fleet, host).items()}
    files = dict(sorted(files.items()))
    sums = [(path, sha256(file.content).hexdigest()) for path, file in files.items()]
    files[SUMS] = _text(scripts.checksums(sums))
    listed = {path: FileFacts(sha256=sha256(file.content).hexdigest(), mode=file.mode) for path, file in files.items()}
    facts = manifest_of(loaded, host, listed).model_dump(mode="json")
    files[MANIFEST] = _text(json.dumps(facts, indent=2) + "\n")
    return files


def _secrets(fleet: Fleet, host: str, keys: Keys) -> dict[str, BundleFile]:
    """Return the files of a host's bundle that hold keys, by path."""
    from swarmabs_fleet.certificates import keystore  # noqa: PLC0415 - cryptography is there only where keys are made
    from swarmabs_fleet.wireguard import configuration  # noqa: PLC0415 - as above

    files: dict[str, bytes] = {}
    if fleet.tunnel is not None:
        files[f"wireguard/{fleet.tunnel.interface}.conf"] = configuration(fleet, host, keys).encode()
    if isinstance(fleet.security, Sros2Security):
        store = keystore(fleet, host, keys, fleet.security.valid_days)
        files |= {f"keystore/{path}": content for path, content in store.items()}
    return {path: BundleFile(content, SECRET) for path, content in files.items()}


def _text(text: str) -> BundleFile:
    return BundleFile(text.encode())


def _keys(loaded: LoadedFleet, output: Path, keys: Path | None) -> Keys | None:
    """Return where keys are kept, checked to be needed and no part of the output."""
    level = loaded.fleet.security.level
    if level == "none":
        if keys is not None:
            raise InputError("security is none, which has no keys; leave out --keys")
        return None
    if keys is None:
        raise InputError(
            f"security {level} has private keys; name a folder for them, which later deployments need: --keys DIR"
        )
    inside, outside = keys.resolve(), output.resolve()
    if inside == outside or outside in inside.parents:
        raise InputError(f"the folder of keys {keys} is in the output, which is copied to robots; name another place")
    return Keys(inside / loaded.fleet.name)


def _beside(output: Path) -> Path:
    """Make a folder beside the output, in which it is written.

    Raises
    ------
    InputError
        If the output exists and is not empty, or cannot be made.
    """
    try:
        if output.exists() and (not output.is_dir() or any(output.iterdir())):
            what = "not empty" if output.is_dir() else "not a folder"
            raise InputError(f"output folder {output} is {what}; name another with -o, or remove it")
        output.parent.mkdir(parents=True, exist_ok=True)
        return Path(tempfile.mkdtemp(prefix=f".{output.name}.", dir=output.parent))
    except (FileExistsError, NotADirectoryError):
        raise InputError(f"output folder {output} is not in a folder; name another with -o") from None
    except OSError as error:
        raise InputError(f"output folder {output} cannot be used: {error.strerror}; choose another with -o") from error


def _write(path: Path, file: BundleFile) -> None:
    """Write a file with its mode from the first byte on, and folders that fit."""
    secret = file.mode == SECRET
    missing = [folder for folder in (path.parent, *path.parent.parents) if not folder.exists()]
    for folder in reversed(missing):
        folder.mkdir()
        folder.chmod(_SECRET_FOLDER if secret else _FOLDER)
    path.touch(mode=file.mode, exist_ok=False)
    path.chmod(file.mode)
    path.write_bytes(file.content)
