"""The row of a case, however it ends; the table and the picture of a sweep."""

import io
import json
import math
from collections.abc import Callable
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from matplotlib import colormaps
from matplotlib.colors import Normalize, to_hex
from matplotlib.contour import ContourSet
from matplotlib.figure import Figure
from scipy.optimize import brentq
from tests.swarmabs_core.helpers import digest

from swarmabs_analysis.sweep import evaluate as module
from swarmabs_analysis.sweep.evaluate import LONGEST_REASON, OUTCOMES, Task, evaluate, lost
from swarmabs_analysis.sweep.picture import LABELS, LOOKS, MARKERS, pictures
from swarmabs_analysis.sweep.study import Study, Sweep, load_sweep
from swarmabs_analysis.sweep.table import parquet, results_table
from swarmabs_config.scenario import parse_scenario
from swarmabs_config.scenarios import builtin_scenarios
from swarmabs_config.theory import attraction
from swarmabs_run.simulation import Simulation, simulate

TEXT = builtin_scenarios()["pd_het_4"].read_text()


def row(*overrides: str) -> Any:
    line = evaluate(Task(TEXT, 5, overrides, 0.2))
    assert "\n" not in line
    return json.loads(line)


def test_row_of_a_run_that_ends_well() -> None:
    scenario = parse_scenario(TEXT, overrides=["duration=5"])
    run = simulate(scenario)
    assert row("duration=5") == {
        "case": 5,
        "status": "ok",
        "outcome": "settled",
        "reason": None,
        "digest": digest(Simulation(scenario).steps()),
        "settled_at": 4.06,
        "final_error": -run.angle[-1],
        "rms_error": pytest.approx(float((run.angle**2).mean() ** 0.5), rel=1e-12),
        "max_abs_position": float(np.max(np.abs(run.agents.position))),
        "max_abs_angle": 0.1,
        "messages": 8 * 501,
        "initial_error_squared": pytest.approx(0.01233, abs=1e-5),
        "in_printed_estimate": True,
        "in_corrected_estimate": True,
    }


@pytest.mark.parametrize(
    ("overrides", "status", "outcome"),
    [
        (("duration=1",), "ok", "unsettled"),
        (("duration=5", "plane.angular_velocity=2"), "ok", "off_plane"),
        (("plane.angular_velocity=40",), "failed", "failed"),
    ],
)
def test_row_of_a_run_that_does_not_end_well(overrides: tuple[str, ...], status: str, outcome: str) -> None:
    found = row(*overrides)
    assert (found["status"], found["outcome"]) == (status, outcome)
    assert outcome == "off_plane" or found["settled_at"] is None
    assert (found["max_abs_position"] > 0.5) == (outcome == "off_plane")
    assert found["in_corrected_estimate"] == (outcome == "unsettled")
    if status == "failed":  # it has the figures up to there
        assert "the plane's angle is" in found["reason"]
        assert 0.1 < found["max_abs_angle"] < 1.5
        assert found["digest"] and found["messages"] > 0


def test_row_of_what_is_no_scenario_of_a_case_that_kills_its_workers_and_of_a_bug(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    refused = row("plane.angle=7")
    assert refused.pop("reason").startswith("--set plane.angle=7: plane.angle: 7 is out of range")
    assert refused == {"case": 5, "status": "refused", "outcome": "refused"}
    assert json.loads(lost(3, "why")) == {"case": 3, "status": "failed", "outcome": "failed", "reason": "why"}
    # There are no estimates without state feedback.
    assert "in_printed_estimate" not in row("controller={type: arise}", "duration=0.1")

    def broken(_: object) -> None:
        raise ZeroDivisionError("x" * 1000)

    monkeypatch.setattr(module, "simulated_steps", broken)
    found = row()
    assert (found["status"], found["digest"], len(found["reason"])) == ("failed", None, LONGEST_REASON)
    assert found["reason"].startswith("ZeroDivisionError: xxx")


@pytest.mark.parametrize(
    ("name", "share", "inside"),
    [
        ("printed", 0.99, (True, True)),
        ("printed", 1.01, (False, True)),
        ("corrected", 0.99, (False, True)),
        ("corrected", 1.01, (False, False)),
    ],
)
def test_a_start_is_in_each_estimate_up_to_its_own_level(name: str, share: float, inside: tuple[bool, bool]) -> None:
    region = attraction(parse_scenario(TEXT), 0.2)
    assert region is not None
    level = share * float(getattr(region, name))
    angle = brentq(lambda angle: region.error_squared(angle, 0.0) - level, 0.09, 0.5)
    found = row("duration=0.05", f"plane.angle={angle!r}")
    assert found["initial_error_squared"] == pytest.approx(level)
    assert (found["in_printed_estimate"], found["in_corrected_estimate"]) == inside


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


def measured(study: Study) -> dict[int, dict[str, Any]]:
    """Return rows with results, of which every seventh has failed and every fifth has not settled."""
    rows = {}
    for index in range(study.sweep.count):
        outcome = "failed" if index % 7 == 6 else "unsettled" if index % 5 == 4 else "settled"
        settled_at = 1.0 + index / study.sweep.count if outcome == "settled" else None
        rows[index] = {"outcome": outcome, "settled_at": settled_at, "rms_error": 10.0 ** -(index % 4)}
    return rows


def test_columns_and_rows_are_those_of_the_cases_and_results_that_are_asked_for(study: Study, tmp_path: Path) -> None:
    rows = computed(study)
    content = parquet(results_table(study, rows))
    assert content == parquet(results_table(study, dict(reversed(rows.items()))))  # in whatever order cases finish
    table = pq.read_table(io.BytesIO(content))
    assert table.column_names == [
        *("case", "plane.angle", "plane.angular_velocity", "swarm.agents.0.mass", *study.sweep.results),
        *("status", "outcome", "reason", "seed", "digest"),
    ]
    for case, found in zip(study.cases(), table.to_pylist(), strict=True):
        expected = {**dict.fromkeys(table.column_names), **rows[case.index], **case.values, "seed": case.seed}
        assert found == expected
    assert table.schema.metadata[b"swarmabs.sweep"] == study.sweep_text.encode()
    assert table.schema.metadata[b"swarmabs.scenario"] == study.scenario.encode()
    study = loaded(tmp_path, "grid: {plane.angle: [0.1, 9]}\nresults: [rms_error]\n")
    table = pq.read_table(io.BytesIO(parquet(results_table(study, computed(study)))))
    names = ("case", "plane.angle", "rms_error", "status", "outcome", "reason", "seed", "digest")
    assert tuple(table.column_names) == names
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
def test_type_of_a_parameter(values: list[object], kind: pa.DataType, found: list[object]) -> None:
    study = Study(Sweep.model_validate({"schema": 1, "scenario": "s", "grid": {"a.b": values}}), "")
    column = pq.read_table(io.BytesIO(parquet(results_table(study, pretended(study)))))["a.b"]
    assert (column.type, column.to_pylist()) == (kind, found)


REGION = "grid:\n  plane.angle: {from: -1, to: 1, count: 9}\n  plane.angular_velocity: {from: -1, to: 1, count: 9}\n"


def draw(folder: Path, text: str, rows: Callable[[Study], dict[int, dict[str, Any]]] = pretended) -> dict[str, bytes]:
    study = loaded(folder, text)
    return pictures(study, rows(study))


def share(colour: str, png: bytes) -> float:
    """Return which part of a picture has a colour."""
    image = (matplotlib.image.imread(io.BytesIO(png)) * 255).round().astype(np.uint8)
    return float(np.mean((image[:, :, :3] == list(bytes.fromhex(colour[1:]))).all(axis=2)))


@pytest.mark.system
def test_region_has_the_colours_of_the_outcomes_and_is_the_same_each_time(tmp_path: Path) -> None:
    files = draw(tmp_path, REGION)
    assert files == draw(tmp_path, REGION)
    assert set(files) == {"region.png", "region.svg"}
    for colour, label in LOOKS.values():
        assert share(colour, files["region.png"]) > 0.0
        assert label in files["region.svg"].decode()
    assert "estimate as printed in the paper" in files["region.svg"].decode()


@pytest.mark.parametrize("picture", ["", "picture: {x: plane.angular_velocity, y: plane.angle}\n"])
def test_outlines_are_where_starts_cease_to_be_in_the_estimates(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, picture: str
) -> None:
    """The estimate of the paper is dotted, the corrected one solid; the rows of cases on both sides tell."""
    drawn: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: drawn.append(figure))
    draw(tmp_path, REGION + picture)
    outlines = [one for one in drawn[0].axes[1].collections if isinstance(one, ContourSet)]
    names = {":": "in_printed_estimate", "-": "in_corrected_estimate"}
    assert sorted(one.linestyles[0] for one in outlines) == ["-", ":"]
    for outline in outlines:
        places = np.concatenate([path.vertices for path in outline.get_paths()])
        middle = (places.max(axis=0) + places.min(axis=0)) / 2.0
        for place in places[:: len(places) // 5]:
            inside = []
            for share in (0.97, 1.03):
                start = (middle + share * (place - middle)).tolist()
                angle, rate = reversed(start) if picture else start
                found = row("duration=0.01", f"plane.angle={angle!r}", f"plane.angular_velocity={rate!r}")
                inside.append(found[names[outline.linestyles[0]]])
            assert inside == [True, False]


def test_a_field_has_the_colour_of_the_median_of_its_results_in_its_place(tmp_path: Path) -> None:
    study = loaded(tmp_path, "grid: {plane.angle: [0, 0.1, 0.2], swarm.agents.2.mass: [0.4, 0.6]}\nsamples: 3\n")
    middles = {place: 2.0 + 1.5 * number for number, place in enumerate(product((0, 0.1, 0.2), (0.4, 0.6)))}
    rows: dict[int, dict[str, Any]] = {}
    for case in study.cases():
        middle = middles[case.values["plane.angle"], case.values["swarm.agents.2.mass"]]
        result = (middle - 1.0, middle, middle + 5.0)[case.index % 3]
        rows[case.index] = {"outcome": "settled", "settled_at": result}
    image = matplotlib.image.imread(io.BytesIO(pictures(study, rows)["region.png"]))[:, :, :3]
    colour = Normalize(min(middles.values()) - 1.0, max(middles.values()) + 5.0)
    centres = {}
    for place, middle in middles.items():
        shown = np.array(colormaps["viridis"](colour(middle))[:3])
        centres[place] = np.median(np.argwhere((np.abs(image - shown) < 1.5 / 255).all(axis=2)), axis=0)
    for place, (down, across) in centres.items():
        for other, (other_down, other_across) in centres.items():
            assert (across < other_across - 20) == (place[0] < other[0])
            assert (down > other_down + 20) == (place[1] < other[1])


def test_estimates_hold_for_one_swarm_only_and_a_field_has_the_colour_of_its_worst_case(tmp_path: Path) -> None:
    files = draw(tmp_path, "grid: {plane.angle: [0, 1], plane.angular_velocity: [0, 1]}\nsamples: 5\n")
    assert share(LOOKS["refused"][0], files["region.png"]) > 0.5
    text = REGION + "random: {swarm.agents.0.mass: {uniform: [0.3, 0.4]}}\nsamples: 2\n"
    assert "estimate" not in draw(tmp_path, text)["region.svg"].decode()


TWO = "plane.angle: {from: -1, to: 1, count: 9}, swarm.agents.2.mass: {from: 0.3, to: 0.7, count: 5}"
THREE = f"{TWO}, controller.type: [pd, lqr]"


@pytest.mark.parametrize(
    ("text", "there", "missing"),
    [
        ("grid: {plane.angle: [0, 0.1, 0.2, 0.3]}", "settled at, s|plane.angle, rad", "median|does not settle"),
        ("grid: {plane.angle: [0, 0.1, 0.2]}\nsamples: 20", "90 % of the cases|median|run fails", "mass"),
        ("random: {plane.angle: {uniform: [0, 1]}}\nsamples: 40", "settled at, s", "%"),
        (f"grid: {{{TWO}}}", "settled at, s|swarm.agents.2.mass (robot 3), kg|run fails", "median"),
        (f"grid: {{{TWO}}}\nsamples: 3\nresults: [rms_error]", "rms error, rad (median)", "settled at"),
        (f"grid: {{{THREE}}}", "controller.type|>pd<|>lqr<", "median"),
        (
            f"grid: {{{TWO}}}\nrandom: {{plane.length: {{uniform: [1, 2]}}}}\nsamples: 9",
            " to |plane.length",
            "of the cases",
        ),
    ],
)
def test_a_result_is_drawn_over_one_two_or_three_parameters(
    tmp_path: Path, text: str, there: str, missing: str
) -> None:
    picture = draw(tmp_path, text, measured)["region.svg"].decode()
    assert [part for part in there.split("|") if part not in picture] == []
    assert [part for part in missing.split("|") if part in picture] == []


def test_a_picture_says_how_far_it_moves_markers_apart(tmp_path: Path) -> None:
    text = "random: {plane.angle: {uniform: [0, 1]}}\ngrid: {swarm.actuator_lag: [0.1, 0.2]}\nsamples: 30"
    moved = "moved by up to 35% of the spacing"
    assert moved in draw(tmp_path, text, measured)["region.svg"].decode()
    alone = "random: {plane.angle: {uniform: [0, 1]}, swarm.actuator_lag: {uniform: [0.1, 0.2]}}\nsamples: 30"
    assert moved not in draw(tmp_path, alone, measured)["region.svg"].decode()


def test_a_result_has_the_colours_of_its_map_and_what_has_none_that_of_its_outcome(tmp_path: Path) -> None:
    picture = draw(tmp_path, f"grid: {{{TWO}}}", measured)["region.png"]
    lowest, highest = (to_hex(colormaps["viridis"](end)) for end in (0.0, 1.0))
    for colour in (lowest, highest, LOOKS["unsettled"][0], LOOKS["failed"][0]):
        assert share(colour, picture) > 0.01
    assert share(LOOKS["off_plane"][0], picture) < 0.001


@pytest.mark.parametrize(
    "text",
    [
        "grid: {plane.angle: [0, 1]}",  # without a result
        "grid: {controller.type: [pd, lqr], plane.robot_gravity: [true, false]}",
        "grid: {plane.angle: [0, 1], controller.type: [pd, lqr]}\npicture: {x: plane.angle, y: controller.type}",
    ],
)
def test_no_picture_without_a_number_and_a_result(tmp_path: Path, text: str) -> None:
    assert draw(tmp_path, text) == {}


def luminance(colour: str) -> float:
    red, green, blue = (math.pow(value / 255, 2.2) for value in bytes.fromhex(colour[1:]))
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def test_outcomes_are_told_apart_without_colour() -> None:
    assert set(LOOKS) == set(LABELS) == set(MARKERS) == set(OUTCOMES)
    assert len(set(MARKERS.values())) == len(OUTCOMES)
    shades = sorted(luminance(colour) for colour, _ in LOOKS.values())
    assert min(b - a for a, b in pairwise(shades)) > 0.05
