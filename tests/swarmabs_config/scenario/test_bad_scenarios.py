"""Every way a scenario can be wrong, with the line, field and remedy that its one-line error names."""

import os
import re
from pathlib import Path

import pytest
import yaml
from tests.privileges import respecting_permissions

from swarmabs_config.scenario import ScenarioError, load_scenario, parse_scenario, yaml_tree
from swarmabs_core.errors import InputError

HEAD = "schema: 1\nswarm:\n  generate: {double_integrator: 2, mass: [1, 2]}\n"
SI = "{id: 1, kind: single_integrator, mass: 0.6, position: 0.1}"
DI = "{id: 2, kind: double_integrator, mass: 0.7, damping: 1, position: -0.1}"


def listed(*agents: str) -> str:
    return "schema: 1\nswarm:\n  agents:\n" + "".join(f"    - {agent}\n" for agent in agents)


# Each row is a text and how its error begins behind the file's name; "…" stands for anything.
WHOLE = [
    ("", "1: the scenario is empty; start with 'schema: 1'"),
    ("- 1", "1: expected a mapping, found a list of 1; start with 'schema: 1', then 'key: value' lines"),
    ("# none\nscenario", "2: expected a mapping, found the text 'scenario'; start with 'schema: 1', then"),
    ("schema: 1\n---\nschema: 1\n", "2: a second YAML document; keep one scenario per file, without '---'"),
    ("a: [1\n", "2: not valid YAML: while parsing a flow sequence, …; check indentation, brackets and quotes near"),
    ("schema: 1\nname: 'x\n", "3: not valid YAML: while scanning a quoted scalar, "),
    ("schema: 1\nname: \x1b[2J\n", "2: the character '\\x1b' is not allowed in a text; remove it"),
    ("schema: 1\nname: \ud800\n", "2: the character '\\ud800' is not allowed in a text; remove it"),
    ("!!python/object/apply:os.system ['true']", "1: the tag 'tag:yaml.org,2002:python/object/apply:os.system' is"),
    ("[" * 40, f"1: {'.'.join('0' * 32)}: nested more than 32 deep; flatten it"),
    ("schema: 1", "1: swarm: 'swarm' is missing; add 'swarm: ...' (the robots and their gains)"),
    ("swarm: {}", "1: schema: 'schema' is missing; add 'schema: ...' (version of this file format: 1)"),
    ("schema: 2\nswarm: {}", "1: schema: version 2 is newer …; update swarmabs"),
    ("schema: true\nswarm: {}", "1: schema: expected 1, found true; write 'schema: 1'"),
    ("schema: 1\nswarm: {}", "2: swarm: no robots: neither 'agents' nor 'generate' is given; list 'agents', or use"),
    ("schema: 1\nswarm:\n  agents: []\n  generate: {}", "2: swarm: both 'agents' and 'generate' are given; keep one"),
]
GENERATED = [
    ("single_integrator: 1", "2: swarm.generate: a swarm needs at least two robots, found 1; add robots"),
    ("single_integrator: 4, position: 0.6", "2: swarm.generate.position: 0.6 m is off the plane, whose half length is"),
    ("single_integrator: 2, mass: [0.001, 0.001]", "2: swarm.generate.position: 3.794733192202055 m is off the plane"),
    ("single_integrator: 2, position: far", "2: swarm.generate.position: expected a number or auto, found the text 'f"),
    ("single_integrator: 2, position: true", "2: swarm.generate.position: expected a number, found true; write"),
    ("single_integrator: 2, position: 0", "2: swarm.generate.position: 0 is out of range; give a number > 0"),
    ("single_integrator: 2, mass: [2, 1]", "2: swarm.generate.mass: the smallest mass 2.0 exceeds the largest 1.0; w"),
    ("single_integrator: 65535, double_integrator: 1", "2: swarm.generate: 65536 robots are more than the 65535 ids;"),
]
EMPTY = "manifold: {torque_max: 20, curvature: 0}"
LISTED = [
    (listed(SI), "3: swarm.agents: a swarm needs at least two robots, found 1; add robots: one robot cannot"),
    (listed(SI, DI, DI), "6: swarm.agents.2.id: robot 2 is listed twice (see line 5); give every robot its own id, e"),
    (listed(SI, DI.replace("0.7", "-0.7")), "5: swarm.agents.1.mass: -0.7 is out of range; give a number > 0"),
    (listed(SI, DI.replace("mass", "mas")), "5: swarm.agents.1.mas: unknown key 'mas'; did you mean 'mass'?"),
    (listed(SI, DI.replace("mass: 0.7, ", "")), "5: swarm.agents.1.mass: 'mass' is missing; add 'mass: ...' (mass"),
    (listed(SI, DI.replace("damping: 1, ", "")), "5: swarm.agents.1.damping: 'damping' is missing; add …viscous"),
    (listed(SI, DI.replace("double", "dubble")), "5: swarm.agents.1.kind: unknown kind 'dubble_integrator'; did you"),
    (listed(SI, "{id: 2}"), "5: swarm.agents.1: 'kind' is missing; add 'kind: ...', one of single_integrator, double"),
    (listed(SI, "2"), "5: swarm.agents.1: expected a mapping, found the number 2; write {kind: single_integrator"),
    (listed(SI.replace("}", ", damping: 1}"), DI), "4: swarm.agents.0.damping: …no damping; remove it, or use 'kind"),
    (listed(SI.replace("}", ", velocity: 0.1}"), DI), "4: swarm.agents.0.velocity: a single integrator starts at"),
    (listed(SI.replace("}", ", velocity: false}"), DI), "4: swarm.agents.0.velocity: a single integrator starts at"),
    (listed(SI, DI.replace("-0.1", "-0.51")), "5: swarm.agents.1.position: -0.51 m is off the plane, whose half"),
    (listed(SI, DI.replace("-0.1", "0.1")), "3: swarm.agents: …at one point (S3 = 0 kg^4 m^2), …; give them different"),
    (listed(SI, DI.replace("-0.1", "0.1000001")), "3: swarm.agents: all robots are at one point (S3 = "),
    (
        listed(SI, DI.replace("-0.1", "0.1"), "{id: 3, kind: single_integrator, mass: 0.6, position: -0.1}")
        + "faults: [{kind: join, agent: 3, at: 1.0}]",
        "3: swarm.agents: …at one point (S3 = 0 kg^4 m^2), …; give them different",
    ),
    (
        listed(SI, DI.replace("-0.1", "0.100005")) + "plane: {length: 10}",
        "3: swarm.agents: all robots are at one point (S3 = ",
    ),
    (
        listed(SI, DI) + EMPTY,
        "6: manifold: robots of 1.3 …1.76852 N m, …; lower torque_max to 1.768, or …166.3 kg",
    ),
]
ADDED = [
    # Keys.
    ("duratoin: 3", "4: duratoin: unknown key 'duratoin'; did you mean 'duration'?"),
    ("plane:\n  angel: 0.1", "5: plane.angel: unknown key 'angel'; did you mean 'angle'?"),
    ("<<: {}", "4: <<: unknown key '<<'; known: schema, name, "),
    ('"a\\e[31mb": 1', "4: a\\x1b[31mb: unknown key 'a\\x1b[31mb'; known: "),
    ("schema: 1", "4: schema: the key is given twice (see line 1); remove one of them"),
    ("1: 2", "4: a key that is not a name: the number 1; write 'key: value' with a name as key"),
    ("? [a]\n: 2", "4: a key that is not a name; write 'key: value' with a name as key"),
    # Types, besides what the declarations give.
    ("duration: '30'", "4: duration: expected a number, found the text '30'; remove the quotes"),
    ("duration: 1_000", "4: duration: expected a number, found the text '1_000'; write a number"),
    ("duration: 0x1F", "4: duration: expected a number, found the text '0x1F'; write a number"),
    ("duration: 010", "4: duration: '010' begins with 0, which could mean octal; remove the 0, or"),
    ("duration: true", "4: duration: expected a number, found true; write a number, e.g. 0.5"),
    ("duration: .nan", "4: duration: .nan is not a finite number; give a finite number"),
    ("duration: 1e999", "4: duration: '1e999' is not a finite number; give a finite number"),
    (f"duration: {'9' * 61}", "4: duration: a number of more than 60 digits is out of range; give a number"),
    (f"duration: {'9' * 5000}", "4: duration: a number of 5000 characters; shorten it"),
    (f"duration: {'x' * 900}", f"4: duration: expected a number, found the text '{'x' * 57}...'; write"),
    ("seed: 1.0", "4: seed: expected a whole number, found the number 1.0; write a whole number, e.g. 1"),
    ("name: 5", "4: name: expected a text, found the number 5; put it in quotes"),
    ("name: a/b", "4: name: the text 'a/b' cannot name a folder; use 1 to 60 printable characters, no /"),
    ("name: ..", "4: name: the text '..' cannot name a folder; use 1 to 60 printable characters"),
    ("name: ''", "4: name: the text '' cannot name a folder; use 1 to 60 printable characters"),
    (f"name: {'x' * 61}", "4: name: the text 'xxx…cannot name a folder; use 1 to 60 printable characters"),
    ("plane:", "4: plane: expected a mapping, found nothing (null); write 'key: value' pairs, or leave it"),
    ("plane: {friction: 3}", "4: plane.friction: expected a list of 6 numbers, found the number 3; write"),
    ("plane: {friction: [1,\n x, 1, 1, 1, 1]}", "5: plane.friction.1: expected a number, found the text 'x'"),
    ("faults: {}", "4: faults: expected a list, found a mapping; write a list in [ ]"),
    ("lockstep: {on_stall: drpo}", "4: lockstep.on_stall: expected 'fail' or 'drop', found the text 'drpo'; did you"),
    # Several settings together.
    ("plane:\n  angle: 0.3\n  end_stop: 0.2", "5: plane.angle: 0.3 rad is beyond the end stop at 0.2 rad (see line 6)"),
    ("plane:\n  center_height: 0.8\n  mass: 1\n  inertia: 0.6", "7: plane.inertia: 0.6 kg m^2 is less than mass …0.64"),
    ("plane: {robot_gravity: true, sensor: {noise: [0.1, 0]}}", "4: plane.sensor: robot_gravity …cannot be combined"),
    ("plane: {robot_gravity: true, sensor: {resolution: [0.1, 0]}}", "4: plane.sensor: robot_gravity …cannot"),
    # Time.
    ("duration: 0", "4: duration: 0 is out of range; give a number > 0"),
    ("duration: 3e9", "4: duration: 3000000000.0 is out of range; give a number <= 2147483647"),
    ("step: 1e-10", "4: step: 1e-10 s is not a whole number of nanoseconds; give at most nine decimals"),
    ("plane: {substep: 0.00000000025}", "4: plane.substep: 2.5e-10 s is not a whole number of nanoseconds"),
    ("duration: 0.015", "4: duration: …0.015 s is not a multiple of the step 0.01 s; use a duration of 0.01 or 0.02 s"),
    ("step: 0.007", "4: step: the duration 30.0 s is not a multiple of the step 0.007 s; use a duration"),
    ("duration: 0.001\nstep: 0.002", "4: duration: …step 0.002 s (see line 5); use a duration of 0.002 s, or"),
    # Controllers.
    ("controller: pd", "4: controller: expected a mapping, found the text 'pd'; write {type: pd, ...}"),
    ("controller: {type: lrq}", "4: controller.type: unknown type 'lrq'; did you mean 'lqr'?"),
    ("controller: {type: [pd]}", "4: controller.type: unknown type (a list of 1); known: pd, lqr, pid, arise"),
    ("controller: {type: pd, gain: 1}", "4: controller.gain: unknown key 'gain'; did you mean 'gains'?"),
    ("controller: {trajectory: {type: sine}}", "4: controller.trajectory: …; remove 'trajectory', or use 'type: ari"),
    ("controller: {type: lqr, trajectory: 0}", "4: controller.trajectory: the lqr controller follows no trajectory"),
    ("controller:\n  type: arise\n  trajectory: {type: cosine}", "6: controller.trajectory.type: …mean 'sine'?"),
    ("controller: {type: arise, trajectory: {type: constant, size: 1}}", "4: controller.trajectory.size: …: type, ang"),
    # Tags, aliases: nothing is executed, nothing explodes.
    ("name: !!python/name:os.system x", "4: name: the tag 'tag:yaml.org,2002:python/name:os.system' is not"),
    ("seed: !!int '1.5'", "4: seed: the number 1.5 does not fit its tag 'tag:yaml.org,2002:int'; remove the"),
    ("seed: *one", "4: seed: the alias 'one' has no anchor before it; write the value itself"),
    ("plane: &p {angle: *p}", "4: plane.angle: the alias 'p' has no anchor before it; write the value"),
]
FAULTS = [
    ("{kind: kil, at: 1, agent: 1}", "5: faults.0.kind: unknown kind 'kil'; did you mean 'kill'?"),
    ("{kind: kill_node, at: 1}", "5: faults.0.kind: unknown kind 'kill_node'; remove it: only fleets have standby coo"),
    ("{kind: freeze_node, at: 1}", "5: faults.0.kind: unknown kind 'freeze_node'; remove it: only fleets have standby"),
    ("{at: 1, agent: 1}", "5: faults.0: 'kind' is missing; add 'kind: ...', one of kill, leave,"),
    ("{kind: kill, agent: 1}", "5: faults.0.at: 'at' is missing; add 'at: ...' (time in s; the"),
    ("{kind: kill, at: 30.006, agent: 1}", "5: faults.0.at: 30.006 s is step 3001, after the last"),
    ("{kind: kill, at: 1, agent: 7}", "5: faults.0.agent: there is no robot 7; name an existing"),
    ("{kind: loss, probability: 0}\n- {kind: loss, probability: 0}", "6: faults.1: a second loss (see line 5); keep"),
    ("{kind: kill, at: 1, agent: 1}\n- {kind: leave, at: 2, agent: 1}", "6: faults.1: …twice (see line 5); keep one"),
    ("{kind: join, at: 1, agent: 1}\n- {kind: join, at: 2, agent: 1}", "6: faults.1: robot 1 joins twice (see line 5)"),
    ("{kind: kill, at: 1, agent: 1}\n- {kind: join, at: 1.011, agent: 1}", "6: faults.1.at: …is gone from step 100"),
    ("{kind: delay, steps: 0, to: 2}\n- {kind: delay, steps: 1, from: 1, agents: [2]}", "6: faults.1: …for robot 2 at"),
    ("{kind: reordering, probability: .1, agents: [1, 7]}", "5: faults.0.agents.1: there is no robot 7; name an"),
    ("{kind: duplication, probability: .1, agents: []}", "5: faults.0.agents: no robots are listed; list"),
    ("{kind: delay, steps: 1, from: 31}", "5: faults.0.from: 31.0 s is step 3100, after the last step 3000; use a"),
    ("{kind: delay, steps: 1, from: 2, to: 1}", "5: faults.0: the fault ends at 1.0 s, before it begins; use 'to' w"),
    ("{kind: delay, steps: 1, from: 1, to: 1.004}", "5: faults.0.to: the fault begins and ends at step 100; make it"),
    ("{kind: clock_offset, agent: 1, offset: 1.0e-10}", "5: faults.0.offset: 1e-10 s is not a whole number of nanosec"),
    ("{kind: clock_offset, agent: 1, offset: 9}\nduration: 2147483640", "5: faults.0.offset: time stamps would exceed"),
    ("{kind: join, at: null, agent: 1}\n- {kind: kill, at: 1, agent: 1}", "6: faults.1: robot 1 joins at an unplanned"),
    ("{kind: lie, agent: 1}", "5: faults.0: the fault falsifies nothing; set 'position_offset'"),
    ("{kind: lie, agent: 1, position_factor: 0}", "5: faults.0.position_factor: 0.0 cannot be inverted; give a number"),
    ("{kind: lie, agents: [1], position_factor: 2}", "5: faults.0.agents: unknown key 'agents'; did you mean 'agent'?"),
    ("{kind: reference, at: 1, offset: 0}\n- {kind: reference, at: 1, offset: 1}", "6: faults.1: a second reference"),
    (
        "{kind: reference, at: 1, offset: 0, until: 3}\n- {kind: reference, at: 2.99, offset: 1}",
        "6: faults.1: a second",
    ),
    ("{kind: join, at: 1, agent: 1}", "3: swarm.generate: a swarm needs at least two robots at step 0, found 1: the"),
]
CASES = [
    *WHOLE,
    *((f"schema: 1\nswarm: {{generate: {{{text}}}}}", expected) for text, expected in GENERATED),
    *LISTED,
    *((HEAD + text, expected) for text, expected in ADDED),
    *((f"{HEAD}faults:\n- {text}", expected) for text, expected in FAULTS),
]


def tree(text: str, loader: yaml_tree.Loader) -> yaml_tree.Node | str:
    try:
        return yaml_tree.read_tree(text, "f", loader=loader)
    except ScenarioError as error:
        return str(error).partition("not valid YAML")[0]


@pytest.mark.parametrize(("text", "expected"), CASES)
def test_the_error_names_line_field_and_remedy(text: str, expected: str) -> None:
    with pytest.raises(ScenarioError, match="^f:" + re.escape(expected).replace("…", ".*")) as caught:
        parse_scenario(text, source="f")
    assert str(caught.value).isprintable()
    assert caught.value.remedy
    assert isinstance(caught.value, InputError)
    # The parser that is always there finds the same values, lines and errors.
    assert tree(text, yaml.SafeLoader) == tree(text, yaml.CSafeLoader)


def test_the_first_error_in_the_file_comes_first_and_further_ones_are_counted() -> None:
    with pytest.raises(ScenarioError, match=r"^f:1: seed: .* \(\+3 more\)$") as caught:
        parse_scenario("seed: x\n" + HEAD + "name: 5\nplane: {length: 0, gravity: 0}", source="f")
    assert (caught.value.more, caught.value.source, caught.value.line, caught.value.field) == (3, "f", 1, "seed")


@pytest.mark.parametrize(
    ("light", "curvature", "torque"), [("0.7", 0.0, 1.768), ("165.7", 0.0, 20.0), ("0.7", 0.004, 2.502)]
)
def test_the_remedies_for_an_empty_preimage_work(light: str, curvature: float, torque: float) -> None:
    text = listed(SI, DI.replace("0.7", light)) + f"manifold: {{torque_max: TORQUE, curvature: {curvature}}}"
    parse_scenario(text.replace("TORQUE", str(torque)))
    with pytest.raises(ScenarioError, match="cannot have the inertia"):
        parse_scenario(text.replace("TORQUE", str(1.01 * torque)))


def test_what_would_grow_without_bounds_is_refused_at_once_and_aliases_within_reason_are_expanded() -> None:
    def aliases(width: int) -> str:
        """Have each list hold the one before several times."""
        lists = (f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * width)}]" for n in range(1, 40))
        return "\n".join([f"a0: &a0 [{', '.join('x' * width)}]", *lists])

    for text, expected in (
        (aliases(10), r"f:7: a6\.\d+: more than 2000000 values after expansion of aliases"),
        (aliases(1), r"f:32: a31\.0: nested more than 32 deep"),
        ("#" * (yaml_tree.LARGEST_TEXT + 1), r"f: more than 16777216 characters; shorten it"),
    ):
        with pytest.raises(ScenarioError, match=f"^{expected}"):
            parse_scenario(text, source="f")
    text = HEAD + "plane: {disturbance: {amplitude: &half 0.5, angular_frequency: *half}}"
    disturbance = parse_scenario(text).plane.disturbance
    assert (disturbance.amplitude, disturbance.angular_frequency) == (0.5, 0.5)


@pytest.mark.parametrize(
    ("name", "data", "expected"),
    [
        ("x", b"schema: 1\nname: \xff\n", "x:2: not UTF-8: byte 0xff at offset 16; save the file as UTF-8"),
        ("x", "schema: 1\n".encode("utf-16-be"), "x:1: not a text file: it has a NUL byte; give a scenario in YAML"),
        ("x", b"#" * (16 * 2**20 + 1), "x: larger than 16777216 bytes; shorten it; 'swarm.generate' describes"),
        ("pd_hte_4.yaml", None, "pd_hte_4.yaml: no such file; did you mean 'pd_het_4.yaml'?"),
        ("no/x.yaml", None, "no/x.yaml: no such file; check the path"),
        ("", None, ": is a directory; give a scenario file in YAML"),
        ("pipe", None, "pipe: not a regular file; give a scenario file in YAML"),
        ("/dev/zero", None, "/dev/zero: not a regular file"),
        ("x\0", None, "x\\x00: cannot be read: "),
        ("closed", None, "closed: cannot be read: Permission denied; check the path and its"),
        ("x" * 5000, None, "...: cannot be read: File name too long; check the path and its permissions"),
    ],
)
def test_what_is_no_file_of_text(tmp_path: Path, name: str, data: bytes | None, expected: str) -> None:
    (tmp_path / "pd_het_4.yaml").touch()
    (tmp_path / "closed").touch(mode=0)
    os.mkfifo(tmp_path / "pipe")
    if data is not None:
        (tmp_path / name).write_bytes(data)
    with pytest.raises(ScenarioError, match=re.escape(expected)):
        respecting_permissions(lambda: load_scenario(tmp_path / name))


def test_byte_order_mark_and_line_ends_of_other_systems(tmp_path: Path) -> None:
    path = tmp_path / "from afar.yaml"
    path.write_bytes(b"\xef\xbb\xbf" + HEAD.replace("\n", "\r\n").encode())
    assert load_scenario(path).name == "from afar"
