"""What would keep a fleet from working, each with its remedy: fleets side by side, and bundles against their manifests.

What can be seen on the host itself only is in `host_check`.
"""

from __future__ import annotations

import re
from datetime import datetime, timedelta, timezone
from hashlib import sha256
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING

from swarmabs_config.fleet.loader import FLEET_FILE, LoadedFleet, load_fleet
from swarmabs_config.scenario.fields import nearest
from swarmabs_core.errors import InputError
from swarmabs_fleet.bundle import MANIFEST, SECRET, SUMS, Manifest, host_bundle, manifest_of, read_manifest, versions
from swarmabs_fleet.host_check import check_host
from swarmabs_fleet.host_plan import HostPlan
from swarmabs_run.doctor import Finding

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

_MADE_THERE = ("complete", "workspace.env")
"""What install.sh adds to a bundle."""
_EXPIRING = timedelta(days=30)
_NOT_AFTER = re.compile(rb"<not_after>([0-9T:-]{19})</not_after>")


def check(paths: Sequence[Path], host: str | None) -> list[Finding]:
    """Check fleet files, folders of bundles, and single or installed bundles.

    Parameters
    ----------
    paths : sequence of Path
        What to check; fleets among them are also checked against each other.
    host : str, optional
        Name of the host that this machine is, which is then examined, too.

    Raises
    ------
    InputError
        If something is neither, or invalid, or there is no such host.
    """
    fleets: list[LoadedFleet] = []
    bundles: dict[Path, Manifest] = {}
    for path in paths:
        if path.is_dir():
            found = _bundles(path)
            bundles |= found
            if (path / FLEET_FILE).is_file():
                fleets.append(load_fleet(path / FLEET_FILE))
            elif not found:
                raise InputError(f"{path} holds no bundle; give a fleet file, or what 'swarm deploy' has written")
        else:
            fleets.append(load_fleet(path))
    findings = [finding for loaded in _different(fleets) for finding in _fleet(loaded)]
    findings += [finding for one, other in combinations(_different(fleets), 2) for finding in _together(one, other)]
    for folder, manifest in bundles.items():
        findings += _bundle(folder, manifest)
        if folder.parent.joinpath(FLEET_FILE).is_file():
            findings += _still_made(folder, manifest, load_fleet(folder.parent / FLEET_FILE))
    if host is not None:
        findings += check_host(_known(host, fleets, bundles))
    return findings


def _different(fleets: list[LoadedFleet]) -> list[LoadedFleet]:
    """Return fleets without repetition, as of a file and the bundles made from it."""
    return list({(loaded.fleet_text, loaded.scenario_text): loaded for loaded in fleets}.values())


def _bundles(path: Path) -> dict[Path, Manifest]:
    """Return the bundles in a folder, which may be one itself."""
    folders = [path, *sorted(path.iterdir())]
    return {folder: read_manifest(folder) for folder in folders if (folder / MANIFEST).is_file()}


def _known(host: str, fleets: list[LoadedFleet], bundles: dict[Path, Manifest]) -> Manifest:
    """Return what is known of a host.

    Raises
    ------
    InputError
        If nothing is, or it is in several fleets.
    """
    found = {(manifest.fleet, manifest.host): manifest for manifest in bundles.values()}
    for loaded in fleets:
        for name in (one.name for one in loaded.fleet.hosts):
            found.setdefault((loaded.fleet.name, name), manifest_of(HostPlan(loaded.fleet, name), {}))
    named = [manifest for (_, name), manifest in found.items() if name == host]
    if not named:
        raise InputError(f"no host '{host}'; {nearest(host, [name for _, name in found])}")
    if len(named) > 1:
        raise InputError(f"several fleets have a host '{host}'; check one fleet at a time with --host")
    return named[0]


def _fleet(loaded: LoadedFleet) -> Iterator[Finding]:
    fleet = loaded.fleet
    used = sum(bool(HostPlan(fleet, host.name).nodes) for host in fleet.hosts)
    text = f"{len(fleet.robots)} robots on {used} hosts, domain {fleet.network.domain}"
    yield Finding(f"fleet {fleet.name}", "ok", text)
    for warning in (*fleet.warnings(), *loaded.scenario.warnings()):
        yield Finding(f"fleet {fleet.name}", "note", warning)


def _together(one: LoadedFleet, other: LoadedFleet) -> Iterator[Finding]:
    """Say where two fleets get into each other's way."""
    first, second = one.fleet, other.fleet
    what = f"fleets {first.name} and {second.name}"
    found = []
    if first.network.domain == second.network.domain:
        found.append(f"both have the ROS domain {first.network.domain}; give one another network.domain")
    shared = sorted({host.address for host in first.hosts} & {host.address for host in second.hosts})
    if shared and first.name == second.name:
        found.append(f"both have this name on {shared[0]}, where one would replace the other; name one otherwise")
    if shared and first.tunnel is not None and second.tunnel is not None:
        if first.tunnel.interface == second.tunnel.interface:
            found.append(f"both have the tunnel {first.tunnel.interface} on {shared[0]}; name one otherwise")
        if first.tunnel.port == second.tunnel.port:
            found.append(f"both tunnels have the port {first.tunnel.port} on {shared[0]}; give one another port")
    for text in found:
        yield Finding(what, "bad", text)
    if not found:
        yield Finding(what, "ok", "they do not get into each other's way")


def _bundle(folder: Path, manifest: Manifest) -> Iterator[Finding]:
    """Compare a bundle with its manifest, and with this version."""
    what = f"bundle {manifest.fleet}/{manifest.host}"
    here = versions()
    differing = [name for name, text in here.items() if manifest.versions.get(name) != text]
    if differing:
        name = differing[0]
        made = manifest.versions.get(name, "none")
        yield Finding(
            what, "bad", f"made with {name} {made}, here is {here[name]}; bring all hosts to one version, deploy again"
        )
    problems = list(_files(folder, manifest))
    for text in problems:
        yield Finding(what, "bad", text)
    if not problems and not differing:
        yield Finding(what, "ok", f"{len(manifest.files)} files as in the manifest, version {here['swarmabs']}")
    yield from _certificates(folder, manifest, what)
    installed = str(folder.resolve()) == manifest.installed
    if installed and not (folder / "complete").is_file():
        yield Finding(what, "bad", "its installation was interrupted; start install.sh of the bundle again")


def _files(folder: Path, manifest: Manifest) -> Iterator[str]:
    for path, facts in manifest.files.items():
        file = folder / path
        if Path(path).is_absolute() or ".." in Path(path).parts:
            raise InputError(f"{folder / MANIFEST} names files that are not in the bundle; deploy again")
        try:
            digest = sha256(file.read_bytes()).hexdigest()
            mode = file.stat().st_mode & 0o7777
        except PermissionError:
            yield f"{file} cannot be read; start this as root"
            continue
        except OSError as error:
            yield f"{file}: {error.strerror}; copy or install the bundle again"
            continue
        if digest != facts.sha256:
            yield f"{file} has been changed; copy or install the bundle again"
        elif mode != facts.mode:
            yield f"{file} has the mode {mode:04o}, not {facts.mode:04o}; chmod {facts.mode:04o} {file}"
    known = {*manifest.files, MANIFEST, *_MADE_THERE}
    found = sorted(str(file.relative_to(folder)) for file in folder.rglob("*") if not file.is_dir())
    for path in found:
        if path not in known:
            yield f"{folder / path} does not belong there; remove it"


def _certificates(folder: Path, manifest: Manifest, what: str) -> Iterator[Finding]:
    """Say when permissions end; certificates end with them."""
    now = datetime.now(timezone.utc)
    for path in manifest.files:
        if not path.endswith("permissions.xml"):
            continue
        try:
            found = _NOT_AFTER.search((folder / path).read_bytes())
        except OSError:
            continue  # it is among the files that are not as they should be
        if found is None:
            continue
        last = datetime.fromisoformat(f"{found[1].decode()}+00:00")
        if last - now < _EXPIRING:
            text = f"{path}: valid until {last:%Y-%m-%d}; remove its folder among the keys, and deploy again"
            yield Finding(what, "bad" if last < now else "note", text)


def _still_made(folder: Path, manifest: Manifest, loaded: LoadedFleet) -> Iterator[Finding]:
    """Say whether this version would make the same bundle, but for what has keys in it."""
    what = f"bundle {manifest.fleet}/{manifest.host}"
    if manifest.host not in {host.name for host in loaded.fleet.hosts}:
        yield Finding(what, "bad", f"{folder.parent / FLEET_FILE} has no such host; deploy again into a new folder")
        return
    made = host_bundle(loaded, HostPlan(loaded.fleet, manifest.host), None)
    listed = manifest.files
    same = {path for path, file in made.items() if path in listed and file.mode != SECRET} - {SUMS}
    differing = sorted(path for path in same if made[path].sha256 != listed[path].sha256)
    if differing:
        yield Finding(what, "note", f"this version makes another {differing[0]}; deploy again if that is wanted")
