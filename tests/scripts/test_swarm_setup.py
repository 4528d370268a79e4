"""The set-up: what it chooses, what it does again and what not, and how it fails."""

from __future__ import annotations

import json
import os
import platform
import shutil
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from _setup import children, environment, machine, stages, state
from _setup.report import FAILED, UNSUITABLE, SetupError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from types import ModuleType

    from _setup.checkout import Checkout

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
NO_LOCK = 2  # stderr, as good as any descriptor where no lock is wanted


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
    def _only_path(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(machine, "INSTALL_FOLDERS", ())

    @pytest.mark.parametrize(
        ("present", "chosen"),
        [
            (["3.10.1", "3.11.1", "3.12.1", "3.13.1"], "3.12.1"),
            (["3.10.1", "3.11.1", "3.13.1"], "3.13.1"),
            (["3.10.1", "3.11.1"], "3.11.1"),
            (["3.9.1", "3.10.1", "3.14.1"], "3.10.1"),
        ],
    )
    def test_prefers(self, tmp_path: Path, present: list[str], chosen: str) -> None:
        for version in present:
            fake_python(tmp_path, version)
        assert machine.choose_interpreter({"PATH": str(tmp_path)}).version == chosen

    def test_passes_over_a_shim_that_leads_nowhere(self, tmp_path: Path) -> None:
        write_command(tmp_path / "shims" / "python3.12", "echo 'python3.12: command not found' >&2; exit 127")
        fake_python(tmp_path / "bin", "3.12.4")
        path = os.pathsep.join([str(tmp_path / "shims"), str(tmp_path / "bin")])
        assert machine.choose_interpreter({"PATH": path}).path == str(tmp_path / "bin" / "python3.12")

    def test_prefers_a_complete_one_to_a_newer_one(self, tmp_path: Path) -> None:
        fake_python(tmp_path, "3.12.4", "ensurepip")
        fake_python(tmp_path, "3.10.4")
        assert machine.choose_interpreter({"PATH": str(tmp_path)}).series == "3.10"

    def test_none(self, tmp_path: Path) -> None:
        with pytest.raises(SetupError, match="apt-get install python3 python3-venv python3-dev") as caught:
            machine.choose_interpreter({"PATH": str(tmp_path)})
        assert caught.value.status == UNSUITABLE

    def test_incomplete_system_python_names_debian_packages(self) -> None:
        found = machine.Interpreter("/usr/bin/python3.11", "3.11.2", "cpython", ("venv", "ensurepip", "Python.h"))
        assert machine.unfit_reason(found).endswith("sudo apt-get install python3.11-venv python3.11-dev")

    def test_incomplete_other_python_names_no_debian_package(self) -> None:
        found = machine.Interpreter("/home/me/bin/python3.11", "3.11.2", "cpython", ("the GIL",))
        assert machine.unfit_reason(found) == (
            "cpython 3.11.2 (/home/me/bin/python3.11) lacks the GIL: name another one in SWARMABS_PYTHON"
        )

    def test_named_one_is_taken(self, tmp_path: Path) -> None:
        fake_python(tmp_path, "3.12.4")
        named = fake_python(tmp_path / "other", "3.10.4")
        environ = {"PATH": str(tmp_path), "SWARMABS_PYTHON": str(named)}
        assert machine.choose_interpreter(environ).path == str(named)

    @pytest.mark.parametrize(
        ("version", "implementation", "text"),
        [("3.9.4", "cpython", "CPython 3.10 to 3.13 is needed"), ("3.11.4", "pypy", "pypy 3.11.4")],
    )
    def test_named_one_that_does_not_fit(self, tmp_path: Path, version: str, implementation: str, text: str) -> None:
        named = fake_python(tmp_path, version, implementation=implementation)
        with pytest.raises(SetupError, match=text):
            machine.choose_interpreter({"SWARMABS_PYTHON": str(named)})

    def test_named_one_that_does_not_start(self, tmp_path: Path) -> None:
        with pytest.raises(SetupError, match="does not start"):
            machine.choose_interpreter({"SWARMABS_PYTHON": str(tmp_path / "none")})

    def test_real_one_answers(self) -> None:
        found = machine.try_interpreter(sys.executable)
        assert found is not None
        assert found.version == ".".join(map(str, sys.version_info[:3]))
        assert found.fits()


class TestMachine:
    def test_other_processor_is_sent_to_the_sourced_ros(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(platform, "machine", lambda: "aarch64")
        with pytest.raises(SetupError, match="SWARMABS_USE_SOURCED_ROS=1") as caught:
            machine.check_platform()
        assert caught.value.status == UNSUITABLE

    @pytest.mark.parametrize("libc", [("glibc", "2.17"), ("", "")])
    def test_other_libc(self, monkeypatch: pytest.MonkeyPatch, libc: tuple[str, str]) -> None:
        monkeypatch.setattr(platform, "libc_ver", lambda _executable: libc)
        with pytest.raises(SetupError, match=r"glibc 2\.28"):
            machine.check_platform()

    def test_missing_compiler_names_its_package(self, tmp_path: Path) -> None:
        for name in ("cc", "make", "cmake"):
            write_command(tmp_path / name, "")
        with pytest.raises(SetupError, match=r"needs g\+\+: sudo apt-get install g\+\+$") as caught:
            machine.check_build_tools({"PATH": str(tmp_path)})
        assert caught.value.status == UNSUITABLE

    def test_all_that_is_missing_is_named_at_once(self, tmp_path: Path) -> None:
        with pytest.raises(SetupError, match=r"apt-get install gcc g\+\+ make cmake$"):
            machine.check_build_tools({"PATH": str(tmp_path)})

    def test_compiler_may_be_named_by_the_user(self, tmp_path: Path) -> None:
        for name in ("clang", "clang++", "make", "cmake"):
            write_command(tmp_path / name, "")
        environ = {"PATH": str(tmp_path), "CC": "clang", "CXX": "clang++ -stdlib=libc++"}
        machine.check_build_tools(environ)


class TestEnvironment:
    def test_nothing_of_a_sourced_ros_gets_in(self) -> None:
        environ = {
            "AMENT_PREFIX_PATH": "/home/me/overlay:/opt/ros/humble",
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
        made = environment.run_environment(environ, "/co/.venv", "/co/install", "3.12")
        assert made["AMENT_PREFIX_PATH"] == "/co/install:/co/.venv"
        assert made["PATH"] == "/co/.venv/bin:/usr/bin"
        assert made["LD_LIBRARY_PATH"] == "/co/install/lib:/co/.venv/lib:/usr/local/cuda/lib"
        assert made["PYTHONPATH"] == "/co/install/lib/python3.12/site-packages"
        assert made["RMW_IMPLEMENTATION"] == "rmw_fastrtps_cpp"
        assert made["ROS_DISTRO"] == "jazzy"
        assert made["ROS_DOMAIN_ID"] == "7"
        assert made["HOME"] == "/home/me"
        assert "FASTRTPS_DEFAULT_PROFILES_FILE" not in made

    def test_started_from_within_it_stays_the_same(self) -> None:
        once = environment.run_environment({"PATH": "/usr/bin"}, "/co/.venv", "/co/install", "3.12")
        assert environment.run_environment(once, "/co/.venv", "/co/install", "3.12") == once

    def test_a_sourced_ros_is_told_where_the_workspace_is(self) -> None:
        environ = {
            "AMENT_PREFIX_PATH": "/home/me/overlay:/opt/ros/jazzy",
            "LD_LIBRARY_PATH": "/opt/ros/jazzy/lib",
            "PATH": "/opt/ros/jazzy/bin:/usr/bin",
            "PYTHONPATH": "/opt/ros/jazzy/lib/python3.12/site-packages",
        }
        sourced = environment.sourced_environment(environ, "/co/.venv", "/co/install", "3.12")
        assert sourced == {
            "SWARMABS_SOURCED_AMENT_PREFIX_PATH": "/home/me/overlay:/opt/ros/jazzy:/co/install",
            "SWARMABS_SOURCED_LD_LIBRARY_PATH": "/opt/ros/jazzy/lib:/co/install/lib",
            "SWARMABS_SOURCED_PYTHONPATH": (
                "/opt/ros/jazzy/lib/python3.12/site-packages:/co/install/lib/python3.12/site-packages"
            ),
            "SWARMABS_SOURCED_RMW_IMPLEMENTATION": "rmw_fastrtps_cpp",
        }
        again = environ | {name[len(environment.SOURCED) :]: value for name, value in sourced.items()}
        assert environment.sourced_environment(again, "/co/.venv", "/co/install", "3.12") == sourced
        nested = environment.run_environment(environ | sourced, "/co/.venv", "/co/install", "3.12")
        assert not any(name.startswith(environment.SOURCED) for name in nested)

    def test_without_a_sourced_ros_there_is_nobody_to_tell(self) -> None:
        own = environment.run_environment({"PATH": "/usr/bin"}, "/co/.venv", "/co/install", "3.12")
        for environ in ({"PATH": "/usr/bin"}, own):
            assert environment.sourced_environment(environ, "/co/.venv", "/co/install", "3.12") == {}

    def test_a_ros_in_usr_does_not_hide_usr(self) -> None:
        made = environment.clean({"AMENT_PREFIX_PATH": "/usr", "PATH": "/usr/bin"}, "/co/.venv")
        assert made["PATH"] == "/co/.venv/bin:/usr/bin"


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
        before, times = state.look_at([str(file)]), file.stat()
        assert state.look_at([str(file)]) == before
        time.sleep(0.02)  # more than the resolution of the file system's clock
        file.write_text("2")
        os.utime(file, ns=(times.st_atime_ns, times.st_mtime_ns))
        assert state.look_at([str(file)]) != before

    @pytest.mark.parametrize("content", ["", "{", "[1]", "\x00"])
    def test_damaged_stamp_is_none(self, tmp_path: Path, content: str) -> None:
        (tmp_path / "stamp").write_text(content)
        assert state.read_stamp(str(tmp_path / "stamp")) == {}

    def test_unwritable_checkout(self, tmp_path: Path) -> None:
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

    def test_second_waits_and_says_for_whom(self, tmp_path: Path) -> None:
        with self.start(tmp_path, "hold") as first:
            assert first.stdout and first.stdout.readline() == "held\n"
            with self.start(tmp_path, "hold") as second:
                assert second.stderr and second.stdout
                assert f"waiting for process {first.pid}" in second.stderr.readline()
                first.communicate()
                assert second.stdout.readline() == "held\n"
                second.communicate()

    def test_killed_one_is_waited_for_until_its_children_end(self, tmp_path: Path) -> None:
        with self.start(tmp_path, "leave") as first:
            assert first.stdout and first.stdin and first.stdout.readline() == "held\n"
            first.kill()
            first.wait()
            with self.start(tmp_path, "hold") as second:
                assert second.stderr and second.stdout
                assert f"what process {first.pid} left running" in second.stderr.readline()
                first.stdin.close()  # which ends the child it left
                assert second.stdout.readline() == "held\n"
                second.communicate()


class TestRunLogged:
    def test_failure_shows_the_end_of_the_log(self, tmp_path: Path) -> None:
        log = str(tmp_path / "log" / "step.log")
        with pytest.raises(SetupError) as caught:
            children.run_logged(["sh", "-c", "seq 1 40; exit 3"], log, os.environ, NO_LOCK)
        lines = str(caught.value).splitlines()
        assert caught.value.status == FAILED
        assert lines[0] == f"step failed with exit code 3; start again to go on. Last lines of {log}:"
        assert lines[-1].strip() == "40"
        assert len(lines) == 1 + children.LAST_LINES

    @pytest.mark.parametrize(
        ("printed", "cause"),
        [
            ("OSError: [Errno 28] No space left on device", "the disk is full"),
            ("Temporary failure in name resolution", "no package index is reachable"),
            ("THESE PACKAGES DO NOT MATCH THE HASHES", "not the one that was locked"),
        ],
    )
    def test_failure_names_a_known_cause_first(self, tmp_path: Path, printed: str, cause: str) -> None:
        command = ["sh", "-c", 'echo "$0"; exit 1', printed]
        with pytest.raises(SetupError) as caught:
            children.run_logged(command, str(tmp_path / "step.log"), os.environ, NO_LOCK)
        assert cause in str(caught.value).splitlines()[0]

    def test_interrupt_ends_children_and_grandchildren(self, tmp_path: Path) -> None:
        log = tmp_path / "step.log"

        def interrupt(text: str) -> None:
            if text.endswith("\n"):
                raise KeyboardInterrupt

        command = ["sh", "-c", "sleep 60 & echo $!; wait"]
        with pytest.raises(KeyboardInterrupt):
            children.run_logged(command, str(log), os.environ, NO_LOCK, interrupt)
        grandchild = int(log.read_text())
        deadline = time.monotonic() + 5
        while running(grandchild) and time.monotonic() < deadline:
            time.sleep(0.01)
        assert not running(grandchild)


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

    def __call__(self, command: Sequence[str], *_others: object) -> None:
        start = command.index("--packages-select") + 1
        self.built = list(command[start : command.index("--cmake-args")])
        for name in self.built:
            source, target = Path(self.checkout.source, name), Path(self.checkout.install, "lib", name)
            target.mkdir(parents=True)  # fails unless the package was uninstalled
            for file in source.glob("*.py"):
                shutil.copy(file, target)
            if self.interrupted:
                raise KeyboardInterrupt


class TestInstall:
    @pytest.fixture
    def colcon(self, checkout: Checkout, monkeypatch: pytest.MonkeyPatch) -> FakeColcon:
        fake = FakeColcon(checkout)
        monkeypatch.setattr(stages, "run_logged", fake)
        return fake

    @pytest.fixture
    def install(self, checkout: Checkout, colcon: FakeColcon) -> Callable[..., list[str]]:
        def install(key: str = "key", environ: Mapping[str, str] = os.environ) -> list[str]:
            colcon.built = []
            stages.install_changed(checkout, key, ["colcon"], environ, NO_LOCK)
            return colcon.built

        return install

    def test_only_what_changed_is_built(self, checkout: Checkout, install: Callable[..., list[str]]) -> None:
        assert install() == ["alpha", "beta", "gamma_msgs"]
        assert install() == []
        Path(checkout.source, "beta", "code.py").write_text("VALUE = 2\n")
        assert install() == ["beta"]
        assert Path(checkout.install, "lib", "beta", "code.py").read_text() == "VALUE = 2\n"
        assert install() == []

    def test_removed_file_disappears(self, checkout: Checkout, install: Callable[..., list[str]]) -> None:
        extra = Path(checkout.source, "alpha", "extra.py")
        extra.write_text("")
        install()
        assert Path(checkout.install, "lib", "alpha", "extra.py").exists()
        extra.unlink()
        assert install() == ["alpha"]
        assert not Path(checkout.install, "lib", "alpha", "extra.py").exists()

    def test_removed_package_disappears(self, checkout: Checkout, install: Callable[..., list[str]]) -> None:
        install()
        shutil.rmtree(Path(checkout.source, "alpha"))
        assert install() == []
        assert not Path(checkout.install, "lib", "alpha").exists()
        assert Path(checkout.install, "lib", "beta").exists()

    def test_interrupted_build_is_done_again_even_if_the_change_is_undone(
        self, checkout: Checkout, colcon: FakeColcon, install: Callable[..., list[str]]
    ) -> None:
        install()
        code = Path(checkout.source, "beta", "code.py")
        code.write_text("VALUE = 2\n")
        colcon.interrupted = True
        with pytest.raises(KeyboardInterrupt):
            install()
        code.write_text("VALUE = 1\n")
        colcon.interrupted = False
        assert install() == ["beta"]
        assert Path(checkout.install, "lib", "beta", "code.py").read_text() == "VALUE = 1\n"

    def test_other_environment_builds_all_anew(self, checkout: Checkout, install: Callable[..., list[str]]) -> None:
        install()
        leftover = Path(checkout.install, "lib", "leftover")
        leftover.touch()
        assert install("other") == ["alpha", "beta", "gamma_msgs"]
        assert not leftover.exists()

    def test_compiler_is_needed_for_messages_only(
        self, checkout: Checkout, tmp_path: Path, install: Callable[..., list[str]]
    ) -> None:
        install()
        nothing = {"PATH": str(tmp_path)}
        Path(checkout.source, "beta", "code.py").write_text("VALUE = 2\n")
        assert install(environ=nothing) == ["beta"]
        Path(checkout.source, "gamma_msgs", "CMakeLists.txt").write_text("project(other)\n")
        with pytest.raises(SetupError, match="apt-get install"):
            install(environ=nothing)


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

    def test_complete_one_is_kept(self, checkout: Checkout) -> None:
        assert stages.current_environment(checkout, None) == {}
        assert self.make(checkout)["version"] == "3.12.1"
        assert stages.current_environment(checkout, self.PYTHON)

    def test_interrupted_one_is_not(self, checkout: Checkout, monkeypatch: pytest.MonkeyPatch) -> None:
        self.make(checkout)

        def interrupted(*_: object) -> None:
            raise KeyboardInterrupt

        monkeypatch.setattr(stages, "install_locked", interrupted)
        with pytest.raises(KeyboardInterrupt):
            self.make(checkout)
        assert stages.current_environment(checkout, None) == {}

    @pytest.mark.parametrize("command", stages.EXTRA_LOCKS)
    def test_interrupted_addition_of_extra_packages_is_repeated_and_costs_nothing_else(
        self, checkout: Checkout, monkeypatch: pytest.MonkeyPatch, command: str
    ) -> None:
        stamp = self.make(checkout)
        packages = Path(checkout.venv, "lib", "python3.12", "site-packages")
        for name in ("there-1.0.dist-info", "broken-1.0.dist-info", "also_broken-1.0.dist-info"):
            (packages / name).mkdir(parents=True)
        (packages / "there-1.0.dist-info" / "RECORD").write_text("")
        found: list[list[str]] = []

        def interrupted(*_: object) -> None:
            assert stages.current_environment(checkout, None) == stamp
            found.append(sorted(path.name for path in packages.iterdir()))
            (packages / "broken-1.0.dist-info").mkdir()
            raise KeyboardInterrupt

        with monkeypatch.context() as patch:
            patch.setattr(stages, "install_locked", interrupted)
            for _ in range(2):
                with pytest.raises(KeyboardInterrupt):
                    stages.install_extra(checkout, command, os.environ, NO_LOCK)
                assert stages.current_environment(checkout, None) == stamp
        assert found == [["there-1.0.dist-info"]] * 2
        assert not Path(checkout.extra_stamp(stages.EXTRA_LOCKS[command])).exists()
        stages.install_extra(checkout, command, os.environ, NO_LOCK)
        assert stages.current_environment(checkout, None) == stamp
        assert Path(checkout.extra_stamp(stages.EXTRA_LOCKS[command])).exists()

    @pytest.mark.parametrize("name", [*stages.LOCKS, *stages.EXTRA_LOCKS.values()])
    def test_changed_lock_spoils_it(self, checkout: Checkout, name: str) -> None:
        self.make(checkout)
        for command in stages.EXTRA_LOCKS:
            stages.install_extra(checkout, command, os.environ, NO_LOCK)
        assert stages.current_environment(checkout, None)
        Path(checkout.lock(name)).write_text("more==1.0\n")
        assert stages.current_environment(checkout, None) == {}

    @pytest.mark.parametrize("name", stages.EXTRA_LOCKS.values())
    def test_extra_lock_does_not_matter_before_it_is_used(self, checkout: Checkout, name: str) -> None:
        self.make(checkout)
        Path(checkout.lock(name)).write_text("more==1.0\n")
        assert stages.current_environment(checkout, None)

    @pytest.mark.parametrize("command", stages.EXTRA_LOCKS)
    def test_only_the_lock_of_the_command_is_installed(
        self, checkout: Checkout, monkeypatch: pytest.MonkeyPatch, command: str
    ) -> None:
        self.make(checkout)
        installed: list[Sequence[str]] = []
        monkeypatch.setattr(stages, "install_locked", lambda _checkout, locks, *_others: installed.append(locks))
        for _ in range(2):  # the second time there is nothing left to do
            stages.install_extra(checkout, command, os.environ, NO_LOCK)
        assert installed == [(stages.EXTRA_LOCKS[command],)]

    def test_moved_checkout_spoils_it(self, checkout: Checkout, tmp_path: Path) -> None:
        self.make(checkout)
        moved = type(checkout)(str(tmp_path / "moved"))
        shutil.copytree(checkout.root, moved.root, ignore=shutil.ignore_patterns("moved"))
        assert stages.current_environment(moved, None) == {}

    def test_other_python_wanted_spoils_it(self, checkout: Checkout) -> None:
        self.make(checkout)
        assert stages.current_environment(checkout, self.PYTHON._replace(version="3.12.2")) == {}

    def test_python_that_is_gone_spoils_it(self, checkout: Checkout) -> None:
        self.make(checkout)
        Path(checkout.python).unlink()
        Path(checkout.python).symlink_to("/nowhere/python3.12")
        assert stages.current_environment(checkout, None) == {}

    def test_full_disk_is_refused_before_anything_starts(
        self, checkout: Checkout, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        usage = shutil.disk_usage(checkout.root)._replace(free=5_000_000)
        monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
        with pytest.raises(SetupError, match="has 5 MB free, the set-up needs") as caught:
            self.make(checkout)
        assert caught.value.status == UNSUITABLE
        assert not Path(checkout.venv).exists()


class TestLockFiles:
    def test_entry_of_one_package(self) -> None:
        wanted = "setuptools==79 \\\n    --hash=y \\\n    --hash=z\n"
        text = f"a==1 \\\n    --hash=x\n{wanted}setuptools-scm==8 \\\n    --hash=w\n"
        assert stages.locked_entry(text, "setuptools") == wanted

    def test_missing_entry(self) -> None:
        with pytest.raises(SetupError, match="does not pin setuptools"):
            stages.locked_entry("a==1\n", "setuptools")

    def test_locks_agree_and_name_no_place(self) -> None:
        pinned: dict[str, str] = {}
        for name in (*stages.LOCKS, *stages.EXTRA_LOCKS.values()):
            text = (SCRIPTS / "requirements" / name).read_text()
            assert "://" not in text
            assert "/home" not in text
            for line in text.splitlines():
                if line[0].isalnum():
                    requirement, _, marker = line.rstrip(" \\").partition(" ; ")
                    package, version = requirement.split("==")
                    assert pinned.setdefault(f"{package} ; {marker}", version) == version


def test_include_folders_are_replaced_once() -> None:
    built = "/opt/python/cp312-cp312"
    text = f'"{built}/include/python3.12;{built}/lib/python3.12/site-packages/numpy/_core/include"'
    once = stages.point_includes(text, "/usr/include/python3.12", "/co/numpy/_core/include")
    assert once == '"/usr/include/python3.12;/co/numpy/_core/include"'
    assert stages.point_includes(once, "/other", "/other") == once


def test_progress_of_pip() -> None:
    assert stages.pip_progress("Collecting a\nCollecting b\n") == "2 fetched"
    assert stages.pip_progress("Collecting a\nInstalling collected packages: a\n") == "unpacking"


class TestScript:
    @pytest.fixture
    def prepared(self, checkout: Checkout, swarm: ModuleType) -> Path:
        """A checkout in which all is done; its Python prints what it is started with."""
        root = Path(checkout.root)
        for name in ("swarm", "_setup"):
            source, target = SCRIPTS / name, root / "scripts" / name
            if source.is_dir():
                shutil.copytree(source, target, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                shutil.copy(source, target)
        write_command(root / ".venv" / "bin" / "python", 'echo "$*"; echo "$PYTHONPATH"')
        state.write_stamp(checkout.environment_stamp, key="key", version="3.12.1")
        state.write_stamp(checkout.snapshot, looks=swarm.look(checkout, {}), key="key")
        return root

    def start(self, root: Path, *arguments: str, **environ: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-S", str(root / "scripts" / "swarm"), *arguments]
        inherited = {"PATH": os.environ["PATH"], **environ}
        return subprocess.run(command, env=inherited, text=True, capture_output=True, check=False)

    def test_second_start_goes_straight_to_the_command_line(self, prepared: Path) -> None:
        ended = self.start(prepared, "run", "a b")
        assert ended.stderr == ""
        site_packages = prepared / "install" / "lib" / "python3.12" / "site-packages"
        assert ended.stdout.splitlines() == ["-m swarmabs_cli run a b", str(site_packages)]
        assert ended.returncode == 0

    def test_says_which_process_was_set_up_and_for_how_long(
        self, prepared: Path, swarm: ModuleType, monkeypatch: pytest.MonkeyPatch, checkout: Checkout
    ) -> None:
        started: list[Mapping[str, str]] = []
        now = iter([100.0, 185.25])
        monkeypatch.setattr(swarm.os, "execve", lambda _program, _words, environ: started.append(environ))
        monkeypatch.setattr(swarm.time, "monotonic", lambda: next(now))
        swarm.start(checkout, {"PATH": "/usr/bin"}, ["run"])
        assert started[0]["SWARMABS_SETUP"] == f"{os.getpid()}:85.250"

    @pytest.mark.parametrize(
        "change",
        [
            lambda root: (root / "src" / "alpha" / "code.py").write_text("VALUE = 3\n"),
            lambda root: (root / "src" / "alpha" / "new.py").write_text(""),
            lambda root: (root / "src" / "alpha" / "code.py").unlink(),
            lambda root: (root / "scripts" / "requirements" / "run.lock").write_text(""),
            lambda root: shutil.rmtree(root / ".venv"),
            lambda root: shutil.rmtree(root / "install"),
        ],
    )
    def test_any_change_is_seen(
        self, prepared: Path, swarm: ModuleType, checkout: Checkout, change: Callable[[Path], object]
    ) -> None:
        assert swarm.ready(checkout, swarm.look(checkout, {}), "run") == "3.12"
        change(prepared)
        assert not swarm.ready(checkout, swarm.look(checkout, {}), "run")

    @pytest.mark.parametrize(("command", "lock"), stages.EXTRA_LOCKS.items())
    def test_command_with_a_lock_of_its_own_is_ready_once_that_is_installed(
        self, prepared: Path, swarm: ModuleType, checkout: Checkout, command: str, lock: str
    ) -> None:
        looks = swarm.look(checkout, {})
        assert not swarm.ready(checkout, looks, command)
        state.write_stamp(checkout.extra_stamp(lock), key="key")
        assert swarm.ready(checkout, looks, command) == "3.12"
        for other, its_lock in stages.EXTRA_LOCKS.items():
            assert bool(swarm.ready(checkout, looks, other)) == (its_lock == lock)

    @pytest.mark.parametrize(
        ("words", "command"),
        [
            ("", ""),
            ("run --json", "run"),
            ("sweep x.yaml", "sweep"),
            ("export BAG -o out", ""),
            ("export BAG -o out --format csv", ""),
            ("export BAG -o out --format parquet", "export"),
            ("export --format=parquet BAG -o out", "export"),
            ("deploy FLEET.yaml -o out", "deploy"),
            ("deploy --check out --host robot-1", ""),
            ("deploy --schema", ""),
            ("run --view", "view"),
            ("run x.yaml --view --open", "view"),
            ("view BAG", "view"),
        ],
    )
    def test_only_what_needs_more_packages_gets_them(self, swarm: ModuleType, words: str, command: str) -> None:
        assert swarm.packages_for(words.split()) == command

    @pytest.mark.parametrize(
        ("words", "options"),
        [
            ("", []),
            ("run --markers", []),
            ("run x.yaml --markers --foxglove", ["foxglove"]),
            ("run --foxglove --foxglove-port 9000", ["foxglove"]),
            ("simulate --foxglove", []),
        ],
    )
    def test_options_that_need_more_packages(self, swarm: ModuleType, words: str, options: list[str]) -> None:
        assert swarm.options_for(words.split()) == options

    def test_refusal_is_one_line_and_leaves_no_environment(self, prepared: Path) -> None:
        shutil.rmtree(prepared / ".venv")
        ended = self.start(prepared, "run", SWARMABS_PYTHON="/nowhere/python3")
        assert ended.stderr == "swarm: SWARMABS_PYTHON=/nowhere/python3 does not start as a Python\n"
        assert ended.returncode == UNSUITABLE
        assert not (prepared / ".venv").exists()

    def test_sourced_ros_must_be_sourced(self, prepared: Path) -> None:
        ended = self.start(prepared, "run", SWARMABS_USE_SOURCED_ROS="1")
        assert "no ROS 2 Jazzy is sourced" in ended.stderr
        assert ended.returncode == UNSUITABLE

    def test_sourced_ros_builds_with_its_colcon_and_runs_its_python(self, prepared: Path) -> None:
        setup = "echo 'SOURCED=yes; export SOURCED'"
        colcon = f'echo "$*" > {prepared}/asked; {setup} > {prepared}/install/local_setup.bash'
        write_command(prepared / "bin" / "colcon", colcon)
        write_command(prepared / "bin" / "python3", 'echo "$SOURCED $*"')
        path = os.pathsep.join([str(prepared / "bin"), os.environ["PATH"]])
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
                assert waiting.stderr.read() == "swarm: interrupted; the next start goes on from here\n"
        assert waiting.returncode == FAILED
