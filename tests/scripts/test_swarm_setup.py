"""The set-up: what it chooses, what it does again and what not, and how it fails."""

import json
import os
import platform
import shutil
import signal
import stat
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest.mock import Mock

import click
import pytest
from tests.processes import ROOT, until

from swarmabs_cli.develop import checkout as develop

sys.path.insert(0, str(ROOT / "scripts"))

from _setup import children, environment, machine, stages, state
from _setup.checkout import Checkout
from _setup.report import FAILED, UNSUITABLE, SetupError

SCRIPTS = ROOT / "scripts"
NO_LOCK = 2  # stderr, as good as any descriptor where no lock is wanted
PLACES = ("/co/.venv", "/co/install", "3.12")


@pytest.fixture(scope="session")
def swarm() -> ModuleType:
    """The script, which has no suffix, as a module."""
    loader = SourceFileLoader("swarm_script", str(SCRIPTS / "swarm"))
    spec = spec_from_loader(loader.name, loader)
    assert spec is not None
    module = module_from_spec(spec)
    loader.exec_module(module)
    return module


@pytest.fixture
def checkout(tmp_path: Path) -> Checkout:
    """A checkout with two Python packages, one message package, and locks, nothing of it prepared."""
    for name in ("alpha", "beta", "gamma_msgs"):
        folder = tmp_path / "src" / name
        folder.mkdir(parents=True)
        (folder / "package.xml").write_text(f"<package><name>{name}</name></package>")
        (folder / "code.py").write_text("VALUE = 1\n")
    (tmp_path / "src" / "gamma_msgs" / "CMakeLists.txt").write_text("project(gamma_msgs)\n")
    locks = tmp_path / "scripts" / "requirements"
    locks.mkdir(parents=True)
    for name in (*stages.LOCKS, *stages.EXTRA_LOCKS.values()):
        entry = f"{Path(name).stem}-part==1.0 \\\n    --hash=sha256:00\nsetuptools==79.0.1 \\\n    --hash=sha256:11\n"
        (locks / name).write_text(entry)
    return Checkout(str(tmp_path))


def write_command(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path


def fake_python(folder: Path, version: str, *missing: str, implementation: str = "cpython") -> Path:
    path = folder / f"python{version.rsplit('.', 1)[0]}"
    facts = {"path": str(path), "version": version, "implementation": implementation, "missing": missing}
    return write_command(path, f"echo '{json.dumps(facts)}'")


class TestInterpreter:
    @pytest.fixture(autouse=True)
    def only_path(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(machine, "INSTALL_FOLDERS", ())

    @pytest.mark.parametrize(
        ("present", "chosen"),
        [
            (["3.10.1", "3.11.1", "3.12.1", "3.13.1"], "3.12.1"),
            (["3.10.1", "3.11.1", "3.13.1"], "3.13.1"),
            (["3.10.1", "3.11.1"], "3.11.1"),
            (["3.9.1", "3.10.1", "3.14.1"], "3.10.1"),
            (["3.12.4 ensurepip", "3.10.4"], "3.10.4"),  # a complete one rather than a newer one
        ],
    )
    def test_prefers(self, tmp_path: Path, present: list[str], chosen: str) -> None:
        write_command(tmp_path / "shims" / "python3.12", "echo 'python3.12: command not found' >&2; exit 127")
        for words in present:
            fake_python(tmp_path, *words.split())
        path = os.pathsep.join([str(tmp_path / "shims"), str(tmp_path)])
        assert machine.choose_interpreter({"PATH": path}).version == chosen
        named = fake_python(tmp_path / "other", "3.10.9")
        assert machine.choose_interpreter({"PATH": path, "SWARMABS_PYTHON": str(named)}).path == str(named)

    @pytest.mark.parametrize(
        ("facts", "variable", "text"),
        [
            ("cpython 3.9.4", "SWARMABS_PYTHON", "CPython 3.10 to 3.13 is needed"),
            ("pypy 3.11.4", "SWARMABS_PYTHON", "pypy 3.11.4"),
            ("cpython 3.11.4 ensurepip", "", "lacks ensurepip"),
            ("", "SWARMABS_PYTHON", "does not start as Python"),
            ("", "", "apt-get install python3 python3-venv python3-dev"),
        ],
    )
    def test_none_is_refused_with_the_remedy(self, tmp_path: Path, facts: str, variable: str, text: str) -> None:
        path = tmp_path / "none"
        if facts:
            implementation, *others = facts.split()
            path = fake_python(tmp_path, *others, implementation=implementation)
        environ = {variable: str(path)} if variable else {}
        with pytest.raises(SetupError, match=text) as caught:
            machine.choose_interpreter({"PATH": str(tmp_path), **environ})
        assert caught.value.status == UNSUITABLE

    def test_incomplete_python_of_the_system_names_debian_packages(self) -> None:
        for path, missing, text in (
            ("/usr/bin", ("venv", "ensurepip", "Python.h"), "sudo apt-get install python3.11-venv python3.11-dev"),
            ("/usr/bin", ("the GIL",), "lacks the GIL; set SWARMABS_PYTHON to another"),
            ("/home/me/bin", ("venv",), "cpython 3.11.2 (/home/me/bin/python3.11) lacks venv; set SWARMABS_"),
        ):
            found = machine.Interpreter(f"{path}/python3.11", "3.11.2", "cpython", missing)
            assert text in machine.unfit_reason(found)

    def test_real_one_answers(self) -> None:
        found = machine.try_interpreter(sys.executable)
        assert found is not None
        assert found.version == ".".join(map(str, sys.version_info[:3]))
        assert found.fits()


class TestMachine:
    def test_another_processor_and_an_old_libc_are_refused(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(platform, "machine", lambda: "aarch64")
        with pytest.raises(SetupError, match="SWARMABS_USE_SOURCED_ROS=1") as caught:
            machine.check_platform()
        assert caught.value.status == UNSUITABLE
        monkeypatch.undo()
        for libc in (("glibc", "2.17"), ("", "")):
            monkeypatch.setattr(platform, "libc_ver", lambda _executable, libc=libc: libc)
            with pytest.raises(SetupError, match=r"glibc 2\.28"):
                machine.check_platform()

    @pytest.mark.parametrize(
        ("present", "chosen", "text"),
        [
            ("cc make cmake", {}, r"needs g\+\+: sudo apt-get install g\+\+$"),
            ("", {}, r"apt-get install gcc g\+\+ make cmake$"),
            ("cc c++ make cmake", {}, None),
            ("clang clang++ make cmake", {"CC": "clang", "CXX": "clang++ -stdlib=libc++"}, None),
        ],
    )
    def test_missing_build_tools(self, tmp_path: Path, present: str, chosen: dict[str, str], text: str | None) -> None:
        for name in present.split():
            write_command(tmp_path / name, "")
        with pytest.raises(SetupError, match=text) if text else nullcontext() as caught:
            machine.check_build_tools({"PATH": str(tmp_path), **chosen})
        assert caught is None or caught.value.status == UNSUITABLE


class TestEnvironment:
    def test_nothing_of_a_sourced_ros_gets_in(self) -> None:
        environ = {
            "AMENT_PREFIX_PATH": "/home/me/overlay:/opt/ros/humble:/usr",
            "CMAKE_PREFIX_PATH": "/opt/ros/humble",
            "FASTRTPS_DEFAULT_PROFILES_FILE": "/home/me/profile.xml",
            "HOME": "/home/me",
            "LD_LIBRARY_PATH": "/opt/ros/humble/lib:/home/me/overlay/lib:/usr/local/cuda/lib",
            "PATH": "/home/me/overlay/bin:/opt/ros/humble/bin:/usr/bin",
            "PYTHONPATH": "/opt/ros/humble/lib/python3.10/site-packages",
            "RMW_IMPLEMENTATION": "rmw_other",
            "ROS_DISTRO": "humble",
            "ROS_DOMAIN_ID": "7",
        }
        made = environment.run_environment(environ, *PLACES)
        assert {name: made.get(name) for name in environ} == {
            "AMENT_PREFIX_PATH": "/co/install:/co/.venv",
            "CMAKE_PREFIX_PATH": "/co/install:/co/.venv",
            "FASTRTPS_DEFAULT_PROFILES_FILE": None,
            "HOME": "/home/me",
            "LD_LIBRARY_PATH": "/co/install/lib:/co/.venv/lib:/usr/local/cuda/lib",
            "PATH": "/co/.venv/bin:/usr/bin",
            "PYTHONPATH": "/co/install/lib/python3.12/site-packages",
            "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp",
            "ROS_DISTRO": "jazzy",
            "ROS_DOMAIN_ID": "7",
        }
        assert environment.run_environment(made, *PLACES) == made
        assert environment.sourced_environment(made, *PLACES) == {}

    def test_a_sourced_ros_is_told_where_the_workspace_is(self) -> None:
        environ = {
            "AMENT_PREFIX_PATH": "/home/me/overlay:/opt/ros/jazzy",
            "LD_LIBRARY_PATH": "/opt/ros/jazzy/lib",
            "PYTHONPATH": "/opt/ros/jazzy/lib/python3.12/site-packages",
        }
        sourced = environment.sourced_environment(environ, *PLACES)
        added = ("/co/install", "/co/install/lib", "/co/install/lib/python3.12/site-packages")
        told = {name: f"{before}:{own}" for (name, before), own in zip(environ.items(), added, strict=True)}
        told["RMW_IMPLEMENTATION"] = "rmw_fastrtps_cpp"
        assert sourced == {environment.SOURCED + name: value for name, value in told.items()}
        assert environment.sourced_environment(environ | told, *PLACES) == sourced
        nested = environment.run_environment(environ | sourced, *PLACES)
        assert not any(name.startswith(environment.SOURCED) for name in nested)


class TestState:
    def test_key_follows_content_and_names_only(self, tmp_path: Path) -> None:
        file = tmp_path / "a.py"
        file.write_text("1")
        before = state.content_key(str(tmp_path))
        os.utime(file, (0, 0))
        (tmp_path / "__pycache__").mkdir()
        (tmp_path / "__pycache__" / "a.pyc").write_text("x")
        assert state.content_key(str(tmp_path)) == before
        file.write_text("2")
        changed = state.content_key(str(tmp_path))
        file.rename(tmp_path / "b.py")
        assert len({before, changed, state.content_key(str(tmp_path)), state.content_key(str(tmp_path), 1)}) == 4

    def test_look_sees_a_change_behind_a_restored_time(self, tmp_path: Path) -> None:
        file = tmp_path / "a.py"
        file.write_text("1")
        before, times = state.metadata_hash([str(file)]), file.stat()
        assert state.metadata_hash([str(file)]) == before

        def differs() -> bool:
            file.write_text("2")
            os.utime(file, ns=(times.st_atime_ns, times.st_mtime_ns))
            return state.metadata_hash([str(file)]) != before

        until(differs, "the clock of the file system has moved on")

    def test_damaged_stamp_is_none_and_unwritable_checkout_is_refused(self, tmp_path: Path) -> None:
        for content in ("", "{", "[1]", "\x00"):
            (tmp_path / "stamp").write_text(content)
            assert state.read_stamp(str(tmp_path / "stamp")) == {}
        (tmp_path / state.LOCK_FILE).mkdir()
        with pytest.raises(SetupError, match="cannot write in") as caught, state.only_one(str(tmp_path)):
            pass
        assert caught.value.status == UNSUITABLE


class TestLock:
    HOLD = """
import subprocess, sys
sys.path.insert(0, sys.argv[1])
from _setup import state
with state.only_one(sys.argv[2]) as lock:
    if sys.argv[3] == "leave":
        subprocess.Popen(["cat"], pass_fds=[lock], stdout=subprocess.DEVNULL)
    print("held", flush=True)
    sys.stdin.read()
"""

    def start(self, root: Path, what: str) -> subprocess.Popen[str]:
        command = [sys.executable, "-c", self.HOLD, str(SCRIPTS), str(root), what]
        pipe = subprocess.PIPE
        return subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True)

    @pytest.mark.parametrize("how", ["hold", "leave"])
    def test_second_waits_and_says_for_whom_also_if_that_one_was_killed(self, tmp_path: Path, how: str) -> None:
        with self.start(tmp_path, how) as first:
            assert first.stdout and first.stdin and first.stdout.readline() == "held\n"
            whom = f"waiting for process {first.pid}"
            if how == "leave":
                first.kill()
                first.wait()
                whom = f"children of process {first.pid}"
            with self.start(tmp_path, "hold") as second:
                assert second.stderr and second.stdout
                assert whom in second.stderr.readline()
                first.stdin.close()  # which ends the first, and the child it left
                assert second.stdout.readline() == "held\n"
                second.communicate()


class TestRunLogged:
    @pytest.mark.parametrize(
        ("printed", "cause"),
        [
            ("no reason", "step failed with exit code 3; start again to continue. Last lines of {log}:"),
            ("OSError: [Errno 28] No space left on device", "the disk is full"),
            ("Temporary failure in name resolution", "the package index is unreachable"),
            ("THESE PACKAGES DO NOT MATCH THE HASHES", "does not match its hash in the lock file"),
        ],
    )
    def test_failure_names_a_known_cause_and_the_end_of_the_log(self, tmp_path: Path, printed: str, cause: str) -> None:
        log = str(tmp_path / "log" / "step.log")
        with pytest.raises(SetupError) as caught:
            children.run_logged(["sh", "-c", 'seq 1 40; echo "$0"; exit 3', printed], log, os.environ, NO_LOCK)
        first, *others = str(caught.value).splitlines()
        assert caught.value.status == FAILED
        assert cause.format(log=log) in first
        assert [line.strip() for line in others][-2:] == ["40", printed]
        assert len(others) == children.LAST_LINES

    def test_interrupt_ends_children_and_grandchildren(self, tmp_path: Path) -> None:
        log = tmp_path / "step.log"

        def interrupt(text: str) -> None:
            if text.endswith("\n"):
                raise KeyboardInterrupt

        command = ["sh", "-c", "sleep 60 & echo $!; wait"]
        with pytest.raises(KeyboardInterrupt):
            children.run_logged(command, str(log), os.environ, NO_LOCK, interrupt)
        grandchild = int(log.read_text())
        until(lambda: not running(grandchild), "the grandchild has ended")


def running(pid: int) -> bool:
    try:
        return ") Z" not in Path(f"/proc/{pid}/stat").read_text()
    except FileNotFoundError:
        return False


class FakeColcon:
    """Stands in for colcon: installs each package's code.py, or is interrupted half-way."""

    def __init__(self, checkout: Checkout) -> None:
        self.checkout = checkout
        self.built: list[str] = []
        self.interrupted = False
        self.interrupted_after = ""

    def install(self, key: str = "key", environ: Mapping[str, str] = os.environ) -> list[str]:
        """Install what has changed; return what was built."""
        self.built = []
        stages.install_changed(self.checkout, key, ["colcon"], environ, NO_LOCK)
        return self.built

    def __call__(self, command: Sequence[str], *others: Any) -> None:
        start = command.index("--packages-select") + 1
        self.built = list(command[start : command.index("--cmake-args")])
        for name in self.built:
            source, target = Path(self.checkout.source, name), Path(self.checkout.install, "lib", name)
            target.mkdir(parents=True)  # fails unless the package was uninstalled
            for file in source.glob("*.py"):
                shutil.copy(file, target)
            if self.interrupted:
                raise KeyboardInterrupt
            log = "".join(f"Starting >>> {each}\nFinished <<< {each} [0.5s]\n" for each in self.built)
            others[-1](log[: log.index("[", log.index(f"<<< {name}")) + 1])
            if name == self.interrupted_after:
                raise KeyboardInterrupt


class TestInstall:
    @pytest.fixture
    def colcon(self, checkout: Checkout, monkeypatch: pytest.MonkeyPatch) -> FakeColcon:
        fake = FakeColcon(checkout)
        monkeypatch.setattr(stages, "run_logged", fake)
        return fake

    def test_what_changed_is_built_and_what_is_removed_disappears(self, checkout: Checkout, colcon: FakeColcon) -> None:
        install = colcon.install
        source, installed = Path(checkout.source), Path(checkout.install, "lib")
        (source / "alpha" / "extra.py").write_text("")
        assert install() == ["alpha", "beta", "gamma_msgs"]
        assert install() == []
        (source / "beta" / "code.py").write_text("VALUE = 2\n")
        (source / "alpha" / "extra.py").unlink()
        assert install() == ["alpha", "beta"]
        assert (installed / "beta" / "code.py").read_text() == "VALUE = 2\n"
        assert [path.name for path in (installed / "alpha").iterdir()] == ["code.py"]
        shutil.rmtree(source / "alpha")
        assert install() == []
        assert [path.name for path in sorted(installed.iterdir())] == ["beta", "gamma_msgs"]
        (installed / "leftover").touch()
        assert install("another environment") == ["beta", "gamma_msgs"]
        assert not (installed / "leftover").exists()

    def test_interrupted_build_is_repeated_without_a_change(self, checkout: Checkout, colcon: FakeColcon) -> None:
        colcon.install()
        code = Path(checkout.source, "beta", "code.py")
        code.write_text("VALUE = 2\n")
        colcon.interrupted = True
        with pytest.raises(KeyboardInterrupt):
            colcon.install()
        code.write_text("VALUE = 1\n")
        colcon.interrupted = False
        assert colcon.install() == ["beta"]
        assert Path(checkout.install, "lib", "beta", "code.py").read_text() == "VALUE = 1\n"

    def test_packages_that_were_built_before_an_interruption_are_kept(
        self, checkout: Checkout, colcon: FakeColcon
    ) -> None:
        colcon.interrupted_after = "beta"
        with pytest.raises(KeyboardInterrupt):
            colcon.install()
        colcon.interrupted_after = ""
        assert colcon.install() == ["gamma_msgs"]
        assert colcon.install() == []

    def test_compiler_is_needed_for_messages_only(self, checkout: Checkout, tmp_path: Path, colcon: FakeColcon) -> None:
        colcon.install()
        nothing = {"PATH": str(tmp_path)}
        Path(checkout.source, "beta", "code.py").write_text("VALUE = 2\n")
        assert colcon.install(environ=nothing) == ["beta"]
        Path(checkout.source, "gamma_msgs", "CMakeLists.txt").write_text("project(other)\n")
        with pytest.raises(SetupError, match="apt-get install"):
            colcon.install(environ=nothing)


class TestVirtualEnvironment:
    PYTHON = machine.Interpreter("/usr/bin/python3.12", "3.12.1", "cpython", ())

    @pytest.fixture(autouse=True)
    def _no_packages(self, monkeypatch: pytest.MonkeyPatch) -> None:
        def run(command: Sequence[str], *_others: object) -> None:
            if "venv" in command:
                write_command(Path(command[-1]) / "bin" / "python", "")

        monkeypatch.setattr(stages, "run_logged", run)
        monkeypatch.setattr(stages, "point_cmake_files", lambda *_: None)

    def make(self, checkout: Checkout) -> dict[str, str]:
        stages.make_environment(checkout, self.PYTHON, os.environ, NO_LOCK)
        return stages.current_environment(checkout, None)

    def test_complete_one_is_kept_for_its_python_and_its_place(self, checkout: Checkout, tmp_path: Path) -> None:
        assert stages.current_environment(checkout, None) == {}
        assert self.make(checkout)["version"] == "3.12.1"
        assert stages.current_environment(checkout, self.PYTHON)
        # With it the packages that come as source are built.
        setuptools = Path(checkout.venv, "setuptools.lock").read_text()
        assert setuptools.startswith("setuptools==79.0.1 ") and "-part" not in setuptools
        for other in (self.PYTHON._replace(version="3.12.2"), self.PYTHON._replace(path="/usr/local/bin/python3.12")):
            assert stages.current_environment(checkout, other) == {}
        moved = type(checkout)(str(tmp_path / "moved"))
        shutil.copytree(checkout.root, moved.root, ignore=shutil.ignore_patterns("moved"))
        assert stages.current_environment(moved, None) == {}
        Path(checkout.python).unlink()
        Path(checkout.python).symlink_to("/nowhere/python3.12")
        assert stages.current_environment(checkout, None) == {}

    def test_interrupted_one_is_not(self, checkout: Checkout, monkeypatch: pytest.MonkeyPatch) -> None:
        self.make(checkout)
        monkeypatch.setattr(stages, "install_locked", Mock(side_effect=KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            self.make(checkout)
        assert stages.current_environment(checkout, None) == {}

    @pytest.mark.parametrize("command", stages.EXTRA_LOCKS)
    def test_interrupted_addition_of_the_packages_of_a_command_is_repeated_and_costs_nothing_else(
        self, checkout: Checkout, monkeypatch: pytest.MonkeyPatch, command: str
    ) -> None:
        stamp = self.make(checkout)
        packages = Path(checkout.venv, "lib", "python3.12", "site-packages")
        for name in ("there-1.0.dist-info", "broken-1.0.dist-info", "also_broken-1.0.dist-info"):
            (packages / name).mkdir(parents=True)
        (packages / "there-1.0.dist-info" / "RECORD").write_text("")
        lock = stages.EXTRA_LOCKS[command]
        outcomes: list[BaseException | None] = [KeyboardInterrupt(), KeyboardInterrupt(), None]

        def install_locked(_: object, locks: Sequence[str], *_others: object) -> None:
            assert stages.current_environment(checkout, None) == stamp
            assert ([path.name for path in packages.iterdir()], locks) == (["there-1.0.dist-info"], (lock,))
            (packages / "broken-1.0.dist-info").mkdir()
            if outcome := outcomes.pop(0):
                raise outcome

        monkeypatch.setattr(stages, "install_locked", install_locked)
        for _ in range(2):
            with pytest.raises(KeyboardInterrupt):
                stages.install_extra(checkout, command, os.environ, NO_LOCK)
            assert not Path(checkout.extra_stamp(lock)).exists()
        for _ in range(2):  # the second time there is nothing left to do
            stages.install_extra(checkout, command, os.environ, NO_LOCK)
            assert stages.current_environment(checkout, None) == stamp
            assert Path(checkout.extra_stamp(lock)).exists()

    @pytest.mark.parametrize("name", stages.LOCKS)
    def test_a_changed_lock_spoils_it(self, checkout: Checkout, name: str) -> None:
        self.make(checkout)
        Path(checkout.lock(name)).write_text("more==1.0\n")
        assert stages.current_environment(checkout, None) == {}

    @pytest.mark.parametrize(("command", "lock"), stages.EXTRA_LOCKS.items())
    def test_a_changed_lock_of_extras_spoils_only_these(self, checkout: Checkout, command: str, lock: str) -> None:
        self.make(checkout)
        stages.install_extra(checkout, command, os.environ, NO_LOCK)
        stages.forget_outdated_extras(checkout)
        assert Path(checkout.extra_stamp(lock)).exists()
        Path(checkout.lock(lock)).write_text("more==1.0\n")
        stages.forget_outdated_extras(checkout)
        assert not Path(checkout.extra_stamp(lock)).exists()
        assert stages.current_environment(checkout, None)

    def test_full_disk_is_refused_at_the_beginning(self, checkout: Checkout, monkeypatch: pytest.MonkeyPatch) -> None:
        usage = shutil.disk_usage(checkout.root)._replace(free=5_000_000)
        monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
        with pytest.raises(SetupError, match="has 5 MB free; the set-up needs") as caught:
            self.make(checkout)
        assert caught.value.status == UNSUITABLE
        assert not Path(checkout.venv).exists()


def test_entry_of_one_package() -> None:
    wanted = "setuptools==79 \\\n    --hash=y \\\n    --hash=z\n"
    text = f"a==1 \\\n    --hash=x\n{wanted}setuptools-scm==8 \\\n    --hash=w\n"
    assert stages.locked_entry(text, "setuptools") == wanted
    with pytest.raises(SetupError, match="does not pin setuptools"):
        stages.locked_entry("a==1\n", "setuptools")


def test_locks_agree_and_name_no_place() -> None:
    pinned: dict[str, str] = {}
    for name in (*stages.LOCKS, *stages.EXTRA_LOCKS.values()):
        text = (SCRIPTS / "requirements" / name).read_text()
        assert "://" not in text and "/home" not in text
        for line in text.splitlines():
            if line[0].isalnum():
                requirement, _, marker = line.rstrip(" \\").partition(" ; ")
                package, version = requirement.split("==")
                assert pinned.setdefault(f"{package} ; {marker}", version) == version


def test_commands_of_the_checkout_install_what_they_need() -> None:
    commands = {command.name for command in vars(develop).values() if isinstance(command, click.Command)}
    assert commands - {"wheel"} <= stages.EXTRA_LOCKS.keys()
    assert stages.EXTRA_LOCKS["soak"] == stages.EXTRA_LOCKS["test"], "it runs what is in tests"


def test_include_folders_are_replaced_once_and_progress_of_pip_is_counted() -> None:
    built = "/opt/python/cp312-cp312"
    text = f'"{built}/include/python3.12;{built}/lib/python3.12/site-packages/numpy/_core/include"'
    once = stages.point_includes(text, "/usr/include/python3.12", "/co/numpy/_core/include")
    assert once == '"/usr/include/python3.12;/co/numpy/_core/include"'
    assert stages.point_includes(once, "/other", "/other") == once
    assert stages.pip_progress("Collecting a\nCollecting b\n") == "2 downloaded"
    assert stages.pip_progress("Collecting a\nInstalling collected packages: a\n") == "unpacking"


class TestScript:
    @pytest.fixture
    def prepared(self, checkout: Checkout, swarm: ModuleType) -> Path:
        """A checkout in which all is done; its Python prints what it is started with."""
        root = Path(checkout.root)
        shutil.copy(SCRIPTS / "swarm", root / "scripts")
        shutil.copytree(SCRIPTS / "_setup", root / "scripts" / "_setup", ignore=shutil.ignore_patterns("__pycache__"))
        told = '[ "${SWARMABS_SETUP%:*}" = $$ ] && echo "set up"'
        write_command(root / ".venv" / "bin" / "python", f'echo "$*"; echo "$PYTHONPATH"; {told}')
        state.write_stamp(checkout.environment_stamp, key="key", version="3.12.1")
        state.write_stamp(checkout.snapshot, snapshot=swarm.snapshot_of(checkout, {}), key="key")
        return root

    def start(self, root: Path, *arguments: str, **environ: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-S", str(root / "scripts" / "swarm"), *arguments]
        inherited = {"PATH": os.environ["PATH"], **environ}
        return subprocess.run(command, env=inherited, text=True, capture_output=True, check=False)

    def test_second_start_goes_straight_to_the_command_line(self, prepared: Path) -> None:
        ended = self.start(prepared, "run", "a b")
        site_packages = prepared / "install" / "lib" / "python3.12" / "site-packages"
        expected = ["-m swarmabs_cli run a b", str(site_packages), "set up"]
        assert (ended.returncode, ended.stdout.splitlines(), ended.stderr) == (0, expected, "")

    def test_signals_are_blocked_until_the_command_line_can_handle_them(self, prepared: Path) -> None:
        told = "import signal; print(*sorted(signal.pthread_sigmask(signal.SIG_BLOCK, ())))"
        (prepared / ".venv" / "bin" / "python").write_text(f"#!{sys.executable} -S\n{told}\n")
        blocked = {int(number) for number in self.start(prepared, "run").stdout.split()}
        assert blocked == {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}

    @pytest.mark.parametrize(
        ("change", "path"),
        [
            (lambda path: path.write_text("VALUE = 3\n"), "src/alpha/code.py"),
            (Path.touch, "src/alpha/new.py"),
            (Path.unlink, "src/alpha/code.py"),
            (lambda path: path.write_text(""), "scripts/requirements/run.lock"),
            (shutil.rmtree, ".venv"),
            (shutil.rmtree, "install"),
        ],
    )
    def test_any_change_is_seen(
        self, prepared: Path, swarm: ModuleType, checkout: Checkout, change: Callable[[Path], object], path: str
    ) -> None:
        assert swarm.ready(checkout, swarm.snapshot_of(checkout, {}), "run") == "3.12"
        change(prepared / path)
        assert not swarm.ready(checkout, swarm.snapshot_of(checkout, {}), "run")

    @pytest.mark.parametrize(("command", "lock"), stages.EXTRA_LOCKS.items())
    def test_command_with_a_lock_of_its_own_is_ready_once_that_is_installed(
        self, prepared: Path, swarm: ModuleType, checkout: Checkout, command: str, lock: str
    ) -> None:
        snapshot = swarm.snapshot_of(checkout, {})
        assert not swarm.ready(checkout, snapshot, command)
        state.write_stamp(checkout.extra_stamp(lock), key="key")
        assert swarm.ready(checkout, snapshot, command) == "3.12"
        for other, its_lock in stages.EXTRA_LOCKS.items():
            assert bool(swarm.ready(checkout, snapshot, other)) == (its_lock == lock)

    def test_other_commands_stay_ready_while_one_gets_its_packages(
        self, prepared: Path, swarm: ModuleType, checkout: Checkout, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        snapshot, seen = swarm.snapshot_of(checkout, {}), []
        monkeypatch.setattr(
            stages, "install_extra", lambda *_: seen.append(swarm.ready(checkout, snapshot, "run")) or None
        )
        assert swarm.prepare(checkout, {}, "view") == "3.12"
        assert seen == ["3.12"]

    @pytest.mark.parametrize(("complete", "steps"), [("", ["", "test"]), ("3.12", ["test"])])
    def test_a_set_up_in_several_parts_has_one_snapshot_and_one_duration(
        self,
        complete: str,
        steps: list[str],
        prepared: Path,
        swarm: ModuleType,
        checkout: Checkout,
        monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str],
    ) -> None:
        parts: list[str] = []
        snapshots: list[object] = []
        monkeypatch.setattr(swarm, "snapshot_of", lambda *_: snapshots.append(None) or "snapshot")
        monkeypatch.setattr(swarm, "ready", lambda _checkout, _snapshot, command: "" if command else complete)
        monkeypatch.setattr(swarm, "prepare", lambda _checkout, _environ, command: parts.append(command) or "3.12")
        monkeypatch.setattr(swarm, "refuse_wrong", lambda *_: None)
        for name in ("run_environment", "sourced_environment"):
            monkeypatch.setattr(swarm.environment, name, lambda *_: {})
        monkeypatch.setattr(swarm.signal, "pthread_sigmask", lambda *_: None)
        monkeypatch.setattr(swarm.os, "execve", lambda *_: None)
        swarm.start(checkout, {}, ["test"])
        assert (parts, len(snapshots)) == (steps, 1)
        assert capsys.readouterr().err.count("ready after") == 1

    @pytest.mark.parametrize(
        ("words", "command", "options"),
        [
            ("", "", []),
            ("run --json", "run", []),
            ("sweep x.yaml", "sweep", []),
            ("export BAG -o out", "", []),
            ("export BAG -o out --format csv", "", []),
            ("export BAG -o out --format parquet", "export", []),
            ("export --format=parquet BAG -o out", "export", []),
            ("deploy FLEET.yaml -o out", "deploy", []),
            ("deploy --check out --host robot-1", "", []),
            ("deploy --schema", "", []),
            ("run --view", "view", []),
            ("demo 200", "view", []),
            ("run x.yaml --view --open", "view", []),
            ("view BAG", "view", []),
            ("run x.yaml --markers", "run", []),
            ("run x.yaml --markers --foxglove", "run", ["foxglove"]),
            ("run --foxglove --foxglove-port 9000", "run", ["foxglove"]),
            ("simulate --foxglove", "simulate", []),
            ("bench", "bench", ["sweep"]),
            ("bench --suite sweep --robots 4", "bench", ["sweep"]),
            ("bench --suite start", "bench", []),
            ("bench --compare a b", "bench", []),
        ],
    )
    def test_packages_only_where_needed(self, swarm: ModuleType, words: str, command: str, options: list[str]) -> None:
        assert (swarm.packages_for(words.split()), swarm.options_for(words.split())) == (command, options)

    def test_a_wrong_command_line_ends_before_packages_are_installed_for_it(self, prepared: Path) -> None:
        script = 'if [ "$SWARMABS_PARSE_ONLY" ]; then echo "error: no such option" >&2; exit 2; fi; echo "$*"'
        write_command(prepared / ".venv" / "bin" / "python", script)
        ended = self.start(prepared, "view", "--nope")
        assert (ended.returncode, ended.stdout, ended.stderr) == (2, "", "error: no such option\n")
        assert self.start(prepared, "run").stdout == "-m swarmabs_cli run\n", "it needs no further packages"

    def test_help_installs_nothing(self, prepared: Path) -> None:
        shutil.rmtree(prepared / ".venv")
        for words in ("-h", "view --help", "--version"):
            ended = self.start(prepared, *words.split())
            assert (ended.returncode, "not set up yet" in ended.stdout, ended.stderr) == (0, True, "")
        assert not (prepared / ".venv").exists()

    def test_refusal_is_one_line_and_leaves_no_environment(self, prepared: Path) -> None:
        shutil.rmtree(prepared / ".venv")
        ended = self.start(prepared, "run", SWARMABS_PYTHON="/nowhere/python3")
        assert ended.stderr.startswith("swarm: SWARMABS_PYTHON=/nowhere/python3 does not start as Python")
        assert ended.returncode == UNSUITABLE
        assert not (prepared / ".venv").exists()

    def test_sourced_ros_builds_with_its_colcon_and_runs_its_python(self, prepared: Path) -> None:
        setup = "echo 'SOURCED=yes; export SOURCED'"
        colcon = f'echo "$*" > {prepared}/asked; {setup} > {prepared}/install/local_setup.bash'
        write_command(prepared / "bin" / "colcon", colcon)
        write_command(prepared / "bin" / "python3", 'echo "$SOURCED $*"')
        path = os.pathsep.join([str(prepared / "bin"), os.environ["PATH"]])
        refused = self.start(prepared, "run", SWARMABS_USE_SOURCED_ROS="1")
        assert (refused.returncode, "no ROS 2 Jazzy is sourced" in refused.stderr) == (UNSUITABLE, True)
        ended = self.start(prepared, "run", "x", SWARMABS_USE_SOURCED_ROS="1", ROS_DISTRO="jazzy", PATH=path)
        assert ended.stdout == "yes -m swarmabs_cli run x\n"
        assert "--merge-install" in (prepared / "asked").read_text()

    def test_termination_while_waiting_is_an_orderly_end(self, prepared: Path) -> None:
        shutil.rmtree(prepared / ".venv")
        with state.only_one(str(prepared)):
            command = [sys.executable, "-S", str(prepared / "scripts" / "swarm"), "run"]
            with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as waiting:
                assert waiting.stderr
                assert f"waiting for process {os.getpid()}" in waiting.stderr.readline()
                waiting.send_signal(signal.SIGTERM)
                assert waiting.stderr.read() == "swarm: interrupted; the next start continues from here\n"
        assert waiting.returncode == FAILED
