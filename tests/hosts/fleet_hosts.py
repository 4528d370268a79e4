"""A whole fleet on test hosts: deployed from a file, installed by its own scripts, started as its units say."""

import shlex
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from tests.hosts import black_box
from tests.hosts.black_box import Note
from tests.hosts.cluster import Host, finish
from tests.hosts.stations import Checkout, Station
from tests.plugin_packages import install as install_package
from tests.processes import ROOT, until
from tests.system.realtime import Client

from swarmabs_config.fleet.loader import LoadedFleet, load_fleet
from swarmabs_core.nodes import agent_name
from swarmabs_fleet.bundle import deploy

PERIOD = 0.02
VELOCITY, FORCE, LANE = 0.5, 3.0, 0.4
"""Limits of every robot, m/s, N and m."""
CALM = 0.02
"""Angle of the plane, rad, that the swarm keeps."""
CALM_FOR = 150
"""States of the plane in a row within this angle after which it is kept."""
PATIENCE = 120.0
"""Time, s, within which a swarm gets into order on a machine that is busy."""

_FLEET = """\
schema: 1
name: {name}
namespace: {namespace}
scenario: pd_het_4
set:
  step: {period}
  limits: {{velocity: {velocity}, force: {force}}}
  realtime: {{start: quorum, quorum: {quorum}}}{coordination}
hosts:
{hosts}
robots:
{robots}coordinators: {{plane: {plane}{central}{recorder}}}
network: {{domain: {domain}, interface: eth0, discovery: {discovery}}}
security: {security}
installation: {{checkout: {checkout}{ros}}}
"""
_ROBOT = """\
  - id: {id}
    host: {host}
    {kind}
    limits: {limits}
    drive: {drive}
"""
_BLACK_BOX = "{{type: plugin, name: black_box, settings: {{file: {file}, position: {position}}}}}"
_KINDS = (
    "kind: single_integrator\n    mass: 0.3552",
    "kind: double_integrator\n    mass: 0.4596\n    damping: 1.3258",
    "kind: double_integrator\n    mass: 0.6762\n    damping: 0.6524",
    "kind: single_integrator\n    mass: 0.3532",
)


class FleetOnHosts:
    """A fleet whose first host, the base, has the coordinators, and of which each other host is a robot.

    Its disks and files are in a folder of its own. `quorum` robots must be there before the swarm moves; ids count
    from `first_id`. A discovery server, and a recorder if there is one, are on the base. With the prefix of a `secured`
    Fast DDS it enforces sros2. With `standby` the second host, the spare, has the standbys of all coordinators but the
    plane. With `peers` there is no observer and no controller. `plane` and `drives` replace the simulated plane, and
    the plug-in drives of some robots, in the fleet file; those that are not `limited` have no limits of their own.
    """

    def __init__(
        self,
        hosts: Sequence[Host],
        folder: Path,
        *,
        name: str = "net",
        namespace: str = "/",
        domain: int = 7,
        discovery: str = "static",
        quorum: int = 3,
        first_id: int = 1,
        recorder: bool = False,
        secured: Path | None = None,
        valid_days: int = 3650,
        standby: bool = False,
        peers: bool = False,
        plane: str = "{host: base}",
        drives: Mapping[int, str] = {},
        limited: bool = True,
    ) -> None:
        folder.mkdir(exist_ok=True)
        packages = folder / "packages"
        install_package(packages, "drive", black_box.NAME, "", target="tests.hosts.black_box:PART")
        self.checkout = Checkout(folder, str(packages), secured / "lib" if secured else None)
        self.name = name
        central = ["base", *(["spare"] if standby else [])]
        self.ids = tuple(range(first_id, first_id + len(hosts) - len(central)))
        self._boxes = folder / "bodies"
        self._boxes.mkdir()
        server = ", server: base" if discovery == "server" else ""
        names = [*central, *(f"robot-{number}" for number in self.ids)]
        pair = "{host: base, standby: spare}" if standby else "{host: base}"
        self._drives, self._limited = drives, limited
        listed = [f"  - {{name: {n}, address: {host.address}}}" for n, host in zip(names, hosts, strict=True)]
        self.file = folder / f"{name}.yaml"
        self.file.write_text(
            _FLEET.format(
                name=name,
                namespace=namespace,
                period=PERIOD,
                velocity=VELOCITY,
                force=FORCE,
                quorum=quorum,
                hosts="\n".join(listed),
                robots="".join(map(self._robot, self.ids)),
                plane=plane,
                central="" if peers else f", observer: {pair}, controller: {pair}",
                coordination="\n  coordination: each_robot" if peers else "",
                recorder=f", recorder: {pair}" if recorder else "",
                domain=domain,
                discovery=f"{discovery}{server}",
                security=f"{{level: sros2, valid_days: {valid_days}}}" if secured else "{level: none}",
                checkout=self.checkout.folder,
                ros=f", ros: sourced, setup: {self.checkout.setup}" if secured else "",
            ),
            encoding="utf-8",
        )
        self.loaded: LoadedFleet = load_fleet(self.file)
        self.bundles = folder / "bundles"
        self.keys = folder / "keys" if secured else None
        deploy(self.loaded, self.bundles, self.keys)
        self.stations = [
            Station(host, station, folder / "disks", self.checkout) for station, host in zip(names, hosts, strict=True)
        ]
        self.base, self.spare = self.stations[0], self.stations[len(central) - 1]
        self.robots = dict(zip(self.ids, self.stations[len(central) :], strict=True))
        self.target = f"swarmabs-{name}.target"

    def _robot(self, number: int) -> str:
        index = number - self.ids[0]
        position = 0.125 * (-1) ** index
        return _ROBOT.format(
            id=number,
            host=f"robot-{number}",
            kind=_KINDS[index % len(_KINDS)],
            limits=f"{{lane: {LANE}}}" if self._limited else "{}",
            drive=self._drives.get(number) or _BLACK_BOX.format(file=self._boxes / str(number), position=position),
        )

    def install(self) -> None:
        """Install each bundle on its host by its own script, all at the same time."""
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        for process in [each.start(self.bundles / each.name / "install.sh", **pipes) for each in self.stations]:
            finish(process)

    def start(self, *some: Station) -> None:
        """Start what is installed on some hosts, or on all, and wait until it is ready."""
        stations = some or self.stations
        started = [station.start("systemctl", "start", "--", self.target) for station in stations]
        for station, process in zip(stations, started, strict=True):
            assert process.wait(PATIENCE) == 0, station.log()

    def lose_hosts(self) -> None:
        """Prove that the fleet levels the plane, also after the host of robot 2, and then the base, was off."""
        for victim in (None, self.robots[2], self.base):
            if victim is not None:
                victim.host.kill()
                victim.power_on()
                victim.until_active(self.target)
            with self.operator() as operator:
                operator.reset_until_calm(*self.ids)

    def bags(self, station: Station) -> list[Path]:
        """Return the bags that a recorder on a host has written, in the order of its starts."""
        return sorted((station.state / f"swarmabs-{self.name}").glob(f"{self.name}-*"))

    def notes(self, number: int) -> list[Note]:
        return black_box.notes(self._boxes / str(number))

    def check_bodies(self) -> None:
        """Prove that no robot was asked for more than it may do, and that none has left its lane."""
        for robot in self.loaded.fleet.members:
            limit = VELOCITY if robot.kind == "single_integrator" else FORCE
            noted = self.notes(robot.id)
            assert len(noted) > 10
            for note in noted:
                assert abs(note.position) <= LANE + 1e-9 and abs(note.command) <= limit, (robot.id, note)

    def environment(self, station: Station, role: str) -> dict[str, str]:
        """Return the variables of tools of a role, or of a node, on a host where the bundle is installed."""
        files = [station.etc / "swarmabs" / self.name / file for file in ("workspace.env", f"nodes/{role}.env")]
        variables = [variable for file in files for variable in shlex.split(file.read_text())]
        return {**dict(variable.split("=", 1) for variable in variables), "ROS_LOG_DIR": "/run"}

    @contextmanager
    def operator(self, station: Station | None = None, client: str = "realtime_client") -> Iterator["Operator"]:
        """Have an operator on the base, or on the spare. Meanwhile no other tool can be started there.

        `client` is the module of `tests.system` that it is.
        """
        words = [sys.executable, ROOT / "tests" / "system" / f"{client}.py", self.loaded.fleet.namespace]
        words += self.ids if self.loaded.fleet.own_topics else ()
        station = station or self.base
        environment = self.environment(station, "operator")
        with station.host.start(words, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
            try:
                yield Operator(process)
            finally:
                process.kill()


class Operator(Client):
    """Looks at a fleet and commands it, from its base."""

    def state(self, number: int) -> dict[str, Any]:
        """Return the newest state of a robot that was heard; empty without."""
        found: dict[str, Any] = self.look()["newest"].get(f"swarm/agent_state {number}", {})
        return found

    def until_following(self, *numbers: int) -> None:
        """Wait until robots follow broadcasts that they have not been heard to follow yet."""
        for number in numbers:
            follows = partial(self._follows, number, self.state(number).get("step", -1))
            until(follows, partial(self._all, number), PATIENCE)

    def _follows(self, number: int, before: int) -> bool:
        state = self.state(number)
        return bool(state) and state["step"] > before + 10 and before < state["broadcast_step"] <= state["step"]

    def _all(self, number: int) -> str:
        look = self.look()
        return f"robot {number} follows; {self.state(number)}; {look['diagnostics']}; {look['events'][-20:]}"

    def follows(self, number: int) -> bool:
        """Tell whether a robot follows the broadcasts of these days."""
        state, plane = self.state(number), self.look()["newest"].get("plane/state")
        if not state or not plane:
            return False
        return abs(state["step"] - plane["step"]) < 100 and 0 <= state["step"] - state["broadcast_step"] < 100

    def until_calm(self) -> None:
        """Wait until the plane has been near level for a while."""
        newest: list[float] = []

        def calm() -> bool:
            newest[:] = self.calm(CALM)
            return newest[0] >= CALM_FOR

        until(calm, lambda: f"{CALM_FOR} states in a row within {CALM} rad; calm for, newest: {newest}", PATIENCE)

    def until_counted(self, *numbers: int) -> None:
        """Wait until these robots, without coordinators, count for a majority and no others, as each of them says."""
        wanted = " ".join(map(str, numbers))

        def counted() -> dict[int, str]:
            return {i: self.health(agent_name(i)).get("values", {}).get("counted robots", "") for i in numbers}

        until(lambda: {*counted().values()} == {wanted}, lambda: f"robots {wanted} count; {counted()}", PATIENCE)

    def reset(self, service: str = "swarm/reset") -> None:
        """Let the swarm move, by the service of the controller or of a robot."""
        until(lambda: self.trigger(service) == [True, ""], f"{service} answers", PATIENCE)

    def reset_until_calm(self, *numbers: int, service: str = "swarm/reset") -> None:
        """Let the swarm move, until robots follow and the plane is level."""
        self.reset(service)
        self.until_following(*numbers)
        self.until_calm()
