"""The folder of a run: made, filled, refused, and never half there."""

from __future__ import annotations

import json
from math import inf, nan
from pathlib import Path

import pytest

from swarmabs_bag.run_folder import RunFolder, new_run_folder, next_run_folder
from swarmabs_config.scenario import load_scenario
from swarmabs_config.scenarios import find_scenario
from swarmabs_core.errors import InputError


def test_a_new_folder_is_made_with_its_parents(tmp_path: Path) -> None:
    folder = new_run_folder(tmp_path / "a" / "b")
    assert folder.path.is_dir()
    assert list(folder.path.iterdir()) == []


def test_an_empty_folder_is_taken(tmp_path: Path) -> None:
    assert new_run_folder(tmp_path).path == tmp_path


def test_a_folder_that_is_not_empty_is_refused_and_left_alone(tmp_path: Path) -> None:
    (tmp_path / "precious").write_text("x")
    with pytest.raises(InputError, match="is not empty; name another with -o, or remove it"):
        new_run_folder(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["precious"]


@pytest.mark.parametrize("below", ["", "sub", "sub/deeper"])
def test_a_file_in_the_way_is_refused(tmp_path: Path, below: str) -> None:
    file = tmp_path / "file"
    file.write_text("x")
    with pytest.raises(InputError, match="is not a folder"):
        new_run_folder(file / below)
    assert file.read_text() == "x"


def test_numbers_go_up_and_gaps_are_no_reason_to_overwrite(tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    names = [next_run_folder(runs, "pd").path.name for _ in range(3)]
    assert names == ["pd-001", "pd-002", "pd-003"]
    (runs / "pd-001").rmdir()
    (runs / "pd-004").write_text("a file")
    assert [next_run_folder(runs, "pd").path.name for _ in range(2)] == ["pd-001", "pd-005"]
    assert next_run_folder(runs, "lqr").path.name == "lqr-001"


def test_a_name_that_somebody_takes_meanwhile_is_passed_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = Path.mkdir
    taken = []

    def mkdir(path: Path, *args: object, **options: object) -> None:
        if path.name == "pd-001" and not taken:
            taken.append(path)
            real(path)
        real(path, *args, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(Path, "mkdir", mkdir)
    assert next_run_folder(tmp_path, "pd").path.name == "pd-002"


def test_a_parent_that_is_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "runs").write_text("x")
    with pytest.raises(InputError, match="name one with -o"):
        next_run_folder(tmp_path / "runs", "pd")


def test_what_stands_in_the_folder_is_the_resolved_scenario(tmp_path: Path) -> None:
    scenario = find_scenario("arise_het_20").resolved()
    folder = RunFolder(tmp_path)
    folder.fill(scenario)
    assert load_scenario(folder.scenario) == scenario
    assert folder.logs.is_dir()


def test_the_summary_is_whole_or_not_there(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    folder.write_summary({"a": 1.5, "b": None})
    assert json.loads(folder.summary.read_text()) == {"a": 1.5, "b": None}
    for bad in (nan, inf):
        with pytest.raises(ValueError, match=r"not JSON compliant|Out of range"):
            folder.write_summary({"a": bad})
    assert json.loads(folder.summary.read_text()) == {"a": 1.5, "b": None}
    assert list(tmp_path.iterdir()) == [folder.summary]


def test_a_summary_that_cannot_be_written_leaves_the_old_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = RunFolder(tmp_path)
    folder.write_summary({"a": 1})

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", full)
    with pytest.raises(OSError, match="No space left"):
        folder.write_summary({"a": 2})
    assert json.loads(folder.summary.read_text()) == {"a": 1}
    assert list(tmp_path.iterdir()) == [folder.summary]
