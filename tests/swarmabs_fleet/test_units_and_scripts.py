"""Units as systemd checks them, and scripts as a shell runs them, below DESTDIR."""

import os
import re
import shutil
import stat
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.swarmabs_fleet.fleets import EXAMPLES, contents, deployed, edited, uses_keys

from swarmabs_config.fleet.loader import LoadedFleet, load_fleet
from swarmabs_fleet import own_address
from swarmabs_fleet.host_plan import HostPlan
from swarmabs_fleet.node_files import node_files

SWARM = """\
#!/bin/sh
[ "$1" = env ] || exit 9
printf "export PYTHONPATH='/a b/lib'\\nexport WHO=%s\\n" "${SWARMABS_USE_SOURCED_ROS:-wheels}$FROM_SETUP"
"""


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make what a bundle needs of a checkout and of an installed ROS."""
    folder = tmp_path_factory.mktemp("checkout") / "opt"
    (folder / "scripts").mkdir(parents=True)
    (folder / ".venv" / "bin").mkdir(parents=True)
    (folder / ".venv" / "bin" / "python").symlink_to("/bin/sh")
    (folder / "scripts" / "swarm").write_text(SWARM)
    (folder / "scripts" / "swarm").chmod(0o755)
    (folder / "setup.sh").write_text("export FROM_SETUP=-sourced\n")
    return folder


def here(name: str, checkout: Path, folder: Path, *changes: tuple[str, str]) -> LoadedFleet:
    """Load an example whose hosts find the checkout of these tests; write its file into a folder."""
    text = EXAMPLES[name].read_text(encoding="utf-8")
    lines = f"installation: {{checkout: {checkout}, setup: {checkout}/setup.sh"
    present = "installation: {" in text
    text = text.replace("installation: {", f"{lines}, ") if present else f"{text}{lines}}}\n"
    return load_fleet(edited(folder / f"{name}.yaml", text, *changes))


@pytest.fixture(scope="module")
def made(checkout: Path) -> dict[str, Path]:
    """Bundles of the examples for that checkout by name, to be read only; the keys are in `keys` beside it."""
    place = checkout.parent
    return {
        name: deployed(here(name, checkout, place), place / name, place / "keys" if uses_keys(name) else None)
        for name in EXAMPLES
    }


def start(script: Path, root: Path | str = "", programs: str = "") -> subprocess.CompletedProcess[str]:
    """Start a script below a root, with programs that come before those of this machine."""
    environment = {"PATH": f"{programs}{os.environ['PATH']}", **({"DESTDIR": str(root)} if root else {})}
    return subprocess.run(["sh", script], env=environment, capture_output=True, text=True, check=False, cwd="/")


def install(bundle: Path, root: Path) -> None:
    done = start(bundle / "install.sh", root)
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def floor(made: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A root with the bundle of the tunnel's base in it, to be copied."""
    root = tmp_path_factory.mktemp("floor") / "root"
    install(made["tunnel"] / "base", root)
    return root


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return tmp_path / "root"


@pytest.fixture
def tunnel(made: dict[str, Path], floor: Path, root: Path, tmp_path: Path) -> Path:
    """Return the bundle of the tunnel's base, which is installed below `root`; both are the test's own."""
    shutil.copytree(floor, root)
    return shutil.copytree(made["tunnel"] / "base", tmp_path / "bundle")


def test_systemd_accepts_the_units(made: dict[str, Path], tmp_path: Path) -> None:
    analyze = shutil.which("systemd-analyze")
    if analyze is None:
        pytest.skip("there is no systemd-analyze here")
    found = {unit.name: unit.read_text() for output in made.values() for unit in output.glob("*/systemd/*")}
    assert {f"swarmabs-{name}.target" for name in ("lan", "floor", "hall")} < set(found)
    found["swarmabs-broken.service"] = found["swarmabs-lan-agent_001.service"].replace("Type=notify", "Type=notfiy")
    for name, text in found.items():
        # The interpreter of sros2 is the system's, which need not be there.
        (tmp_path / name).write_text(text.replace("/usr/bin/python3", "/bin/sh"))
    files = [tmp_path / name for name in found]
    done = subprocess.run([analyze, "verify", "--man=no", *files], capture_output=True, text=True, check=False)
    lines = [line for line in done.stderr.splitlines() if "swarmabs" in line]
    # What needs a unit or an account of the host itself cannot be seen here.
    unexpected = [line for line in lines if "wg-quick@" not in line and "not found" not in line]
    assert unexpected and all("swarmabs-broken" in line for line in unexpected)
    assert "notfiy" in unexpected[0]


def test_what_the_units_say(made: dict[str, Path], checkout: Path) -> None:
    output = made["tunnel"]
    unit = (output / "cart-1" / "systemd" / "swarmabs-floor-agent_001.service").read_text()
    assert {
        *("Type=notify", "Restart=on-failure", "WatchdogSec=2", "RestartPreventExitStatus=2", "User=swarmabs"),
        *("NoNewPrivileges=yes", "ProtectSystem=strict", "PrivateTmp=yes", "IPAddressDeny=any"),
        f"ExecStartPre={checkout}/.venv/bin/python -m swarmabs_fleet.own_address 10.83.0.11",
        "IPAddressAllow=localhost 10.83.0.11 10.83.0.1",
        "RestrictNetworkInterfaces=lo floor0",
    } <= set(unit.splitlines())
    assert "wg-quick@floor0.service" in unit
    order = (output / "base" / "units.txt").read_text().split()
    assert order[-2:] == ["swarmabs-floor-parent_controller.service", "swarmabs-floor.target"]
    slow = [path.stem for path in (output / "base" / "systemd").iterdir() if "WatchdogSec=10" in path.read_text()]
    assert slow == ["swarmabs-floor-recorder"]


def test_a_host_restarts_its_standbys_before_its_primaries(checkout: Path, tmp_path: Path) -> None:
    crossed = ("observer: {host: base, standby: spare}", "observer: {host: spare, standby: base}")
    loaded = here("standby", checkout, tmp_path, crossed)
    for host, names in (
        ("base", ("abstraction_observer_standby", "recorder", "parent_controller")),
        ("spare", ("recorder_standby", "parent_controller_standby", "abstraction_observer")),
    ):
        order = node_files(HostPlan(loaded.fleet, host))["units.txt"].split()
        assert order == [*(f"swarmabs-pair-{name}.service" for name in names), "swarmabs-pair.target"]


def test_units_ask_whether_an_address_is_this_hosts(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments, code, words in (
        (["127.0.0.1"], 0, ""),
        (["192.0.2.77"], 1, "192.0.2.77: Cannot assign requested address; is its interface up?"),
        ([], 1, "give one address"),
        (["127.0.0.1", "127.0.0.1"], 1, "give one address"),
    ):
        assert own_address.main(arguments) == code
        error = capsys.readouterr().err
        assert words in error and bool(error) == bool(code)


def test_shells_and_shellcheck_accept_the_scripts(made: dict[str, Path]) -> None:
    together = {name: b"".join(path.read_bytes() for path in made[name].glob("base/*.sh")) for name in made}
    assert [text.count(b"#!/bin/sh") for text in together.values()] == [4] * len(made)
    subprocess.run(["sh", "-n"], input=b"".join(together.values()), check=True)
    shellcheck = shutil.which("shellcheck")
    if shellcheck is None:
        pytest.skip("there is no shellcheck here")
    # All scripts begin with the same names, of which each uses some: none may be used by no script. Together each
    # script has the functions of those before it, too.
    command = [shellcheck, "--severity=warning", "--exclude=SC2218", "--shell=sh", "-"]
    subprocess.run(command, input=together["tunnel"], check=True)


def test_install_twice_and_uninstall(checkout: Path, tmp_path: Path, root: Path) -> None:
    changed = here("tunnel", checkout, tmp_path, ("checkout: ", "prefix: /srv/swarms/bundles, checkout: "))
    bundle = deployed(changed, tmp_path / "out", checkout.parent / "keys") / "base"
    (bundle / "stray.txt").write_text("is not listed, so it is not installed")
    (bundle / "nodes" / "plane_driver.env").chmod(0o666)
    installed = root / "srv" / "swarms" / "bundles" / "floor"
    for _ in range(2):
        install(bundle, root)
        listed, found = contents(bundle), contents(installed)
        del listed["stray.txt"]
        assert found.pop("workspace.env") == b"PYTHONPATH='/a b/lib'\nWHO=wheels\n"
        assert found.pop("complete") == b""
        assert found == listed
    assert stat.S_IMODE((installed / "nodes" / "plane_driver.env").stat().st_mode) == 0o644
    # Everybody may enter the folders on the way, and nobody those of secrets.
    folders = [root, *(path for path in root.rglob("*") if path.is_dir())]
    modes = {str(path.relative_to(root)): stat.S_IMODE(path.stat().st_mode) for path in folders}
    assert {"srv/swarms/bundles/floor", "etc/systemd/system", "etc/wireguard"} < set(modes)
    closed = {path: mode for path, mode in modes.items() if mode != 0o755}
    assert closed == {"etc/wireguard": 0o700, "srv/swarms/bundles/floor/wireguard": 0o700}
    units = {path.name for path in (root / "etc/systemd/system").iterdir()}
    assert units == set((bundle / "units.txt").read_text().split())
    tunnel = root / "etc/wireguard/floor0.conf"
    assert stat.S_IMODE(tunnel.stat().st_mode) == 0o600
    assert tunnel.read_bytes() == (bundle / "wireguard" / "floor0.conf").read_bytes()
    assert start(installed / "uninstall.sh", root).returncode == 0
    assert contents(root) == {}
    assert start(bundle / "uninstall.sh", root).returncode == 1


def test_a_prefix_that_was_made_for_root_alone_is_opened(made: dict[str, Path], root: Path) -> None:
    prefix = root / "etc" / "swarmabs"
    prefix.mkdir(parents=True)
    # There is nothing in it, then a bundle, then what somebody keeps to himself, which is not this script's to open.
    for mode in (0o755, 0o755, 0o700):
        prefix.chmod(0o700)
        if mode == 0o700:
            (prefix / "mine").touch()
        install(made["lan"] / "base", root)
        assert stat.S_IMODE(prefix.stat().st_mode) == mode


ANOTHER = "manifest of another"


@pytest.mark.parametrize(
    ("place", "content"),
    [("floor", "file"), ("floor", ANOTHER), ("floor", "link"), ("floor.new", "file"), ("floor.old", ANOTHER)],
)
def test_a_folder_that_is_no_bundle_of_the_fleet_is_left_alone(
    place: str, content: str, made: dict[str, Path], floor: Path, root: Path, tmp_path: Path
) -> None:
    if place != "floor":
        shutil.copytree(floor, root)
    foreign = root / "etc" / "swarmabs" / place
    if content == "link":
        foreign.parent.mkdir(parents=True)
        foreign.symlink_to(tmp_path / "elsewhere")
    else:
        foreign.mkdir(parents=True)
        name = "sshd_config" if content == "file" else "manifest.json"
        (foreign / name).write_text('{\n  "bundle": 1,\n  "fleet": "floor2",\n  "name": "floor"\n}\n')
    before = contents(root)
    for script in ("install.sh", "uninstall.sh") if content != "link" else ("install.sh",):
        done = start(made["tunnel"] / "base" / script, root)
        assert done.returncode == 1
        assert done.stderr.startswith(f"{script}: {foreign} is not a bundle of floor; move it away")
        assert contents(root) == before
        assert foreign.is_symlink() == (content == "link")


@pytest.mark.parametrize("change", ["renamed", "none", "not ours"])
def test_what_a_new_bundle_has_no_more_is_removed(
    change: str, checkout: Path, tunnel: Path, root: Path, tmp_path: Path
) -> None:
    tunnels, recorder = root / "etc" / "wireguard", root / "etc/systemd/system/swarmabs-floor-recorder.service"
    assert recorder.exists()
    changes = [("interface: floor0", "interface: floor9"), ("  recorder: {host: base}\n", "")]
    if change == "none":
        text = EXAMPLES["tunnel"].read_text(encoding="utf-8")
        changes[0] = ("level: tunnel, interface: floor0, port: 51820", "level: none")
        changes += [(part, "}") for part in re.findall(r", tunnel_address: [0-9.]+}", text)]
    if change == "not ours":
        (tunnels / "floor0.conf").write_text("# mine\n")
    keys = None if change == "none" else checkout.parent / "keys"
    install(deployed(here("tunnel", checkout, tmp_path, *changes), tmp_path / "new", keys) / "base", root)
    assert not recorder.exists()
    expected = {"renamed": {"floor9.conf"}, "none": set(), "not ours": {"floor0.conf", "floor9.conf"}}[change]
    assert {path.name for path in tunnels.iterdir()} == expected
    # A bundle's own script removes what is installed, not what the bundle would.
    assert start(tunnel / "uninstall.sh", root).returncode == 0
    assert {path.name for path in tunnels.iterdir()} == expected - {"floor9.conf"}


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        ("changed", "nodes/recorder.yaml"),
        ("missing", "nodes/recorder.yaml"),
        ("no list", "the bundle is incomplete; copy it again"),
        ("no manifest", "the bundle is incomplete; copy it again"),
        ("not prepared", "is not set up"),
        ("no environment", "./scripts/swarm doctor"),
        ("foreign tunnel", "floor0.conf"),
    ],
)
def test_half_a_bundle_is_refused_and_nothing_is_changed(
    damage: str, words: str, checkout: Path, tunnel: Path, root: Path, tmp_path: Path
) -> None:
    parameters = tunnel / "nodes" / "recorder.yaml"
    away = tmp_path / "away"
    acts: dict[str, Callable[[], object]] = {
        "changed": lambda: parameters.write_text("{}"),
        "missing": parameters.unlink,
        "no list": (tunnel / "SHA256SUMS").unlink,
        "no manifest": (tunnel / "manifest.json").unlink,
        "not prepared": lambda: (checkout / ".venv").rename(away),
        "no environment": lambda: (checkout / "scripts" / "swarm").write_text("#!/bin/sh\nexit 1\n"),
        "foreign tunnel": lambda: (root / "etc/wireguard/floor0.conf").write_text("# mine\n"),
    }
    acts[damage]()
    before = contents(root)
    try:
        done = start(tunnel / "install.sh", root)
    finally:
        (checkout / "scripts" / "swarm").write_text(SWARM)
        if away.exists():
            away.rename(checkout / ".venv")
    last = done.stderr.splitlines()[-1]
    assert done.returncode == 1
    assert last.startswith("install.sh: ") and "; " in last
    assert words in done.stderr
    assert contents(root) == before


def test_an_interrupted_installation_is_mended_and_has_the_environment_of_an_installed_ros(
    made: dict[str, Path], tunnel: Path, root: Path
) -> None:
    installed = root / "etc/swarmabs/floor"
    before = contents(root)
    installed.rename(installed.with_name("floor.old"))
    installed.with_name("floor.new").mkdir()
    install(tunnel, root)
    assert contents(root) == before
    install(made["sros2"] / "arm-1", root)
    installed = root / "etc/swarmabs/hall"
    assert (installed / "workspace.env").read_text() == "PYTHONPATH='/a b/lib'\nWHO=1-sourced\n"
    assert stat.S_IMODE((installed / "keystore/enclaves/hall/agent_001/key.pem").stat().st_mode) == 0o600


def program(path: Path, text: str) -> None:
    path.parent.mkdir(exist_ok=True)
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)


def test_without_root_nothing_is_touched(made: dict[str, Path], tmp_path: Path) -> None:
    program(tmp_path / "programs" / "id", "echo 1000")
    for script in ("install.sh", "uninstall.sh", "restart.sh"):
        done = start(made["lan"] / "base" / script, programs=f"{tmp_path / 'programs'}:")
        assert (done.returncode, done.stderr) == (1, f"{script}: root is required; run it with sudo\n")
    assert not Path("/etc/swarmabs").exists()


@pytest.mark.parametrize("failing", ["", "swarmabs-floor-plane_driver.service"])
def test_nodes_are_restarted_one_by_one_and_a_failure_ends_it(failing: str, checkout: Path, tmp_path: Path) -> None:
    prefix = tmp_path / "prefix"
    changed = here("tunnel", checkout, tmp_path, ("checkout: ", f"prefix: {prefix}, checkout: "))
    output = deployed(changed, tmp_path / "out", checkout.parent / "keys")
    prefix.mkdir()
    installed = (output / "base").rename(prefix / "floor")
    programs, log = tmp_path / "programs", tmp_path / "log"
    program(programs / "id", "echo 0")
    program(programs / "systemctl", f'echo "$*" >>{log}\n[ "$3" != "{failing}" ]')
    assert "is incomplete; run install.sh again" in start(installed / "restart.sh", programs=f"{programs}:").stderr
    assert not log.exists()
    (installed / "complete").touch()
    done = start(installed / "restart.sh", programs=f"{programs}:")
    calls = log.read_text().splitlines()
    restarted = [call.rpartition("-floor-")[2].partition(".")[0] for call in calls if call.startswith("restart")]
    if failing:
        assert restarted == ["plane_driver"]
        assert (done.returncode, "journalctl -u" in done.stderr) == (1, True)
    else:
        assert restarted == ["plane_driver", "abstraction_observer", "recorder", "parent_controller"]
        assert calls[1] == "is-active --quiet -- swarmabs-floor-plane_driver.service"
        assert (done.returncode, calls[-1]) == (0, "start -- swarmabs-floor.target")
