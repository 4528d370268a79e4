"""Exports, read back by other libraries: every number has the bits of the message that was recorded."""

import csv
import json
import math
import struct
import sys
import tracemalloc
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader
from scipy.io import loadmat
from tests.frozen.command import swarm
from tests.swarmabs_analysis.figures.conftest import record
from tests.swarmabs_bag.conftest import SCENARIO
from tests.swarmabs_bag.realtime_bags import realtime_bag
from tests.swarmabs_bag.sample_run import make_run, make_step, write_bag

from swarmabs_analysis.comparison import compare_bags
from swarmabs_analysis.export import SUFFIXES, TABLES, export_arrays, export_tables
from swarmabs_analysis.export.matlab import write_mat
from swarmabs_bag.arrays import load_arrays
from swarmabs_bag.errors import BagTooLargeError, DamagedBagError
from swarmabs_core.errors import InputError, RunError
from swarmabs_core.messages import TOPIC_OF, AgentState, EventKind, PlaneState, SwarmEvent

PERIOD = 10_000_000
NEVER = 2**64 - 1
WORDS = {
    "kind": {1: "single_integrator", 2: "double_integrator", 7: "limit_hit"},
    "status": {1: "active"},
    "mode": {1: "run"},
}
ODD = (math.nan, math.inf, -0.0, 5e-324, 0.1 + 0.2, 1.7976931348623157e308)


RUN = [
    *(m._replace(angle=ODD[m.step]) if isinstance(m, PlaneState) and m.step < len(ODD) else m for m in make_run()),
    SwarmEvent(40_000_000, 4, 0, EventKind.LIMIT_HIT, -0.0, 'a "stop", reached\nat once – größer'),
    SwarmEvent(50_000_000, 2**64 - 1, 2**16 - 1, 2**8 - 1, 1.0, "the largest numbers there are"),
]


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bag(tmp_path_factory.mktemp("bag") / "bag", RUN, {"scenario.yaml": SCENARIO})


def bits(value: Any) -> Any:
    return struct.pack("<d", value) if isinstance(value, float) else value


def expected(table: Any) -> list[list[Any]]:
    """Return the rows of a table as bits, from the messages that went into the bag."""
    messages = [m for m in RUN if TOPIC_OF[type(m)] is table.topic]
    return [[bits(value_of(m, column.name)) for column in table.columns] for m in messages]


def read_csv(path: Path) -> list[list[str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.reader(file))


def value_of(message: Any, column: str) -> Any:
    times = {"time": message.step * PERIOD, "stamp": message.stamp}
    if column in times:
        return times[column] / 1e9
    if column == "reference":
        return 0.0  # the law of the scenario levels the plane
    value = getattr(message, column)
    return (
        WORDS[column].get(value, str(value))
        if column in WORDS
        else None
        if (column, value) == ("broadcast_step", NEVER)
        else value
    )


def test_csv_read_by_the_csv_module(bag: Path, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    files = export_tables(bag, tmp_path / "out", "csv")  # an empty folder is filled
    assert sorted(path.stem for path in files) == sorted([*(table.name for table in TABLES), "columns", "summary"])
    for table in TABLES:
        head, *rows = read_csv(tmp_path / "out" / f"{table.name}.csv")
        read = {"float64": float, "string": str, "word": str}
        kinds = [read.get(column.type, int) for column in table.columns]
        assert head == [column.name for column in table.columns]
        cells = [[bits(kind(text) if text else None) for kind, text in zip(kinds, row, strict=True)] for row in rows]
        assert [[None if bit == "" else bit for bit in row] for row in expected(table)] == cells
    described = read_csv(tmp_path / "out" / "columns.csv")
    assert described == [
        ["table", "column", "type", "unit", "meaning"],
        *([table.name, *column] for table in TABLES for column in table.columns),
    ]
    assert ["agents", "time", "float64", "s", "time of the step; in real time the stamp"] in described
    assert ["desired", "mode", "word", "", "one of run, stop, reset"] in described


def test_parquet_read_by_pyarrow(bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("swarmabs_analysis.export.tables.PARQUET_ROWS", 7)
    export_tables(bag, tmp_path / "out", "parquet")
    for table in TABLES:
        read = pq.read_table(tmp_path / "out" / f"{table.name}.parquet")
        assert [str(kind) for kind in read.schema.types] == [
            {"float64": "double", "word": "dictionary<values=string, indices=int32, ordered=0>"}.get(c.type, c.type)
            for c in table.columns
        ]
        assert [field.metadata.get(b"unit", b"").decode() for field in read.schema] == [c.unit for c in table.columns]
        assert [[bits(value) for value in row.values()] for row in read.to_pylist()] == expected(table)


def test_numpy_has_every_array_of_the_run(bag: Path, tmp_path: Path) -> None:
    file = export_arrays(bag, tmp_path / "new" / "run.npz")
    arrays = load_arrays(bag)
    with np.load(file, allow_pickle=False) as read:
        units = json.loads(str(read["units"]))
        assert set(units) == set(read.files) - {"units", "words", "summary"}
        assert units["agents_position"] == "m"
        for path in (
            *("angle", "time", "abstract.torque_rate", "auxiliary.s3", "desired.mean_inertia_rate"),
            *("agents.position", "agents.ids"),
        ):
            array, exported = attrgetter(path)(arrays), read[path.replace(".", "_")]
            assert (exported.tobytes(), exported.shape) == (array.tobytes(), array.shape)


def doubles(file: Path) -> dict[str, tuple[tuple[int, ...], bytes]]:
    """Return shape and bytes of each array of float64 in a MAT file, read by the published format."""
    data = file.read_bytes()
    assert data[124:128] == b"\x00\x01IM"  # level 5, little-endian
    variables, place = {}, 128
    while place < len(data):
        kind, size = struct.unpack_from("<II", data, place)
        assert kind == 14, "not a matrix"
        inside, end = place + 8, place + 8 + size
        parts: list[bytes] = []
        while inside < end and len(parts) < 4:
            small = struct.unpack_from("<HH", data, inside)
            length, head = (small[1], 4) if small[1] else (struct.unpack_from("<I", data, inside + 4)[0], 8)
            parts.append(data[inside + head : inside + head + length])
            inside += 8 if head == 4 else 8 + -(-length // 8) * 8
        if parts[0][0] == 6:  # double
            shape = struct.unpack(f"<{len(parts[1]) // 4}i", parts[1])
            variables[parts[2].decode()] = (shape, parts[3])
        place = end
    return variables


def test_matlab_files_have_every_bit_texts_as_cells_and_no_time_of_writing(bag: Path, tmp_path: Path) -> None:
    file = export_arrays(bag, tmp_path / "run.mat", "mat")
    assert file.read_bytes()[:116] == b"MATLAB 5.0 MAT-file, written by swarmabs".ljust(116)
    arrays_read = doubles(file)
    angle = [m.angle for m in RUN if isinstance(m, PlaneState)]
    assert arrays_read["angle"] == ((len(angle), 1), struct.pack(f"<{len(angle)}d", *angle))
    read = loadmat(file, simplify_cells=True)
    robots = read["agents_ids"].tolist()
    by_robot = [[m.position for m in RUN if isinstance(m, AgentState) and m.agent_id == robot] for robot in robots]
    values = [position for robot in by_robot for position in robot]  # a column per robot, stored column by column
    assert arrays_read["agents_position"] == ((len(angle), 3), struct.pack(f"<{len(values)}d", *values))
    assert read["events_detail"].tolist() == [m.detail for m in RUN if isinstance(m, SwarmEvent)]
    with np.load(export_arrays(bag, tmp_path / "run.npz")) as arrays:
        assert {name for name in read if not name.startswith("__")} == set(arrays.files)
        units = json.loads(str(arrays["units"]))
        assert {name: unit if len(unit) else "" for name, unit in read["units"].items()} == units
        summary = json.loads(str(arrays["summary"]))
        assert {name: None if np.size(value) == 0 else value for name, value in read["summary"].items()} == summary
    assert read["words"]["agents_kind"] == {"single_integrator": 1, "double_integrator": 2}


def test_names_that_matlab_does_not_allow_are_replaced_and_stay_different(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    values = {"plane.angle": 1.0, "plane_angle": 2.0, "_x": 3.0, "9": 4.0, "n" * 70: 5.0, "n" * 71: 6.0}
    with (tmp_path / "x.mat").open("wb") as stream:
        write_mat(stream, {**values, "none": None})
    read = loadmat(tmp_path / "x.mat", simplify_cells=True)
    names = ["plane_angle", "plane_angle_2", "x_x", "x9", "n" * 63, f"{'n' * 59}_2"]
    assert [read[name] for name in names] == list(values.values())
    assert read["none"].size == 0
    monkeypatch.setattr("swarmabs_analysis.export.matlab.LARGEST", 16)
    with (tmp_path / "y.mat").open("wb") as stream, pytest.raises(InputError, match=r"long has .* GB, too much for"):
        write_mat(stream, {"long": np.zeros(2)})


def test_numpy_has_the_events_without_pickle_or_empty_columns(bag: Path, tmp_path: Path) -> None:
    events = [m for m in RUN if isinstance(m, SwarmEvent)]
    assert len({len(event.detail) for event in events}) == len(events) > 1
    with np.load(export_arrays(bag, tmp_path / "run.npz"), allow_pickle=False) as read:
        assert all(read[name].dtype.kind in "iufU" for name in read.files)
        for name in ("step", "agent_id", "kind", "value", "detail"):
            values = read[f"events_{name}"].tolist()
            assert [bits(value) for value in values] == [bits(getattr(event, name)) for event in events]
        assert read["events_time"].tolist() == [event.step * PERIOD / 1e9 for event in events]
        assert read["events_stamp"].tolist() == [event.stamp / 1e9 for event in events]
    quiet = write_bag(tmp_path / "bag", [m for m in RUN if not isinstance(m, SwarmEvent)])
    with np.load(export_arrays(quiet, tmp_path / "quiet.npz"), allow_pickle=False) as read:
        assert [read[name].shape for name in read.files if name.startswith("events_")] == [(0,)] * 7


def test_every_export_has_words_reference_missing_values_and_the_summary_of_the_run(tmp_path: Path) -> None:
    faults = "faults=[{kind: reference, at: 0.1, until: 0.2, offset: 0.05}, {kind: kill, agent: 3, at: 0.15}]"
    folder = record(tmp_path / "run", "pd_het_4", faults)
    wanted = [0.05 if 10 <= step < 20 else 0.0 for step in range(31)]
    run = load_arrays(folder)
    (path,) = folder.glob("bag/*.mcap")
    with path.open("rb") as stream:
        recorded = sum(1 for _ in make_reader(stream).iter_messages())
    error = np.array(wanted) - run.angle
    summary = run.summary()
    assert summary["messages"] == recorded
    assert summary["digest"] == compare_bags(folder, folder).a.digest
    assert summary["rms_error"] == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-12)
    assert (summary["final_error"], summary["settled_at"]) == (error[-1], None)
    assert summary["max_abs_position"] == np.nanmax(np.abs(run.agents.position))

    for table_format in ("csv", "parquet"):
        out = tmp_path / table_format
        export_tables(folder, out, "csv" if table_format == "csv" else "parquet")
        assert json.loads((out / "summary.json").read_text()) == summary
    head, *plane = read_csv(tmp_path / "csv" / "plane.csv")
    assert [float(row[head.index("reference")]) for row in plane] == run.reference.tolist() == wanted
    agents = pq.read_table(tmp_path / "parquet" / "agents.parquet").to_pydict()
    assert agents["broadcast_step"] == [None if step == 0 else step - 1 for step in agents["step"]]
    assert set(agents["kind"]) == {"single_integrator", "double_integrator"}
    events = pq.read_table(tmp_path / "parquet" / "events.parquet").to_pydict()
    assert [(e.step, e.kind, e.agent or 0, e.value, e.detail) for e in run.events] == list(
        zip(*(events[name] for name in ("step", "kind", "agent_id", "value", "detail")), strict=True)
    )
    assert {("steering", None), ("dead", 3)} <= {(event.kind, event.agent) for event in run.events}
    with np.load(export_arrays(folder, tmp_path / "run.npz")) as read:
        assert (json.loads(str(read["summary"])), read["reference"].tolist()) == (summary, wanted)
        assert json.loads(str(read["words"]))["agents_kind"] == {"1": "single_integrator", "2": "double_integrator"}
        steps = read["agents_broadcast_step"]
        assert np.isnan(steps[0]).all()
        assert steps[1:, 0].tolist() == list(range(30))


def test_times_are_those_of_the_step_whatever_a_clock_says_or_the_stamp_without_a_period(tmp_path: Path) -> None:
    offset = "faults=[{kind: clock_offset, agent: 1, offset: -0.25}]"
    export_tables(record(tmp_path / "run", "pd_het_4", offset), tmp_path / "out", "csv")
    of_robot = [row for row in read_csv(tmp_path / "out" / "agents.csv") if row[2] == "1"]
    shown = [(*row[:2], row[-1]) for row in of_robot[:3]]
    assert shown == [("0", "0.0", "-0.25"), ("1", "0.01", "-0.24"), ("2", "0.02", "-0.23")]
    # Nobody says how long a step is: another recorder attaches no scenario.
    export_tables(write_bag(tmp_path / "bag", make_run(3)), tmp_path / "bare", "csv")
    _, *rows = read_csv(tmp_path / "bare" / "plane.csv")
    assert [row[1] for row in rows] == [row[-1] for row in rows] == ["0.0", "0.01", "0.02", "0.03"]


def test_times_of_a_run_in_real_time_count_from_its_first_step(tmp_path: Path) -> None:
    bag = realtime_bag(tmp_path / "bag", "deaths")
    run = load_arrays(bag)
    assert len(run.events) > 1 and run.time[0] == 0.0
    with np.load(export_arrays(bag, tmp_path / "run.npz")) as read:
        assert sorted(read["events_time"].tolist()) == sorted(event.time for event in run.events)
        assert read["time"].tolist() == run.time.tolist()


def test_texts_that_would_not_fit_into_memory_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One long text makes all of them as wide."""
    event = SwarmEvent(0, 0, 1, EventKind.LIMIT_HIT, 0.0, "short")
    run = [*make_run(1), *[event._replace(value=float(n)) for n in range(2000)], event._replace(detail="x" * 10**6)]
    long = write_bag(tmp_path / "bag", run)
    monkeypatch.setattr("swarmabs_analysis.export.arrays.available_memory", lambda: 7 * 10**9)
    with pytest.raises(BagTooLargeError, match="its events need about 8004 MB as arrays, but only 7000 MB are free"):
        export_arrays(long, tmp_path / "run.npz")
    assert [path.name for path in tmp_path.iterdir()] == ["bag"]


@pytest.mark.parametrize("file_format", ["csv", "parquet", "numpy", "mat"])
def test_nothing_is_overwritten_and_nothing_left_of_a_damaged_bag(bag: Path, tmp_path: Path, file_format: str) -> None:
    name = f"out{dict(SUFFIXES).get(file_format, '')}"  # type: ignore[call-overload]
    words = ("export", bag, "--format", file_format, "-o", name)
    assert swarm(words, tmp_path).code == 0
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    again = swarm(words, tmp_path)
    assert again.code == 2
    assert "exists; name another" in again.err
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before

    data = bytearray(next(bag.glob("*.mcap")).read_bytes())
    place = len(data) // 2
    data[place : place + 64] = bytes(64)
    (tmp_path / "damaged.mcap").write_bytes(data)
    assert swarm(("export", "damaged.mcap", "--format", file_format, "-o", f"second-{name}"), tmp_path).code == 1
    assert {path.name for path in tmp_path.iterdir()} == {name, "damaged.mcap"}


def test_a_full_disk_leaves_nothing_and_without_pyarrow_the_remedy_is_named(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("swarmabs_analysis.export.tables.write_columns", full)
    with pytest.raises(RunError, match=r"cannot write .*: No space left on device; export to another disk with -o"):
        export_tables(bag, tmp_path / "out", "csv")
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(InputError, match=r"Parquet needs the Python package pyarrow; .*pip install pyarrow$"):
        export_tables(bag, tmp_path / "out", "parquet")
    assert not list(tmp_path.iterdir())


def test_the_ending_tells_the_format(bag: Path, tmp_path: Path) -> None:
    for name, begin in (("run.npz", b"PK"), ("run.mat", b"MATLAB 5.0")):
        assert swarm(("export", bag, "-o", name), tmp_path).code == 0
        assert (tmp_path / name).read_bytes().startswith(begin)
    assert swarm(("export", bag, "-o", "tables"), tmp_path).code == 0
    assert (tmp_path / "tables" / "plane.csv").is_file()
    refused = swarm(("export", bag, "--format", "mat", "-o", "run.npz"), tmp_path)
    assert (refused.code, "does not end in .mat; name a file such as run.mat" in refused.err) == (2, True)


@pytest.mark.parametrize("words", [("run.parquet",), ("run.csv",), ("run.mat", "--format", "csv")])
def test_a_folder_of_tables_is_not_named_like_a_file(bag: Path, tmp_path: Path, words: tuple[str, ...]) -> None:
    refused = swarm(("export", bag, "-o", *words), tmp_path)
    assert refused.code == 2
    assert f"error: {words[0]} is named like a file, and tables are written to a folder; name one" in refused.err
    assert "such as run, and the format with --format csv or parquet" in refused.err
    assert not (tmp_path / words[0]).exists()


def test_what_is_no_bag_or_no_npz_is_refused(bag: Path, tmp_path: Path) -> None:
    assert swarm(("export", tmp_path, "-o", "out"), tmp_path).code == 2
    with pytest.raises(InputError, match=r"does not end in .npz; name a file such as"):
        export_arrays(bag, tmp_path / "out")
    (tmp_path / "cut.mcap").write_bytes(next(bag.glob("*.mcap")).read_bytes()[:-100])
    with pytest.raises(DamagedBagError):
        export_tables(tmp_path / "cut.mcap", tmp_path / "out", "csv")


def test_the_memory_for_tables_does_not_grow_with_the_run(tmp_path: Path) -> None:
    def most(steps: int) -> int:
        messages = (message for step in range(steps) for message in make_step(step))
        long = write_bag(tmp_path / f"bag_{steps}", messages, chunk_bytes=20_000)
        tracemalloc.start()
        export_tables(long, tmp_path / f"out_{steps}", "csv")
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return peak

    assert most(1200) < 1.2 * most(400)
