"""The table and the picture of a sweep."""

from __future__ import annotations

import io
import json
import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from numpy.typing import NDArray

from swarmabs_analysis.sweep.evaluate import OUTCOMES, evaluate
from swarmabs_analysis.sweep.picture import LOOKS, MARKERS, pictures
from swarmabs_analysis.sweep.run import parquet
from swarmabs_analysis.sweep.study import Study, Sweep, load_sweep

HEAD = "schema: 1\nscenario: pd_het_4\nset: {duration: 0.05}\n"


def loaded(folder: Path, text: str) -> Study:
    path = folder / "s.yaml"
    path.write_text(HEAD + text)
    return load_sweep(path)


def computed(study: Study) -> dict[int, dict[str, Any]]:
    return {case.index: json.loads(evaluate(study.task(case.index))) for case in study.cases()}


def pretended(study: Study) -> dict[int, dict[str, Any]]:
    """Return rows with all outcomes in turn."""
    return {index: {"outcome": OUTCOMES[index % len(OUTCOMES)]} for index in range(study.sweep.count)}


def colours(png: bytes) -> NDArray[np.int64]:
    """Return the colours of all points of a picture, as 0xRRGGBB."""
    image: NDArray[np.int64] = (matplotlib.image.imread(io.BytesIO(png)) * 255).round().astype(np.int64)
    return (image[:, :, 0] << 16) | (image[:, :, 1] << 8) | image[:, :, 2]


class TestTable:
    def test_columns_and_rows(self, study: Study) -> None:
        rows = computed(study)
        table = pq.read_table(io.BytesIO(parquet(study, rows)))
        assert table.column_names == [
            *("case", "plane.angle", "plane.angular_velocity", "swarm.agents.0.mass", *study.sweep.results),
            *("status", "outcome", "reason", "seed", "digest"),
        ]
        for case, found in zip(study.cases(), table.to_pylist(), strict=True):
            expected = {**dict.fromkeys(table.column_names), **rows[case.index], **case.values, "seed": case.seed}
            assert found == expected
        assert table.schema.metadata[b"swarmabs.sweep"] == study.sweep_text.encode()
        assert table.schema.metadata[b"swarmabs.scenario"] == study.scenario.encode()

    def test_bytes_do_not_depend_on_the_order_in_which_cases_finish(self, study: Study) -> None:
        rows = computed(study)
        assert parquet(study, rows) == parquet(study, dict(reversed(rows.items())))

    def test_only_the_results_that_are_asked_for(self, tmp_path: Path) -> None:
        study = loaded(tmp_path, "grid: {plane.angle: [0.1, 9]}\nresults: [rms_error]\n")
        table = pq.read_table(io.BytesIO(parquet(study, computed(study))))
        assert table.column_names == [
            "case",
            "plane.angle",
            "rms_error",
            "status",
            "outcome",
            "reason",
            "seed",
            "digest",
        ]
        assert table["status"].to_pylist() == ["ok", "refused"]
        assert table["rms_error"].null_count == 1

    @pytest.mark.parametrize(
        ("values", "kind", "found"),
        [
            ([1, 2], pa.int64(), [1, 2]),
            ([1, 2.5], pa.float64(), [1.0, 2.5]),
            ([None, 2.5], pa.float64(), [None, 2.5]),
            ([2**63, 1], pa.float64(), [2.0**63, 1.0]),
            ([True, False], pa.bool_(), [True, False]),
            (["a", "b"], pa.string(), ["a", "b"]),
            (["a", 1], pa.string(), ['"a"', "1"]),
            ([[1, 2], {"a": None}], pa.string(), ["[1, 2]", '{"a": null}']),
        ],
    )
    def test_type_of_a_parameter(self, values: list[object], kind: pa.DataType, found: list[object]) -> None:
        study = Study(Sweep.model_validate({"schema": 1, "scenario": "s", "grid": {"a.b": values}}), "")
        column = pq.read_table(io.BytesIO(parquet(study, pretended(study))))["a.b"]
        assert (column.type, column.to_pylist()) == (kind, found)


class TestPicture:
    REGION = (
        "grid:\n  plane.angle: {from: -1, to: 1, count: 9}\n  plane.angular_velocity: {from: -1, to: 1, count: 9}\n"
    )

    def draw(self, folder: Path, text: str) -> dict[str, bytes]:
        study = loaded(folder, text)
        return pictures(study, pretended(study))

    def test_region_with_the_estimates(self, tmp_path: Path) -> None:
        files = self.draw(tmp_path, self.REGION)
        assert set(files) == {"region.png", "region.svg"}
        seen = set(np.unique(colours(files["region.png"])).tolist())
        assert {int(colour[1:], 16) for colour, _ in LOOKS.values()} <= seen
        text = files["region.svg"].decode()
        for words in ("estimate printed in the paper", "estimate with the corrected", "≤ 0.02", "≤ 0.04", "rad/s"):
            assert words in text
        assert all(label in text for _, label in LOOKS.values())

    def test_equal_sweeps_give_equal_bytes(self, tmp_path: Path) -> None:
        assert self.draw(tmp_path, self.REGION) == self.draw(tmp_path, self.REGION)

    def test_estimates_hold_for_one_swarm_only(self, tmp_path: Path) -> None:
        text = self.REGION + "random: {swarm.agents.0.mass: {uniform: [0.3, 0.4]}}\nsamples: 2\n"
        picture = self.draw(tmp_path, text)["region.svg"].decode()
        assert "estimate" not in picture
        assert "the worst of 2 cases per point" in picture

    def test_field_has_the_colour_of_its_worst_case(self, tmp_path: Path) -> None:
        study = loaded(tmp_path, "grid: {plane.angle: [0, 1], plane.angular_velocity: [0, 1]}\nsamples: 5\n")
        files = pictures(study, pretended(study))
        assert LOOKS["refused"][1] in files["region.svg"].decode()
        assert np.mean(colours(files["region.png"]) == int(LOOKS["refused"][0][1:], 16)) > 0.5

    @pytest.mark.parametrize(
        "text",
        [
            "random:\n  plane.angle: {uniform: [0, 1]}\n  plane.inertia: {normal: [1, 0.1]}\nsamples: 20\n",
            "random:\n  plane.angle: {uniform: [0, 1]}\ngrid: {limits.force: [1, 2, 3]}\nsamples: 20\n",
            "grid: {controller.type: [pd, lqr], plane.angle: [0, 1], plane.inertia: [1, 2]}\n",
            "picture: {x: plane.length, y: plane.angle}\ngrid: {plane.angle: [0, 1], plane.length: [1, 2]}\n",
        ],
    )
    def test_any_two_numbers_will_do(self, tmp_path: Path, text: str) -> None:
        assert set(self.draw(tmp_path, text)) == {"region.png", "region.svg"}

    @pytest.mark.parametrize(
        "text",
        [
            "grid: {plane.angle: [0, 1]}\n",
            "grid: {plane.angle: [0, 1], plane.inertia: [1]}\n",
            "grid: {plane.angle: [0, 1], controller.type: [pd, lqr], plane.robot_gravity: [true, false]}\n",
            "grid: {plane.angle: [0, 1], controller.type: [pd, lqr]}\npicture: {x: plane.angle, y: controller.type}\n",
        ],
    )
    def test_no_picture_without_two_numbers(self, tmp_path: Path, text: str) -> None:
        assert self.draw(tmp_path, text) == {}


def luminance(colour: str) -> float:
    red, green, blue = (math.pow(value / 255, 2.2) for value in bytes.fromhex(colour[1:]))
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def test_outcomes_are_told_apart_without_colour() -> None:
    assert set(LOOKS) == set(MARKERS) == set(OUTCOMES)
    assert len(set(MARKERS.values())) == len(OUTCOMES)
    shades = sorted(luminance(colour) for colour, _ in LOOKS.values())
    assert min(b - a for a, b in pairwise(shades)) > 0.05
