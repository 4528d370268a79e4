"""A program in which the parent controller publishes on a further recorded topic, declared as a contributor would.

It stands for a change of three files: the topic and its message, the graph, and the behaviour. Everything else must
follow from these. What it does with runs, bags and tables is printed as JSON.
"""

import csv
import json
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np

from swarmabs_core import messages as msg


class Effort(NamedTuple):
    """Power of the desired torque; its layout is that of an installed definition, `PlaneState`."""

    stamp: msg.Stamp
    step: msg.StepNumber
    power: Annotated[float, msg.Field("float64", "W")]
    work: Annotated[float, msg.Field("float64", "J", "since the start")]


EFFORT = msg.Topic("parent/effort", Effort, msg.PLANE_STATE.ros_type)  # type: ignore[arg-type]
msg.TOPICS = (*msg.TOPICS, EFFORT)
msg.TOPIC_OF[Effort] = EFFORT  # type: ignore[index]
for family in msg.FAMILIES:
    object.__setattr__(family, "further", (EFFORT,))

from swarmabs_config import graph  # noqa: E402 - what is imported from here on knows the topic

LINK = graph.Link(
    EFFORT,
    {graph.LOCKSTEP: graph.Qos("reliable", 100)},
    (graph.End(graph.CONTROLLER),),
    (graph.End(graph.RECORDER, 1000),),
    system=EFFORT,
)
graph.GRAPH = (*graph.GRAPH, LINK)
graph.OFFERED[graph.LOCKSTEP][EFFORT] = LINK.offered[graph.LOCKSTEP]

from swarmabs_core.behaviours import Controller  # noqa: E402

_finish = Controller._finish  # noqa: SLF001 - the change of the behaviour


def _finish_with_effort(controller: Controller) -> msg.Messages:
    *events, desired = _finish(controller)
    effort = Effort(desired.stamp, desired.step, 0.5 * msg.vector_of(desired, "value")[0], desired.step + 0.25)
    return (*events, effort, desired)  # type: ignore[return-value]


Controller._finish = _finish_with_effort  # type: ignore[method-assign]  # noqa: SLF001

from swarmabs_analysis.export import export_arrays, export_tables  # noqa: E402
from swarmabs_analysis.verify import BagToVerify  # noqa: E402
from swarmabs_bag.arrays import load_arrays  # noqa: E402
from swarmabs_bag.attached import attachments, provenance  # noqa: E402
from swarmabs_bag.reader import open_bag  # noqa: E402
from swarmabs_bag.recorder.recording import Recording  # noqa: E402
from swarmabs_bag.repair.completeness import complete_steps  # noqa: E402
from swarmabs_bag.run.step import Step  # noqa: E402
from swarmabs_bag.run.writer import BagWriter  # noqa: E402
from swarmabs_bag.shown.swarm_state import SwarmState  # noqa: E402
from swarmabs_config.scenario import Scenario  # noqa: E402
from swarmabs_config.scenarios import find_scenario  # noqa: E402
from swarmabs_core.cdr import encode  # noqa: E402
from swarmabs_run.simulation import Simulation, simulate, simulated_steps  # noqa: E402
from swarmabs_run.vector_simulation import vectorised  # noqa: E402
from swarmabs_view.playback import open_recording  # noqa: E402

OUT = Path(sys.argv[1])
FEW = find_scenario("pd_het_4", ["duration=1", "faults=[{at: 0.3, agent: 2, kind: kill}]"])
MANY = find_scenario(
    "arise_het_200", ["duration=1", "swarm.generate.single_integrator=22", "swarm.generate.double_integrator=22"]
)


def recorded(scenario: Scenario, name: str, steps: Iterable[Step], told: dict[str, object]) -> Path:
    """Record steps in a bag, and note what the summary says of the topic at the end."""
    recording = Recording(scenario, OUT / name, driver="simulate")
    for step in steps:
        recording.add(step)
    summary = recording.summary()
    told[name] = summary and summary.further
    recording.close()
    return OUT / name


def shown(bag: Path) -> dict[str, object]:
    """Return what the page shows of a bag in its last step, and whether a running swarm shows the same."""
    recording, live = open_recording(bag), SwarmState.of(FEW)
    instants = [instant for _, _, message in open_bag(bag).decoded() if (instant := live.add(message))]
    places = [place for place, row in enumerate(recording.hello().system.rows) if row.role == "further"]
    rows = [recording.hello().system.rows[place] for place in places]
    values = recording.frame(len(recording) - 1).values
    return {
        "rows": [(row.name, row.unit) for row in rows],
        "values": [values[place] for place in places],
        "live": instants == [recording.swarm.instant(row) for row in range(len(recording))],
    }


def stored(bag: Path) -> list[tuple[str, int, bytes]]:
    """Return the messages of a bag."""
    return [(topic.name, time, payload) for topic, time, payload in open_bag(bag).messages()]


def copied(bag: Path, name: str, *, step: int | None) -> Path:
    """Copy the bag of `FEW` with a changed effort in a step, or with no step without the topic."""
    topics = [topic for topic in open_bag(bag).topics() if step is not None or topic is not EFFORT]
    attached = attachments(FEW, provenance(FEW, driver="simulate"))
    with BagWriter(OUT / name, topics=topics, attachments=attached) as writer:
        for topic, time, message in open_bag(bag).decoded(topics):
            changed = topic is EFFORT and message.step == step
            writer.write(topic, time, encode(message._replace(work=0.0) if changed else message))  # type: ignore[union-attr]
    return OUT / name


def verified(bag: Path) -> dict[str, object]:
    """Verify a bag."""
    result = BagToVerify(bag).verify()
    difference = result.difference and (result.difference.topic, result.difference.step, result.difference.field)
    wanted = ("ok", "complete", "messages", "digest", "notes")
    return {"difference": difference, **{name: value for name, value in result.to_dict().items() if name in wanted}}


def main() -> dict[str, object]:
    """Simulate, record, verify and export."""
    told: dict[str, object] = {}
    few = recorded(FEW, "few", simulated_steps(FEW), told)
    many = recorded(MANY, "many", simulated_steps(MANY), told)
    nodes = recorded(MANY, "nodes", Simulation(MANY).steps(), told)
    without = copied(few, "without", step=None)
    with np.load(export_arrays(few, OUT / "few.npz")) as file:
        exported = file["parent_effort_work"].tolist()
    export_tables(few, OUT / "tables", "csv")
    rows = list(csv.DictReader((OUT / "tables" / "parent_effort.csv").open(encoding="utf-8")))
    steps = complete_steps(few)
    return {
        "on_arrays": vectorised(MANY) is not None,
        "same": stored(many) == stored(nodes),
        "counts": [sum(name == EFFORT.name for name, *_ in stored(bag)) for bag in (few, many)],
        "few": verified(few),
        "many": verified(many),
        "changed": verified(copied(few, "changed", step=40)),
        "without": verified(without),
        "arrays": [run.further["parent_effort"].work.tolist() for run in (load_arrays(few), simulate(FEW))]
        + [exported],
        "page": [shown(few), shown(without)],
        "terminal": told["few"],
        "order": [name for name, time, _ in stored(few) if time == 500_000_000],
        "rows": [rows[0], rows[-1]],
        "complete": steps and steps.by_topic,
    }


sys.stdout.write(json.dumps(main()))
