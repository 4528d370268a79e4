"""Bags that are run again: what is claimed, what is said to differ, and what is refused."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tests.frozen.command import swarm
from tests.swarmabs_bag.sample_run import write_bag

from swarmabs_analysis.comparison import compare_bags
from swarmabs_analysis.rerun import recorded_run
from swarmabs_analysis.verify import BagToVerify
from swarmabs_bag.attached import provenance
from swarmabs_bag.reader import open_bag
from swarmabs_config import configure
from swarmabs_config.scenario import dump_scenario, parse_scenario
from swarmabs_core.errors import InputError
from swarmabs_core.faults import RobotFault
from swarmabs_core.membership import Change, ChangeKind
from swarmabs_core.messages import EventKind, Message, SwarmEvent

SCENARIO = parse_scenario("""schema: 1
name: again
duration: 0.2
swarm:
  agents:
    - {id: 1, kind: single_integrator, mass: 0.4, position: 0.15}
    - {id: 2, kind: single_integrator, mass: 0.5, position: -0.12}
    - {id: 3, kind: double_integrator, mass: 0.6, damping: 0.8, position: 0.1}
faults:
  - {kind: loss, probability: 0.2}
""")

Remake = Callable[..., Path]


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("original")
    (folder / "again.yaml").write_text(dump_scenario(SCENARIO))
    assert swarm(("simulate", "again.yaml", "-o", "run"), folder).code == 0
    return folder / "run"


@pytest.fixture
def remake(original: Path, tmp_path: Path) -> Remake:
    """Return a function that writes the bag again, with other messages or another provenance."""
    messages = [message for _, _, message in open_bag(original).decoded()]

    def write(change: Callable[[list[Message]], list[Message]] = list, **changes: Any) -> Path:
        said = {**provenance(SCENARIO, driver="simulate"), **changes}
        return write_bag(
            tmp_path / f"remade-{len(list(tmp_path.iterdir()))}",
            change(messages),
            {"scenario.yaml": dump_scenario(SCENARIO).encode(), "provenance.json": json.dumps(said).encode()},
        )

    return write


@pytest.fixture
def again(tmp_path: Path) -> Callable[..., tuple[dict[str, Any], str]]:
    """Return a function that runs a bag again and returns ``rerun_of`` and what stood on standard error."""

    def run(bag: Path, *words: str, code: int = 0) -> tuple[dict[str, Any], str]:
        out = tmp_path / f"out-{len(list(tmp_path.iterdir()))}"
        done = swarm(("simulate", bag, *words, "-o", out, "--json"), tmp_path)
        assert done.code == code, done.err
        summary = done.document()
        assert summary == json.loads((out / "summary.json").read_text())
        return summary["rerun_of"], done.err

    return run


def test_the_digest_is_claimed_of_the_same_scenario_only(original: Path, again: Callable[..., Any]) -> None:
    rerun, said = again(original)
    digest = json.loads((original / "summary.json").read_text())["digest"]
    told = {"bag": str(original), "digest": digest, "last_step": 20, "differences": []}
    assert rerun == {**told, "same": True, "compared": "digest"}
    assert "the bag was made" not in said
    assert again(original, "--no-bag")[0]["same"] is True
    for words in (("--duration", "0.1"), ("--set", "plane.angle=0.05"), ("--set", "plane.angle=0.1")):
        rerun, _ = again(original, *words)
        assert (rerun["same"], rerun["compared"]) == (None, None)
    assert again(original / "scenario.yaml")[0] is None  # a scenario is no rerun


def test_one_other_bit_is_another_run_and_a_short_one_is_compared(remake: Remake, again: Callable[..., Any]) -> None:
    def bent(messages: list[Message]) -> list[Message]:
        *kept, state = messages
        return [*kept, state._replace(torque=math.nextafter(state.torque, 1.0))]  # type: ignore[attr-defined, call-arg]

    def cut(messages: list[Message]) -> list[Message]:
        return [message for message in messages if message.step <= 9]

    rerun, said = again(remake(bent), code=1)
    assert (rerun["same"], rerun["compared"], "the digest differs from that of" in said) == (False, "digest", True)
    bag = remake(lambda messages: cut(messages)[:-2])  # the last step is not whole
    rerun, _ = again(bag)
    assert (rerun["same"], rerun["compared"], rerun["last_step"]) == (True, "prefix", 9)
    assert again(bag, "--no-bag")[0]["same"] is None
    holed, _ = again(remake(lambda messages: [message for message in messages if message.step != 9]))
    assert (holed["same"], holed["compared"], holed["last_step"]) == (True, "prefix", 20)
    assert again(remake(lambda messages: bent(cut(messages))), code=1)[0]["same"] is False


def test_another_arithmetic_gives_another_digest_which_is_no_error(remake: Remake, again: Callable[..., Any]) -> None:
    said = provenance(SCENARIO, driver="simulate")
    assert said["arithmetic"] == 2
    for arithmetic in (1, 3):
        rerun, told = again(remake(lambda messages: messages[:-1], arithmetic=arithmetic))
        assert (rerun["same"], rerun["compared"]) == (None, None)
        assert f"recorded under arithmetic {arithmetic}, and this version computes with 2: figures are close" in told


def test_other_versions_are_named(remake: Remake, again: Callable[..., Any]) -> None:
    bag = remake(versions={"numpy": "0.1", "nothing_known": "7"}, machine="abacus")
    rerun, said = again(bag)
    assert rerun["same"] is True
    for text in ("numpy 0.1, here it is ", "nothing_known 7, here it is not installed", "machine abacus"):
        assert any(text in difference for difference in rerun["differences"])
        assert text in said


def test_the_origin_is_told_in_one_line_and_may_be_missing(remake: Remake, original: Path, tmp_path: Path) -> None:
    bag = remake(versions={"\n\x1b[2J" * 99: "\n\x1b[2J" * 99}, arithmetic="\n\x1b[2J" * 99)
    differences = recorded_run(bag).differences
    assert len(differences) == 1
    assert all(line.isprintable() and len(line) < 500 for line in differences)
    with pytest.raises(InputError) as error:
        recorded_run(remake(driver="\n" * 9999))
    assert str(error.value).isprintable() and len(str(error.value)) < 500
    messages = [message for _, _, message in open_bag(original).decoded()]
    bag = write_bag(tmp_path / "silent", messages, {"scenario.yaml": dump_scenario(SCENARIO).encode()})
    unsaid = "the bag does not record its software versions: the digest may differ"
    assert recorded_run(bag).differences == (unsaid,)


def test_the_scenario_of_a_bag_that_holds_none_is_named(original: Path, again: Callable[..., Any]) -> None:
    messages = [message for _, _, message in open_bag(original).decoded()]
    bare, named = write_bag(original / "bare", messages, {}), str(original / "scenario.yaml")
    with pytest.raises(InputError, match=r"contains no scenario.*--scenario"):
        recorded_run(bare)
    assert again(bare, "--scenario", named)[0]["same"] is True
    with pytest.raises(InputError, match="leave out --scenario"):
        recorded_run(original, scenario=named)
    refused = swarm(("simulate", named, "--scenario", named), original)
    assert (refused.code, "--scenario" in refused.err) == (2, True)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"driver": "realtime"}, r"was recorded in real time: .*; run the scenario.yaml"),
        ({"driver": "oracle"}, r"was made by 'oracle'"),
        ({"replay": {}}, r"is the replay of another bag"),
        ({"schema": 2}, r"its provenance has schema 2, but this version reads 1; update swarmabs"),
    ],
)
def test_what_cannot_be_repeated_is_refused(remake: Remake, tmp_path: Path, changes: Any, reason: str) -> None:
    bag = remake(**changes)
    with pytest.raises(InputError, match=reason):
        recorded_run(bag)
    assert swarm(("simulate", bag, "-o", "out"), tmp_path).code == 2
    assert not (tmp_path / "out").exists()


def event(step: int, robot: int, kind: EventKind, detail: str, value: float = 0.1) -> SwarmEvent:
    return SwarmEvent(step * 10_000_000, step, robot, kind, value, detail)


def test_a_robot_that_fell_silent_is_named_and_steering_that_nobody_knows_refused(remake: Remake) -> None:
    repeatable = recorded_run(remake(lambda messages: [*messages, event(6, 2, EventKind.DEAD, "silent")]))
    assert "robot 2 fell silent at step 6" in repeatable.differences[0]
    assert Change(5, 2, ChangeKind.KILL) in configure.schedule(repeatable.scenario)
    unknown = event(5, 0, EventKind.STEERING, "controller.gains.0", 4.0)
    with pytest.raises(InputError, match=r"a setting was changed from outside at step 5 \('controller.gains.0'\)"):
        recorded_run(remake(lambda messages: [*messages, unknown]))


def test_what_was_done_from_outside_is_planned(remake: Remake) -> None:
    done = (
        event(5, 0, EventKind.STEERING, "reference"),
        event(7, 2, EventKind.DEAD, "freeze"),
        event(9, 3, EventKind.LEFT, "remove"),
    )
    planned = recorded_run(remake(lambda messages: [*messages, *done], steered=True)).scenario
    assert configure.step_changes(planned, "reference") == ((5, 0.1),)
    assert configure.schedule(planned) == (Change(6, 2, ChangeKind.FREEZE), Change(8, 3, ChangeKind.REMOVE))
    (loss,) = planned.faults_of(RobotFault)
    assert loss.kind == "loss"


def test_what_a_run_that_could_not_be_steered_says_is_not_planned_and_a_contradiction_no_secret(remake: Remake) -> None:
    frozen = event(7, 2, EventKind.DEAD, "freeze")
    bag = remake(lambda messages: [*messages, frozen])
    assert configure.schedule(recorded_run(bag).scenario) == ()
    assert BagToVerify(bag).verify().difference is not None
    bag = remake(lambda messages: [*messages, frozen._replace(agent_id=9)], steered=True)
    with pytest.raises(InputError, match="there is no robot 9"):
        recorded_run(bag)
    difference = BagToVerify(bag).verify().difference
    assert difference is not None and (difference.step, difference.topic) == (7, "swarm/events")


def test_a_split_bag_is_one_run(original: Path, tmp_path: Path) -> None:
    words = ("--set", "duration=2.5", "--max-bag-duration", "1", "-o", "split")
    assert swarm(("simulate", original / "scenario.yaml", *words), tmp_path).code == 0
    assert len(list((tmp_path / "split" / "bag").glob("*.mcap"))) > 1
    rerun = swarm(("simulate", "split", "-o", "whole", "--json"), tmp_path).document()["rerun_of"]
    assert (rerun["same"], rerun["last_step"]) == (True, 250)
    assert compare_bags(tmp_path / "whole", tmp_path / "split").equal
