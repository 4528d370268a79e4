"""Checks of a fleet, with a remedy for each problem: fleets against each other, bundles against their manifests.

`host_check` contains the checks that only the host itself can make.
"""

from __future__ import annotations

import re
from datetime import datetime, timedelta, timezone
from hashlib import sha256
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

from swarmabs_config.fleet.loader import FLEET_FILE, LoadedFleet, load_fleet
from swarmabs_config.model.fields import nearest
from swarmabs_core.errors import InputError
from swarmabs_core.realtime.leadership import TAKEOVER_STEPS
from swarmabs_fleet.bundle import MANIFEST, SECRET, SUMS, Manifest, host_bundle, manifest_of, read_manifest, versions
from swarmabs_fleet.host_check import check_host
from swarmabs_fleet.host_plan import HostPlan
from swarmabs_run.doctor import Finding

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from swarmabs_config.fleet.model import Fleet
    from swarmabs_run.doctor import Verdict

_MADE_THERE = ("complete", "workspace.env")
"""Files that install.sh adds to a bundle."""
_EXPIRING = timedelta(days=30)
_NOT_AFTER = re.compile(rb"<not_after>([0-9T:-]{19})</not_after>")


def check(paths: Sequence[Path], host: str | None) -> list[Finding]:
    """Check fleet files, folders of bundles, and single or installed bundles.

    Parameters
    ----------
    paths : sequence of Path
        Files and folders to check; several fleets are also checked against each other.
    host : str, optional
        Name of the host that this machine is; the machine is then checked, too.

    Raises
    ------
    InputError
        If a path is none of these or invalid, or no such host exists.
    """
    given: list[LoadedFleet] = []
    bundles: dict[Path, Manifest] = {}
    for path in paths:
        if path.is_dir():
            folders = [path, *sorted(path.iterdir())]
            manifests = {folder: read_manifest(folder) for folder in folders if (folder / MANIFEST).is_file()}
            bundles |= manifests
            if (path / FLEET_FILE).is_file():
                given.append(load_fleet(path / FLEET_FILE))
            elif not manifests:
                raise InputError(f"{path} contains no bundle; give a fleet file or the output of 'swarm deploy'")
        else:
            given.append(load_fleet(path))
    # Without duplicates, such as a fleet file and the copy in its bundles.
    fleets = list({(loaded.fleet_text, loaded.scenario_text): loaded for loaded in given}.values())
    verdicts = [(f"fleet {loaded.fleet.name}", _alone(loaded)) for loaded in fleets]
    pairs = [(one.fleet, other.fleet) for one, other in combinations(fleets, 2)]
    verdicts += [(f"fleets {one.name} and {other.name}", _together(one, other)) for one, other in pairs]
    verdicts += [
        (f"bundle {manifest.fleet}/{manifest.host}", _bundle(folder, manifest)) for folder, manifest in bundles.items()
    ]
    findings = [Finding(what, *verdict) for what, of_check in verdicts for verdict in of_check]
    if host is not None:
        findings += check_host(_known(host, given, bundles))
    return findings


def _known(host: str, fleets: list[LoadedFleet], bundles: dict[Path, Manifest]) -> Manifest:
    """Return the manifest of a host, from its bundle or its fleet.

    Raises
    ------
    InputError
        If no fleet has the host, or several have.
    """
    manifests = {(manifest.fleet, manifest.host): manifest for manifest in bundles.values()}
    for loaded in fleets:
        for name in (one.name for one in loaded.fleet.hosts):
            manifests.setdefault((loaded.fleet.name, name), manifest_of(HostPlan(loaded.fleet, name), {}))
    named = [manifest for (_, name), manifest in manifests.items() if name == host]
    if not named:
        raise InputError(f"no host '{host}'; {nearest(host, [name for _, name in manifests])}")
    if len(named) > 1:
        raise InputError(f"several fleets have a host '{host}'; check one fleet at a time with --host")
    return named[0]


def _alone(loaded: LoadedFleet) -> Iterator[Verdict]:
    fleet = loaded.fleet
    used = sum(bool(HostPlan(fleet, host.name).nodes) for host in fleet.hosts)
    yield "ok", f"{len(fleet.robots)} robots on {used} hosts, domain {fleet.network.domain}"
    for warning in loaded.warnings():
        yield "note", warning
    if fleet.decentralised:
        text = f"no observer and no controller: each robot sums up the swarm; only {fleet.coordinators.plane.host}"
        yield "ok", f"{text}, the host of the plane, cannot be lost"
    else:
        yield from _standbys(loaded)


def _standbys(loaded: LoadedFleet) -> Iterator[Verdict]:
    """Report who stands by for whom, how old broadcasts become in a takeover, and what no standby can help."""
    parts, limits = loaded.fleet.coordinators, loaded.scenario.realtime
    named: dict[str, Any] = {"observer": parts.observer, "controller": parts.controller}
    named |= {} if parts.recorder is None else {"recorder": parts.recorder}
    paired = {name: part for name, part in named.items() if part.standby is not None}
    if not paired:
        return
    told = ", ".join(f"{name} on {part.standby} for {part.host}" for name, part in paired.items())
    oldest = limits.takeover_after + TAKEOVER_STEPS * loaded.scenario.period
    limit = limits.broadcast_age_limit
    yield "ok", f"standbys: {told}; in a takeover broadcasts become {oldest:g} s old, robots stop after {limit:g} s"
    for name in ("observer", "controller"):
        if name not in paired:
            yield (
                "note",
                f"{name} has no standby: without {named[name].host} robots stop; add coordinators.{name}.standby",
            )
    shared = [
        name for name, part in paired.items() if name in {"observer", "controller"} and part.host == parts.plane.host
    ]
    if shared:
        text = (
            f"plane is on {parts.plane.host}, as {' and '.join(shared)}: without this host robots stop, since the plane"
        )
        yield "note", f"{text} has no standby; move one of them if the host may fail"


def _together(one: Fleet, other: Fleet) -> Iterator[Verdict]:
    """Report conflicts between two fleets."""
    conflicts = []
    if one.network.domain == other.network.domain:
        conflicts.append(f"both use ROS domain {one.network.domain}; change network.domain of one")
    shared = sorted({host.address for host in one.hosts} & {host.address for host in other.hosts})
    if shared and one.name == other.name:
        conflicts.append(f"both have this name on {shared[0]}, where one would replace the other; rename one")
    if shared and one.tunnel is not None and other.tunnel is not None:
        if one.tunnel.interface == other.tunnel.interface:
            conflicts.append(f"both have the tunnel {one.tunnel.interface} on {shared[0]}; rename one")
        if one.tunnel.port == other.tunnel.port:
            conflicts.append(f"both tunnels use port {one.tunnel.port} on {shared[0]}; change the port of one")
    for text in conflicts:
        yield "bad", text
    if not conflicts:
        yield "ok", "no conflicts"


def _bundle(folder: Path, manifest: Manifest) -> Iterator[Verdict]:
    """Compare a bundle with its manifest, with this version, and with the fleet file next to it."""
    here = versions()
    differing = next((name for name, text in here.items() if manifest.versions.get(name) != text), None)
    if differing is not None:
        version = manifest.versions.get(differing, "none")
        text = f"made with {differing} {version}, but this machine has {here[differing]}"
        yield "bad", f"{text}; bring all hosts to one version, then deploy again"
    problems = list(_files(folder, manifest))
    for problem in problems:
        yield "bad", problem
    if not problems and differing is None:
        yield "ok", f"{len(manifest.files)} files match the manifest, version {here['swarmabs']}"
    yield from _ends(folder, manifest).values()
    if str(folder.resolve()) == manifest.installed and not (folder / "complete").is_file():
        yield "bad", "its installation was interrupted; run install.sh of the bundle again"
    file = folder.parent / FLEET_FILE
    if file.is_file():
        yield from _up_to_date(file, manifest)


def _files(folder: Path, manifest: Manifest) -> Iterator[str]:
    """Report files that differ from the manifest."""
    for path, facts in manifest.files.items():
        file = folder / path
        if Path(path).is_absolute() or ".." in Path(path).parts:
            raise InputError(f"{folder / MANIFEST} lists files outside the bundle; deploy again")
        try:
            digest = sha256(file.read_bytes()).hexdigest()
            mode = file.stat().st_mode & 0o7777
        except PermissionError:
            yield f"{file} cannot be read; run this check as root"
            continue
        except OSError as error:
            yield f"{file}: {error.strerror}; copy or install the bundle again"
            continue
        if digest != facts.sha256:
            yield f"{file} has been changed; copy or install the bundle again"
        elif mode != facts.mode:
            yield f"{file} has mode {mode:04o}, not {facts.mode:04o}; run: chmod {facts.mode:04o} {file}"
    listed = {*manifest.files, MANIFEST, *_MADE_THERE}
    present = {str(file.relative_to(folder)) for file in folder.rglob("*") if not file.is_dir()}
    for path in sorted(present - listed):
        yield f"{folder / path} does not belong to the bundle; remove it"


def expiring(fleet: Fleet, file: Path) -> list[str]:
    """Return one line for each enclave of a fleet whose certificate has expired or soon will.

    Found are those in the bundle that is installed on this host and in all bundles next to the fleet file.
    """
    installed = Path(f"{fleet.installation.prefix}/{fleet.name}")
    lines: dict[str, str] = {}
    for folder in (installed, *(file.parent / host.name for host in fleet.hosts)):
        try:
            manifest = read_manifest(folder)
        except InputError:
            continue  # no bundle, or one that is not for this account
        if manifest.fleet == fleet.name:
            lines |= {path: f"{manifest.host}: {text}" for path, (_, text) in _ends(folder, manifest).items()}
    return list(lines.values())


def _ends(folder: Path, manifest: Manifest) -> dict[str, Verdict]:
    """Return, by their paths, the permissions that have expired or soon will; certificates expire with them."""
    now = datetime.now(timezone.utc)
    ends: dict[str, Verdict] = {}
    for path in manifest.files:
        if not path.endswith("permissions.xml"):
            continue
        try:
            expiry = _NOT_AFTER.search((folder / path).read_bytes())
        except OSError:
            continue  # a check reports it as a file that differs
        if expiry is None:
            continue
        last = datetime.fromisoformat(f"{expiry[1].decode()}+00:00")
        if last - now < _EXPIRING:
            text = f"{path}: valid until {last:%Y-%m-%d}; remove its folder from the key folder, and deploy again"
            ends[path] = ("bad" if last < now else "note", text)
    return ends


def _up_to_date(file: Path, manifest: Manifest) -> Iterator[Verdict]:
    """Report whether the fleet file now gives another bundle; files with keys are not compared."""
    loaded = load_fleet(file)
    if manifest.host not in {host.name for host in loaded.fleet.hosts}:
        yield "bad", f"{file} no longer has this host; deploy again into a new folder"
        return
    generated = host_bundle(loaded, HostPlan(loaded.fleet, manifest.host), None)
    listed = manifest.files
    same = {path for path, one in generated.items() if path in listed and one.mode != SECRET} - {SUMS}
    differing = sorted(path for path in same if generated[path].sha256 != listed[path].sha256)
    if differing:
        yield "note", f"{file.name} now results in a different {differing[0]}; deploy again to update it"
