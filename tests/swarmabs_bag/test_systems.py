"""Runs on any parent system: what is recorded in which order, and what is shown of them live and from the bag."""

import hashlib
import json
import math
import random
import struct
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.swarmabs_bag.test_recorder import parameters
from tests.swarmabs_core.helpers import singly
from tests.swarmabs_ros.nodes import settings_from

from swarmabs_bag.attached import attached_provenance, attached_scenario, description_of
from swarmabs_bag.bag_summary import reference_of_bag, summarise_bag
from swarmabs_bag.errors import DamagedBagError
from swarmabs_bag.info import bag_info
from swarmabs_bag.reader import open_bag
from swarmabs_bag.recorder import node
from swarmabs_bag.recorder.recording import Recording
from swarmabs_bag.recorder.swarm_summary import SummaryTracker
from swarmabs_bag.repair import repair_bag
from swarmabs_bag.repair.completeness import complete_steps
from swarmabs_bag.run.figures import RunFigures, Tracking
from swarmabs_bag.run.gatherer import RunCollector
from swarmabs_bag.run.step import Step
from swarmabs_bag.shown.recorded_swarm import read_swarm
from swarmabs_bag.shown.swarm_state import RobotIdentity, ShownRobot, SwarmState
from swarmabs_config import configure
from swarmabs_config.scenario import Scenario, parse_scenario
from swarmabs_config.scenarios import find_scenario
from swarmabs_core import messages as msg
from swarmabs_core.behaviours.base import ConflictError, OtherSystemError
from swarmabs_core.cdr import encode
from swarmabs_core.record import Record
from swarmabs_core.steering import REFERENCE
from swarmabs_core.systems import SYSTEMS, Quantity, SystemTables, Tracked
from swarmabs_ros.status import StatusChannel
from swarmabs_run.simulation import Simulation

pytestmark = pytest.mark.usefixtures("systems")

SHEET = """
schema: 1
name: sheet
duration: 0.4
system: {type: sheet, amplitude: 0.2}
swarm:
  gains: {k: [5, 5, 5, 5, 5]}
  agents:
    - {id: 1, coordinates: [0.6, 0.0], constants: {mass: 0.7}}
    - {id: 3, coordinates: [0.2, 0.6], constants: {mass: 1.1}, kind: double_integrator}
    - {id: 4, coordinates: [-0.5, 0.3], constants: {mass: 1.0}}
    - {id: 5, coordinates: [-0.4, -0.5], constants: {mass: 0.9}}
    - {id: 7, coordinates: [0.3, -0.5], constants: {mass: 1.1, damping: 0.2}, kind: double_integrator}
faults:
  - {kind: kill, agent: 4, at: 0.2}
  - {kind: remove, agent: 5, at: 0.3}
  - {kind: join, agent: 7, at: 0.1}
"""
BEAM = """
schema: 1
name: beam
duration: 0.2
system: {type: beam}
swarm:
  gains: {k: [5, 5]}
  agents:
    - {id: 1, coordinates: [0.3], constants: {mass: 0.2}}
    - {id: 2, coordinates: [-0.2], constants: {mass: 0.3}}
"""
LIFT = """
schema: 1
name: lift
duration: 0.3
system: {type: lift}
swarm:
  gains: {k: [5, 5]}
  agents:
    - {id: 1, kind: first_order_lag, coordinates: [7.0], constants: {place: -0.4, top: 8.0}}
    - {id: 2, kind: first_order_lag, coordinates: [7.0], constants: {place: -0.2, top: 40.0}}
    - {id: 3, kind: first_order_lag, coordinates: [7.0], constants: {place: 0.1, top: 40.0}}
    - {id: 4, kind: first_order_lag, coordinates: [7.0], constants: {place: 0.4, top: 40.0}}
"""


def simulated(text: str, *overrides: str) -> tuple[Any, list[Step]]:
    scenario = parse_scenario(text, overrides=overrides).resolved()
    return scenario, singly(Simulation(scenario).steps())


def messages_of(steps: Iterable[Step]) -> list[msg.Message]:
    return [record.message for step in steps for record in step.records]


def bag_of(scenario: Scenario, steps: Iterable[Step], folder: Path) -> Path:
    recording = Recording(scenario, folder, driver="simulate")
    for step in steps:
        recording.add(step)
    recording.close()
    return folder


def sheet_steps(names: tuple[str, ...] = ()) -> list[str]:
    """Return the topics of a step on the sheet while robots 1, 3, 4 and 5 take part."""
    states = ["swarm/robot_state"] * 4
    return [*names, *states, "parent/state", "swarm/abstract", "swarm/auxiliary", "swarm/desired"]


# The order of a bag, and what makes a step complete


def test_the_description_is_first_and_not_in_the_digest_whatever_the_order_of_arrival() -> None:
    scenario, steps = simulated(SHEET)
    assert [record.topic.name for record in steps[0].records] == sheet_steps(("parent/system",))
    assert [record.topic.name for record in steps[1].records] == sheet_steps()
    mixed = messages_of(steps)
    random.Random(5).shuffle(mixed)
    members, schedule = configure.members(scenario), configure.schedule(scenario)
    division = configure.division(scenario)
    collector = RunCollector(members, schedule, scenario.steps, division=division, family=msg.SYSTEM_FAMILY)
    found = [step for message in [*mixed, mixed[0]] for step in collector.add(Record.of(message))]
    assert sorted(record.payload for step in found for record in step.records) == sorted(map(encode, mixed))
    complete = [step for step in found if step.parent is not None]
    assert singly(complete) == steps
    records = []
    for message in mixed:
        if not isinstance(message, msg.SwarmEvent | msg.SystemDescription | msg.StandingState):
            payload, topic = encode(message), msg.TOPIC_OF[type(message)].name.encode()
            key = (message.step, topic, getattr(message, "agent_id", 0))
            records.append((key, topic + b"\0" + struct.pack("<I", len(payload)) + payload))
    figures = RunFigures(lambda _: (0.0, 0.0), Tracking.of(scenario.named.instance))
    for step in complete:
        figures.add(step)
    assert figures.digest() == hashlib.sha256(b"".join(record for _, record in sorted(records))).hexdigest()


def test_step_0_waits_for_the_description_and_refuses_a_second_one() -> None:
    scenario, steps = simulated(SHEET)
    collector = RunCollector(configure.members(scenario), (), scenario.steps, family=msg.SYSTEM_FAMILY)
    description, *others = steps[0].records
    late = [step for record in others for step in collector.add(record)]
    assert (late, collector.step, "parent/system" in collector.missing()) == ([], 0, True)
    assert [each.step for each in collector.add(description)] == []
    joins = steps[10].records[-1]
    assert collector.missing() == ("agent 7",), "no schedule tells this collector that it joins later"
    other = msg.SystemDescription(0, 0, 1, "{}")
    with pytest.raises(ConflictError, match="parent/system"):
        collector.add(Record.of(other))
    assert isinstance(joins.message, msg.SwarmEvent)


def test_the_recorder_reports_the_first_tracked_quantity(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scenario, steps = simulated(SHEET)
    told: list[dict[str, Any]] = []
    monkeypatch.setattr(StatusChannel, "send", lambda _, event, **details: told.append({"event": event, **details}))
    spec = node.make(settings_from(node.PARAMETERS, **parameters(scenario, tmp_path)), StatusChannel("recorder"))
    assert set(spec.behaviour.awaits()) == {*msg.SYSTEM_FAMILY.main, msg.SYSTEM, msg.STANDING, msg.EVENTS}
    parent = steps[0].parent
    assert isinstance(parent, msg.ParentState)
    with pytest.raises(OtherSystemError):
        spec.behaviour.handle(parent._replace(system=1))
    for message in messages_of(steps):
        spec.behaviour.handle(message)
    assert spec.behaviour.awaits() == ()
    spec.on_exit(None)
    last = [report for report in told if report["event"] == "progress"][-1]
    parent = steps[-1].parent
    assert isinstance(parent, msg.ParentState) and last["angle"] == parent.state[0]
    assert last["robots"]["statuses"] == "AADLA" and last["robots"]["places"] == []
    done = told[-1]
    assert done["complete"] and done["figures"]["messages"] == len(messages_of(steps))
    bag = open_bag(tmp_path / "bag")
    assert [encode(message) for message in messages_of(steps)] == [payload for _, _, payload in bag.messages()]


# Figures


def quantities(*names: str) -> tuple[Quantity, ...]:
    return tuple(Quantity(name, "m") for name in names)


def tables(*tracked: Tracked) -> SystemTables:
    return SystemTables("t", quantities("x", "y", "z"), (), quantities("q"), (), (), tracked, {})


def follow(figures: RunFigures, states: Iterable[tuple[float, ...]]) -> dict[str, Any]:
    for step, state in enumerate(states):
        figures.follow(step, step * 0.5, state)
    return figures.figures()


def test_the_error_is_the_norm_over_all_that_is_tracked() -> None:
    figures = RunFigures(lambda time: (1.0, time), Tracking.of(tables(Tracked("z", 0.5), Tracked("x", 0.1))))
    found = follow(figures, [(0.0, 9.0, 1.0), (0.2, 9.0, 1.4), (1.05, 9.0, 0.8), (1.53, 9.0, 1.04)])
    assert (figures.tracking.name, figures.tracking.unit) == ("z", "m")
    assert found["settled_at"] == 1.0
    assert found["final_error"] == pytest.approx(math.hypot(0.04, 0.03), rel=1e-12)
    errors = [0.0, math.hypot(0.4, 0.3), math.hypot(0.2, 0.05), 0.05]
    assert found["rms_error"] == pytest.approx(math.sqrt(sum(each * each for each in errors) / 4), rel=1e-12)
    assert figures.latest is not None and figures.latest.angle == 1.04
    assert follow(figures, [(math.nan, 0.0, 0.0)])["settled_at"] is None


def test_one_quantity_has_an_error_with_its_sign_and_none_has_no_error() -> None:
    one = RunFigures(lambda _: (1.0,), Tracking.of(tables(Tracked("y", 0.1))))
    assert follow(one, [(0.0, 1.25, 0.0)])["final_error"] == -0.25
    none = RunFigures(lambda _: (), Tracking.of(tables()))
    found = follow(none, [(3.0, 0.0, 0.0)])
    assert [found[name] for name in ("settled_at", "final_error", "rms_error")] == [None, None, None]
    assert none.latest is not None and (none.latest.angle, none.latest.error) == (3.0, None)
    assert (none.tracking.name, none.tracking.unit) == ("x", "m")


def test_the_largest_coordinate_counts(tmp_path: Path) -> None:
    scenario, steps = simulated(SHEET.replace("[0.3, -0.5]", "[0.3, -7.0]"))
    assert summarise_bag(bag_of(scenario, steps, tmp_path / "bag"), None)["max_abs_position"] == 7.0


# Bags


def test_a_bag_has_the_description_the_reference_and_the_same_figures(tmp_path: Path) -> None:
    scenario, steps = simulated(SHEET)
    recording = Recording(scenario, tmp_path / "bag", driver="simulate")
    for step in steps:
        recording.add(step)
    figures = recording.close()
    bag = open_bag(tmp_path / "bag")
    assert bag.family is msg.SYSTEM_FAMILY
    assert bag.topics() == (msg.SYSTEM, *msg.SYSTEM_FAMILY.main, msg.STANDING, msg.EVENTS)
    found = description_of(bag)
    assert found.parent == scenario.named.instance.parent and found.tracked == scenario.named.instance.tracked
    assert (found.name, found.settings["amplitude"]) == ("sheet", 0.2)
    assert attached_scenario(bag) == scenario
    assert attached_provenance(bag)["versions"]["systems-of-tests"] == "1.5"
    wanted = reference_of_bag(bag)
    assert wanted(30) == (0.2 * math.sin(0.4 * 0.3), 0.2 * math.sin(0.25 * 0.3))
    summary = summarise_bag(tmp_path / "bag", None)
    assert summary == {name: figures[name] for name in summary}
    info = bag_info(tmp_path / "bag")
    assert (info.complete, info.problem) == (True, None)
    assert info.scenario is not None and (info.scenario.name, info.scenario.agents) == ("sheet", 5)


def test_the_reference_of_a_bag_has_the_offsets_of_the_scenario(tmp_path: Path) -> None:
    scenario, steps = simulated(BEAM, "faults=[{kind: reference, at: 0.1, until: 0.15, offset: 0.125}]")
    wanted = reference_of_bag(open_bag(bag_of(scenario, steps, tmp_path / "bag")))
    assert [wanted(step) for step in (9, 10, 14, 15)] == [(0.0,), (0.125,), (0.125,), (0.0,)]
    assert read_swarm(tmp_path / "bag").instant(12).reference == (0.125,)


def test_without_its_package_a_bag_still_tells_names_and_units(tmp_path: Path, packages: Path) -> None:
    scenario, steps = simulated(SHEET)
    folder = bag_of(scenario, steps, tmp_path / "bag")
    figures = summarise_bag(folder, None)
    for metadata in packages.glob("*.dist-info"):
        (metadata / "entry_points.txt").unlink()
    SYSTEMS.forget()
    assert [quantity.unit for quantity in description_of(open_bag(folder)).robot] == ["m", "m"]
    found = summarise_bag(folder, None)
    assert found["digest"] == figures["digest"] and found["rms_error"] is None


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"name": "x"}', '{"parent": 1}', "[" * 10**5])
def test_a_damaged_description_is_a_damaged_bag(text: str, tmp_path: Path) -> None:
    scenario, (step, *_) = simulated(SHEET)
    first = step.records[0].message
    assert isinstance(first, msg.SystemDescription)
    records = (Record.of(first._replace(description=text)), *step.records[1:])
    folder = bag_of(scenario, [Step.of(step.step, records)], tmp_path / "bag")
    with pytest.raises(DamagedBagError, match="malformed SystemDescription"):
        description_of(open_bag(folder))
    nothing = bag_of(scenario, [Step.of(step.step, step.records[1:])], tmp_path / "nothing")
    with pytest.raises(DamagedBagError, match="no message on /parent/system"):
        description_of(open_bag(nothing))


def test_a_cut_bag_is_repaired_and_its_complete_steps_are_known(tmp_path: Path) -> None:
    scenario, steps = simulated(SHEET)
    folder = bag_of(scenario, steps, tmp_path / "bag")
    whole = complete_steps(folder)
    assert whole is not None and (whole.first, whole.last_complete, whole.last_planned) == (0, 40, 40)
    steps[25] = Step.of(steps[25].step, steps[25].records[1:])
    lacking = complete_steps(bag_of(scenario, steps, tmp_path / "lacking"))
    assert lacking is not None and lacking.last_complete == 24
    assert lacking.by_topic["/swarm/robot_state"] == 24 and lacking.by_topic["/parent/state"] == 40
    short = [*simulated(SHEET)[1][:40], Step.of(40, steps[40].records[:-1])]
    ending = complete_steps(bag_of(scenario, short, tmp_path / "ending"))
    assert ending is not None and (ending.last_complete, ending.by_topic["/swarm/desired"]) == (39, 39)
    file = folder / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[: file.stat().st_size * 2 // 3])
    report = repair_bag(folder, tmp_path / "new")
    assert report.last_planned_step == 40 and report.messages > 0
    assert description_of(open_bag(tmp_path / "new")).name == "sheet"


# What is shown: live, whatever the order, and from the bag


def live(scenario: Scenario, found: Iterable[msg.Message]) -> SwarmState:
    state = SwarmState.of(scenario)
    for message in found:
        state.add(message)
    return state


def test_live_and_recorded_swarms_show_the_same(tmp_path: Path) -> None:
    scenario, steps = simulated(SHEET)
    swarm = read_swarm(bag_of(scenario, steps, tmp_path / "bag"))
    assert (len(swarm), swarm.status, swarm.reason) == (41, "ok", None)
    state = live(scenario, ())
    assert state.tables == swarm.tables == SystemTables.read(scenario.named.description)
    for row, step in enumerate(steps):
        shuffled = messages_of([step])
        random.Random(row).shuffle(shuffled)
        for message in shuffled:
            state.add(message)
        instant = state.instant()
        assert instant is not None and instant == swarm.instant(row)
        parent = step.parent
        assert isinstance(parent, msg.ParentState) and instant.parent == parent.state
        assert instant.reference == (0.2 * math.sin(0.4 * (row / 100)), 0.2 * math.sin(0.25 * (row / 100)))
        shown = state.shown_robots(row)
        assert shown == swarm.shown_robots(row)
        assert state.members() == swarm.members(row)
        for robot, status, place, there in zip(
            shown, range(5), swarm.coordinates[row], swarm.on_plane[row], strict=True
        ):
            assert swarm.have_status("dead")[row, status] == (robot.status == "dead")
            assert (list(robot.coordinates) == place.tolist()) if there else np.isnan(place).all()


def test_a_dead_robot_stays_where_it_died_with_all_coordinates(tmp_path: Path) -> None:
    scenario, steps = simulated(SHEET)
    state = live(scenario, messages_of(steps))
    before = next(s for s in steps[20].states() if s.agent_id == 4)
    assert isinstance(before, msg.RobotState)
    (death,) = (e.step for step in steps for e in step.events if e.kind == msg.EventKind.DEAD)
    for step in (death, 38):
        state.add(before._replace(step=step, stamp=step * 10**7, coordinates=(9.0, 9.0)))
    found = dict(zip([robot.id for robot in state.robots], state.shown_robots(40), strict=True))
    assert found[4] == ShownRobot(before.coordinates, (0.0, 0.0), (), "dead")
    assert found[5] == ShownRobot(status="left")
    assert found[1].status == found[3].status == "active"
    assert state.members().standing == ((4, before.coordinates[0]),)
    haunted = [*steps]
    for step in (death, 38):
        ghost = before._replace(step=step, stamp=step * 10**7, coordinates=(9.0, 9.0))
        haunted[step] = Step.of(step, (*steps[step].records, Record.of(ghost)))
    recorded = read_swarm(bag_of(scenario, haunted, tmp_path / "bag"))
    for row in (death, 30, 38, 40):
        assert recorded.shown_robots(row)[2] == found[4]
        assert recorded.coordinates[row, 2].tolist() == list(before.coordinates)
    early = dict(zip([robot.id for robot in state.robots], state.shown_robots(5), strict=True))
    assert early[7] == ShownRobot()
    assert state.robots[4] == RobotIdentity(7, msg.Kind.DOUBLE_INTEGRATOR, (1.1, 0.2), joins=True)


def test_a_robot_at_its_limit_is_shown_and_counted_as_limited() -> None:
    scenario, steps = simulated(LIFT)
    state = live(scenario, messages_of(steps))
    statuses = [[robot.status for robot in state.shown_robots(row)] for row in range(31)]
    row = next(row for row, found in enumerate(statuses) if found[0] == "limited")
    assert statuses[row] == ["limited", "active", "active", "active"]
    assert state.shown_robots(row)[0].command == (8.0,)
    tracker = SummaryTracker((1, 2, 3, 4), None)
    tracker.take(steps[row])
    seen = tracker.summary()
    assert seen is not None and seen.statuses == "MAAA"
    assert json.loads(json.dumps(seen._asdict()))["counts"] == {"A": 3, "M": 1}


def test_without_a_scenario_the_swarm_is_learned_from_its_messages() -> None:
    scenario, steps = simulated(SHEET)
    state = SwarmState(tables=scenario.tables, period_ns=scenario.step_ns)
    for message in messages_of(steps[:15]):
        state.add(message)
    assert [(robot.id, robot.kind.name[0]) for robot in state.robots] == [
        (1, "S"),
        (3, "D"),
        (4, "S"),
        (5, "S"),
        (7, "D"),
    ]
    instant = state.instant()
    assert instant is not None and (instant.step, instant.reference) == (14, ())
    strange = next(s for s in steps[3].states() if isinstance(s, msg.RobotState))
    state.add(strange._replace(agent_id=99, kind=77, constants=(math.inf, 0.0), step=14))
    assert state.robots[-1] == RobotIdentity(99, msg.Kind.SINGLE_INTEGRATOR, (None, 0.0))


def test_an_announced_offset_shifts_all_that_is_tracked() -> None:
    scenario, steps = simulated(SHEET)
    offset = msg.SwarmEvent(0, 20, 0, msg.EventKind.STEERING, 0.5, REFERENCE)
    state = live(scenario, [offset, *messages_of(steps)])
    instant = state.instant()
    assert instant is not None
    assert instant.reference == (0.2 * math.sin(0.4 * 0.4) + 0.5, 0.2 * math.sin(0.25 * 0.4) + 0.5)


def test_the_plane_keeps_its_own_projection() -> None:
    state = SwarmState.of(find_scenario("pd_het_4").resolved())
    assert state.add(msg.ParentState(0, 0, 1, (0.0,))) is None and state.step is None
