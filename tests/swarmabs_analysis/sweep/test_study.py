"""Sweep files: what is refused and with which words, and which cases the others have."""

from math import inf
from pathlib import Path
from statistics import mean, stdev

import pytest

from swarmabs_analysis.sweep.study import RESULTS, Range, Study, load_sweep
from swarmabs_config.scenario import parse_scenario
from swarmabs_core.errors import InputError

HEAD = "schema: 1\nscenario: pd_het_4\n"
GRID = HEAD + "grid: {plane.angle: [0.1, 0.2]}\n"

BAD = [
    ("", "sweep is empty; start with 'schema: 1'"),
    ("schema: 2\n", ":1: scenario: 'scenario' is missing; add 'scenario: ...'"),
    (GRID.replace("1", "2", 1), ":1: schema: version 2 is newer than"),
    (HEAD, ":1: nothing is swept; add e.g. 'grid: {plane.angle: [0.1, 0.2]}'"),
    (GRID + "seed: -1\n", ":4: seed: -1 is out of range; give a number >= 0"),
    (GRID + "samples: 0\n", ":4: samples: 0 is out of range; give a number >= 1"),
    (GRID + "samples: 900000\n", ":1: 1800000 cases are too many; use at most 1000000"),
    (GRID + "name: a/b\n", ":4: name: the text 'a/b' cannot name a folder; use 1 to 60 printable characters"),
    (GRID + "results: [settled]\n", ":4: results.0: expected 'settled_at', 'final_error'"),
    (GRID + "results: [settled_at, settled_at]\n", ":4: results: a result is listed twice; list each once"),
    (GRID + "picture: {x: plane.angle, y: plane.angel}\n", ":4: picture.y: 'plane.angel' is not swept; did you mean"),
    (GRID + "picture: {x: plane.angle, y: plane.angle}\n", ":4: picture: both axes are the same parameter"),
    (GRID + "attraction: {angle_max: 2}\n", ":4: attraction.angle_max: 2 is out of range; give a number < 1.57"),
    (HEAD + "grid: {plane.angle: 1}\n", ":3: grid.plane.angle: expected a list of values, found the number 1"),
    (HEAD + "grid: {plane.angle: []}\n", ":3: grid.plane.angle: the list is empty; give one or more values"),
    (HEAD + "grid: {plane.angle: [1, 1]}\n", ":3: grid.plane.angle: the value 1 is given twice; remove one of them"),
    (HEAD + "grid: {plane.angle: {from: 0, to: 1}}\n", ":3: grid.plane.angle.count: 'count' is missing; add"),
    (HEAD + "grid: {plane.angle: {from: 0, to: 1, count: 1}}\n", ":3: grid.plane.angle.count: 1 is out of range"),
    (HEAD + "grid: {plane..angle: [1]}\n", "'plane..angle' is not a dotted path; write e.g. plane.angle"),
    (HEAD + "grid: {seed: [1, 2]}\n", "'seed' cannot be swept: every case has its own seed"),
    (HEAD + "grid:\n  plane.angle: [7, 8]\n", ":4: plane.angle: plane.angle=7: 7 is out of range; give a number"),
    (HEAD + "grid:\n  swarm.agents.9.mass: [1]\n", ":4: swarm.agents: swarm.agents.9.mass=1: '9' is not an index of"),
    (HEAD + "random: {step: {uniform: [2, 1]}}\n", ":3: random.step.uniform: 2.0 is not below 1.0; write [smallest,"),
    (HEAD + "random: {step: {normal: [2, 0]}}\n", ":3: random.step.normal: the standard deviation is 0.0; write"),
    (HEAD + "random: {step: {choice: []}}\n", ":3: random.step.choice: the list is empty; give one or more values"),
    (HEAD + "random: {step: {}}\n", ":3: random.step: expected one of uniform, normal and choice, found none; keep"),
    (HEAD + "random: {step: {uniform: [1, 2], choice: [1]}}\n", "found uniform and choice; keep exactly one"),
    (GRID + "random: {plane.angle: {choice: [1]}}\n", ":4: random.plane.angle: it is also in the grid (see line 3)"),
    (GRID.replace("pd_het_4", "pd_hat_4"), "scenario or file 'pd_hat_4'; did you mean pd_het_4?"),
    (GRID.replace("pd_het_4", "none.yaml"), "none.yaml: no such file; did you mean"),
]


def written(folder: Path, text: str) -> Path:
    path = folder / "s.yaml"
    path.write_text(text)
    return path


@pytest.mark.parametrize(("text", "expected"), BAD)
def test_bad_sweep_is_one_line_with_its_place_and_a_remedy(tmp_path: Path, text: str, expected: str) -> None:
    with pytest.raises(InputError) as caught:
        load_sweep(written(tmp_path, text))
    assert expected in str(caught.value)
    assert "\n" not in str(caught.value)


def test_file_that_is_none_and_override_of_the_command_line_keep_their_names_and_the_rest_has_defaults(
    tmp_path: Path,
) -> None:
    with pytest.raises(InputError, match=r"is a directory; give a sweep file in YAML$"):
        load_sweep(tmp_path)
    with pytest.raises(InputError, match=r"^--set plane\.lenght=2: plane\.lenght: unknown key"):
        load_sweep(written(tmp_path, GRID), ["plane.lenght=2"])
    sweep = load_sweep(written(tmp_path, HEAD + "grid: {plane.angle: [7, 8, 0.1]}\n")).sweep
    assert (sweep.name, sweep.seed, sweep.samples, sweep.results, sweep.count) == ("s", 1, 1, RESULTS, 3)


def test_scenario_files_are_relative_to_the_sweep(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "sub").mkdir()
    scenario_text = "schema: 1\nswarm: {generate: {double_integrator: 3, mass: [0.6, 0.7]}}\n"
    (tmp_path / "sub" / "mine.yaml").write_text(scenario_text)
    path = written(tmp_path / "sub", GRID.replace("pd_het_4", "mine.yaml"))
    monkeypatch.chdir(tmp_path)
    scenario = parse_scenario(load_sweep(path).scenario)
    assert (scenario.name, len(scenario.agents)) == ("mine", 3)


@pytest.mark.parametrize("values", [[0.0, 0.1, 0.2, 0.3], [-1, 0, 1], [1.0, 0.5, 0.0], [0.0, 1 / 3, 2 / 3, 1.0]])
def test_values_of_a_range_are_exact(values: list[float]) -> None:
    ends = {"from": float(values[0]), "to": float(values[-1]), "count": len(values)}
    found = Range.model_validate(ends).values()
    assert found == values
    assert {type(value) for value in found} == {type(values[0])}


def test_grid_is_in_order_and_seeds_and_draws_differ_and_are_always_the_same(study: Study, small: Path) -> None:
    cases = list(study.cases())
    assert [case.index for case in cases] == list(range(36))
    places = [(case.values["plane.angle"], case.values["plane.angular_velocity"]) for case in cases]
    assert places[:4] == [(-0.2, 0.0), (-0.2, 0.0), (-0.2, 1.5), (-0.2, 1.5)]
    assert places[-1] == (0.3, 200)
    assert len(set(places)) == 18
    assert list(cases[0].values) == ["plane.angle", "plane.angular_velocity", "swarm.agents.0.mass"]
    assert len({case.seed for case in cases}) == len({case.values["swarm.agents.0.mass"] for case in cases}) == 36
    assert all(0 <= case.seed < 2**63 for case in cases)
    assert list(load_sweep(small).cases()) == cases
    # Fixed for good: results of today can be computed again tomorrow.
    assert (cases[3].seed, cases[3].values["swarm.agents.0.mass"]) == (4532179165627572865, 0.5868372841865062)
    # Another parameter changes no other draw.
    more = "  swarm.agents.1.mass: {uniform: [0.25, 0.75]}\nsamples"
    small.write_text(small.read_text().replace("samples", more))
    masses = [case.values["swarm.agents.0.mass"] for case in cases]
    assert [case.values["swarm.agents.0.mass"] for case in load_sweep(small).cases()] == masses


def test_distributions(tmp_path: Path) -> None:
    text = (
        HEAD + "random:\n  plane.angle: {uniform: [-0.5, 1.5]}\n  plane.inertia: {normal: [3, 0.5]}\n"
        "  step: {choice: [0.01, 0.02]}\nsamples: 4000\n"
    )
    cases = list(load_sweep(written(tmp_path, text)).cases())
    uniform, normal, choice = ([case.values[path] for case in cases] for path in cases[0].values)
    assert -0.5 < min(uniform) < -0.49 < 1.49 < max(uniform) < 1.5
    assert mean(uniform) == pytest.approx(0.5, abs=0.03)
    assert (mean(normal), stdev(normal)) == (pytest.approx(3.0, abs=0.03), pytest.approx(0.5, abs=0.03))
    assert choice.count(0.01) == pytest.approx(2000, abs=150)


def test_values_may_be_anything_that_a_scenario_holds(tmp_path: Path) -> None:
    text = HEAD + "grid:\n  limits.force: [null, 2.0]\n  faults: [[], [{kind: delay, steps: 2}]]\n"
    study = load_sweep(written(tmp_path, text))
    scenarios = [parse_scenario(study.scenario, overrides=case.overrides()) for case in study.cases()]
    assert [(s.limits.force, len(s.faults)) for s in scenarios] == [(inf, 0), (inf, 1), (2.0, 0), (2.0, 1)]
    # Generated swarms are left to generate.
    text = HEAD.replace("pd_het_4", "arise_het_20") + "grid: {swarm.generate.single_integrator: [4, 8]}\n"
    study = load_sweep(written(tmp_path, text))
    scenarios = [parse_scenario(study.scenario, overrides=case.overrides()) for case in study.cases()]
    assert [len(scenario.agents) for scenario in scenarios] == [14, 18]


def test_the_sweep_that_is_kept_is_the_same_sweep(tmp_path: Path, small: Path) -> None:
    study = load_sweep(small, ["plane.friction.0=0.02"])
    (tmp_path / "sweep.yaml").write_text(study.sweep_text)
    (tmp_path / "scenario.yaml").write_text(study.scenario)
    again = load_sweep(tmp_path / "sweep.yaml")
    assert (again.sweep_text, again.scenario) == (study.sweep_text, study.scenario)
    assert list(again.cases()) == list(study.cases())
