"""The folder of a run: made, filled, refused, and never half there."""

import json
from math import inf, nan
from pathlib import Path

import pytest

from swarmabs_bag.run_folder import RunFolder, new_folder, new_run_folder, next_run_folder
from swarmabs_config.scenario import load_scenario
from swarmabs_config.scenarios import find_scenario
from swarmabs_core.errors import InputError, RunError


def test_the_folder_holds_the_resolved_scenario_and_a_summary_that_is_whole_or_not_there(tmp_path: Path) -> None:
    scenario, folder = find_scenario("arise_het_20").resolved(), RunFolder(tmp_path)
    folder.fill(scenario)
    assert load_scenario(folder.scenario) == scenario
    assert folder.logs.is_dir()
    folder.write_summary({"a": 1.5, "b": None})
    for bad in (nan, inf):
        with pytest.raises(ValueError, match=r"not JSON compliant|Out of range"):
            folder.write_summary({"a": bad})
    assert json.loads(folder.summary.read_text()) == {"a": 1.5, "b": None}
    assert {*tmp_path.iterdir()} == {folder.summary, folder.scenario, folder.logs}


def test_a_new_folder_is_made_with_its_parents_and_nothing_in_the_way_is_changed(tmp_path: Path) -> None:
    folder = new_run_folder(tmp_path / "a" / "b")
    assert folder.path.is_dir()
    assert list(folder.path.iterdir()) == []
    assert new_run_folder(folder.path).path == folder.path, "an empty one is taken"
    file = folder.path / "precious"
    file.write_text("x")
    with pytest.raises(InputError, match="is not empty; name another with -o, or remove it"):
        new_run_folder(folder.path)
    for below in ("", "sub", "sub/deeper"):
        with pytest.raises(InputError, match="is not a folder"):
            new_run_folder(file / below)
    with pytest.raises(InputError, match="name one with -o"):
        next_run_folder(file, "pd")
    assert list(folder.path.iterdir()) == [file]
    assert file.read_text() == "x"


def test_numbers_go_up_and_gaps_are_no_reason_to_overwrite(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    runs = tmp_path / "runs"
    names = [next_run_folder(runs, "pd").path.name for _ in range(3)]
    assert names == ["pd-001", "pd-002", "pd-003"]
    (runs / "pd-001").rmdir()
    (runs / "pd-004").write_text("a file")
    assert [next_run_folder(runs, "pd").path.name for _ in range(2)] == ["pd-001", "pd-005"]
    assert next_run_folder(runs, "lqr").path.name == "lqr-001"
    real, taken = Path.mkdir, []

    def mkdir(path: Path, *args: object, **options: object) -> None:
        if path.name == "pd-006" and not taken:  # somebody takes this name meanwhile
            taken.append(path)
            real(path)
        real(path, *args, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(Path, "mkdir", mkdir)
    assert next_run_folder(runs, "pd").path.name == "pd-007"


def test_a_folder_to_fill_is_made_with_its_parents_or_not_at_all(tmp_path: Path) -> None:
    with new_folder(tmp_path / "a/b/first") as part:
        (part / "x").write_text("x")
    with pytest.raises(RunError, match="No space left"), new_folder(tmp_path / "a/b/second") as part:
        raise OSError(28, "No space left on device")
    assert [path.name for path in (tmp_path / "a/b").rglob("*")] == ["first", "x"]
