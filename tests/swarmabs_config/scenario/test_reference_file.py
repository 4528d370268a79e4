"""References from a CSV file: what becomes of the file, and every way in which it can be wrong."""

import os
from pathlib import Path

import pytest

from swarmabs_config.model.controllers import CsvTrajectory
from swarmabs_config.scenario import Scenario, ScenarioError, dump_scenario, load_scenario, parse_scenario

TEXT = """\
schema: 1
controller:
  type: arise
  trajectory:
    type: csv
    file: data/ref.csv
swarm:
  generate: {double_integrator: 2, mass: [1, 2]}
"""
ROWS = "time,angle\n0,0\n2.5,0.25\n5,-0.125\n"


def folder(path: Path, rows: str | bytes = ROWS, text: str = TEXT) -> Path:
    (path / "data").mkdir(exist_ok=True)
    (path / "data" / "ref.csv").write_bytes(rows.encode() if isinstance(rows, str) else rows)
    (path / "s.yaml").write_text(text, encoding="utf-8")
    return path / "s.yaml"


def trajectory(scenario: Scenario) -> CsvTrajectory:
    found = scenario.controller.trajectory  # type: ignore[attr-defined]
    assert isinstance(found, CsvTrajectory)
    return found


def test_rows_take_the_place_of_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = folder(tmp_path)
    monkeypatch.chdir("/")
    scenario = load_scenario(file)
    assert trajectory(scenario).times == (0.0, 2.5, 5.0)
    assert trajectory(scenario).angles == (0.0, 0.25, -0.125)
    (tmp_path / "data" / "ref.csv").unlink()
    text = dump_scenario(scenario)
    assert "ref.csv" not in text
    assert parse_scenario(text) == scenario.resolved()
    # A name in an override is relative to the current folder.
    (tmp_path / "mine.csv").write_text("\ufefftime, angle\r\n 0 , 0\r\n\r\n1e0, 0.5\r\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    folder(tmp_path, "time,angle\n0,0\n1,9\n")
    scenario = load_scenario(file, ["controller.trajectory.file=mine.csv"])
    assert (trajectory(scenario).times, trajectory(scenario).angles) == ((0.0, 1.0), (0.0, 0.5))


BAD_ROWS = [
    ("", "ref.csv:1: no header time,angle; make 'time,angle' the first line"),
    ("0,0\n1,0\n", "ref.csv:1: no header time,angle; make"),
    ("angle,time\n0,0\n1,0\n", "ref.csv:1: no header time,angle; make"),
    ("time,angle\n0,0\n", "ref.csv: 1 rows; give 2 to 2000 rows of time,angle"),
    ("time,angle\n" + "".join(f"{n},0\n" for n in range(2001)), "ref.csv: 2001 rows; give 2 to 2000"),
    ("time,angle\n0,0\n1\n", "ref.csv:3: 1 values; give two numbers, time in s and angle in rad"),
    ("time,angle\n0,0\n1,0,0\n", "ref.csv:3: 3 values; give two numbers"),
    ("time,angle\n0,0\n1,nan\n", "ref.csv:3: angle: 'nan' is not a number; give a finite number"),
    ("time,angle\n0,0\n-inf,0\n", "ref.csv:3: time: '-inf' is not a number; give a finite number"),
    ("time,angle\n0,0\nx\x1b[2J,0\n", "ref.csv:3: time: 'x\\x1b[2J' is not a number; give a finite"),
    ("time,angle\n0,0\n1,1.5\n", "ref.csv:3: angle: 1.5 rad is out of range; stay within +-1.5 rad, in radians"),
    ("time,angle\n-1,0\n1,0\n", "ref.csv:2: time: -1.0 s is out of range; give 0 to 2147483647 s"),
    ("time,angle\n0,0\n0,0\n", "ref.csv:3: time: time 0.0 s follows 0.0 s; make each time at least 0.001"),
    ("time,angle\n0,0\n2,0\n1,0\n", "ref.csv:4: time: time 1.0 s follows 2.0 s; make each time"),
    ('time,angle\n0,0\n"1,0\n', "ref.csv:3: not CSV: unexpected end of data; give two numbers in each line"),
    (b"time,angle\n0,0\n1,\0\n", "ref.csv:3: not a text file: it has a NUL byte; give a trajectory in CSV"),
    (b"time,angle\n\xff\n", "ref.csv:2: not UTF-8: byte 0xff at offset 11; save the file as UTF-8"),
]


@pytest.mark.parametrize(("rows", "expected"), BAD_ROWS)
def test_bad_rows_are_named_with_file_and_line(tmp_path: Path, rows: str | bytes, expected: str) -> None:
    file = folder(tmp_path, rows)
    with pytest.raises(ScenarioError) as caught:
        load_scenario(file)
    assert str(caught.value).startswith(str(tmp_path / "data" / expected.partition(":")[0]))
    assert expected in str(caught.value)
    folder(tmp_path)
    load_scenario(file)


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("file: 7", "s.yaml:6: controller.trajectory.file: expected a text, found the number 7; put it in quotes"),
        ("file: none.csv", "none.csv: no such file; "),
        ("file: data", "data: is a directory; give a trajectory file in CSV"),
        ("file: pipe", "pipe: not a regular file; give a trajectory file in CSV"),
        ("times: [0, 1]", "trajectory: 2 times and 0 angles; give 'file', or as many times as angles, 2 to 2000"),
        ("times: [0, 0]\n    angles: [0, 0]", "s.yaml:6: controller.trajectory.times.1: 0.0 s follows 0.0 s; make"),
        ("times: [0, 1]\n    angles: [0, 2]", "s.yaml:7: controller.trajectory.angles.1: 2 is out of range; give"),
        ("file: data/ref.csv\n    times: [0, 1]", "trajectory: 'file' is given together with rows"),
    ],
)
def test_bad_fields(tmp_path: Path, line: str, expected: str) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ScenarioError) as caught:
        load_scenario(folder(tmp_path, text=TEXT.replace("file: data/ref.csv", line)))
    assert expected in str(caught.value)


def test_where_there_can_be_no_file_and_a_curve_that_swings_too_far_it_is_named(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="not read from a file; give either 'file', or 'times' and 'angles'"):
        parse_scenario(TEXT)
    with pytest.raises(ScenarioError, match=r"trajectory\.file: unknown key 'file'"):
        load_scenario(folder(tmp_path, text=TEXT.replace("type: csv", "type: constant")))
    far = r"s\.yaml:6: .*times\.1: the smooth curve through the rows reaches 1\.\d+ rad"
    with pytest.raises(ScenarioError, match=far):
        load_scenario(folder(tmp_path, "time,angle\n0,-1.4\n1,1.4\n2,1.4\n3,-1.4\n"))
