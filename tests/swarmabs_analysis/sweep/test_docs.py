"""The page on sweeps names everything there is, and its examples and those of the folder work."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from swarmabs_analysis.sweep.evaluate import OUTCOMES
from swarmabs_analysis.sweep.study import RESULTS, Distribution, Range, Sweep, load_sweep

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs" / "sweep.md").read_text()


@pytest.mark.parametrize("model", [Sweep, Range, Distribution])
def test_every_key_is_described(model: type[Sweep | Range | Distribution]) -> None:
    assert [key for key in model.key_names() if f"`{key}`" not in PAGE] == []


def test_every_result_and_outcome_is_described() -> None:
    assert [name for name in (*RESULTS, *OUTCOMES) if f"`{name}`" not in PAGE] == []


def test_the_sweep_of_the_page_is_valid(tmp_path: Path) -> None:
    found = re.search("```yaml\n(.*?)```", PAGE, re.DOTALL)
    assert found is not None
    (tmp_path / "s.yaml").write_text(found.group(1))
    study = load_sweep(tmp_path / "s.yaml")
    assert study.sweep.count == 9 * 2 * 20


@pytest.mark.parametrize("path", sorted((ROOT / "examples" / "sweeps").glob("*.yaml")), ids=lambda path: path.stem)
def test_examples_are_valid(path: Path) -> None:
    assert load_sweep(path).sweep.count > 1
