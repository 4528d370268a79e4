"""The bundles of a fleet: one folder per host with all files that its nodes need, and a manifest that lists them."""

from __future__ import annotations

import json
import shutil
import tempfile
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pydantic import BeforeValidator, PlainSerializer, ValidationError

from swarmabs_bag.run.channels import RECORDED_TYPES, current_hash
from swarmabs_config.fleet.loader import FLEET_FILE, SCENARIO_FILE
from swarmabs_config.fleet.participants import ports
from swarmabs_config.fleet.parts import Account, Address, FolderPath, Interface
from swarmabs_config.graph import RECORDER
from swarmabs_config.installation import own_version
from swarmabs_config.model.fields import AsTuple, Model, Name
from swarmabs_config.scenario.text_file import read_text
from swarmabs_core.errors import InputError, RunError
from swarmabs_fleet.host_plan import HostPlan
from swarmabs_fleet.node_files import node_files
from swarmabs_fleet.parameters import parameter_file, parameters

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from swarmabs_config.fleet.loader import LoadedFleet
    from swarmabs_fleet.keys import Keys

MANIFEST, SUMS = "manifest.json", "SHA256SUMS"
FORMAT = 1
"""Version of the bundle's layout."""
SCRIPTS = ("install.sh", "uninstall.sh", "restart.sh", "fence.sh")
"""POSIX shell scripts in which no value from the fleet file is interpreted as code.

Names and paths are assigned in single quotes at the top and expanded in double quotes; reading the fleet file checks
their characters. With DESTDIR the scripts install below that folder and leave accounts and services alone, as packagers
expect.
"""
SECRET, PLAIN, PROGRAM = 0o600, 0o644, 0o755
_FOLDER, _SECRET_FOLDER = 0o755, 0o700


@dataclass(frozen=True, slots=True)
class BundleFile:
    """A file of a bundle."""

    content: bytes
    mode: int = PLAIN

    @property
    def sha256(self) -> str:
        """SHA-256 of the content."""
        return sha256(self.content).hexdigest()


def _octal(value: object) -> object:
    """Read a mode, which is written in octal."""
    return int(value, 8) if isinstance(value, str) and value.isdecimal() else value


class FileFacts(Model):
    """Checksum and mode of a file as written."""

    sha256: str
    mode: Annotated[int, BeforeValidator(_octal), PlainSerializer("{:04o}".format)]


class Manifest(Model):
    """What a bundle contains, which versions it was generated with, and what to check on its host."""

    bundle: int
    fleet: Name
    host: Name
    domain: int
    interface: Interface
    address: Address
    ports: Annotated[tuple[int, ...], AsTuple]
    nodes: Annotated[tuple[str, ...], AsTuple]
    modules: Annotated[tuple[str, ...], AsTuple]
    security: str
    ros: str
    checkout: FolderPath
    installed: FolderPath
    user: Account
    max_offset: float
    versions: dict[str, str]
    files: dict[str, FileFacts]


def manifest_of(host: HostPlan, files: Mapping[str, BundleFile]) -> Manifest:
    """Return the manifest of a host's bundle; `files` is empty before the bundle is generated."""
    fleet = host.fleet
    return Manifest(
        bundle=FORMAT,
        fleet=fleet.name,
        host=host.name,
        domain=fleet.network.domain,
        interface=fleet.interface(host.name),
        address=host.address,
        ports=tuple(sorted(port for node in host.nodes for port in ports(fleet, node))),
        nodes=tuple(node.name for node in host.nodes),
        modules=tuple(sorted({node.module for node in host.nodes})),
        security=fleet.security.level,
        ros=fleet.ros(host.name),
        checkout=fleet.installation.checkout,
        installed=host.installed,
        user=fleet.user(host.name),
        max_offset=fleet.time.max_offset,
        versions=versions(),
        files={path: FileFacts(sha256=file.sha256, mode=file.mode) for path, file in files.items()},
    )


def versions() -> dict[str, str]:
    """Return what must be the same on all hosts of a fleet: the version and the message definitions."""
    own = own_version() or "unknown"
    return {"swarmabs": own} | {name.rpartition("/")[2]: current_hash(name) for name in RECORDED_TYPES}


def read_manifest(folder: Path) -> Manifest:
    """Read the manifest of a bundle.

    Raises
    ------
    InputError
        If it is missing, damaged, or of a newer format.
    """
    path = folder / MANIFEST
    text = read_text(path, "manifest", "JSON")
    try:
        data = json.loads(text)
        if isinstance(data, dict) and isinstance(data.get("bundle"), int) and data["bundle"] > FORMAT:
            raise InputError(f"{path} has a newer format than this version reads ({FORMAT}); update swarmabs")
        return Manifest.model_validate(data)
    except (ValueError, RecursionError, ValidationError) as error:
        raise InputError(f"{path} is not a valid bundle manifest; deploy again") from error


def deploy(loaded: LoadedFleet, output: Path, keys: Path | None, revoke: Sequence[str] = ()) -> list[Path]:
    """Write the bundles of a fleet and return the folder of each host.

    Parameters
    ----------
    loaded : LoadedFleet
        The fleet and its scenario.
    output : Path
        Folder to write, which must be empty or not exist; it is written atomically.
    keys : Path, optional
        Key folder, required with tunnel or sros2 security.
    revoke : sequence of str, optional
        With sros2: hosts and enclaves whose certificates to revoke first.

    Raises
    ------
    InputError
        If the output folder or the keys cannot be used; nothing is written.
    RunError
        If writing fails; the incomplete output is removed.
    """
    part = _temporary_folder(output)
    try:
        store = _keys(loaded, output, keys)
        if revoke:
            if store is None or loaded.fleet.security.level != "sros2":
                level = loaded.fleet.security.level
                raise InputError(f"security {level} has no certificates to revoke; leave out --revoke")
            store.revoke(loaded.fleet, revoke)
        _write(part / FLEET_FILE, BundleFile(loaded.fleet_text.encode()))
        _write(part / SCENARIO_FILE, BundleFile(loaded.scenario_text.encode()))
        hosts = [host for host in (HostPlan(loaded.fleet, host.name) for host in loaded.fleet.hosts) if host.nodes]
        for host in hosts:
            for path, file in host_bundle(loaded, host, store).items():
                _write(part / host.name / path, file)
        part.chmod(_FOLDER)
        if output.exists():
            output.rmdir()
        part.rename(output)
    except OSError as error:
        raise RunError(f"{output}: {error.strerror}; free space or choose another folder with -o") from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return [output / host.name for host in hosts]


def host_bundle(loaded: LoadedFleet, host: HostPlan, keys: Keys | None) -> dict[str, BundleFile]:
    """Return the files of a host's bundle by path, the manifest last; those made from keys only if keys are given."""
    texts = node_files(host)
    for node in host.nodes:
        texts[f"nodes/{node.name}.yaml"] = parameter_file(parameters(loaded, node))
        if node.kind == RECORDER:
            texts[SCENARIO_FILE] = loaded.scenario_text
    files = {path: BundleFile(text.encode()) for path, text in texts.items()}
    files |= {name: BundleFile(host.render(name).encode(), PROGRAM) for name in SCRIPTS}
    if keys is not None:
        files |= {path: BundleFile(content, SECRET) for path, content in keys.files(host).items()}
    files = dict(sorted(files.items()))
    files[SUMS] = BundleFile("".join(f"{file.sha256}  {path}\n" for path, file in files.items()).encode())
    facts = manifest_of(host, files).model_dump(mode="json")
    files[MANIFEST] = BundleFile((json.dumps(facts, indent=2) + "\n").encode())
    return files


def _keys(loaded: LoadedFleet, output: Path, folder: Path | None) -> Keys | None:
    """Return the key store after checking that it is needed and outside the output; None without security."""
    level = loaded.fleet.security.level
    if level == "none":
        if folder is not None:
            raise InputError("security is none and uses no keys; leave out --keys")
        return None
    if folder is None:
        raise InputError(
            f"security {level} needs private keys; give a folder for them and reuse it in later deployments: --keys DIR"
        )
    inside, outside = folder.resolve(), output.resolve()
    if inside == outside or outside in inside.parents:
        raise InputError(
            f"the key folder {folder} is inside the output, which is copied to robots; choose another folder"
        )
    try:
        from swarmabs_fleet.keys import Keys  # noqa: PLC0415 - cryptography is optional
    except ImportError as error:
        raise InputError(f"{error}; generating keys needs the Python package cryptography: install it") from error
    return Keys(inside / loaded.fleet.name)


def _temporary_folder(output: Path) -> Path:
    """Create the temporary folder, next to the output, in which the output is prepared.

    Raises
    ------
    InputError
        If the output exists and is not empty, or cannot be created.
    """
    try:
        if output.exists() and (not output.is_dir() or any(output.iterdir())):
            what = "not empty" if output.is_dir() else "not a folder"
            raise InputError(f"output folder {output} is {what}; choose another with -o, or remove it")
        output.parent.mkdir(parents=True, exist_ok=True)
        return Path(tempfile.mkdtemp(prefix=f".{output.name}.", dir=output.parent))
    except (FileExistsError, NotADirectoryError):
        raise InputError(f"a parent of the output folder {output} is not a folder; choose another with -o") from None
    except OSError as error:
        raise InputError(f"output folder {output} cannot be used: {error.strerror}; choose another with -o") from error


def _write(path: Path, file: BundleFile) -> None:
    """Write a file that has its mode from the start, and create missing folders with the mode that fits it."""
    missing = [folder for folder in (path.parent, *path.parent.parents) if not folder.exists()]
    for folder in reversed(missing):
        folder.mkdir()
        folder.chmod(_SECRET_FOLDER if file.mode == SECRET else _FOLDER)
    path.touch(mode=file.mode, exist_ok=False)
    path.chmod(file.mode)
    path.write_bytes(file.content)
