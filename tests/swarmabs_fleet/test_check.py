"""`deploy --check`: fleets side by side, bundles against their manifests, and this machine as a host."""

from __future__ import annotations

import json
import os
import socket
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from tests.swarmabs_fleet.fleets import EXAMPLES, ONE_HOST, deployed, edited, example

from swarmabs_cli import main
from swarmabs_config.fleet.loader import load_fleet
from swarmabs_core.errors import InputError
from swarmabs_fleet.check import check
from swarmabs_fleet.host_check import Reader, read_chrony, read_pmc, read_timedatectl
from swarmabs_run.doctor import Finding
from swarmabs_run.orchestration.network import claimed_domain


def bad(findings: list[Finding]) -> list[str]:
    return [finding.text for finding in findings if finding.verdict == "bad"]


def test_what_deploy_has_written_is_fine(tmp_path: Path) -> None:
    for name in EXAMPLES:
        deployed(example(name), tmp_path / name, None if name == "lan" else tmp_path / "keys")
    findings = check([tmp_path / name for name in EXAMPLES] + list(EXAMPLES.values()), None)
    assert bad(findings) == []
    assert sum(finding.text.startswith("they do not get") for finding in findings) == 3


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        ("changed", "agent_001.yaml has been changed; copy or install"),
        ("missing", "agent_001.yaml: No such file or directory; copy or install"),
        ("mode", "floor0.conf has the mode 0644, not 0600; chmod 0600"),
        ("stray", "authorized_keys does not belong there; remove it"),
        ("version", "made with AgentState RIHS01_0, here is RIHS01_"),
    ],
)
def test_a_bundle_that_is_not_as_it_was_made(damage: str, words: str, tmp_path: Path) -> None:
    bundle = deployed(example("tunnel"), tmp_path / "out", tmp_path / "keys") / "cart-1"
    parameters = bundle / "nodes" / "agent_001.yaml"
    if damage == "changed":
        parameters.write_text(parameters.read_text().replace("mass: 0.45", "mass: 4.5"))
    elif damage == "missing":
        parameters.unlink()
    elif damage == "mode":
        (bundle / "wireguard" / "floor0.conf").chmod(0o644)
    elif damage == "stray":
        (bundle / "nodes" / "authorized_keys").write_text("")
    else:
        manifest = json.loads((bundle / "manifest.json").read_text())
        manifest["versions"]["AgentState"] = "RIHS01_0"
        (bundle / "manifest.json").write_text(json.dumps(manifest))
    (text,) = bad(check([bundle], None))
    assert words in text and "; " in text


def test_bundles_that_this_version_would_make_otherwise_are_noted(tmp_path: Path) -> None:
    output = deployed(example("lan"), tmp_path / "out")
    text = (output / "fleet.yaml").read_text().replace("mass: 0.3552", "mass: 0.4")
    (output / "fleet.yaml").write_text(text)
    notes = [finding.text for finding in check([output], None) if finding.check == "bundle lan/robot-1"]
    assert "this version makes another nodes/agent_001.yaml; deploy again if that is wanted" in notes


def test_fleets_that_get_into_each_others_way(tmp_path: Path) -> None:
    tunnel = EXAMPLES["tunnel"].read_text(encoding="utf-8")
    second = edited(tmp_path / "second.yaml", tunnel, ("name: floor", "name: other"), ("10.83.0.", "10.84.0."))
    texts = bad(check([EXAMPLES["tunnel"], second], None))
    assert len(texts) == 3
    for text, words in zip(
        texts, ("ROS domain 41", "tunnel floor0 on 10.20.0.5", "port 51820 on 10.20.0.5"), strict=True
    ):
        assert words in text
    apart = edited(
        tmp_path / "apart.yaml",
        second.read_text(encoding="utf-8"),
        ("domain: 41", "domain: 43"),
        ("interface: floor0, port: 51820", "interface: other0, port: 51821"),
    )
    assert bad(check([EXAMPLES["tunnel"], apart], None)) == []


@pytest.mark.parametrize(
    ("path", "host", "words"),
    [
        ("lan", "robot-9", "did you mean 'robot-"),
        ("empty", None, "holds no bundle"),
        ("nothing.yaml", None, "no such file"),
    ],
)
def test_what_cannot_be_checked_is_refused(path: str, host: str | None, words: str, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=words):
        check([EXAMPLES.get(path, tmp_path / path)], host)


@pytest.mark.parametrize("text", ["{", "[]", '{"bundle": 1}', '{"bundle": 2}', "[" * 100_000])
def test_a_manifest_that_is_none_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "manifest.json").write_text(text)
    with pytest.raises(InputError, match=r"no manifest of a bundle|update swarmabs"):
        check([tmp_path], None)


def test_a_manifest_cannot_name_files_outside(tmp_path: Path) -> None:
    bundle = deployed(example("lan"), tmp_path / "out") / "robot-1"
    manifest = json.loads((bundle / "manifest.json").read_text())
    manifest["files"]["../../secret"] = {"sha256": "0", "mode": "0644"}
    (bundle / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(InputError, match="not in the bundle"):
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
    state = read_chrony(CHRONY.format(offset="-0.000250", leap="Normal"))
    assert state is not None and state.synchronised
    assert state.bound == pytest.approx(0.00025 + 0.0003 + 0.0006)  # offset, dispersion, half the delay
    state = read_chrony(CHRONY.format(offset="0.0", leap="Not synchronised"))
    assert state is not None and not state.synchronised
    assert read_chrony("506 Cannot talk to daemon\n") is None
    state = read_pmc(PMC.format(present="true"))
    assert state is not None and state.synchronised and state.bound == pytest.approx(1.75e-6)
    state = read_pmc(PMC.format(present="false"))
    assert state is not None and not state.synchronised
    assert read_pmc("sending: GET TIME_STATUS_NP\n") is None
    assert [read_timedatectl(text) for text in ("", "nonsense\n")] == [None, None]
    assert [getattr(read_timedatectl(text), "synchronised", None) for text in ("yes\n", "no\n")] == [True, False]


class Machine:
    """This machine as the host of a fleet, with programs of the test's own."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.folder = folder
        (folder / "bin").mkdir()
        monkeypatch.setenv("PATH", str(folder / "bin"))

    def program(self, name: str, text: str) -> None:
        path = self.folder / "bin" / name
        path.write_text(f"#!/bin/sh\ncat <<'END'\n{text.rstrip()}\nEND\n".replace("cat ", "/bin/cat "))
        path.chmod(0o755)

    def findings(self, fleet: Path) -> dict[str, Finding]:
        return {finding.check: finding for finding in check([fleet], "base")}


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Machine:
    return Machine(tmp_path, monkeypatch)


def test_the_machine_is_examined(machine: Machine) -> None:
    with claimed_domain() as domain:
        fleet = edited(machine.folder / "one.yaml", ONE_HOST, ("domain: 7", f"domain: {domain}"))
        machine.program("chronyc", CHRONY.format(offset="0.001", leap="Normal"))
        machine.program("systemctl", "systemd 255 (255.4)")
        found = machine.findings(fleet)
        assert [found[name].verdict for name in ("interface", "ports", "clock", "systemd")] == ["ok"] * 4
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            other.bind(("127.0.0.1", 7000 + 100 * domain + 10 + 2 * 9))  # the second robot's
            assert machine.findings(fleet)["ports"].verdict == "bad"
            assert f"UDP {other.getsockname()[1]} " in machine.findings(fleet)["ports"].text
            machine.program("systemctl", "active")
            assert machine.findings(fleet)["ports"].verdict == "note"


@pytest.mark.parametrize(
    ("chrony", "verdict", "words"),
    [
        (CHRONY.format(offset="0.0", leap="Normal"), "ok", "at most 0.000900 s by chrony"),
        (CHRONY.format(offset="-0.0049", leap="Normal"), "bad", "more than time.max_offset 0.005 s"),
        (CHRONY.format(offset="0.0", leap="Not synchronised"), "bad", "is not synchronised"),
        ("506 Cannot talk to daemon", "note", "not how well"),
        (None, "note", "not how well"),
    ],
)
def test_the_clock_of_the_machine(chrony: str | None, verdict: str, words: str, machine: Machine) -> None:
    machine.program("timedatectl", "yes")
    if chrony is not None:
        machine.program("chronyc", chrony)
    finding = machine.findings(edited(machine.folder / "one.yaml", ONE_HOST))["clock"]
    assert (finding.verdict, words in finding.text) == (verdict, True), finding


def test_a_machine_that_is_not_the_host(machine: Machine) -> None:
    found = machine.findings(edited(machine.folder / "one.yaml", ONE_HOST, ("interface: lo", "interface: wlan9")))
    assert found["interface"].text.startswith("there is no wlan9 here (")
    found = machine.findings(edited(machine.folder / "one.yaml", ONE_HOST, ("127.0.0.1", "127.0.0.9")))
    assert "lo has not the address 127.0.0.9 but 127.0.0.1" in found["interface"].text
    assert found["ports"].verdict == "note"
    assert found["clock"].text.startswith("nothing synchronises it; install chrony")
    assert found["systemd"].verdict == "bad"
    assert found["checkout"].text.startswith("there is no /nowhere/swarmabs/scripts/swarm; ")
    assert found["account"].text.startswith("there is no nobody-here; make it: useradd")


class Installed:
    """The bundle of a fleet of one host, installed where everybody may enter, for an account of this machine."""

    def __init__(self, folder: Path, account: str) -> None:
        folder.chmod(0o755)
        self.folder = folder
        changes = [("/etc/swarmabs", f"{folder}/etc"), ("/nowhere", f"{folder}/opt"), ("nobody-here", account)]
        fleet = edited(folder / "one.yaml", ONE_HOST, *changes)
        output = deployed(load_fleet(fleet), folder / "out")
        (folder / "etc").mkdir()
        self.bundle = (output / "base").rename(folder / "etc" / "one")
        self.python = folder / "opt" / "swarmabs" / ".venv" / "bin" / "python"
        self.python.parent.mkdir(parents=True)
        self.python.symlink_to("/bin/sh")

    def access(self) -> Finding:
        return {finding.check: finding for finding in check([self.bundle], "base")}["access"]


@pytest.fixture
def installed() -> Iterator[Installed]:
    with TemporaryDirectory(dir="/tmp") as folder:  # the folders of tests are closed to others
        yield Installed(Path(folder), "nobody")


def test_the_account_of_the_nodes_must_be_able_to_read_its_bundle(installed: Installed) -> None:
    assert installed.access() == Finding("access", "ok", f"nobody can read {installed.bundle}")
    for path, mode, remedy in (
        (installed.bundle.parent, 0o700, "start install.sh of the bundle again"),
        (installed.bundle, 0o750, "start install.sh of the bundle again"),
        (installed.bundle / "dds", 0o744, "start install.sh of the bundle again"),
        (installed.bundle / "dds" / "robot.xml", 0o600, "start install.sh of the bundle again"),
        (installed.folder / "opt", 0o700, "let others enter it"),
    ):
        before = path.stat().st_mode & 0o7777
        path.chmod(mode)
        text = f"nobody has no access to {path} (mode {mode:04o}), so no node starts; {remedy}"
        assert installed.access() == Finding("access", "bad", text)
        path.chmod(before)
    assert installed.access().verdict == "ok"


def test_what_is_not_installed_is_not_looked_at(installed: Installed) -> None:
    installed.bundle = installed.bundle.rename(installed.folder / "elsewhere")
    finding = installed.access()
    assert (finding.verdict, "nothing is installed in" in finding.text) == ("note", True)


def test_owner_and_groups_of_a_file_decide(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.touch()
    found = file.stat()
    other, group = Reader(found.st_uid + 1, frozenset()), Reader(found.st_uid + 1, frozenset({found.st_gid}))
    for mode, own, of_group, others in (
        (0o400, True, False, False),
        (0o070, False, True, False),
        (0o604, True, False, True),
    ):
        file.chmod(mode)
        assert group.may(file, os.R_OK) == of_group
        assert other.may(file, os.R_OK) == others
        if found.st_uid:
            assert Reader(found.st_uid, frozenset({found.st_gid})).may(file, os.R_OK) == own


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
    for words in (
        ["deploy"],
        ["deploy", fleet],
        ["deploy", fleet, fleet, "-o", output],
        ["deploy", fleet, "--host", "a"],
    ):
        assert main(words) == 2
    assert main(["deploy", "--schema"]) == 0
    captured = capsys.readouterr()
    assert json.loads(captured.out)["title"] == "swarmabs fleet"


def test_permissions_that_end_are_named(tmp_path: Path) -> None:
    fleet = edited(
        tmp_path / "hall.yaml",
        EXAMPLES["sros2"].read_text(encoding="utf-8"),
        ("level: sros2", "level: sros2, valid_days: 3"),
    )
    output = deployed(load_fleet(fleet), tmp_path / "out", tmp_path / "keys")
    notes = [finding for finding in check([output / "arm-1"], None) if "valid until" in finding.text]
    assert {finding.verdict for finding in notes} == {"note"}
    assert len(notes) == 2
