"""Runs on other parent systems than the plane: verified, compared, replayed, exported and swept like those on it."""

import csv
import itertools
import json
import math
import re
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from matplotlib.figure import Figure
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from numpy.typing import NDArray
from scipy.io import loadmat
from tests.frozen.command import swarm, swarm_process
from tests.swarmabs_analysis.report.conftest import Page
from tests.swarmabs_analysis.report.test_report import assert_self_contained
from tests.swarmabs_bag.mcap_files import rewritten
from tests.systems import Sheet, installed

from swarmabs_analysis.comparison.bags import compare_bags
from swarmabs_analysis.export import export_arrays, export_tables
from swarmabs_analysis.figures.runs import find_runs
from swarmabs_analysis.figures.style import styled
from swarmabs_analysis.report import make_report
from swarmabs_analysis.report.panels import Panel, panels
from swarmabs_analysis.report.record import read_recorded
from swarmabs_analysis.rerun import recorded_run
from swarmabs_analysis.sweep.evaluate import evaluate
from swarmabs_analysis.sweep.picture import pictures
from swarmabs_analysis.sweep.study import load_sweep
from swarmabs_analysis.verify import BagToVerify
from swarmabs_bag.errors import DamagedBagError
from swarmabs_bag.run_folder import new_run_folder
from swarmabs_config.scenario import parse_scenario
from swarmabs_config.scenarios import find_scenario
from swarmabs_core.cdr import decode, encode
from swarmabs_core.errors import InputError
from swarmabs_core.messages import TOPICS, Kind
from swarmabs_core.nodes import NodeName
from swarmabs_core.systems.components import derived
from swarmabs_core.systems.interface import SYSTEMS
from swarmabs_core.systems.kinds import KINDS, RobotKind
from swarmabs_run.simulated_run import simulate_run
from swarmabs_run.simulation import simulate

Floats = NDArray[np.float64]
ROWS = ("moment_x", "moment_y", "inertia_xx", "inertia_yy", "inertia_xy")
BEAM = """\
schema: 1
name: beam
duration: 0.5
step: 0.01
system: {type: beam}
swarm:
  agents:
    - {id: 1, kind: single_integrator, coordinates: [0.1], constants: {mass: 0.7}}
    - {id: 2, kind: single_integrator, coordinates: [-0.1], constants: {mass: 0.6}}
    - {id: 3, kind: double_integrator, coordinates: [0.2], constants: {mass: 0.5, damping: 0.1}}
    - {id: 5, kind: first_order_lag, coordinates: [-0.15], constants: {mass: 0.5}}
faults:
  - {kind: kill, agent: 2, at: 0.2}
  - {kind: loss, probability: 0.2, agents: [1]}
"""
SHEET = """\
schema: 1
name: sheet
duration: 0.3
step: 0.01
system: {type: sheet}
swarm:
  agents:
    - {id: 1, kind: single_integrator, coordinates: [0.4, 0.0], constants: {mass: 1.2}}
    - {id: 2, kind: single_integrator, coordinates: [-0.2, 0.3], constants: {mass: 1.2}}
    - {id: 3, kind: double_integrator, coordinates: [-0.2, -0.3], constants: {mass: 1.2}}
    - {id: 4, kind: double_integrator, coordinates: [0.1, 0.2], constants: {mass: 1.2}}
"""
LIFT = """\
schema: 1
name: lift
duration: 1.0
step: 0.01
system: {type: lift}
swarm:
  agents:
    - {id: 1, kind: first_order_lag, coordinates: [7.0], constants: {place: 0.5}}
    - {id: 2, kind: first_order_lag, coordinates: [7.0], constants: {place: -0.5}}
    - {id: 3, kind: first_order_lag, coordinates: [7.0], constants: {place: 0.3, top: 7.5}}
    - {id: 4, kind: first_order_lag, coordinates: [7.0], constants: {place: -0.3}}
"""


@pytest.fixture(scope="module", autouse=True)
def _systems(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    folder = tmp_path_factory.mktemp("packages") / "systems"
    with pytest.MonkeyPatch.context() as patch:
        installed(folder)
        patch.syspath_prepend(folder)
        SYSTEMS.forget()
        yield
    SYSTEMS.forget()
    sys.modules.pop("systems_of_tests", None)


def record(folder: Path, text: str, *overrides: str) -> Path:
    outcome = simulate_run(parse_scenario(text, overrides=overrides).resolved(), new_run_folder(folder))
    assert outcome.status == "ok", outcome.reason
    return folder


@pytest.mark.smoke
@pytest.mark.timeout(300)
@pytest.mark.parametrize("fault", ["derivative_late", pytest.param("reference_late", marks=pytest.mark.system)])
def test_an_exception_of_the_system_ends_simulate_and_run_with_one_line(
    tmp_path: Path, fault: str, nothing_survives: str
) -> None:
    """The one is of a node, the other of the recorder."""
    del nothing_survives
    installed(tmp_path / "packages")
    text = BEAM.replace("type: beam", f"type: faulty, fault: {fault}").replace("kill, agent: 2", "kill, agent: 5")
    (tmp_path / "beam.yaml").write_text(text, encoding="utf-8")
    simulated = swarm(["simulate", "beam.yaml", "-o", "simulated"], tmp_path)
    for done in (simulated, swarm_process(["run", "beam.yaml", "-o", "run"], tmp_path, [tmp_path / "packages"])):
        assert done.code == 1
        assert "Traceback" not in done.out + done.err
        assert re.search(r"step 5: ZeroDivisionError: float division by zero \(systems_of_tests\.py:\d+\)", done.err)


@pytest.mark.system
@pytest.mark.timeout(300)
def test_a_generated_swarm_with_noise_and_a_slow_filter_has_one_digest(tmp_path: Path, nothing_survives: str) -> None:
    del nothing_survives
    installed(tmp_path / "packages")
    parts = "sensor: {noise: [0.001, 0.01]}\nrequests: {bandwidth: 20.0, high: [3.0]}\nseed: 5\n"
    swarm_of = "{single_integrator: 2, first_order_lag: 2, constants: {mass: [0.3, 0.6]}, coordinates: [[-0.3, 0.3]]}"
    text = f"{BEAM.partition('swarm:')[0]}{parts}swarm:\n  generate: {swarm_of}\n"
    (tmp_path / "beam.yaml").write_text(text, encoding="utf-8")
    run = swarm_process(["run", "beam.yaml", "-o", "run", "--json"], tmp_path, [tmp_path / "packages"])
    simulated = swarm(["simulate", "beam.yaml", "-o", "simulated", "--json"], tmp_path)
    assert run.document()["digest"] == simulated.document()["digest"]
    logs = {path.stem for path in (tmp_path / "run" / "logs").glob("*.log")}
    assert "parent_system" in logs and "plane_sim" not in logs
    assert swarm(["verify", "run"], tmp_path).code == 0


@pytest.fixture(scope="module")
def beam(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("runs") / "beam", BEAM)


@pytest.fixture(scope="module")
def sheet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("runs") / "sheet", SHEET)


class Read:
    """The messages of a bag by topic, read with the libraries of MCAP and nothing of this project."""

    def __init__(self, run: Path) -> None:
        self._messages: dict[str, list[Any]] = defaultdict(list)
        with next(run.rglob("*.mcap")).open("rb") as stream:
            reader = make_reader(stream, decoder_factories=[DecoderFactory()])
            for _, channel, _, message in reader.iter_decoded_messages():
                self._messages[channel.topic].append(message)

    def of(self, topic: str, agent: int | None = None) -> list[Any]:
        return [m for m in self._messages[topic] if agent is None or m.agent_id == agent]

    def column(self, topic: str, field: str, agent: int | None = None) -> Floats:
        return np.array([getattr(m, field) for m in self.of(topic, agent)])


def altered(run: Path, folder: Path, topic: str, number: int, **fields: Any) -> Path:
    """Return a bag with other fields in one message; a function gives a field from the one in the bag."""
    kind = next(one.message for one in TOPICS if f"/{one.name}" == topic)
    count = itertools.count()

    def change(name: str, data: bytes) -> bytes:
        if name != topic or next(count) != number:
            return data
        message: Any = decode(kind, data)
        new = {key: value(getattr(message, key)) if callable(value) else value for key, value in fields.items()}
        return encode(message._replace(**new))

    folder.mkdir()
    return rewritten(run / "bag", folder / "bag_0.mcap", change)


def flipped(index: int) -> Callable[[tuple[float, ...]], tuple[float, ...]]:
    """Return a function that changes the last bit of a component."""
    return lambda v: (*v[:index], math.nextafter(v[index], math.inf), *v[index + 1 :])


@pytest.mark.parametrize("name", ["beam", "sheet"])
def test_a_run_is_verified_and_its_description_too(name: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    run = request.getfixturevalue(name)
    result = BagToVerify(run).verify()
    assert result.complete
    assert result.messages == sum(len(Read(run).of(f"/{topic.name}")) for topic in TOPICS)
    assert result.digest == simulate(BagToVerify(run).scenario).summary()["digest"]
    other = altered(run, tmp_path / "other", "/parent/system", 0, description=lambda text: text.replace("mass", "mess"))
    difference = BagToVerify(other).verify().difference
    assert difference is not None
    assert (difference.topic, difference.step, difference.field) == ("parent/system", 0, "description")


@pytest.mark.parametrize(
    ("topic", "number", "field", "index", "agent"),
    [
        ("/swarm/auxiliary", 9, "curvature", 1, None),
        ("/swarm/desired", 3, "mean_rate", 1, None),
        ("/parent/state", 5, "state", 1, None),
        ("/swarm/robot_state", 8, "velocities", 0, 1),
        ("/swarm/robot_state", 8, "constants", 2, 1),
    ],
)
def test_a_flipped_bit_is_found_and_named(
    beam: Path, tmp_path: Path, topic: str, number: int, field: str, index: int, agent: int | None
) -> None:
    bag = altered(beam, tmp_path / "bag", topic, number, **{field: flipped(index)})
    step = number if agent is None else number // 4
    value = getattr(Read(beam).of(topic)[number], field)[index]
    difference = BagToVerify(bag).verify().difference
    assert difference is not None
    assert (f"/{difference.topic}", difference.step, difference.agent) == (topic, step, agent)
    assert (difference.field, difference.a, difference.b) == (
        f"{field}[{index}]",
        math.nextafter(value, math.inf),
        value,
    )
    assert BagToVerify(bag).verify(tolerance=1e-9).ok
    first = compare_bags(bag, beam).messages.first
    assert first is not None and first.field == f"{field}[{index}]"


def test_deviations_are_by_component_with_names_and_units(beam: Path, tmp_path: Path) -> None:
    other = record(tmp_path / "other", BEAM, "swarm.gains.k=[4.0]")
    comparison = compare_bags(beam, other)
    fields = {(t.topic, f.field): f for t in comparison.messages.topics for f in t.fields}
    for topic, field, index in (
        ("swarm/abstract", "value", 1),
        ("swarm/auxiliary", "gram", 2),
        ("parent/state", "state", 0),
    ):
        a, b = (Read(run).column(f"/{topic}", field)[:, index] for run in (beam, other))
        of = fields[topic, f"{field}[{index}]"]
        assert of.largest == np.abs(a - b).max()
        assert of.rms == pytest.approx(np.sqrt(np.mean((a - b) ** 2)), rel=1e-12)
        assert of.differing == np.count_nonzero(a != b)
    assert [difference.field for difference in comparison.scenario] == ["swarm.gains.k"]
    text = swarm(("compare", beam, other), tmp_path).out
    for named in (
        "value[1] inertia, kg m^2 ",
        "rate[0] torque, N m/s ",
        "state[1] rate, rad/s ",
        "max |position|, m",
    ):
        assert named in text
    assert "rms error, rad" in text
    assert (
        comparison.a.figures["max_abs_position"] == np.abs(Read(beam).column("/swarm/robot_state", "coordinates")).max()
    )


def test_runs_on_different_parent_systems_have_no_message_in_common(beam: Path, sheet: Path, tmp_path: Path) -> None:
    plane = tmp_path / "plane"
    assert simulate_run(find_scenario("pd_het_4", ["duration=0.1"]).resolved(), new_run_folder(plane)).status == "ok"
    comparison = compare_bags(plane, sheet)
    assert {topic.compared for topic in comparison.messages.topics} == {0}
    assert sum(t.missing_in_a for t in comparison.messages.topics) == comparison.b.figures["messages"]
    done = swarm(("compare", beam, sheet), tmp_path)
    assert done.code == 1
    assert "system" in done.out and "coordinates " in done.out
    assert "rms error" in done.out and "rms error, rad" not in done.out


@pytest.mark.parametrize(
    "nodes", ["controller", "plane", "observer", "agent:2", "agent:3 controller", "parent agent:5"]
)
def test_a_node_answers_its_recording_as_it_did(beam: Path, nodes: str) -> None:
    bag = BagToVerify(beam)
    result = bag.verify(trial=bag.trial(tuple(map(NodeName.parse, nodes.split()))))
    assert (result.ok, result.complete, result.trial["deviations"]) == (True, True, [])
    assert result.messages > 20


def test_a_controller_with_another_setting_answers_differently_to_the_same_states(beam: Path) -> None:
    bag, controller = BagToVerify(beam), (NodeName.parse("controller"),)
    result = bag.verify(trial=bag.trial(controller, ("system.added=4.0",)))
    first = result.difference
    assert first is not None
    assert (first.step, first.topic, first.field) == (1, "swarm/desired", "mean_rate[0]")
    assert first.b == pytest.approx(2.0 * first.a, rel=1e-12)  # torque = added * rate
    assert {row["field"].partition("[")[0] for row in result.trial["deviations"]}.isdisjoint({"system", "step"})
    with pytest.raises(InputError, match="--set changes the control period"):
        bag.trial(controller, ("step=0.005",))


def test_a_recorded_run_is_repeated(beam: Path) -> None:
    repeated = recorded_run(beam)
    assert (repeated.complete, repeated.differences) == (True, ())
    assert repeated.scenario.resolved() == parse_scenario(BEAM).resolved()


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_tables_have_a_column_for_each_quantity(sheet: Path, tmp_path: Path) -> None:
    export_tables(sheet, tmp_path / "csv", "csv")
    export_tables(sheet, tmp_path / "parquet", "parquet")
    read = Read(sheet)
    gram = [f"gram_{row}_{column}" for n, row in enumerate(ROWS) for column in ROWS[: n + 1]]
    columns = {
        ("agents", "/swarm/robot_state", "coordinates"): ["x", "y"],
        ("agents", "/swarm/robot_state", "velocities"): ["velocities_x", "velocities_y"],
        ("agents", "/swarm/robot_state", "constants"): ["mass", "damping"],
        ("parent", "/parent/state", "state"): ["al", "be", "al_rate", "be_rate"],
        ("abstract", "/swarm/abstract", "value"): list(ROWS),
        ("abstract", "/swarm/abstract", "rate"): [f"rate_{row}" for row in ROWS],
        ("auxiliary", "/swarm/auxiliary", "gram"): gram,
        ("auxiliary", "/swarm/auxiliary", "curvature"): [f"curvature_{row}" for row in ROWS],
        ("desired", "/swarm/desired", "end_rate"): [f"end_rate_{row}" for row in ROWS],
    }
    for (table, topic, field), names in columns.items():
        values = read.column(topic, field)
        lines = rows(tmp_path / "csv" / f"{table}.csv")
        np.testing.assert_array_equal([[float(row[name]) for name in names] for row in lines], values)
        frame = pq.read_table(tmp_path / "parquet" / f"{table}.parquet")
        np.testing.assert_array_equal(np.column_stack([frame[name].to_numpy() for name in names]), values)
    units = {(row["table"], row["column"]): row["unit"] for row in rows(tmp_path / "csv" / "columns.csv")}
    assert {"system", "coordinates"}.isdisjoint(column for _, column in units)
    assert units["parent", "al_rate"] == "rad/s"
    assert units["agents", "velocities_y"] == "m/s"
    assert units["desired", "mean_acceleration_inertia_xy"] == "kg m^2/s^2"
    assert units["parent", "reference_be"] == "rad"
    goals = [Sheet().reference(step * 0.01) for step in range(31)]
    lines = rows(tmp_path / "csv" / "parent.csv")
    assert [(float(row["reference_al"]), float(row["reference_be"])) for row in lines] == goals
    file = export_arrays(sheet, tmp_path / "run.npz")
    with np.load(file, allow_pickle=False) as arrays:
        assert json.loads(str(arrays["units"]))["agents_x"] == "m"
        for agent in range(4):
            path = read.column("/swarm/robot_state", "coordinates", agent + 1)
            np.testing.assert_array_equal(arrays["agents_y"][:, agent], path[:, 1])
        np.testing.assert_array_equal(arrays["abstract_inertia_xy"], read.column("/swarm/abstract", "value")[:, 4])
        np.testing.assert_array_equal(arrays["parent_reference_al"], [al for al, _ in goals])
        assert set(json.loads(str(arrays["units"]))) == set(arrays.files) - {"units", "words", "summary"}
        mat = loadmat(export_arrays(sheet, tmp_path / "run.mat", "mat"), simplify_cells=True)
        assert {name for name in mat if not name.startswith("__")} == set(arrays.files)
        units = json.loads(str(arrays["units"]))
        assert {name: unit if len(unit) else "" for name, unit in mat["units"].items()} == units
    values = read.column("/parent/state", "state")
    np.testing.assert_array_equal([mat[f"parent_{name}"] for name in ("al", "be", "al_rate", "be_rate")], values.T)


def test_a_name_that_is_taken_is_preceded_by_its_field(beam: Path, tmp_path: Path) -> None:
    def renamed(text: str) -> str:
        document = json.loads(text)
        document["parent"][1]["name"], document["robot"][0]["name"], document["constants"][0]["name"] = (
            "time",
            "kind",
            "kind",
        )
        return json.dumps(document)

    bag = altered(beam, tmp_path / "bag", "/parent/system", 0, description=renamed)
    export_tables(bag, tmp_path / "csv", "csv")
    assert set(rows(tmp_path / "csv" / "parent.csv")[0]) == {
        "step",
        "time",
        "reference_angle",
        "angle",
        "state_time",
        "stamp",
    }
    state = rows(tmp_path / "csv" / "agents.csv")[2]
    assert (state["kind"], state["coordinates_kind"], state["constants_kind"]) == ("double_integrator", "0.2", "0.5")


@pytest.mark.parametrize(
    ("unit", "first", "second"),
    [
        ("N m", "N m/s", "N m/s^2"),
        ("m/s", "m/s^2", "m/s^3"),
        ("m/s^2", "m/s^3", "m/s^4"),
        ("1", "1/s", "1/s^2"),
        ("s", "s/s", "s/s^2"),
    ],
)
def test_units_of_derivatives(unit: str, first: str, second: str) -> None:
    assert (derived(unit, 0), derived(unit), derived(unit, 2)) == (unit, first, second)


def test_a_bag_that_is_cut_off_before_its_first_message_has_no_report(beam: Path, tmp_path: Path) -> None:
    whole = (beam / "bag" / "bag_0.mcap").read_bytes()
    bag = tmp_path / "bag_0.mcap"
    bag.write_bytes(whole[: whole.index(b"provenance.json") + 3000])
    with pytest.raises(DamagedBagError, match="no messages of the parent system of its scenario"):
        make_report(bag)
    assert BagToVerify(bag).verify().problem is not None


def test_a_figure_of_the_paper_refuses_another_parent_system(beam: Path) -> None:
    with pytest.raises(InputError, match="a figure of the paper supports only the plane, not the parent system 'beam'"):
        find_runs([beam], ["pd_si_4"])


def test_a_sweep_varies_settings_of_the_parent_system(tmp_path: Path) -> None:
    (tmp_path / "beam.yaml").write_text(BEAM)
    (tmp_path / "sweep.yaml").write_text(
        "schema: 1\nscenario: beam.yaml\nset: {duration: 0.3, swarm.agents.2.coordinates: [0.14]}\n"
        "grid: {system.angle: [0.001, 0.1], system.hit: [10.0, 0.0011]}\n"
    )
    study = load_sweep(tmp_path / "sweep.yaml")
    rows = [json.loads(evaluate(study.task(index))) for index in range(study.sweep.count)]
    assert [row["outcome"] for row in rows] == ["settled", "failed", "unsettled", "refused"]
    assert rows[2]["max_abs_angle"] == 0.1
    assert rows[1]["reason"].endswith("the beam hit the ground")
    assert all("in_printed_estimate" not in row for row in rows)
    drawn = pictures(study, dict(enumerate(rows)))
    svg = drawn["region.svg"].decode()
    assert "does not settle" in svg and "the run fails" in svg
    assert "plane" not in svg
    alone = simulate(
        find_scenario(
            str(tmp_path / "beam.yaml"),
            ["duration=0.3", "swarm.agents.2.coordinates=[0.14]", *study.case(2).overrides()],
        )
    )
    assert alone.summary()["digest"] == rows[2]["digest"]


def drawn(panel: Panel) -> dict[str, list[Floats]]:
    """Return the curves of a panel by their labels, as arrays (points, 2)."""
    with styled():
        figure = Figure()
        panel.draw(figure)
    curves: dict[str, list[Floats]] = defaultdict(list)
    for line in figure.axes[0].lines:
        curves[str(line.get_label())].append(np.asarray(line.get_xydata()))
    legend = figure.axes[0].get_legend()
    for text in legend.get_texts() if legend else ():
        curves.setdefault(text.get_text(), [])
    return curves


@pytest.mark.system
def test_the_page_has_the_numbers_of_the_bag(sheet: Path) -> None:
    report, read = make_report(sheet), Read(sheet)
    assert_self_contained(report.html)
    assert report.png.startswith(b"\x89PNG")
    page = Page(report.html)
    goals = np.array([Sheet().reference(step * 0.01) for step in range(31)])
    error = np.linalg.norm(goals - read.column("/parent/state", "state")[:, :2], axis=1)
    assert page.rows["RMS error"][1] == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-12)
    assert page.rows["Final error"][1] == pytest.approx(error[-1], rel=1e-12)
    assert page.rows["Largest |coordinate|"][1] == np.abs(read.column("/swarm/robot_state", "coordinates")).max()
    margins, scale = [], np.array([row.scale for row in Sheet.abstract])
    for lower in read.column("/swarm/auxiliary", "gram"):
        matrix = np.zeros((5, 5))
        matrix[np.tril_indices(5)] = lower
        matrix = (matrix + matrix.T - np.diag(matrix.diagonal())) / np.outer(scale, scale)
        margins.append(min(np.linalg.eigvalsh(matrix)) / max(matrix.diagonal()))
    assert page.rows["Margin of the Gram matrix"][1] == pytest.approx(min(margins), rel=1e-9)
    assert report.numbers["margins"] == {"gram": pytest.approx(min(margins), rel=1e-9)}
    assert report.numbers["digest"] == BagToVerify(sheet).verify().digest
    assert page.rows["Messages"][1] == BagToVerify(sheet).verify().messages
    texts = [text for _, text in page.texts]
    assert {"Parent system", "Al, be and references of the sheet", "Paths of the robots"} <= set(texts)
    assert "4 (2 single integrators, 2 double integrators)" in re.sub(r"<[^>]*>", "", report.html)
    assert "Plane" not in texts and "Theory" not in texts


def test_the_pictures_show_parent_abstract_state_and_robots(sheet: Path) -> None:
    by_key, read = {panel.key: panel for panel in panels(read_recorded(sheet))}, Read(sheet)
    time = np.arange(31) * 0.01
    state, value, desired = (
        read.column(*names)
        for names in (("/parent/state", "state"), ("/swarm/abstract", "value"), ("/swarm/desired", "value"))
    )
    goals = np.array([Sheet().reference(step * 0.01) for step in range(31)])
    curves = {
        "parent-0": {"al": state[:, 0], "be": state[:, 1], "reference al": goals[:, 0], "reference be": goals[:, 1]},
        "parent-1": {"al rate": state[:, 2], "be rate": state[:, 3]},
        "parent-error": {"reference - al": goals[:, 0] - state[:, 0], "reference - be": goals[:, 1] - state[:, 1]},
        "abstract-1": {f"{ROWS[n].replace('_', ' ')} actual": value[:, n] for n in range(2, 5)}
        | {f"{ROWS[n].replace('_', ' ')} desired": desired[:, n] for n in range(2, 5)},
        "robots-coordinate-1": {
            f"y{'₀₁₂₃₄'[agent]}": read.column("/swarm/robot_state", "coordinates", agent)[:, 1] for agent in range(1, 5)
        },
        "robots-rate-1": {
            f"rate of y{'₀₁₂₃₄'[agent]}": read.column("/swarm/robot_state", "velocities", agent)[:, 1]
            for agent in range(1, 5)
        },
        "parent-error-decades": {"norm of the errors": np.linalg.norm(goals - state[:, :2], axis=1)},
    }
    for key, lines in curves.items():
        shown = drawn(by_key[key])
        for label, values in lines.items():
            np.testing.assert_allclose(shown[label][0], np.column_stack([time, values]), rtol=0, atol=1e-15)
    figure = Figure()
    by_key["robots-paths"].draw(figure)
    paths = [np.asarray(line.get_xydata()) for line in figure.axes[0].lines[::2]]
    for agent in range(1, 5):
        np.testing.assert_array_equal(paths[agent - 1], read.column("/swarm/robot_state", "coordinates", agent))


def test_commands_are_shown_by_kind_with_their_units(beam: Path) -> None:
    by_key = {panel.key: panel for panel in panels(read_recorded(beam)) if "command" in panel.key}
    axes = {}
    for key, panel in by_key.items():
        figure = Figure()
        panel.draw(figure)
        axes[key] = figure.axes[0].get_ylabel()
    assert axes == {
        "robots-command-position-1": "command u, m/s",
        "robots-command-position-2": "command u, N",
        "robots-command-position-3": "command u, m",
    }
    (line,) = drawn(by_key["robots-command-position-2"])["u₃"]
    np.testing.assert_array_equal(line[:, 1], Read(beam).column("/swarm/robot_state", "command", 3)[:, 0])
    assert "commands of 1 double integrator: " in by_key["robots-command-position-2"].about


def test_each_number_of_a_command_has_the_unit_that_its_kind_gives_it(
    sheet: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Steered(RobotKind):
        def command_units(self, units: Sequence[str]) -> tuple[str, ...]:
            along, _ = units
            return f"{along}/s", "rad/s"

    monkeypatch.setitem(KINDS, Kind.SINGLE_INTEGRATOR, Steered())
    labels = {}
    for panel in panels(read_recorded(sheet)):
        if panel.key.startswith("robots-command") and panel.key.endswith("-1"):
            figure = Figure()
            panel.draw(figure)
            labels[panel.key] = figure.axes[0].get_ylabel()
    assert labels == {
        "robots-command-x-1": "command u along x, m/s",
        "robots-command-y-1": "command u along y, rad/s",
    }


def test_a_limited_robot_and_a_dead_one_are_shown(beam: Path, tmp_path: Path) -> None:
    lift = record(tmp_path / "lift", LIFT)
    assert 4 in {m.status for m in Read(lift).of("/swarm/robot_state", 3)}
    for run, labels in (
        (lift, {"first order lag follows", "at a limit"}),
        (beam, {"single integrator follows", "double integrator follows", "first order lag follows", "dead"}),
    ):
        (membership,) = (panel for panel in panels(read_recorded(run)) if panel.key == "membership")
        assert {label for label in drawn(membership) if not label.startswith("_")} == labels
    many = [f"{{id: {n}, kind: single_integrator, coordinates: [{0.01 * n - 0.2}]}}" for n in range(1, 30)]
    text = f"{BEAM[: BEAM.index('  agents')]}  agents: [{', '.join(many)}]\n".replace(
        "]}", "], constants: {mass: 0.1}}"
    )
    crowd = record(tmp_path / "crowd", text, "duration=0.1")
    (coordinates,) = (panel for panel in panels(read_recorded(crowd)) if panel.key == "robots-coordinate-0")
    assert {"initially position > 0", "initially position ≤ 0"} <= set(drawn(coordinates))
