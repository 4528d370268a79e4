"""Fleets whose permissions are enforced. They need a Fast DDS with DDS Security, and skip without.

Attackers use a library without its own checks: what is refused is refused by the others.
"""

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from datetime import datetime, timedelta, timezone
from pathlib import Path

import pytest
from tests.hosts.cluster import Host, hosts
from tests.hosts.driver import PLACE
from tests.hosts.fleet_hosts import PATIENCE, FleetOnHosts, Operator
from tests.hosts.intruder import MARK, POSITION
from tests.hosts.stations import Station, preferring
from tests.hosts.switch import Impairment
from tests.processes import ROOT, until
from tests.system.realtime import Client

from swarmabs_config.fleet.participants import OPERATOR, node_plans, ports
from swarmabs_config.ports import metatraffic_port
from swarmabs_core.messages import EventKind, Mode
from swarmabs_core.realtime.validation import SECOND_SENDER
from swarmabs_fleet import keys
from swarmabs_fleet.bundle import deploy
from swarmabs_run.orchestration.network import FIRST_FREE, Discovery, network_profile_xml

pytestmark = [pytest.mark.full, pytest.mark.timeout(600), pytest.mark.usefixtures("possible")]


TRIALS = 20
"""After so many failures in a row a command of the operator fails."""
LIFETIME = timedelta(seconds=150)
"""How long certificates are valid that expire in a test; a fleet comes up within it."""


@pytest.mark.parametrize("discovery", ["static", "multicast"])
def test_a_fleet_comes_up_and_its_hosts_return(discovery: str, secured: Path, tmp_path: Path) -> None:
    with hosts(4) as machines:
        fleet = FleetOnHosts(machines, tmp_path / "fleet", discovery=discovery, secured=secured)
        fleet.install()
        fleet.start()
        fleet.lose_hosts()
        fleet.check_bodies()


@contextmanager
def intruder(host: Host, fleet: FleetOnHosts, unchecked: Path, stolen: Path, enclave: str) -> Iterator[Client]:
    """Have an attacker on a host of his own, with a key from the keystore of another."""
    profile = fleet.bundles.parent / f"{host.name}.xml"
    plan = fleet.loaded.fleet
    peers = [(plan.address(node.host), ports(plan, node)[0]) for node in node_plans(plan)]
    peers.append((fleet.base.host.address, metatraffic_port(plan.network.domain, OPERATOR)))
    profile.write_text(network_profile_xml(host.address, Discovery(peers=tuple(peers)), FIRST_FREE), encoding="utf-8")
    files = {f"FAST{name}_DEFAULT_PROFILES_FILE": str(profile) for name in ("RTPS", "DDS")}
    environment = fleet.environment(fleet.robots[1], "agent_001") | preferring(unchecked / "lib") | files
    environment["ROS_SECURITY_KEYSTORE"] = str(stolen)
    environment["ROS_SECURITY_ENCLAVE_OVERRIDE"] = f"/{fleet.name}/{enclave}"
    environment["PYTHONPATH"] = f"{ROOT}:{environment['PYTHONPATH']}"
    words = [sys.executable, ROOT / "tests" / "hosts" / "intruder.py", fleet.loaded.fleet.namespace]
    with host.start(words, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        try:
            yield Client(process)
        finally:
            process.kill()


def forged(operator: Operator) -> list[object]:
    """Return what an honest node, which may read everything, has believed of an attacker."""
    look = operator.look()
    events = [event for event in look["events"] if MARK in event[2] and event[0] != 1]
    states = [key for key, state in look["newest"].items() if state.get("position") == POSITION]
    second = [event for event in look["events"] if SECOND_SENDER in event[2]]
    return [*events, *states, *second, *(["STOP"] if Mode.STOP in look["modes"][1:] else [])]


def test_the_key_of_a_robot_speaks_for_that_robot_only(secured: Path, unchecked: Path, tmp_path: Path) -> None:
    with hosts(5) as machines:
        *ours, foreign = machines
        fleet = FleetOnHosts(ours, tmp_path / "fleet", secured=secured)
        fleet.install()
        fleet.start()
        stolen = fleet.bundles / "robot-1" / "keystore"
        with fleet.operator() as operator, intruder(foreign, fleet, unchecked, stolen, "agent_001") as attacker:
            operator.reset_until_calm(*fleet.ids)
            # What the key permits is heard, so it is the permissions that refuse all else.
            attacker.forge_events("agent_001/events", 1, EventKind.LIMIT_HIT)
            until(lambda: [1, EventKind.LIMIT_HIT, MARK] in operator.look()["events"], "it is heard", PATIENCE)
            attacker.forge_robot(2)
            attacker.forge_coordinators("")
            attacker.forge_coordinators("standby/")

            def attacked(count: int) -> None:
                before = min(attacker.sent().values())
                until(lambda: min(attacker.sent().values()) > before + count, "the attacker speaks", PATIENCE)

            attacked(300)
            operator.until_following(*fleet.ids)
            operator.until_calm()
            assert forged(operator) == []
            assert set(attacker.read()) == {"swarm/desired_abstract_state"}
            assert not any(attacker.called(service) for service in ("swarm/stop", "agent_002/leave"))

            machines.partition([0, 1, 3, 4], [2])  # robot 2 is silent
            until(lambda: [2, EventKind.DEAD, "silent"] in operator.look()["events"], "robot 2 is missed", PATIENCE)
            attacked(300)
            operator.until_following(1, 3)
            operator.until_calm()
            assert forged(operator) == []
            machines.partition()
            operator.until_following(*fleet.ids)
            operator.until_calm()
            assert forged(operator) == []


def test_operators_and_standbys(secured: Path, tmp_path: Path) -> None:
    with hosts(5) as machines:
        fleet = FleetOnHosts(
            machines, tmp_path / "fleet", secured=secured, standby=True, recorder=True, plane="{host: robot-1}"
        )
        fleet.install()
        fleet.start()

        def operate(station: Station, *words: object) -> None:
            """Run a command of the operator until it succeeds: a busy machine may answer late."""
            for _ in range(TRIALS):
                done = station.swarm(words[0], fleet.file, *words[1:])
                if done.returncode == 0:
                    return
            raise AssertionError(f"{words} fails: {done.stdout}{done.stderr}")

        def in_order(station: Station) -> None:
            operate(station, "status")
            with fleet.operator(station) as operator:
                operator.until_following(*fleet.ids)
                operator.until_calm()

        def moves() -> bool:
            return all(fleet.base.swarm(word, fleet.file).returncode == 0 for word in ("reset", "status"))

        until(moves, "the fleet moves", PATIENCE)
        in_order(fleet.base)
        operate(fleet.base, "failover")
        in_order(fleet.base)
        operate(fleet.base, "drain", 2)
        operate(fleet.base, "join", 2)
        in_order(fleet.base)
        for station, node in (
            (fleet.robots[2], "agent_002"),
            (fleet.base, "abstraction_observer"),
            (fleet.spare, "parent_controller_standby"),
        ):
            station.run("systemctl", "restart", "--", f"swarmabs-{fleet.name}-{node}.service")
            in_order(fleet.base)
        fleet.robots[3].host.kill()
        operate(fleet.base, "remove", 3)
        fleet.robots[3].power_on()
        in_order(fleet.base)

        fleet.base.host.kill()
        with fleet.operator(fleet.spare) as operator:
            operator.until_following(*fleet.ids)
            operator.until_calm()
        fleet.base.power_on()
        fleet.base.until_active(fleet.target)
        in_order(fleet.spare)
        fleet.check_bodies()
        for station in (fleet.base, fleet.spare):
            station.run("systemctl", "stop", "--", fleet.target)
        (whole,) = (fleet.spare.state / f"swarmabs-{fleet.name}").glob(f"{fleet.name}-*")
        for command in ("verify", "info"):
            told = fleet.spare.swarm(command, whole)
            assert told.returncode == 0, told.stdout + told.stderr


def test_a_robot_with_a_topic_drive_and_a_measured_plane(secured: Path, tmp_path: Path) -> None:
    with hosts(4) as machines, ExitStack() as stack:
        encoder = "{type: driver, host: base, source: joint_state}"
        drives = {1: "{type: topic, offset: 0.0}"}
        fleet = FleetOnHosts(machines, tmp_path / "fleet", secured=secured, plane=encoder, drives=drives)
        fleet.install()

        def driver(station: Station, what: str, served: str) -> Client:
            namespace = f"/driver_{station.name.replace('-', '_')}"
            words = [sys.executable, ROOT / "tests" / "hosts" / "driver.py", namespace, what, served]
            environment = fleet.environment(station, "driver") | {"PYTHONPATH": os.environ["PYTHONPATH"]}
            environment["PYTHONPATH"] = f"{ROOT}:{environment['PYTHONPATH']}"
            pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
            process = stack.enter_context(station.host.start(words, env=environment, **pipes))
            stack.callback(process.kill)
            return Client(process)

        base = driver(fleet.robots[1], "base", "agent_001")
        driver(fleet.base, "encoder", "plane_driver")
        fleet.start()
        with fleet.operator() as operator:
            operator.reset()
            operator.until_following(*fleet.ids)
            before, _ = base.body()
            until(lambda: base.body()[0] > before + 100, "commands come", PATIENCE)
            until(lambda: abs(base.body()[1] - PLACE) > 1e-3, "the base moves", PATIENCE)
            heard = lambda: abs(operator.state(1)["position"] - base.body()[1]) < 0.01  # noqa: E731
            until(heard, "the robot says where its base is", PATIENCE)


def test_a_revoked_key_is_refused_by_nodes_that_have_restarted(secured: Path, unchecked: Path, tmp_path: Path) -> None:
    with hosts(5) as machines:
        *ours, foreign = machines
        fleet = FleetOnHosts(ours, tmp_path / "fleet", secured=secured)
        fleet.install()
        fleet.start()
        stolen = tmp_path / "stolen"
        shutil.copytree(fleet.bundles / "robot-1" / "keystore", stolen)

        def reads(*accepted: int) -> bool:
            """Tell whether one who comes with the stolen key hears broadcasts within 500 steps of accepted robots."""
            with fleet.operator() as operator, intruder(foreign, fleet, unchecked, stolen, "agent_001") as attacker:
                operator.reset_until_calm(*accepted)
                last = operator.state(2)["step"] + 500
                until(lambda: attacker.read() or operator.state(2)["step"] > last, "steps pass", PATIENCE)
                return bool(attacker.read())

        assert reads(*fleet.ids)
        shutil.rmtree(fleet.bundles)
        deploy(fleet.loaded, fleet.bundles, fleet.keys, ["robot-1"])
        fleet.install()
        # Running nodes accept it still. The operator is a new process: it refuses it, also of robot 1 itself.
        assert reads(2, 3)
        for station in fleet.stations:
            station.run(f"/etc/swarmabs/{fleet.name}/restart.sh")
        assert not reads(*fleet.ids)


def test_certificates_expire_while_a_fleet_runs(secured: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with hosts(4) as machines:
        monkeypatch.setattr(keys, "_today", lambda: datetime.now(timezone.utc) - timedelta(days=1) + LIFETIME)
        fleet = FleetOnHosts(machines, tmp_path / "fleet", secured=secured, valid_days=1)
        last = datetime.now(timezone.utc) + LIFETIME
        fleet.install()
        fleet.start()
        assert "valid until" in (told := fleet.base.swarm("status", fleet.file)).stderr, told
        with fleet.operator() as operator:
            operator.reset_until_calm(*fleet.ids)
            assert datetime.now(timezone.utc) < last, "the machine is too busy for this test"
            until(lambda: datetime.now(timezone.utc) > last, "certificates expire", LIFETIME.total_seconds())
            operator.until_following(*fleet.ids)
            operator.until_calm()
            unit = f"swarmabs-{fleet.name}-agent_002.service"
            assert fleet.robots[2].start("systemctl", "restart", "--", unit).wait(PATIENCE) == 1
            operator.until_following(1, 3)
            operator.until_calm()


DEAF = 8.0
"""Time, s, for which a host hears nothing: longer than the lease of a fleet without security."""


@pytest.mark.parametrize("victim", ["robot", "base"])
def test_nodes_that_lose_each_other_one_sidedly_meet_again(victim: str, secured: Path, tmp_path: Path) -> None:
    """As after an overload: who has forgotten another that has not forgotten it, cannot authenticate again."""
    with hosts(4) as machines:
        fleet = FleetOnHosts(machines, tmp_path / "fleet", secured=secured)
        fleet.install()
        fleet.start()
        host = (fleet.base if victim == "base" else fleet.robots[2]).host
        with fleet.operator() as operator:
            operator.reset()
            operator.until_following(*fleet.ids)
            host.impair(Impairment(loss=1.0), directions=("to",))
            time.sleep(DEAF)
            host.impair(Impairment(), directions=("to",))
            operator.reset()
            operator.until_following(*fleet.ids)
