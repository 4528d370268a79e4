"""Exports, read back by other libraries: every number has the bits of the message that was recorded."""

from __future__ import annotations

import csv
import json
import math
import struct
import sys
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from tests.swarmabs_analysis.figures.conftest import record
from tests.swarmabs_bag.conftest import SCENARIO
from tests.swarmabs_bag.sample_run import changed, make_run, make_step, write_bag
from tests.swarmabs_msgs.definitions import DEFINITIONS

from swarmabs_analysis.export import TABLES, export_arrays, export_tables
from swarmabs_bag.arrays import load_arrays
from swarmabs_bag.errors import BagTooLargeError, DamagedBagError
from swarmabs_cli import main
from swarmabs_core.errors import InputError, RunError
from swarmabs_core.messages import TOPIC_OF, EventKind, Message, PlaneState, SwarmEvent

PERIOD = 10_000_000
ODD = (math.nan, math.inf, -0.0, 5e-324, 0.1 + 0.2, 1.7976931348623157e308)


def run_with_odd_numbers() -> list[Message]:
    run = make_run()
    for state, angle in zip([m for m in run if isinstance(m, PlaneState)], ODD, strict=False):
        run = changed(run, state, angle=angle)
    return [
        *run,
        SwarmEvent(40_000_000, 4, 0, EventKind.LIMIT_HIT, -0.0, 'a "stop", reached\nat once – größer'),
        SwarmEvent(50_000_000, 2**64 - 1, 2**16 - 1, 2**8 - 1, 1.0, "the largest numbers there are"),
    ]


RUN = run_with_odd_numbers()


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bag(tmp_path_factory.mktemp("bag") / "bag", RUN, {"scenario.yaml": SCENARIO})


def bits(value: Any) -> Any:
    return struct.pack("<d", value) if isinstance(value, float) else value


def expected(table: Any) -> list[list[Any]]:
    """Return the rows of a table as bits, from the messages that went into the bag."""
    messages = [m for m in RUN if TOPIC_OF[type(m)] is table.topic]
    names = [column.name for column in table.columns]
    return [[bits(value_of(m, n)) for n in names] for m in messages]


def value_of(message: Any, column: str) -> Any:
    times = {"time": message.step * PERIOD, "stamp": message.stamp}
    return times[column] / 1e9 if column in times else getattr(message, column)


def test_csv_read_by_the_csv_module(bag: Path, tmp_path: Path) -> None:
    export_tables(bag, tmp_path / "out", "csv")
    for table in TABLES:
        with (tmp_path / "out" / f"{table.name}.csv").open(newline="", encoding="utf-8") as file:
            head, *rows = csv.reader(file)
        read = {"float64": float, "string": str}
        kinds = [read.get(column.type, int) for column in table.columns]
        assert head == [column.name for column in table.columns]
        assert [[bits(kind(text)) for kind, text in zip(kinds, row, strict=True)] for row in rows] == expected(table)


def test_parquet_read_by_pyarrow(bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("swarmabs_analysis.export.tables._PARQUET_ROWS", 7)
    export_tables(bag, tmp_path / "out", "parquet")
    for table in TABLES:
        read = pq.read_table(tmp_path / "out" / f"{table.name}.parquet")
        assert [str(kind) for kind in read.schema.types] == [
            {"float64": "double"}.get(column.type, column.type) for column in table.columns
        ]
        assert [field.metadata.get(b"unit", b"").decode() for field in read.schema] == [c.unit for c in table.columns]
        assert [[bits(value) for value in row.values()] for row in read.to_pylist()] == expected(table)


def test_numpy_has_every_array_of_the_run(bag: Path, tmp_path: Path) -> None:
    file = export_arrays(bag, tmp_path / "new" / "run.npz")
    arrays = load_arrays(bag)
    with np.load(file, allow_pickle=False) as read:
        units = json.loads(str(read["units"]))
        assert set(units) == set(read.files) - {"units"}
        assert units["agents_position"] == "m"
        for name, array in (
            ("angle", arrays.angle),
            ("time", arrays.time),
            ("abstract_torque_rate", arrays.abstract.torque_rate),
            ("auxiliary_s3", arrays.auxiliary.s3),
            ("desired_mean_inertia_rate", arrays.desired.mean_inertia_rate),
            ("agents_position", arrays.agents.position),
            ("agents_ids", arrays.agents.ids),
        ):
            assert read[name].tobytes() == array.tobytes()
            assert read[name].shape == array.shape


def test_numpy_has_the_events_without_pickle(bag: Path, tmp_path: Path) -> None:
    events = [m for m in RUN if isinstance(m, SwarmEvent)]
    assert len({len(event.detail) for event in events}) == len(events) > 1
    with np.load(export_arrays(bag, tmp_path / "run.npz"), allow_pickle=False) as read:
        assert all(read[name].dtype.kind in "iufU" for name in read.files)
        for name in ("step", "agent_id", "kind", "value", "detail"):
            found = read[f"events_{name}"].tolist()
            assert [bits(value) for value in found] == [bits(getattr(event, name)) for event in events]
        assert read["events_time"].tolist() == [event.step * PERIOD / 1e9 for event in events]
        assert read["events_stamp"].tolist() == [event.stamp / 1e9 for event in events]


def test_a_wrong_clock_changes_stamps_and_no_times(tmp_path: Path) -> None:
    offset = "faults=[{kind: clock_offset, agent: 1, offset: -0.25}]"
    export_tables(record(tmp_path / "run", "pd_het_4", offset), tmp_path / "out", "csv")
    with (tmp_path / "out" / "agents.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["agent_id"] == "1"]
    assert [(row["step"], row["time"], row["stamp"]) for row in rows[:3]] == [
        ("0", "0.0", "-0.25"),
        ("1", "0.01", "-0.24"),
        ("2", "0.02", "-0.23"),
    ]


def test_without_a_period_the_stamp_is_the_time(tmp_path: Path) -> None:
    """Nobody says how long a step is: another recorder attaches no scenario."""
    export_tables(write_bag(tmp_path / "bag", make_run(3)), tmp_path / "out", "csv")
    with (tmp_path / "out" / "plane.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["time"] for row in rows] == [row["stamp"] for row in rows] == ["0.0", "0.01", "0.02", "0.03"]


def test_numpy_without_events_has_empty_columns(tmp_path: Path) -> None:
    quiet = write_bag(tmp_path / "bag", [m for m in RUN if not isinstance(m, SwarmEvent)])
    with np.load(export_arrays(quiet, tmp_path / "run.npz"), allow_pickle=False) as read:
        shapes = {name: read[name].shape for name in read.files if name.startswith("events_")}
    assert set(shapes.values()) == {(0,)}
    assert len(shapes) == 7


def test_texts_that_would_not_fit_into_memory_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One long text makes all of them as wide."""
    event = SwarmEvent(0, 0, 1, EventKind.LIMIT_HIT, 0.0, "short")
    run = [*make_run(1), *[event._replace(value=float(n)) for n in range(2000)], event._replace(detail="x" * 10**6)]
    long = write_bag(tmp_path / "bag", run)
    monkeypatch.setattr("swarmabs_analysis.export.arrays.available_memory", lambda: 7 * 10**9)
    with pytest.raises(BagTooLargeError, match="its events take about 8004 MB as arrays, but 7000 MB are free; export"):
        export_arrays(long, tmp_path / "run.npz")
    assert [path.name for path in tmp_path.iterdir()] == ["bag"]


def test_units_are_those_of_the_message_definitions() -> None:
    """A comment in a definition begins with the unit."""
    for table in TABLES:
        fields = {field.name: field for field in DEFINITIONS[table.topic.message.__name__].fields}
        columns = {column.name: column for column in table.columns if column.name not in {"time", "stamp"}}
        assert set(columns) == set(fields) - {"header"}
        for name, column in columns.items():
            assert column.type == fields[name].type
            if column.type == "float64" and name not in {"command", "value"}:
                assert fields[name].comment.startswith(column.unit)
                rest = fields[name].comment[len(column.unit) :]
                assert not rest or rest.startswith((",", " along"))


def test_columns_are_described_beside_the_tables(bag: Path, tmp_path: Path) -> None:
    export_tables(bag, tmp_path / "out", "csv")
    with (tmp_path / "out" / "columns.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["table"], row["column"], row["unit"]) for row in rows] == [
        (table.name, column.name, column.unit) for table in TABLES for column in table.columns
    ]


def test_every_constant_of_a_definition_is_in_the_meaning_of_its_column() -> None:
    """By name and number, and no other: a mode that is not explained is one that readers misjudge."""
    owners = {"AgentState": {"kind": range(2), "status": range(2, 5)}}
    for table in TABLES:
        definition = DEFINITIONS[table.topic.message.__name__]
        constants = [f"{c.value}: {c.name.lower().replace('_', ' ')}" for c in definition.constants]
        for name in {"kind", "status", "mode"} & {column.name for column in table.columns}:
            (meaning,) = (column.meaning for column in table.columns if column.name == name)
            places = owners.get(definition.name, {}).get(name, range(len(constants)))
            assert meaning == ", ".join(constants[place] for place in places)
    assert any(column.meaning == "1: run, 2: stop, 3: reset" for table in TABLES for column in table.columns)


@pytest.mark.parametrize("file_format", ["csv", "parquet", "numpy"])
def test_nothing_is_overwritten_and_nothing_left_of_a_damaged_bag(
    bag: Path, tmp_path: Path, file_format: str, capfd: pytest.CaptureFixture[str]
) -> None:
    name = "out.npz" if file_format == "numpy" else "out"
    words = ["--format", file_format, "-o", str(tmp_path / name)]
    assert main(["export", str(bag), *words]) == 0
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert main(["export", str(bag), *words]) == 2
    assert "is there already; name another with -o, or remove it" in capfd.readouterr().err
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before

    data = bytearray(next(bag.glob("*.mcap")).read_bytes())
    place = len(data) // 2
    data[place : place + 64] = bytes(64)
    (tmp_path / "damaged.mcap").write_bytes(data)
    words[-1] = str(tmp_path / f"second-{name}")
    assert main(["export", str(tmp_path / "damaged.mcap"), *words]) == 1
    assert {path.name for path in tmp_path.iterdir()} == {name, "damaged.mcap"}


def test_an_empty_folder_is_filled(bag: Path, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    assert len(export_tables(bag, tmp_path / "out", "csv")) == len(TABLES) + 1


def test_a_full_disk_leaves_nothing(bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("swarmabs_analysis.export.tables._write_columns", full)
    with pytest.raises(RunError, match=r"cannot write .*: No space left on device; export to another disk with -o"):
        export_tables(bag, tmp_path / "out", "csv")
    assert not list(tmp_path.iterdir())


def test_without_pyarrow_the_remedy_is_named(bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(InputError, match=r"Parquet needs the package pyarrow .*; install it, or use --format csv"):
        export_tables(bag, tmp_path / "out", "parquet")
    assert not (tmp_path / "out").exists()


def test_what_is_no_bag_or_no_npz_is_refused(bag: Path, tmp_path: Path) -> None:
    assert main(["export", str(tmp_path), "-o", str(tmp_path / "out")]) == 2
    with pytest.raises(InputError, match=r"does not end in .npz; name a file such as"):
        export_arrays(bag, tmp_path / "out")
    (tmp_path / "cut.mcap").write_bytes(next(bag.glob("*.mcap")).read_bytes()[:-100])
    with pytest.raises(DamagedBagError):
        export_tables(tmp_path / "cut.mcap", tmp_path / "out", "csv")


def test_tables_are_written_in_a_fraction_of_their_size(tmp_path: Path) -> None:
    long = write_bag(tmp_path / "long", (m for step in range(4000) for m in make_step(step)), chunk_bytes=100_000)
    tracemalloc.start()
    files = export_tables(long, tmp_path / "out", "csv")
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 0.5 * sum(file.stat().st_size for file in files)
