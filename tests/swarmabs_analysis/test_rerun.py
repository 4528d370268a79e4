"""Bags that are run again: what is claimed, what is said to differ, and what is refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tests.swarmabs_bag.sample_run import write_bag

from swarmabs_analysis.comparison import compare_bags
from swarmabs_analysis.rerun import recorded_run
from swarmabs_analysis.verify import BagToVerify
from swarmabs_bag.attached import provenance
from swarmabs_bag.reader import open_bag
from swarmabs_cli import main
from swarmabs_config import configure
from swarmabs_config.scenario import dump_scenario, parse_scenario
from swarmabs_core.errors import InputError
from swarmabs_core.faults import RobotFault
from swarmabs_core.membership import Change, ChangeKind
from swarmabs_core.messages import EventKind, Message, PlaneState, SwarmEvent

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
    assert main(["simulate", str(folder / "again.yaml"), "-o", str(folder / "run")]) == 0
    return folder / "run"


@pytest.fixture
def remake(original: Path, tmp_path: Path) -> Remake:
    """Return a function that writes the bag again, with other messages or another provenance."""
    messages = [message for _, _, message in open_bag(original).decoded()]

    def write(change: Callable[[list[Message]], list[Message]] = list, **changes: Any) -> Path:
        said = {**provenance(SCENARIO, driver="simulate"), **changes}
        return write_bag(
            tmp_path / "remade",
            change(messages),
            {"scenario.yaml": dump_scenario(SCENARIO).encode(), "provenance.json": json.dumps(said).encode()},
        )

    return write


@pytest.fixture
def again(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> Callable[..., tuple[dict[str, Any], str]]:
    """Return a function that runs a bag again and returns ``rerun_of`` and what stood on standard error."""

    def run(bag: Path, *words: str, code: int = 0) -> tuple[dict[str, Any], str]:
        out = tmp_path / f"out-{len(list(tmp_path.iterdir()))}"
        assert main(["simulate", str(bag), *words, "-o", str(out), "--json"]) == code
        captured = capfd.readouterr()
        summary = json.loads(captured.out)
        assert summary == json.loads((out / "summary.json").read_text())
        return summary["rerun_of"], captured.err

    return run


def test_the_digest_is_reached(original: Path, again: Callable[..., Any]) -> None:
    found, said = again(original)
    digest = json.loads((original / "summary.json").read_text())["digest"]
    assert found == {
        "bag": str(original),
        "digest": digest,
        "last_step": 20,
        "same": True,
        "compared": "digest",
        "differences": [],
    }
    assert "the bag was made" not in said
    assert again(original, "--no-bag")[0]["same"] is True


@pytest.mark.parametrize("words", [("--duration", "0.1"), ("--set", "plane.angle=0.05"), ("--set", "plane.angle=0.1")])
def test_nothing_is_claimed_of_a_changed_scenario(original: Path, again: Callable[..., Any], words: Any) -> None:
    found, _ = again(original, *words)
    assert (found["same"], found["compared"]) == (None, None)


def test_a_scenario_is_no_rerun(original: Path, again: Callable[..., Any]) -> None:
    assert again(original / "scenario.yaml")[0] is None


def test_one_other_bit_is_another_run(remake: Remake, again: Callable[..., Any]) -> None:
    def bent(messages: list[Message]) -> list[Message]:
        return [
            message._replace(angle=message.angle + 1e-15)
            if isinstance(message, PlaneState) and message.step == 7
            else message
            for message in messages
        ]

    found, said = again(remake(bent), code=1)
    assert (found["same"], found["compared"]) == (False, "digest")
    assert "see the command compare" in said


def test_a_bag_that_ends_early_is_compared_as_far_as_it_goes(remake: Remake, again: Callable[..., Any]) -> None:
    def cut(messages: list[Message]) -> list[Message]:
        kept = [message for message in messages if message.step <= 9]
        return kept[:-2]  # the last step is not whole

    bag = remake(cut)
    found, _ = again(bag)
    assert (found["same"], found["compared"], found["last_step"]) == (True, "prefix", 9)
    assert again(bag, "--no-bag")[0]["same"] is None


def test_a_bag_that_ends_early_with_another_bit_is_another_run(remake: Remake, again: Callable[..., Any]) -> None:
    def cut(messages: list[Message]) -> list[Message]:
        kept = [message for message in messages if message.step <= 9]
        state = kept[-1]
        return [*kept[:-1], state._replace(torque=0.25)]  # type: ignore[call-arg]

    assert again(remake(cut), code=1)[0]["same"] is False


def test_other_versions_and_another_library_are_named(remake: Remake, again: Callable[..., Any]) -> None:
    bag = remake(versions={"numpy": "0.1", "nothing_known": "7"}, libm_fingerprint="feed", machine="abacus")
    found, said = again(bag)
    assert found["same"] is True
    for text in ("numpy 0.1, here it is ", "nothing_known 7, here it is not installed", "machine abacus", "feed"):
        assert any(text in difference for difference in found["differences"])
        assert text in said


def test_what_is_told_of_the_origin_stays_in_its_line(remake: Remake) -> None:
    bag = remake(versions={"\n\x1b[2J" * 99: "\n\x1b[2J" * 99}, libm_fingerprint="\n\x1b[2J" * 99)
    differences = recorded_run(bag).differences
    assert len(differences) == 2
    assert all(line.isprintable() and len(line) < 500 for line in differences)
    with pytest.raises(InputError) as error:
        recorded_run(remake(driver="\n" * 9999))
    assert str(error.value).isprintable() and len(str(error.value)) < 500


def test_a_bag_that_says_nothing_of_its_origin_is_run_all_the_same(original: Path, tmp_path: Path) -> None:
    messages = [message for _, _, message in open_bag(original).decoded()]
    bag = write_bag(tmp_path / "silent", messages, {"scenario.yaml": dump_scenario(SCENARIO).encode()})
    assert recorded_run(bag).differences == (
        "the bag does not say with what it was made: its digest may not be reached",
    )


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"driver": "realtime"}, r"was recorded in real time: .*; run the scenario.yaml"),
        ({"driver": "oracle"}, r"was made by 'oracle'"),
        ({"replay": {}}, r"is the replay of another bag"),
        ({"schema": 2}, r"its provenance is of schema 2, this version reads 1; update swarmabs"),
    ],
)
def test_what_cannot_be_repeated_is_refused(remake: Remake, tmp_path: Path, changes: Any, reason: str) -> None:
    bag = remake(**changes)
    with pytest.raises(InputError, match=reason):
        recorded_run(bag)
    assert main(["simulate", str(bag), "-o", str(tmp_path / "out")]) == 2
    assert not (tmp_path / "out").exists()


def test_a_robot_that_fell_silent_is_named(remake: Remake) -> None:
    def silent(messages: list[Message]) -> list[Message]:
        return [*messages, SwarmEvent(60_000_000, 6, 2, EventKind.DEAD, 0.1, "silent")]

    found = recorded_run(remake(silent))
    assert "robot 2 fell silent at step 6" in found.differences[0]
    assert Change(5, 2, ChangeKind.KILL) in configure.schedule(found.scenario)


def test_steering_that_nobody_knows_is_refused(remake: Remake) -> None:
    def steered(messages: list[Message]) -> list[Message]:
        return [*messages, SwarmEvent(50_000_000, 5, 0, EventKind.STEERING, 4.0, "controller.gains.0")]

    with pytest.raises(InputError, match=r"a setting was changed from outside at step 5 \('controller.gains.0'\)"):
        recorded_run(remake(steered))


def steered(messages: list[Message], *events: SwarmEvent) -> list[Message]:
    return [*messages, *events]


def test_what_was_done_from_outside_is_planned(remake: Remake) -> None:
    done = (
        SwarmEvent(50_000_000, 5, 0, EventKind.STEERING, 0.1, "reference"),
        SwarmEvent(70_000_000, 7, 2, EventKind.DEAD, 0.1, "freeze"),
        SwarmEvent(90_000_000, 9, 3, EventKind.LEFT, 0.1, "remove"),
    )
    found = recorded_run(remake(lambda messages: steered(messages, *done), steered=True)).scenario
    assert configure.step_changes(found, "reference") == ((5, 0.1),)
    assert configure.schedule(found) == (Change(6, 2, ChangeKind.FREEZE), Change(8, 3, ChangeKind.REMOVE))
    (loss,) = found.faults_of(RobotFault)
    assert loss.kind == "loss"


def test_what_a_run_that_could_not_be_steered_says_is_not_planned(remake: Remake) -> None:
    event = SwarmEvent(70_000_000, 7, 2, EventKind.DEAD, 0.1, "freeze")
    bag = remake(lambda messages: steered(messages, event))
    assert configure.schedule(recorded_run(bag).scenario) == ()
    assert BagToVerify(bag).verify().difference is not None


def test_steering_that_contradicts_the_scenario_is_refused_and_no_secret_to_verify(remake: Remake) -> None:
    event = SwarmEvent(70_000_000, 7, 9, EventKind.DEAD, 0.1, "freeze")
    bag = remake(lambda messages: steered(messages, event), steered=True)
    with pytest.raises(InputError, match="there is no robot 9"):
        recorded_run(bag)
    verdict = BagToVerify(bag).verify()
    assert verdict.difference is not None
    assert (verdict.difference.step, verdict.difference.topic) == (7, "swarm/events")


def test_a_split_bag_is_one_run(original: Path, tmp_path: Path) -> None:
    words = ["--set", "duration=2.5", "--max-bag-duration", "1", "-o", str(tmp_path / "split")]
    assert main(["simulate", str(original / "scenario.yaml"), *words]) == 0
    assert len(list((tmp_path / "split" / "bag").glob("*.mcap"))) > 1
    assert main(["simulate", str(tmp_path / "split"), "-o", str(tmp_path / "whole")]) == 0
    rerun = json.loads((tmp_path / "whole" / "summary.json").read_text())["rerun_of"]
    assert (rerun["same"], rerun["last_step"]) == (True, 250)
    assert compare_bags(tmp_path / "whole", tmp_path / "split").equal
