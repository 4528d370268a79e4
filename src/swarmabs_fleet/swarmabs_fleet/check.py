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
from swarmabs_config.model.fields import nearest
from swarmabs_core.errors import InputError
from swarmabs_fleet.bundle import MANIFEST, SECRET, SUMS, Manifest, host_bundle, manifest_of, read_manifest, versions
from swarmabs_fleet.host_check import check_host
from swarmabs_fleet.host_plan import HostPlan
from swarmabs_run.doctor import Finding

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from swarmabs_config.fleet.checked import Fleet
    from swarmabs_run.doctor import Verdict

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
    given: list[LoadedFleet] = []
    bundles: dict[Path, Manifest] = {}
    for path in paths:
        if path.is_dir():
            folders = [path, *sorted(path.iterdir())]
            found = {folder: read_manifest(folder) for folder in folders if (folder / MANIFEST).is_file()}
            bundles |= found
            if (path / FLEET_FILE).is_file():
                given.append(load_fleet(path / FLEET_FILE))
            elif not found:
                raise InputError(f"{path} holds no bundle; give a fleet file, or what 'swarm deploy' has written")
        else:
            given.append(load_fleet(path))
    # Without repetition, as of a file and the bundles made from it.
    fleets = list({(loaded.fleet_text, loaded.scenario_text): loaded for loaded in given}.values())
    verdicts = [(f"fleet {loaded.fleet.name}", _alone(loaded)) for loaded in fleets]
    pairs = [(one.fleet, other.fleet) for one, other in combinations(fleets, 2)]
    verdicts += [(f"fleets {one.name} and {other.name}", _together(one, other)) for one, other in pairs]
    verdicts += [(f"bundle {made.fleet}/{made.host}", _bundle(folder, made)) for folder, made in bundles.items()]
    findings = [Finding(what, *verdict) for what, each in verdicts for verdict in each]
    if host is not None:
        findings += check_host(_known(host, given, bundles))
    return findings


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


def _alone(loaded: LoadedFleet) -> Iterator[Verdict]:
    fleet = loaded.fleet
    used = sum(bool(HostPlan(fleet, host.name).nodes) for host in fleet.hosts)
    yield "ok", f"{len(fleet.robots)} robots on {used} hosts, domain {fleet.network.domain}"
    for warning in (*fleet.warnings(), *loaded.scenario.warnings()):
        yield "note", warning


def _together(one: Fleet, other: Fleet) -> Iterator[Verdict]:
    """Say where two fleets get into each other's way."""
    found = []
    if one.network.domain == other.network.domain:
        found.append(f"both have the ROS domain {one.network.domain}; give one another network.domain")
    shared = sorted({host.address for host in one.hosts} & {host.address for host in other.hosts})
    if shared and one.name == other.name:
        found.append(f"both have this name on {shared[0]}, where one would replace the other; name one otherwise")
    if shared and one.tunnel is not None and other.tunnel is not None:
        if one.tunnel.interface == other.tunnel.interface:
            found.append(f"both have the tunnel {one.tunnel.interface} on {shared[0]}; name one otherwise")
        if one.tunnel.port == other.tunnel.port:
            found.append(f"both tunnels have the port {one.tunnel.port} on {shared[0]}; give one another port")
    for text in found:
        yield "bad", text
    if not found:
        yield "ok", "they do not get into each other's way"


def _bundle(folder: Path, manifest: Manifest) -> Iterator[Verdict]:
    """Compare a bundle with its manifest, with this version, and with the fleet file beside it."""
    here = versions()
    differing = next((name for name, text in here.items() if manifest.versions.get(name) != text), None)
    if differing is not None:
        made = manifest.versions.get(differing, "none")
        text = f"made with {differing} {made}, here is {here[differing]}"
        yield "bad", f"{text}; bring all hosts to one version, deploy again"
    problems = list(_files(folder, manifest))
    for problem in problems:
        yield "bad", problem
    if not problems and differing is None:
        yield "ok", f"{len(manifest.files)} files as in the manifest, version {here['swarmabs']}"
    yield from _certificates(folder, manifest)
    if str(folder.resolve()) == manifest.installed and not (folder / "complete").is_file():
        yield "bad", "its installation was interrupted; start install.sh of the bundle again"
    file = folder.parent / FLEET_FILE
    if file.is_file():
        yield from _still_made(file, manifest)


def _files(folder: Path, manifest: Manifest) -> Iterator[str]:
    """Say which files are not as the manifest says."""
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
    found = {str(file.relative_to(folder)) for file in folder.rglob("*") if not file.is_dir()}
    for path in sorted(found - known):
        yield f"{folder / path} does not belong there; remove it"


def _certificates(folder: Path, manifest: Manifest) -> Iterator[Verdict]:
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
            yield "bad" if last < now else "note", text


def _still_made(file: Path, manifest: Manifest) -> Iterator[Verdict]:
    """Say whether this version would make the same bundle of a fleet file, but for what has keys in it."""
    loaded = load_fleet(file)
    if manifest.host not in {host.name for host in loaded.fleet.hosts}:
        yield "bad", f"{file} has no such host; deploy again into a new folder"
        return
    made = host_bundle(loaded, HostPlan(loaded.fleet, manifest.host), None)
    listed = manifest.files
    same = {path for path, one in made.items() if path in listed and one.mode != SECRET} - {SUMS}
    differing = sorted(path for path in same if made[path].sha256 != listed[path].sha256)
    if differing:
        yield "note", f"this version makes another {differing[0]}; deploy again if that is wanted"
