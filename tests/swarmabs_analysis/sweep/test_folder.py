"""The folder of a sweep: what a crash leaves is mended, and nobody else's folder is touched."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from swarmabs_analysis.sweep import folder as module
from swarmabs_analysis.sweep.folder import SweepFolder, find_folder, make_folder
from swarmabs_analysis.sweep.study import Study, load_sweep
from swarmabs_core.errors import InputError, RunError

FIRST, SECOND = '{"case": 4, "outcome": "settled"}', '{"case": 1, "outcome": "failed"}'


@pytest.mark.parametrize("torn", [b"", b'{"case": 2', b'{"case": 2}', b"\0\0\0\n", b"[]\n", b'{"x": 1}\n{"case": 9}\n'])
def test_what_a_crash_has_torn_is_cut_off(tmp_path: Path, torn: bytes) -> None:
    with SweepFolder(tmp_path) as folder:
        folder.add(FIRST)
    with folder.journal.open("ab") as file:
        file.write(torn)
    with SweepFolder(tmp_path) as folder:
        assert list(folder.rows) == [4]
        folder.add(SECOND)
    assert folder.journal.read_text() == f"{FIRST}\n{SECOND}\n"
    with SweepFolder(tmp_path) as folder:
        assert folder.rows == {4: json.loads(FIRST), 1: json.loads(SECOND)}
        assert folder.outcomes == {"settled": 1, "failed": 1}


def test_two_sweeps_cannot_write_one_folder(tmp_path: Path) -> None:
    with SweepFolder(tmp_path) as folder:
        folder.add(FIRST)
        with pytest.raises(InputError, match="is being written by another sweep"), SweepFolder(tmp_path):
            pass
    with SweepFolder(tmp_path) as folder:
        assert list(folder.rows) == [4]


def test_full_disk_names_the_file_and_the_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with SweepFolder(tmp_path) as folder:
        folder.add(FIRST)

        def full(descriptor: int, content: bytes) -> None:
            raise OSError(28, "No space left on device")

        with monkeypatch.context() as patch:
            patch.setattr(module, "_write_all", full)
            with pytest.raises(RunError, match=r"cases\.jsonl: No space left on device; free space, then go on"):
                folder.add(SECOND)
            patch.setattr(os, "fsync", lambda descriptor: full(descriptor, b""))
            with pytest.raises(RunError, match=r"summary\.json: "):
                folder.write_whole(folder.summary, b"{}")
    assert [path.name for path in tmp_path.iterdir()] == ["cases.jsonl"]
    with SweepFolder(tmp_path) as folder:
        assert list(folder.rows) == [4]


def test_new_folder_holds_the_sweep(study: Study, tmp_path: Path) -> None:
    folder = make_folder(study, tmp_path / "new", tmp_path)
    assert (folder.path / "sweep.yaml").read_text() == study.sweep_text
    assert (folder.path / "scenario.yaml").read_text() == study.scenario
    assert find_folder(study, folder.path).path == folder.path
    with pytest.raises(InputError, match="holds a sweep already; go on with it with --resume"):
        make_folder(study, folder.path, tmp_path)


def test_folder_without_a_name_is_the_next_free_one(study: Study, tmp_path: Path) -> None:
    made = [make_folder(study, None, tmp_path / "runs").path.name for _ in range(2)]
    assert made == ["small-001", "small-002"]


def test_another_sweep_is_not_gone_on_with(study: Study, small: Path, tmp_path: Path) -> None:
    folder = make_folder(study, tmp_path / "new", tmp_path)
    small.write_text(small.read_text().replace("seed: 7", "seed: 8"))
    with pytest.raises(InputError, match=r"holds another sweep: sweep\.yaml differs from line 11 on"):
        find_folder(load_sweep(small), folder.path)
    with pytest.raises(InputError, match=r"holds another sweep: scenario\.yaml differs from line"):
        find_folder(load_sweep(small, ["plane.inertia=1"]), folder.path)
    (folder.path / "sweep.yaml").unlink()
    with pytest.raises(InputError, match=r"sweep\.yaml cannot be read: No such file"):
        find_folder(study, folder.path)


@pytest.mark.parametrize("content", [None, "", "{", '{"status": "interrupted"}', '{"status": "ok"}'])
def test_only_summary_and_results_together_are_complete(tmp_path: Path, content: str | None) -> None:
    folder = SweepFolder(tmp_path)
    if content is not None:
        folder.summary.write_text(content)
    assert folder.complete() is None
    folder.results.touch()
    assert (folder.complete() is not None) == (content == '{"status": "ok"}')
