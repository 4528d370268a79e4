"""The processes of a run: found by its folder, named by their logs, asked to end, and what they leave behind."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil
import pytest
from rich.console import Console
from tests.processes import until

from swarmabs_core.errors import InputError
from swarmabs_fleet.operate import target
from swarmabs_run import tracing_files
from swarmabs_run.ending import end_asked, interrupt_once, no_more_interrupts, terminable
from swarmabs_run.orchestration import run_files
from swarmabs_run.orchestration.network import FIRST_FREE, profile_xml
from swarmabs_run.processes import ProcessMonitor, ProcessState
from swarmabs_run.tracing_files import tracing_files_removed
from swarmabs_view.terminal import ProcessTable, watch_run

SWARM = [sys.executable, "-m", "swarmabs_cli"]
NODES = {"plane_sim", "abstraction_observer", "parent_controller", "recorder"}
NODES |= {f"agent_00{agent}" for agent in (1, 2, 3, 4)}


def folder_of(tmp_path: Path, name: str = "run") -> Path:
    """Return the folder of a run that this process has started."""
    logs = tmp_path / name / "logs"
    logs.mkdir(parents=True)
    run_files.write_network(logs, 5, 12)
    return logs.parent


def test_processes_are_monitored_until_they_are_gone_and_not_mistaken(monkeypatch: pytest.MonkeyPatch) -> None:
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as child:
        monitor = ProcessMonitor({"child": child.pid, "own": os.getpid(), "nobody": 2**22 + 1})
        until(lambda: monitor.states()[0].state == "sleeping", "the child waits")
        until(lambda: monitor.states()[1].cpu, "the time that a query takes shows in the next")
        alive, _, nobody = monitor.states()
        assert (alive.name, alive.pid) == ("child", child.pid)
        assert alive.memory == pytest.approx(psutil.Process(child.pid).memory_info().rss, rel=0.2)
        assert nobody == ProcessState("nobody", 2**22 + 1, "gone", None, None)
        child.kill()
        child.wait()
        assert monitor.states()[0] == ProcessState("child", child.pid, "gone", None, None)
    monkeypatch.setattr(psutil.Process, "is_running", lambda _: False)  # the id is that of another process
    assert [one.state for one in monitor.states()] == ["gone"] * 3


def test_progress_is_written_now_and_then(tmp_path: Path) -> None:
    file = run_files.ProgressFile(tmp_path)
    file.update("starting", 0, 100, 10.0)
    assert run_files.read_progress(tmp_path) == run_files.ProgressReport("starting", 0, 100, None, 10.0)
    file.update("running", 0, 100, 10.1)  # the phase is another one
    file.update("running", 30, 100, 10.2)
    assert run_files.read_progress(tmp_path) == run_files.ProgressReport("running", 0, 100, None, 10.1)
    file.update("running", 50, 100, 10.1 + run_files.PROGRESS_INTERVAL)
    told = run_files.read_progress(tmp_path)
    assert told is not None and told.step_rate == pytest.approx(50 / run_files.PROGRESS_INTERVAL)
    file.update("closing", 60, 100, told.told_at)  # no time has passed
    assert run_files.read_progress(tmp_path) == run_files.ProgressReport("closing", 60, 100, None, told.told_at)
    file.over()
    told = run_files.read_progress(tmp_path)
    assert told is not None and told[:4] == ("over", 60, 100, None)
    assert [path.name for path in tmp_path.iterdir()] == ["progress.json"]
    run_files.ProgressFile(tmp_path / "nowhere").update("running", 1, 2, 3.0)  # a full disk does not end the run


def test_folders_that_are_damaged_or_without_a_run_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is not the folder of a run with processes"):
        watch_run(tmp_path)
    folder = folder_of(tmp_path)
    for content in ("", "[]", "{}", "null", '{"orchestrator": null}', '{"orchestrator": "x"}'):
        (folder / "logs" / "network.json").write_text(content, encoding="utf-8")
        with pytest.raises(InputError, match=r"network\.json.*not written by a run"):
            watch_run(folder)


def test_a_process_that_has_got_the_id_later_is_not_the_run(tmp_path: Path) -> None:
    folder = folder_of(tmp_path)
    assert run_files.is_running(folder)
    network = folder / "logs" / "network.json"
    written = json.loads(network.read_text())
    network.write_text(json.dumps(written | {"started": written["started"] - 1}))
    for look in (watch_run, run_files.environment_of_run):
        with pytest.raises(run_files.RunOverError, match="this run is over"):
            look(folder)


def drawn(table: ProcessTable, now: float) -> list[str]:
    """Return the lines of a table that was updated at a time."""
    console = Console(width=200)
    with console.capture() as capture:
        table.update(now)
        console.print(table)
    return [line.rstrip() for line in capture.get().splitlines()]


def test_a_run_that_says_that_it_is_over_is_over(tmp_path: Path) -> None:
    """The process that has started it may live on, such as a notebook."""
    folder = folder_of(tmp_path)
    with pytest.raises(InputError, match="operator commands need a realtime run"), target(folder):
        pass
    table = ProcessTable(folder)
    file = run_files.ProgressFile(folder / "logs")
    file.update("running", 0, 100, 10.0)
    file.update("running", 60, 100, 11.0)
    assert drawn(table, 11.5)[0] == f"{folder}: running, step 60 of 100, 60 steps/s"
    assert drawn(table, 20.0)[0] == f"{folder}: running, step 60 of 100", "the speed of a run that stalls is not known"
    run_files.write_processes(folder / "logs", {"plane_sim": 2**22 + 1})
    _, _, own, gone = drawn(table, 20.0)
    assert (own.split()[:2], gone.split()) == (
        ["orchestrator", str(os.getpid())],
        ["plane_sim", str(2**22 + 1), "gone"],
    )
    environment = run_files.environment_of_run(folder)
    assert environment["ROS_DOMAIN_ID"] == "5"
    profile = Path(environment["FASTDDS_DEFAULT_PROFILES_FILE"])
    assert profile.read_text() == profile_xml(5, peers=range(12), participant=FIRST_FREE)
    file.over()
    assert not run_files.is_running(folder)
    with pytest.raises(run_files.RunOverError):
        run_files.environment_of_run(folder)
    with pytest.raises(run_files.RunOverError), target(folder):
        pass


def test_the_start_of_a_process_is_the_kernels() -> None:
    ticks, hertz = run_files.start_of(os.getpid()), os.sysconf("SC_CLK_TCK")
    assert ticks is not None
    assert psutil.Process().create_time() == pytest.approx(psutil.boot_time() + ticks / hertz, abs=1.0)
    assert run_files.start_of(2**22 + 1) is None


@pytest.mark.system
@pytest.mark.timeout(300)
def test_a_run_is_watched_in_another_terminal(tmp_path: Path, nothing_survives: str) -> None:
    words = [*SWARM, "run", "--duration", "10000", "--no-bag", "-o", "run"]
    watch = [*SWARM, "view", "--live", "run", "--terminal"]
    with subprocess.Popen(words, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as run:
        logs = tmp_path / "run" / "logs"
        try:
            until(lambda: (told := run_files.read_progress(logs)) is not None and told.step > 100, "steps", 60.0)
            with subprocess.Popen(watch, cwd=tmp_path, stdout=subprocess.PIPE, text=True) as watching:
                assert watching.stdout is not None
                title, heading, *rows = [watching.stdout.readline() for _ in range(4 + len(NODES))]
                assert title.startswith("run: running, step ") and title.endswith(" steps/s\n")
                assert heading.split() == ["process", "pid", "CPU", "%", "memory", "MB", "state"]
                shown = {row.split()[0]: row.split() for row in rows}
                assert shown.keys() == NODES | {"orchestrator", "launcher"}
                children = {child.pid for child in psutil.Process(run.pid).children(recursive=True)}
                assert {int(pid) for _, pid, *_ in shown.values()} <= {run.pid, *children}
                assert all(float(memory) > 1.0 for _, _, _, memory, _ in shown.values())
                run.send_signal(signal.SIGINT)
                rest, _ = watching.communicate(timeout=60)
            assert (watching.returncode, rest.splitlines()[-1:]) == (0, ["run: the run has ended"])
        finally:
            run.send_signal(signal.SIGINT)
            run.communicate(timeout=60)
    over = subprocess.run(watch, cwd=tmp_path, check=False, capture_output=True, text=True, timeout=60)
    assert (over.returncode, over.stderr) == (
        2,
        "error: run: this run is over; view its bag with ./scripts/swarm view run\n",
    )


ASKING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@pytest.fixture
def handlers() -> Iterator[list[object]]:
    before = {number: signal.signal(number, signal.SIG_IGN) for number in ASKING}
    yield [signal.SIG_IGN] * len(ASKING)
    for number, handler in before.items():
        signal.signal(number, handler)


def current() -> list[object]:
    return [signal.getsignal(number) for number in ASKING]


@pytest.mark.parametrize("number", ASKING)
def test_a_signal_is_noted_or_interrupts_while_that_is_wanted(number: int, handlers: list[object]) -> None:
    with end_asked() as asked:
        assert not asked()
        signal.raise_signal(number)
        assert asked()
    assert current() == handlers
    with pytest.raises(KeyboardInterrupt), terminable():
        signal.raise_signal(number)
    assert current() == handlers
    interrupt_once()
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(number)
    for later in ASKING:
        signal.raise_signal(later)


def test_beside_the_main_thread_signals_are_left_alone(handlers: list[object]) -> None:
    def during() -> tuple[bool, list[object]]:
        with end_asked() as asked:
            return asked(), current()

    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(during).result() == (False, handlers)
    # Who has not asked for interrupts keeps its own.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    no_more_interrupts()
    assert current()[0] is signal.default_int_handler


_MAPPER = (
    "import mmap, sys; f = open(sys.argv[1], 'r+b'); m = mmap.mmap(f.fileno(), 0); f.close();"
    "print('mapped', flush=True); sys.stdin.read()"
)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(tracing_files, "SHARED_MEMORY", tmp_path)
    return tmp_path


def tracing_file(folder: Path, name: str = "lttng-ust-wait-6") -> Path:
    path = folder / name
    path.write_bytes(bytes(4096))
    return path


@contextmanager
def mapped(path: Path) -> Iterator[None]:
    """Let another process map a file, as a program does that has loaded rclpy."""
    words = [sys.executable, "-c", _MAPPER, str(path)]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None and process.stdout.readline() == b"mapped\n"
        yield
        process.communicate()


def test_files_from_before_and_from_the_block_are_removed_also_after_an_error(folder: Path) -> None:
    tracing_file(folder, "lttng-ust-wait-5")
    with suppress(KeyboardInterrupt), tracing_files_removed():
        tracing_file(folder)
        raise KeyboardInterrupt
    assert not list(folder.iterdir())


def test_a_file_that_another_program_uses_stays_until_the_last_one_ends(folder: Path) -> None:
    with tracing_files_removed():
        path = tracing_file(folder)
        other = mapped(path)
        other.__enter__()
    assert path.exists(), "it was made in the block, but another program uses it now"
    with tracing_files_removed():
        other.__exit__(None, None, None)
    assert not path.exists()


def test_shared_files_stay_where_their_users_are_unknown(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    other, shared = tracing_file(folder, "someone-elses"), tracing_file(folder)
    own = tracing_file(folder, f"lttng-ust-wait-6-{tracing_files.os.getuid()}")
    with monkeypatch.context() as patch:
        patch.setattr(tracing_files, "mapped_by_others", lambda: (set(), True))
        with tracing_files_removed():
            new = tracing_file(folder, "lttng-ust-wait-8")
    assert [path.exists() for path in (other, shared, own)] == [True, True, False]
    assert not new.exists(), "nobody else can have had the time to use it"
    with tracing_files_removed():
        theirs = tracing_file(folder, "lttng-ust-wait-9")
        monkeypatch.setattr(tracing_files.os, "getuid", lambda: 12345)
    assert other.exists() and theirs.exists()


def test_a_living_parent_removes_the_files_of_a_process(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with tracing_files_removed(if_orphaned=True):
        path = tracing_file(folder)
    assert path.exists()
    with tracing_files_removed(if_orphaned=True):
        monkeypatch.setattr(tracing_files.os, "getppid", lambda: 1)
    assert not path.exists()
