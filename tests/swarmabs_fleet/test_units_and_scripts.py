"""Units as systemd checks them, and scripts as a shell runs them, below DESTDIR."""

from __future__ import annotations

import os
import re
import shutil
import stat
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from tests.swarmabs_fleet.fleets import EXAMPLES, contents, deployed, edited

from swarmabs_config.fleet.loader import LoadedFleet, load_fleet

SWARM = """\
#!/bin/sh
[ "$1" = env ] || exit 9
printf "export PYTHONPATH='/a b/lib'\\nexport WHO=%s\\n" "${SWARMABS_USE_SOURCED_ROS:-wheels}$FROM_SETUP"
"""


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """Make what a bundle needs of a checkout and of an installed ROS."""
    folder = tmp_path / "opt"
    (folder / "scripts").mkdir(parents=True)
    (folder / ".venv" / "bin").mkdir(parents=True)
    (folder / ".venv" / "bin" / "python").symlink_to("/bin/sh")
    (folder / "scripts" / "swarm").write_text(SWARM)
    (folder / "scripts" / "swarm").chmod(0o755)
    (folder / "setup.sh").write_text("export FROM_SETUP=-sourced\n")
    return folder


def here(name: str, checkout: Path, *changes: tuple[str, str]) -> LoadedFleet:
    """Load an example whose hosts find the checkout of a test."""
    text = EXAMPLES[name].read_text(encoding="utf-8")
    lines = f"checkout: {checkout}, setup: {checkout}/setup.sh"
    if "installation: {" in text:
        text = text.replace("installation: {", f"installation: {{{lines}, ")
    else:
        text += f"installation: {{{lines}}}\n"
    return load_fleet(edited(checkout.parent / f"{name}.yaml", text, *changes))


def bundles(name: str, checkout: Path) -> Path:
    keys = None if name == "lan" else checkout.parent / "keys"
    return deployed(here(name, checkout), checkout.parent / f"{name}-bundles", keys)


def start(script: Path, root: Path) -> subprocess.CompletedProcess[str]:
    environment = {"PATH": os.environ["PATH"], "DESTDIR": str(root)}
    return subprocess.run(["sh", script], env=environment, capture_output=True, text=True, check=False, cwd="/")


@pytest.mark.parametrize("name", EXAMPLES)
def test_systemd_accepts_the_units(name: str, checkout: Path) -> None:
    analyze = shutil.which("systemd-analyze")
    if analyze is None:
        pytest.skip("there is no systemd-analyze here")
    output = bundles(name, checkout)
    if name == "sros2":  # its interpreter is the system's, which need not be there
        for unit in output.rglob("*.service"):
            unit.write_text(unit.read_text().replace("/usr/bin/python3", "/bin/sh"))
    for folder in sorted(output.glob("*/systemd")):
        files = sorted(folder.iterdir())
        assert any(file.suffix == ".target" for file in files)
        done = subprocess.run([analyze, "verify", "--man=no", *files], capture_output=True, text=True, check=False)
        own = [line for line in done.stderr.splitlines() if "swarmabs" in line]
        # What needs a unit or an account of the host itself cannot be seen here.
        unexpected = [line for line in own if "wg-quick@" not in line and "not found" not in line]
        assert not unexpected
    broken = files[0]
    broken.write_text(broken.read_text().replace("Type=notify", "Type=notfiy"))
    done = subprocess.run([analyze, "verify", "--man=no", broken], capture_output=True, text=True, check=False)
    assert "notfiy" in done.stderr


def test_what_the_units_say(checkout: Path) -> None:
    output = bundles("tunnel", checkout)
    unit = (output / "cart-1" / "systemd" / "swarmabs-floor-agent_001.service").read_text()
    lines = unit.splitlines()
    for line in (
        "Type=notify",
        "Restart=on-failure",
        "WatchdogSec=2",
        "RestartPreventExitStatus=2",
        "User=swarmabs",
        "NoNewPrivileges=yes",
        "ProtectSystem=strict",
        "PrivateTmp=yes",
        f"ExecStartPre={checkout}/.venv/bin/python -m swarmabs_fleet.own_address 10.83.0.11",
        "IPAddressDeny=any",
        "IPAddressAllow=localhost 10.83.0.11 10.83.0.1",
        "RestrictNetworkInterfaces=lo floor0",
    ):
        assert line in lines
    assert "wg-quick@floor0.service" in unit
    order = (output / "base" / "units.txt").read_text().split()
    assert order[-2:] == ["swarmabs-floor-parent_controller.service", "swarmabs-floor.target"]


@pytest.mark.parametrize("name", EXAMPLES)
def test_shells_accept_the_scripts(name: str, checkout: Path) -> None:
    files = sorted(bundles(name, checkout).glob("*/*.sh"))
    assert len(files) >= 9
    for file in files:
        subprocess.run(["sh", "-n", file], check=True)


def test_shellcheck_accepts_the_scripts(checkout: Path) -> None:
    shellcheck = shutil.which("shellcheck")
    if shellcheck is None:
        pytest.skip("there is no shellcheck here")
    files = sorted(bundles("tunnel", checkout).glob("base/*.sh"))
    # All scripts begin with the same names, of which each uses some: none may be used by no script.
    together = b"".join(file.read_bytes() for file in files)
    subprocess.run([shellcheck, "--include=SC2034", "--shell=sh", "-"], input=together, check=True)
    subprocess.run([shellcheck, "--severity=warning", "--exclude=SC2034", *files], check=True)


def test_install_twice_and_uninstall(checkout: Path, tmp_path: Path) -> None:
    bundle, root = bundles("tunnel", checkout) / "base", tmp_path / "root"
    (bundle / "stray.txt").write_text("is not listed, so it is not installed")
    (bundle / "nodes" / "plane_driver.env").chmod(0o666)
    for _ in range(2):
        done = start(bundle / "install.sh", root)
        assert done.returncode == 0, done.stderr
        installed = root / "etc" / "swarmabs" / "floor"
        listed = contents(bundle)
        del listed["stray.txt"]
        found = contents(installed)
        assert found.pop("workspace.env") == b"PYTHONPATH='/a b/lib'\nWHO=wheels\n"
        assert found.pop("complete") == b""
        assert found == listed
    assert stat.S_IMODE((installed / "nodes" / "plane_driver.env").stat().st_mode) == 0o644
    assert stat.S_IMODE((installed / "wireguard").stat().st_mode) == 0o700
    units = {path.name for path in (root / "etc/systemd/system").iterdir()}
    assert units == set((bundle / "units.txt").read_text().split())
    tunnel = root / "etc/wireguard/floor0.conf"
    assert stat.S_IMODE(tunnel.stat().st_mode) == 0o600
    assert tunnel.read_bytes() == (bundle / "wireguard" / "floor0.conf").read_bytes()
    assert start(installed / "uninstall.sh", root).returncode == 0
    assert contents(root) == {}
    assert start(bundle / "uninstall.sh", root).returncode == 1


def modes(folder: Path) -> dict[str, int]:
    """Return the modes of a folder and of the folders below it, by path."""
    found = [folder, *(path for path in sorted(folder.rglob("*")) if path.is_dir())]
    return {str(path.relative_to(folder)): stat.S_IMODE(path.stat().st_mode) for path in found}


def test_everybody_may_enter_the_folders_on_the_way_and_nobody_those_of_secrets(checkout: Path, tmp_path: Path) -> None:
    changed = here("tunnel", checkout, ("checkout: ", "prefix: /srv/swarms/bundles, checkout: "))
    bundle, root = deployed(changed, tmp_path / "out", tmp_path / "keys") / "base", tmp_path / "root"
    assert start(bundle / "install.sh", root).returncode == 0
    found = modes(root)
    assert {"srv/swarms/bundles/floor", "etc/systemd/system", "etc/wireguard"} < set(found)
    closed = {path for path, mode in found.items() if mode != 0o755}
    assert closed == {"etc/wireguard", "srv/swarms/bundles/floor/wireguard"}
    assert {found[path] for path in closed} == {0o700}


@pytest.mark.parametrize("content", ["nothing", "a bundle", "something else"])
def test_a_prefix_that_was_made_for_root_alone_is_opened(content: str, checkout: Path, tmp_path: Path) -> None:
    bundle, root = bundles("lan", checkout) / "base", tmp_path / "root"
    prefix = root / "etc" / "swarmabs"
    if content == "a bundle":
        assert start(bundle / "install.sh", root).returncode == 0
    else:
        prefix.mkdir(parents=True)
    if content == "something else":
        (prefix / "mine").touch()
    prefix.chmod(0o700)
    assert start(bundle / "install.sh", root).returncode == 0
    # What somebody keeps to himself with other things in it is not this script's to open.
    assert stat.S_IMODE(prefix.stat().st_mode) == (0o700 if content == "something else" else 0o755)


@pytest.mark.parametrize("name", ["lan", "tunnel"])
def test_another_account_can_read_what_nodes_need(name: str, checkout: Path) -> None:
    setpriv = shutil.which("setpriv")
    if os.geteuid() or setpriv is None:
        pytest.skip("only root can try as another account, by setpriv")
    bundle = bundles(name, checkout) / "base"
    with TemporaryDirectory(dir="/tmp") as folder:  # the folders of tests are closed to others
        Path(folder).chmod(0o755)
        assert start(bundle / "install.sh", Path(folder)).returncode == 0
        installed = Path(folder) / "etc" / "swarmabs" / ("floor" if name == "tunnel" else name)
        needed = [path for path in contents(installed) if not path.startswith("wireguard/")]
        assert {"nodes/parent_controller.yaml", "dds/coordinator.xml", "scenario.yaml"} < set(needed)
        nobody = [setpriv, "--reuid=65534", "--regid=65534", "--clear-groups", "--"]
        command = [*nobody, "cat", *(installed / path for path in needed)]
        done = subprocess.run(command, capture_output=True, check=False)
        assert (done.returncode, done.stderr) == (0, b"")
        if name == "tunnel":
            command = [*nobody, "cat", installed / "wireguard" / "floor0.conf"]
            assert b"Permission denied" in subprocess.run(command, capture_output=True, check=False).stderr


@pytest.mark.parametrize("place", ["floor", "floor.new", "floor.old"])
@pytest.mark.parametrize("content", ["file", "manifest of another", "link"])
def test_a_folder_that_is_no_bundle_of_the_fleet_is_left_alone(
    place: str, content: str, checkout: Path, tmp_path: Path
) -> None:
    bundle, root = bundles("tunnel", checkout) / "base", tmp_path / "root"
    foreign = root / "etc" / "swarmabs" / place
    if content == "link":
        foreign.parent.mkdir(parents=True)
        foreign.symlink_to(tmp_path / "elsewhere")
    else:
        foreign.mkdir(parents=True)
        name = "sshd_config" if content == "file" else "manifest.json"
        (foreign / name).write_text('{\n  "bundle": 1,\n  "fleet": "floor2",\n  "name": "floor"\n}\n')
    before = contents(root)
    scripts = ["install.sh", "uninstall.sh"] if foreign.is_dir() and place == "floor" else ["install.sh"]
    for script in scripts:
        done = start(bundle / script, root)
        assert done.returncode == 1
        assert done.stderr.startswith(f"{script}: {foreign} is no bundle of floor, so it stays as it is; move it away")
        assert contents(root) == before
        assert foreign.is_symlink() == (content == "link")


@pytest.mark.parametrize("place", [".new", ".old"])
def test_uninstalling_leaves_alone_what_stands_beside(place: str, checkout: Path, tmp_path: Path) -> None:
    bundle, root = bundles("lan", checkout) / "base", tmp_path / "root"
    assert start(bundle / "install.sh", root).returncode == 0
    beside = root / "etc" / "swarmabs" / f"lan{place}"
    beside.mkdir()
    (beside / "mine").touch()
    before = contents(root)
    done = start(root / "etc/swarmabs/lan/uninstall.sh", root)
    assert (done.returncode, "is no bundle of lan" in done.stderr) == (1, True)
    assert contents(root) == before


@pytest.mark.parametrize("change", ["renamed", "none", "not ours"])
def test_a_tunnel_that_a_new_bundle_has_no_more_is_removed(change: str, checkout: Path, tmp_path: Path) -> None:
    root = tmp_path / "root"
    assert start(bundles("tunnel", checkout) / "base" / "install.sh", root).returncode == 0
    tunnels = root / "etc" / "wireguard"
    text = EXAMPLES["tunnel"].read_text(encoding="utf-8")
    if change == "none":
        changes = [("level: tunnel, interface: floor0, port: 51820", "level: none")]
        changes += [(part, "}") for part in re.findall(r", tunnel_address: [0-9.]+}", text)]
    else:
        changes = [("interface: floor0", "interface: floor9")]
    if change == "not ours":
        (tunnels / "floor0.conf").write_text("# mine\n")
    keys = None if change == "none" else tmp_path / "keys"
    output = deployed(here("tunnel", checkout, *changes), tmp_path / "new", keys)
    done = start(output / "base" / "install.sh", root)
    assert done.returncode == 0, done.stderr
    expected = {"renamed": {"floor9.conf"}, "none": set(), "not ours": {"floor0.conf", "floor9.conf"}}[change]
    assert {path.name for path in tunnels.iterdir()} == expected
    # A bundle's own script removes what is installed, not what the bundle would.
    assert start(checkout.parent / "tunnel-bundles" / "base" / "uninstall.sh", root).returncode == 0
    assert {path.name for path in tunnels.iterdir()} == expected - {"floor9.conf"}


def test_the_environment_of_an_installed_ros(checkout: Path, tmp_path: Path) -> None:
    bundle, root = bundles("sros2", checkout) / "arm-1", tmp_path / "root"
    assert start(bundle / "install.sh", root).returncode == 0
    installed = root / "etc/swarmabs/hall"
    assert (installed / "workspace.env").read_text() == "PYTHONPATH='/a b/lib'\nWHO=1-sourced\n"
    assert stat.S_IMODE((installed / "keystore/enclaves/hall/agent_001/key.pem").stat().st_mode) == 0o600


def test_units_that_a_new_bundle_has_no_more_are_removed(checkout: Path, tmp_path: Path) -> None:
    root = tmp_path / "root"
    assert start(bundles("tunnel", checkout) / "base" / "install.sh", root).returncode == 0
    recorder = root / "etc/systemd/system/swarmabs-floor-recorder.service"
    assert recorder.exists()
    fewer = here("tunnel", checkout, ("  recorder: {host: base}\n", ""))
    output = deployed(fewer, tmp_path / "fewer", tmp_path / "keys")
    assert start(output / "base" / "install.sh", root).returncode == 0
    assert not recorder.exists()


@pytest.mark.parametrize("damage", ["changed", "missing", "no list", "no manifest", "not prepared", "foreign tunnel"])
def test_half_a_bundle_is_refused_and_nothing_is_changed(damage: str, checkout: Path, tmp_path: Path) -> None:
    bundle, root = bundles("tunnel", checkout) / "base", tmp_path / "root"
    assert start(bundle / "install.sh", root).returncode == 0
    if damage == "changed":
        (bundle / "nodes" / "recorder.yaml").write_text("{}")
    elif damage == "missing":
        (bundle / "nodes" / "recorder.yaml").unlink()
    elif damage == "no list":
        (bundle / "SHA256SUMS").unlink()
    elif damage == "no manifest":
        (bundle / "manifest.json").unlink()
    elif damage == "not prepared":
        (checkout / ".venv" / "bin" / "python").unlink()
    else:
        (root / "etc/wireguard/floor0.conf").write_text("# mine\n")
    before = contents(root)
    done = start(bundle / "install.sh", root)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].startswith("install.sh: ") and "; " in done.stderr
    assert contents(root) == before


def test_an_environment_that_cannot_be_had_changes_nothing(checkout: Path, tmp_path: Path) -> None:
    bundle, root = bundles("lan", checkout) / "base", tmp_path / "root"
    assert start(bundle / "install.sh", root).returncode == 0
    before = contents(root)
    (checkout / "scripts" / "swarm").write_text("#!/bin/sh\nexit 1\n")
    done = start(bundle / "install.sh", root)
    assert done.returncode == 1
    assert "./scripts/swarm doctor" in done.stderr
    assert contents(root) == before


def test_an_installation_that_was_interrupted_between_its_renamings_is_mended(checkout: Path, tmp_path: Path) -> None:
    bundle, root = bundles("lan", checkout) / "base", tmp_path / "root"
    assert start(bundle / "install.sh", root).returncode == 0
    installed = root / "etc/swarmabs/lan"
    before = contents(root)
    installed.rename(installed.with_name("lan.old"))
    (root / "etc/swarmabs/lan.new").mkdir()
    assert start(bundle / "install.sh", root).returncode == 0
    assert contents(root) == before


def test_without_root_nothing_is_touched(checkout: Path, tmp_path: Path) -> None:
    bundle = bundles("lan", checkout) / "base"
    somebody = tmp_path / "programs" / "id"
    somebody.parent.mkdir()
    somebody.write_text("#!/bin/sh\necho 1000\n")
    somebody.chmod(0o755)
    environment = {"PATH": f"{somebody.parent}:{os.environ['PATH']}"}
    for script in ("install.sh", "uninstall.sh", "restart.sh"):
        done = subprocess.run(
            ["sh", bundle / script], env=environment, capture_output=True, text=True, check=False, cwd="/"
        )
        assert (done.returncode, done.stderr) == (1, f"{script}: this needs root; start it with sudo\n")
    assert not Path("/etc/swarmabs").exists()


@pytest.mark.parametrize("failing", ["", "swarmabs-floor-plane_driver.service"])
def test_nodes_are_restarted_one_by_one_and_a_failure_ends_it(failing: str, checkout: Path, tmp_path: Path) -> None:
    prefix = tmp_path / "prefix"
    text = EXAMPLES["tunnel"].read_text(encoding="utf-8") + f"installation: {{prefix: {prefix}}}\n"
    output = deployed(load_fleet(edited(tmp_path / "f.yaml", text)), tmp_path / "out", tmp_path / "keys")
    prefix.mkdir()
    installed = (output / "base").rename(prefix / "floor")
    programs, log = tmp_path / "programs", tmp_path / "log"
    programs.mkdir()
    (programs / "id").write_text("#!/bin/sh\necho 0\n")
    (programs / "systemctl").write_text(f'#!/bin/sh\necho "$*" >>{log}\n[ "$3" != "{failing}" ]\n')
    for program in programs.iterdir():
        program.chmod(0o755)
    command = ["sh", installed / "restart.sh"]
    environment = {"PATH": f"{programs}:{os.environ['PATH']}"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert "is not complete; start install.sh again" in done.stderr
    assert not log.exists()
    (installed / "complete").touch()
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    calls = log.read_text().splitlines()
    restarted = [call.rpartition("-floor-")[2].partition(".")[0] for call in calls if call.startswith("restart")]
    if failing:
        assert restarted == ["plane_driver"]
        assert (done.returncode, "journalctl -u" in done.stderr) == (1, True)
    else:
        assert restarted == ["plane_driver", "abstraction_observer", "recorder", "parent_controller"]
        assert calls[1] == "is-active --quiet -- swarmabs-floor-plane_driver.service"
        assert (done.returncode, calls[-1]) == (0, "start -- swarmabs-floor.target")
