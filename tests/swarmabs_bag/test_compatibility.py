"""Frozen files of earlier versions, which every later one reads (docs/reference/compatibility.md)."""

import json
from pathlib import Path

import pytest
from tests.swarmabs_bag.test_merge import piece, sent

from swarmabs_analysis.comparison import compare_bags
from swarmabs_analysis.verify import BagToVerify
from swarmabs_bag.arrays import load_arrays
from swarmabs_bag.attached import attached_provenance, attached_scenario, events_in
from swarmabs_bag.errors import UnknownTypeError
from swarmabs_bag.info import bag_info
from swarmabs_bag.reader import open_bag
from swarmabs_bag.run import channels
from swarmabs_bag.run.channels import FORMER_HASHES, RECORDED_TYPES, current_hash
from swarmabs_bag.run.digest import Digest
from swarmabs_cli import main
from swarmabs_config.scenario import load_scenario
from swarmabs_core.arithmetic import FORMER
from swarmabs_core.events import code_of
from swarmabs_core.messages import BASIS
from swarmabs_run.simulation import Simulation

DATA = Path(__file__).parents[1] / "data" / "schema_1"
REALTIME = Path(__file__).parents[1] / "data" / "realtime_1"
RELEASED = {
    "swarmabs_msgs/msg/AgentState": ("RIHS01_920c20b49337933ad2a2a54073afa24dac7f0bf85b89c0d8dd1b57ebfc9011bc",),
    "swarmabs_msgs/msg/PlaneState": ("RIHS01_eb50ea2ec4166fc2bcb82d6d93a165895a6769696f9119a68ef5631216479631",),
    "swarmabs_msgs/msg/AbstractState": ("RIHS01_d95f247c2589dc4f0829654e4f27b3962f02586fe75af371aa28dd2eabbaa7fd",),
    "swarmabs_msgs/msg/AuxiliaryState": ("RIHS01_52d6abf330048f23e1dfe0c338ba3a94672fa727da8cc3a240be1862e5e4e14d",),
    "swarmabs_msgs/msg/DesiredAbstractState": (
        "RIHS01_8d0ba0d2bda583bda9b0e7c060dfa8a7a61a5c5f1136fef6732eaf73845a4374",
    ),
    "swarmabs_msgs/msg/SwarmEvent": ("RIHS01_fed027d673123455049e51599995fd5dc6fefa15802f457c22ec5640bc24a2ae",),
    "swarmabs_msgs/msg/Basis": ("RIHS01_1251f0667986052e75e8fc930c843c888e9779334f8dbb913468a7921d9366b7",),
    "swarmabs_msgs/msg/RobotState": ("RIHS01_9a85044d40a2697251219c25b4b462ba33c5f507241274debae8e840be33170e",),
    "swarmabs_msgs/msg/ParentState": ("RIHS01_bac92cfe9f90d7848e4e8a720037fb9f95740f5e51e1ec1746ea217b120ec9c3",),
    "swarmabs_msgs/msg/SwarmAbstract": ("RIHS01_87004a96dcc261a8d4e62518df2b55f181ea05a7064370e042667518dc5069aa",),
    "swarmabs_msgs/msg/SwarmAuxiliary": ("RIHS01_363d152a03bdafcf03ef68aef9f060871e0a9e4de0bae31cebf5f86e7fd6f6c5",),
    "swarmabs_msgs/msg/SwarmDesired": ("RIHS01_14d4547108eaf7c9e58e558e9472aa0e2e82784160f1a0cf59ee18e36f6a445f",),
    "swarmabs_msgs/msg/StandingState": ("RIHS01_7cf46f19732db063247dd0137cbcc1c54ea43f8097f71c408d008b4d3eb62501",),
    "swarmabs_msgs/msg/Relay": ("RIHS01_7edb3e9283fc1920ab621aae3796e6349c3bb47a81501005ac1cb24dae217f6f",),
    "swarmabs_msgs/msg/SystemDescription": ("RIHS01_f2899023e8687bf5f9b1a866527ee09a370eb818ec831ed10a4d4e4217d2804c",),
}
"""Hashes of all definitions of recorded types; when one changes, its new hash is added to the others."""
BAG_DIGEST = "5d18682d320a574cd86cec5b660a2f38928ffe5bada4d51dea71a6cdc6786934"
SCENARIO_DIGEST = "ba94d716d10be258b27811a0e9f57a15e2ae8e2401a7c5cf41c83f661f180866"
KILLED = 15


def test_everything_in_it_is_still_read() -> None:
    info = bag_info(DATA)
    assert (info.complete, info.message_count, info.arithmetic) == (True, 234, FORMER)
    assert info.scenario is not None
    assert (info.scenario.name, info.scenario.agents) == ("frozen", 4)
    assert "schema" not in attached_provenance(open_bag(DATA)), "the provenance of its time has no number"
    arrays = load_arrays(DATA)
    assert list(arrays.agents.ids) == [1, 2, 3, 4]
    assert (arrays.angle[0], -arrays.angle[-1]) == (0.1, -0.08705067223642807), "from the summary of its run"
    found = compare_bags(DATA, DATA / "bag" / "bag_0.mcap")
    assert (found.equal, found.a.digest) == (True, BAG_DIGEST)
    assert found.a.figures["max_abs_position"] == 0.1353662543782129 > abs(arrays.agents.position[:16]).max()


def test_each_definition_is_read_and_one_that_is_not_known_is_refused_but_described(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert {name: {current_hash(name), *FORMER_HASHES.get(name, ())} for name in RECORDED_TYPES} == {
        name: {*hashes} for name, hashes in RELEASED.items()
    }
    (known,) = RELEASED["swarmabs_msgs/msg/PlaneState"]
    other = "RIHS01_of_another_version"
    monkeypatch.setattr(
        channels, "current_hash", lambda name: other if name.endswith("PlaneState") else current_hash(name)
    )
    refusal = f"bag_0.mcap: /plane/state has a definition of .* that this version does not know .*{known}.*; use the"
    with pytest.raises(UnknownTypeError, match=refusal):
        load_arrays(DATA)
    assert main(["compare", str(DATA), str(DATA)]) == 2
    assert known in {topic.type_hash for topic in bag_info(DATA).topics}
    monkeypatch.setitem(FORMER_HASHES, "swarmabs_msgs/msg/PlaneState", (known,))
    assert load_arrays(DATA).angle[0] == 0.1


@pytest.mark.parametrize(
    ("bag", "codes"),
    [
        ("schema_1", {"KILLED": "observer"}),
        (
            "faults_1",
            {
                "FAULT_INJECTED": "agent",
                "KILLED": "observer",
                "LEFT": "observer",
                "OFF_END": "parent",
                "REFERENCE": "controller",
            },
        ),
        ("realtime_1", {"NO_BROADCASTS": "agent", "JOINED": "observer", "HELD": "agent", "RECOVERED": "agent"}),
    ],
)
def test_events_of_earlier_versions_have_codes_and_sources(bag: str, codes: dict[str, str]) -> None:
    found = {code_of(event) for event in events_in(open_bag(DATA.parent / bag))}
    assert {code and (code.name, code.source and code.source.value) for code in found} == {*codes.items()}


def test_a_bag_in_real_time_is_verified_and_not_run_again(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    info, arrays = bag_info(REALTIME), load_arrays(REALTIME)
    assert (info.complete, info.message_count, info.arithmetic) == (True, 1125, FORMER)
    assert (len(arrays.angle), arrays.angle[0], arrays.angle[-1]) == (101, 0.1, 0.053620192355359385)
    assert BASIS in {channel.topic for channel in open_bag(REALTIME).channels}
    assert main(["verify", str(REALTIME)]) == 0
    assert "former arithmetic" in capfd.readouterr().out
    assert main(["run", str(REALTIME), "-o", str(tmp_path / "out")]) == 2
    assert "real time" in capfd.readouterr().err


@pytest.mark.parametrize("command", ["simulate", pytest.param("run", marks=pytest.mark.system)])
def test_it_runs_again_to_close_figures_and_is_verified_within_the_former_arithmetic(
    command: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    found = BagToVerify(DATA).verify()
    assert (found.ok, found.complete, found.digest) == (True, True, BAG_DIGEST)
    assert any("former arithmetic" in note for note in found.notes)
    assert main([command, str(DATA), "-o", str(tmp_path / "out"), "--json"]) == 0
    out, err = capfd.readouterr()
    rerun = json.loads(out)["rerun_of"]
    assert (rerun["digest"], rerun["same"], rerun["compared"]) == (BAG_DIGEST, None, None)
    assert "recorded under arithmetic 1, and this version computes with 2" in err
    ours, theirs = load_arrays(DATA), load_arrays(tmp_path / "out")
    until = KILLED + 1  # the abstract state divides from the step after it on
    assert abs(ours.angle[:until] - theirs.angle[:until]).max() < 1e-9
    assert abs(ours.agents.position[:until] - theirs.agents.position[:until]).max() < 1e-8


def test_a_scenario_file_of_its_time_means_the_same() -> None:
    """`resolved.yaml` is what the version of its time made of `scenario.yaml`, in which no state was divided."""
    written, resolved = (load_scenario(DATA / name) for name in ("scenario.yaml", "resolved.yaml"))
    assert written.resolved() == load_scenario(DATA / "resolved.yaml", ["plane.substep=null"]), "1 ms was the default"
    assert attached_scenario(open_bag(DATA)).faults[0].kind == "kill"
    digest = Digest()
    for step in Simulation(resolved, division=0).steps():
        digest.update(step)
    assert digest.hexdigest() == SCENARIO_DIGEST


def test_a_bag_of_a_run_with_standbys_in_lockstep_is_read_without_the_faults_of_their_processes(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    run, kill = tmp_path / "run", "{at: 0.1, kind: kill, agent: 2}"
    assert main(["simulate", "pd_het_4", "--duration", "0.3", "--set", f"faults=[{kill}]", "-o", str(run)]) == 0
    text = (run / "scenario.yaml").read_text()
    assert text.count("\nfaults:\n") == 1
    retired = (f"  - {{kind: {kind}, at: 0.1, node: recorder}}" for kind in ("kill_node", "freeze_node"))
    earlier = text.replace("\nfaults:\n", "\n".join(["", "faults:", *retired, ""]))
    assert open_bag(run).attachment("scenario.yaml") == text.encode()
    made = attached_provenance(open_bag(run)) | {"standby": "primary"}
    changed = {"scenario.yaml": earlier.encode(), "provenance.json": json.dumps(made).encode()}
    bag = piece(run, tmp_path / "earlier", sent(run / "bag"), **changed)
    assert attached_scenario(open_bag(bag)) == attached_scenario(open_bag(run))
    assert attached_provenance(open_bag(bag))["standby"] == "primary"
    assert attached_scenario(open_bag(bag), ["faults.0.at=0.2"]).faults[0].at == 0.2
    capfd.readouterr()
    assert main(["verify", str(bag), "--json"]) == 0
    assert json.loads(capfd.readouterr().out)["ok"]
    assert main(["simulate", str(bag), "-o", str(tmp_path / "again"), "--json"]) == 0
    assert json.loads(capfd.readouterr().out)["rerun_of"]["same"]
    (tmp_path / "earlier.yaml").write_text(earlier)
    assert main(["simulate", str(tmp_path / "earlier.yaml"), "--no-bag"]) == 2
    assert "unknown kind 'kill_node'; remove it: only fleets have standby coordinators" in capfd.readouterr().err
