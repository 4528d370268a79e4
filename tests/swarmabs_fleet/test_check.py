"""`deploy --check`: fleets side by side, bundles against their manifests, and this machine as a host."""

import json
import os
import socket
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from tests.swarmabs_fleet.fleets import EXAMPLES, ONE_HOST, deployed, edited

from swarmabs_cli import main
from swarmabs_config.fleet.loader import load_fleet
from swarmabs_core.errors import InputError
from swarmabs_fleet.check import check, expiring
from swarmabs_fleet.host_check import Reader, read_chrony, read_pmc, read_timedatectl
from swarmabs_run.doctor import Finding
from swarmabs_run.orchestration.network import claimed_domain


def bad(findings: list[Finding]) -> list[str]:
    return [finding.text for finding in findings if finding.verdict == "bad"]


def changed_manifest(bundle: Path, change: Callable[[dict[str, Any]], object]) -> None:
    manifest = json.loads((bundle / "manifest.json").read_text())
    change(manifest)
    (bundle / "manifest.json").write_text(json.dumps(manifest))


PARAMETERS, CONFIGURATION = "nodes/agent_001.yaml", "wireguard/floor0.conf"
DAMAGES: dict[str, Callable[[Path], object]] = {
    "agent_001.yaml has been changed; copy or install": lambda bundle: os.truncate(bundle / PARAMETERS, 9),
    "agent_001.yaml: No such file or directory; copy or install": lambda bundle: (bundle / PARAMETERS).unlink(),
    "floor0.conf has mode 0644, not 0600; run: chmod 0600": lambda bundle: (bundle / CONFIGURATION).chmod(0o644),
    "authorized_keys does not belong to": lambda bundle: (bundle / "nodes/authorized_keys").touch(),
    "made with AgentState RIHS01_0, but this machine has RIHS01_": lambda bundle: changed_manifest(
        bundle, lambda found: found["versions"].update(AgentState="RIHS01_0")
    ),
}


def test_a_bundle_is_as_it_was_made_or_what_is_wrong_is_named(
    examples: dict[str, Path], own: Callable[[str], Path]
) -> None:
    findings = check([*examples.values(), *EXAMPLES.values()], None)
    assert bad(findings) == []
    assert sum(finding.text.startswith("no conflicts") for finding in findings) == 10
    assert [finding.verdict for finding in findings if finding.text.startswith("security is none")] == ["note"] * 3
    for words, act in DAMAGES.items():
        bundle = own("tunnel") / "cart-1"
        act(bundle)
        findings = check([bundle], None)
        (text,) = bad(findings)
        assert words in text and "; " in text
        assert not [finding for finding in findings if finding.verdict == "ok" and finding.check.startswith("bundle")]


def test_bundles_that_this_version_would_make_otherwise_are_noted(own: Callable[[str], Path]) -> None:
    output = own("lan")
    file = output / "fleet.yaml"
    file.write_text(file.read_text().replace("mass: 0.3552", "mass: 0.4"))
    found = [(one.verdict, one.text) for one in check([output], None) if one.check == "bundle lan/robot-1"]
    assert ("note", "fleet.yaml now results in a different nodes/agent_001.yaml; deploy again to update it") in found
    file.write_text(file.read_text().replace("robot-1", "robot-7"))
    (text,) = bad(check([output], None))
    assert text == f"{file} no longer has this host; deploy again into a new folder"


def test_fleets_that_get_into_each_others_way(tmp_path: Path) -> None:
    tunnel = EXAMPLES["tunnel"].read_text(encoding="utf-8")
    second = edited(tmp_path / "second.yaml", tunnel, ("name: floor", "name: other"), ("10.83.0.", "10.84.0."))
    texts = bad(check([EXAMPLES["tunnel"], second], None))
    said = ("ROS domain 41", "tunnel floor0 on 10.20.0.5", "port 51820 on 10.20.0.5")
    assert [words in text for text, words in zip(texts, said, strict=True)] == [True] * 3
    changes = (("domain: 41", "domain: 43"), ("floor0, port: 51820", "other0, port: 51821"))
    apart = edited(tmp_path / "apart.yaml", second.read_text(encoding="utf-8"), *changes)
    assert bad(check([EXAMPLES["tunnel"], apart], None)) == []


def test_standbys_are_listed_with_what_they_do_not_cover(tmp_path: Path) -> None:
    text = EXAMPLES["standby"].read_text(encoding="utf-8")
    (found,) = (each for each in check([EXAMPLES["standby"]], None) if "standbys" in each.text)
    who = "standbys: observer on spare for base, controller on spare for base, recorder on spare for base"
    assert (found.verdict, found.text) == (
        "ok",
        f"{who}; in a takeover broadcasts become 0.06 s old, robots stop after 0.1 s",
    )
    changes = (
        ("observer: {host: base, standby: spare}", "observer: {host: base}"),
        ("driver, host: encoder", "driver, host: base"),
    )
    notes = [
        each.text for each in check([edited(tmp_path / "one.yaml", text, *changes)], None) if each.verdict == "note"
    ]
    wanted = ("observer has no standby: without base", "plane is on base, as controller:")
    assert [any(words in note for note in notes) for words in wanted] == [True, True]
    assert not any("standby" in each.text for each in check([EXAMPLES["lan"]], None))


def test_what_cannot_be_checked_is_refused(tmp_path: Path, own: Callable[[str], Path]) -> None:
    (tmp_path / "empty").mkdir()
    for paths, host, words in (
        (["lan"], "robot-9", "did you mean 'robot-"),
        (["lan", "tunnel"], "base", "several fleets have a host 'base'; check one fleet at a time"),
        (["empty"], None, "contains no bundle"),
        (["nothing.yaml"], None, "no such file"),
    ):
        with pytest.raises(InputError, match=words):
            check([EXAMPLES.get(path, tmp_path / path) for path in paths], host)
    # A manifest that names files outside, or is none.
    bundle = own("lan") / "robot-1"
    for path in ("../../secret", "/etc/passwd"):
        changed_manifest(bundle, lambda found: found.update(files={path: {"sha256": "0", "mode": "0644"}}))  # noqa: B023
        with pytest.raises(InputError, match="outside the bundle"):
            check([bundle], None)
    for text in ("{", "[]", '{"bundle": 1}', "[" * 100_000, '{"bundle": 2}'):
        (bundle / "manifest.json").write_text(text)
        with pytest.raises(InputError, match="update swarmabs" if "2" in text else "not a valid bundle manifest"):
            check([bundle], None)


# From `chronyc -c tracking` of chrony 4.3 and `pmc` of linuxptp 3.1.
CHRONY = (
    "A29FC87B,192.168.10.1,3,1763731200.123,{offset},-0.000012,0.000034,-12.3,0.001,0.05,0.0012,0.0003,64.2,{leap}\n"
)
PMC = """\
sending: GET TIME_STATUS_NP
\t52540a.fffe.123456-0 seq 0 RESPONSE MANAGEMENT TIME_STATUS_NP
\t\tmaster_offset              -1750
\t\tingress_time               1763731200123456789
\t\tgmPresent                  {present}
\t\tgmIdentity                 52540a.fffe.654321
"""


def test_how_well_the_clock_is_known_to_go() -> None:
    states = {
        **{text: read_timedatectl(text) for text in ("", "nonsense\n", "yes\n", "no\n")},
        **{leap: read_chrony(CHRONY.format(offset="-0.000250", leap=leap)) for leap in ("Normal", "Not synchronised")},
        **{present: read_pmc(PMC.format(present=present)) for present in ("true", "false")},
        **{text: read(text) for read, text in ((read_chrony, "506 Cannot talk\n"), (read_pmc, "sending: GET\n"))},
    }
    synchronised = {text: None if state is None else state.synchronised for text, state in states.items()}
    assert list(synchronised.values()) == [None, None, True, False, True, False, True, False, None, None]
    # Offset, dispersion and half the delay, as chrony knows them.
    for text, bound in (("Normal", 0.00025 + 0.0003 + 0.0006), ("true", 1.75e-6)):
        assert getattr(states[text], "bound", None) == pytest.approx(bound)


class Machine:
    """This machine as the host of a fleet, with programs of the test's own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / "bin").mkdir()

    def program(self, name: str, text: str) -> None:
        path = self.folder / "bin" / name
        path.write_text(f"#!/bin/sh\ncat <<'END'\n{text.rstrip()}\nEND\n".replace("cat ", "/bin/cat "))
        path.chmod(0o755)

    def findings(self, fleet: Path) -> dict[str, Finding]:
        return {finding.check: finding for finding in check([fleet], "base")}


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Machine:
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    return Machine(tmp_path)


def test_the_machine_is_examined(machine: Machine) -> None:
    with claimed_domain() as domain:
        fleet = edited(machine.folder / "one.yaml", ONE_HOST, ("domain: 7", f"domain: {domain}"))
        machine.program("chronyc", CHRONY.format(offset="0.001", leap="Normal"))
        machine.program("systemctl", "systemd 255 (255.4)")
        by_check = machine.findings(fleet)
        assert [by_check[name].verdict for name in ("interface", "ports", "clock", "systemd", "packages")] == ["ok"] * 5
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            other.bind(("127.0.0.1", 7000 + 100 * domain + 10 + 2 * 9))  # the second robot's
            assert machine.findings(fleet)["ports"].verdict == "bad"
            assert f"UDP port {other.getsockname()[1]} " in machine.findings(fleet)["ports"].text
            machine.program("systemctl", "active")
            assert machine.findings(fleet)["ports"].verdict == "note"


def test_the_clock_of_the_machine(machine: Machine) -> None:
    machine.program("timedatectl", "yes")
    for chrony, verdict, words in (
        (None, "note", "does not report the error"),
        ("506 Cannot talk to daemon", "note", "does not report the error"),
        (CHRONY.format(offset="0.0", leap="Normal"), "ok", "at most 0.000900 s according to chrony"),
        (CHRONY.format(offset="-0.0049", leap="Normal"), "bad", "more than time.max_offset (0.005 s)"),
        (CHRONY.format(offset="0.0", leap="Not synchronised"), "bad", "not synchronised"),
    ):
        if chrony is not None:
            machine.program("chronyc", chrony)
        finding = machine.findings(edited(machine.folder / "one.yaml", ONE_HOST))["clock"]
        assert (finding.verdict, words in finding.text) == (verdict, True), finding


def test_a_machine_that_is_not_the_host(machine: Machine) -> None:
    by_check = machine.findings(edited(machine.folder / "one.yaml", ONE_HOST, ("interface: lo", "interface: wlan9")))
    assert by_check["interface"].text.startswith("no interface wlan9 on this host (")
    by_check = machine.findings(edited(machine.folder / "one.yaml", ONE_HOST, ("127.0.0.1", "127.0.0.9")))
    assert "lo has 127.0.0.1 instead of 127.0.0.9" in by_check["interface"].text
    assert by_check["ports"].verdict == "note"
    assert by_check["clock"].text.startswith("not synchronised by any service; install chrony")
    assert by_check["systemd"].verdict == "bad"
    assert by_check["checkout"].text.startswith("/nowhere/swarmabs/scripts/swarm does not exist; ")
    assert by_check["account"].text.startswith("account nobody-here does not exist; create it: useradd")


def test_an_installed_bundle_and_its_checkout_must_be_whole_and_open_to_the_account_of_the_nodes() -> None:
    with TemporaryDirectory(dir="/tmp") as name:  # the folders of tests are closed to others
        folder = Path(name)
        folder.chmod(0o755)
        changes = [("/etc/swarmabs", f"{folder}/etc"), ("/nowhere", f"{folder}/opt"), ("nobody-here", "nobody")]
        output = deployed(load_fleet(edited(folder / "one.yaml", ONE_HOST, *changes)), folder / "out")
        python = folder / "opt" / "swarmabs" / ".venv" / "bin" / "python"
        python.parent.mkdir(parents=True)
        python.symlink_to("/bin/sh")
        (folder / "etc").mkdir()
        bundle = folder / "etc" / "one"

        def examined(name: str = "access") -> tuple[str, str]:
            given = bundle if bundle.exists() else output / "base"
            return next((found.verdict, found.text) for found in check([given], "base") if found.check == name)

        assert examined() == ("note", f"not checked: nothing is installed in {bundle}")
        (output / "base").rename(bundle)
        assert examined() == ("ok", f"nobody can read {bundle}")
        again = "run install.sh of the bundle again"
        closed = {bundle.parent: 0o700, bundle: 0o750, bundle / "dds": 0o744, bundle / "dds" / "robot.xml": 0o600}
        for path, mode in {**closed, folder / "opt": 0o700}.items():
            before = path.stat().st_mode & 0o7777
            path.chmod(mode)
            remedy = again if path in closed else "grant it access, for example with chmod o+rx"
            text = f"nobody has no access to {path} (mode {mode:04o}), so no node starts; {remedy}"
            assert examined() == ("bad", text)
            path.chmod(before)
        (bundle / "units.txt").unlink()
        assert examined() == ("bad", f"{bundle / 'units.txt'}: No such file or directory; {again}")
        changed_manifest(bundle, lambda manifest: manifest["modules"].append("nowhere.node"))
        remedy = "bring this checkout to the fleet's version"
        assert examined("packages") == ("bad", f"nowhere.node cannot be imported; {remedy}")
        swarm = folder / "opt" / "swarmabs" / "scripts" / "swarm"
        swarm.parent.mkdir()
        swarm.touch(mode=0o755)
        assert examined("checkout") == ("ok", f"{folder}/opt/swarmabs")
        python.unlink()
        remedy = "run there: ./scripts/swarm doctor"
        assert examined("checkout") == ("bad", f"{folder}/opt/swarmabs is not set up; {remedy}")


def test_owner_and_groups_of_a_file_decide(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.touch()
    status = file.stat()
    other, group = Reader(status.st_uid + 1, frozenset()), Reader(status.st_uid + 1, frozenset({status.st_gid}))
    for mode, own, of_group, others in ((0o400, 1, 0, 0), (0o070, 0, 1, 0), (0o604, 1, 0, 1)):
        file.chmod(mode)
        assert group.may(file, os.R_OK) == of_group
        assert other.may(file, os.R_OK) == others
        if status.st_uid:
            assert Reader(status.st_uid, frozenset({status.st_gid})).may(file, os.R_OK) == own


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fleet = str(edited(tmp_path / "one.yaml", ONE_HOST))
    output = str(tmp_path / "out")
    assert main(["deploy", fleet, "-o", output, "--json"]) == 0
    made = json.loads(capsys.readouterr().out)
    assert made["bundles"] == [{"host": "base", "address": "127.0.0.1", "folder": f"{output}/base"}]
    assert main(["deploy", "--check", output, "--json"]) == 0
    assert {finding["verdict"] for finding in json.loads(capsys.readouterr().out)} == {"ok", "note"}
    os.truncate(f"{output}/base/units.txt", 3)
    assert main(["deploy", "--check", output]) == 1
    assert "BAD   bundle one/base: " in capsys.readouterr().out
    assert main(["deploy", fleet, "-o", output]) == 2
    assert "is not empty" in capsys.readouterr().err
    for words in ([], [fleet], [fleet, fleet, "-o", output], [fleet, "--host", "a"]):
        assert main(["deploy", *words]) == 2
    assert main(["deploy", "--schema"]) == 0
    captured = capsys.readouterr()
    assert json.loads(captured.out)["title"] == "swarmabs fleet"


def test_permissions_that_end_are_named(tmp_path: Path) -> None:
    text = EXAMPLES["sros2"].read_text(encoding="utf-8")
    fleet = edited(tmp_path / "hall.yaml", text, ("level: sros2", "level: sros2, valid_days: 3"))
    output = deployed(load_fleet(fleet), tmp_path / "out", tmp_path / "keys")
    notes = [finding for finding in check([output / "arm-1"], None) if "valid until" in finding.text]
    assert {finding.verdict for finding in notes} == {"note"}
    assert len(notes) == 2
    # `status` says so of all hosts whose bundles are beside the file, and nothing once they are replaced.
    enclaves = [path.parent.name for path in output.glob("*/keystore/enclaves/hall/*/permissions.xml")]
    found = expiring(load_fleet(output / "fleet.yaml").fleet, output / "fleet.yaml")
    assert len(enclaves) == len(found) == 8
    assert all(sum(f"/{name}/permissions.xml: valid until " in line for line in found) == 1 for name in enclaves)
    renewed = deployed(load_fleet(EXAMPLES["sros2"]), tmp_path / "new", tmp_path / "others")
    assert expiring(load_fleet(renewed / "fleet.yaml").fleet, renewed / "fleet.yaml") == []
