"""The command check, as a user types it, and the warnings before a run."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from swarmabs_cli import main


def document(capfd: pytest.CaptureFixture[str], *words: str, code: int = 0) -> Any:
    assert main(["check", *words, "--json"]) == code
    return json.loads(capfd.readouterr().out, parse_constant=pytest.fail)


def test_table_names_conditions_numbers_and_verdicts(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "arise_si_4"]) == 0
    text = " ".join(capfd.readouterr().out.split())
    assert "ARISE_SI_sys, ARISE with single integrators: fails (as printed: fails)" in text
    assert "corrected ks > c_max^2/(4 eta3) 1 144 -143 fails" in text
    assert "with ks = 1 the ARISE theorem does not cover this run" in text
    assert "LQR_SI_sys: not applicable, the parent controller is arise" in text


def test_document_has_stable_names(capfd: pytest.CaptureFixture[str]) -> None:
    found = document(capfd, "pd_het_4")
    assert set(found) == {
        *("scenario", "controller", "swarm", "angle_max", "covered", "failed", "theorems", "beyond_the_paper"),
        *("attraction", "abstract_states", "notes"),
    }
    assert len(found["theorems"]) == 8
    (used,) = [one for one in found["theorems"] if one["label"] == "LQR_noHomo_sys"]
    assert set(used) == {"label", "title", "applicable", "verdict", "printed_verdict", "note", "conditions"}
    names = {"name", "printed", "corrected", "margin", "verdict", "inputs", "note"}
    assert all(set(one) == names for one in used["conditions"])
    (epsilon,) = [one for one in used["conditions"] if one["name"] == "epsilon"]
    assert epsilon["corrected"]["value"] == pytest.approx(3.077, abs=5e-4)
    assert epsilon["verdict"] == "holds"


def test_what_does_not_exist_is_null(capfd: pytest.CaptureFixture[str]) -> None:
    found = document(capfd, "pd_di_4", "--set", "controller.gains=[3, -2]")
    assert found["attraction"]["weight"] is None


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (("pd_het_4",), 0),
        (("arise_het_4",), 1),
        (("pd_si_4", "--set", "plane.angle=0.18"), 1),
        (("pd_si_4", "--set", "plane.angle=0.18", "--angle-max", "0.25"), 0),
        (("pd_si_4", "--set", "step=0.25", "--duration", "5"), 1),
    ],
)
def test_strict_tells_by_the_exit_code(capfd: pytest.CaptureFixture[str], words: tuple[str, ...], code: int) -> None:
    assert bool(document(capfd, *words)["failed"]) == bool(code)
    assert document(capfd, *words, "--strict", code=code)["covered"] == (not code)


@pytest.mark.parametrize(
    "words", [("nothing",), ("pd_si_4", "--set", "plane.angel=1"), ("pd_si_4", "--angle-max", "2")]
)
def test_invalid_requests_are_refused(capfd: pytest.CaptureFixture[str], words: tuple[str, ...]) -> None:
    assert main(["check", *words, "--strict", "--json"]) == 2
    captured = capfd.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("error: ")


def test_a_run_is_warned_of_in_few_lines(
    capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, count in (("arise_si_4", 2), ("pd_si_4", 1)):
        assert main(["simulate", name, "--duration", "0.1", "--json"]) == 0
        captured = capfd.readouterr()
        json.loads(captured.out)
        warnings = [line for line in captured.err.splitlines() if line.startswith("warning: ")]
        assert len(warnings) == count
        assert any("ks = 1" in line for line in warnings) == (name == "arise_si_4")
