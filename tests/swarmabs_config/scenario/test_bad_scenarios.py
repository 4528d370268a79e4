"""Every way a scenario can be wrong, with the line, field and remedy that its one-line error names."""

import os
from pathlib import Path

import pytest
import yaml

from swarmabs_config.scenario import ScenarioError, load_scenario, parse_scenario, yaml_tree
from swarmabs_core.errors import InputError

HEAD = "schema: 1\nswarm:\n  generate: {double_integrator: 2, mass: [1, 2]}\n"
SI = "{id: 1, kind: single_integrator, mass: 0.6, position: 0.1}"
DI = "{id: 2, kind: double_integrator, mass: 0.7, damping: 1, position: -0.1}"


def listed(*agents: str) -> str:
    return "schema: 1\nswarm:\n  agents:\n" + "".join(f"    - {agent}\n" for agent in agents)


CASES = [
    # Not a scenario at all.
    ("", "f:1: no scenario: there is nothing in it; begin with 'schema: 1'"),
    ("- 1", "f:1: expected a mapping, found a list of 1; begin with 'schema: 1', then 'key: value' lines"),
    ("# none\nscenario", "f:2: expected a mapping, found the text 'scenario'; begin with 'schema: 1', then"),
    ("schema: 1\n---\nschema: 1\n", "f:2: a second YAML document; keep one scenario per file, without '---'"),
    ("a: [1\n", "f:2: not valid YAML: while parsing a flow sequence, "),
    ("schema: 1\nname: 'x\n", "f:3: not valid YAML: while scanning a quoted scalar, "),
    ("schema: 1\nname: \x1b[2J\n", "f:2: the character '\\x1b' is not text; remove it; a scenario is text"),
    ("schema: 1\nname: \ud800\n", "f:2: the character '\\ud800' is not text; remove it"),
    # Keys.
    ("schema: 1", "f:1: swarm: 'swarm' is missing; add 'swarm: ...' (the robots and their gains)"),
    ("swarm: {}", "f:1: schema: 'schema' is missing; add 'schema: ...' (version of this file format: 1)"),
    (HEAD + "duratoin: 3", "f:4: duratoin: unknown key 'duratoin'; did you mean 'duration'?"),
    (HEAD + "plane:\n  angel: 0.1", "f:5: plane.angel: unknown key 'angel'; did you mean 'angle'?"),
    (
        HEAD + "plane: {tilt: 0}",
        "f:4: plane.tilt: unknown key 'tilt'; known: inertia, length, gravity, friction,",
    ),
    (HEAD + "<<: {}", "f:4: <<: unknown key '<<'; known: schema, name, "),
    (HEAD + '"a\\e[31mb": 1', "f:4: a\\x1b[31mb: unknown key 'a\\x1b[31mb'; known: "),
    (HEAD + "schema: 1", "f:4: schema: the key is given twice (see line 1); remove one of them"),
    (
        HEAD + "plane: {angle: 0, angle: 0}",
        "f:4: plane.angle: the key is given twice (see line 4); remove one",
    ),
    (HEAD + "1: 2", "f:4: a key that is not a name: the number 1; write 'key: value' with a name as key"),
    (HEAD + "? [a]\n: 2", "f:4: a key that is not a name; write 'key: value' with a name as key"),
    # Types.
    (HEAD + "duration: '30'", "f:4: duration: expected a number, found the text '30'; remove the quotes"),
    (
        HEAD + "duration: long",
        "f:4: duration: expected a number, found the text 'long'; write a number, e.g. 0.5",
    ),
    (HEAD + "duration: 1:30", "f:4: duration: expected a number, found the text '1:30'; write a number"),
    (HEAD + "duration: 1_000", "f:4: duration: expected a number, found the text '1_000'; write a number"),
    (HEAD + "duration: 0x1F", "f:4: duration: expected a number, found the text '0x1F'; write a number"),
    (
        HEAD + "duration: 010",
        "f:4: duration: '010' begins with 0, which could mean octal; leave out the 0, or",
    ),
    (HEAD + "duration: true", "f:4: duration: expected a number, found true; write a number, e.g. 0.5"),
    (HEAD + "duration: .nan", "f:4: duration: .nan is not a finite number; give a finite number"),
    (HEAD + "duration: -.inf", "f:4: duration: -.inf is not a finite number; give a finite number"),
    (HEAD + "duration: 1e999", "f:4: duration: '1e999' is not a finite number; give a finite number"),
    (
        HEAD + f"duration: {'9' * 99}",
        "f:4: duration: a number of more than 60 digits is out of range; give a number",
    ),
    (
        HEAD + f"duration: {'9' * 5000}",
        "f:4: duration: a number of 5000 characters; give a number a computer can",
    ),
    (
        HEAD + f"duration: {'x' * 900}",
        f"f:4: duration: expected a number, found the text '{'x' * 57}...'; write",
    ),
    (
        HEAD + "seed: 1.0",
        "f:4: seed: expected a whole number, found the number 1.0; write a whole number, e.g. 1",
    ),
    (HEAD + "name: 5", "f:4: name: expected a text, found the number 5; put it in quotes"),
    (
        HEAD + "name: a/b",
        "f:4: name: the text 'a/b' cannot name a folder; use 1 to 60 printable characters, no /",
    ),
    (HEAD + "name: ..", "f:4: name: the text '..' cannot name a folder; use 1 to 60 printable characters"),
    (HEAD + "name: ''", "f:4: name: the text '' cannot name a folder; use 1 to 60 printable characters"),
    (
        HEAD + "plane:",
        "f:4: plane: expected a mapping, found nothing (null); write 'key: value' pairs, or leave it",
    ),
    (HEAD + "plane: [1]", "f:4: plane: expected a mapping, found a list of 1; write 'key: value' pairs"),
    (
        HEAD + "plane: {robot_gravity: yes}",
        "f:4: plane.robot_gravity: expected true or false, found the text 'yes'",
    ),
    (
        HEAD + "plane:\n  friction: [1, 2]",
        "f:5: plane.friction: expected a list of 6 numbers, found a list of 2",
    ),
    (
        HEAD + "plane: {friction: 3}",
        "f:4: plane.friction: expected a list of 6 numbers, found the number 3; write",
    ),
    (
        HEAD + "plane:\n  friction:\n    - 1\n    - x\n    - 1\n    - 1\n    - 1\n    - 1",
        "f:7: plane.friction.1: expected a number, found the text 'x'; write a number, e.g. 0.5",
    ),
    # The world's imperfections.
    (HEAD + "plane: {end_stop: 1.5}", "f:4: plane.end_stop: 1.5 is out of range; give a number < 1.5"),
    (HEAD + "plane: {end_stop: 0}", "f:4: plane.end_stop: 0 is out of range; give a number > 0"),
    (
        HEAD + "plane:\n  angle: 0.3\n  end_stop: 0.2",
        "f:5: plane.angle: 0.3 rad is beyond the end stop at 0.2 rad (see line 6); begin between the stops, or move",
    ),
    (
        HEAD + "plane:\n  robot_gravity: true\n  sensor: {noise: [0.1, 0]}",
        "f:6: plane.sensor: with robot_gravity the robots feel the plane's true angle, which its sensor",
    ),
    (
        HEAD + "plane: {sensor: {noise: 0.1}}",
        "f:4: plane.sensor.noise: expected a list of 2 numbers, found the number 0.1; write a list",
    ),
    (HEAD.replace("swarm:", "swarm:\n  actuator_lag: -1"), "f:3: swarm.actuator_lag: -1 is out of range; give a"),
    (
        HEAD.replace("swarm:", "swarm:\n  sensor: {resolution: [0, -1]}"),
        "f:3: swarm.sensor.resolution.1: -1 is out of range; give a number >= 0",
    ),
    (HEAD + "faults: {}", "f:4: faults: expected a list, found a mapping; write a list in [ ]"),
    # Ranges.
    ("schema: 2\nswarm: {}", "f:1: schema: the number 2 is a newer version than this one reads (1); update swarmabs"),
    ("schema: true\nswarm: {}", "f:1: schema: expected 1, found true; write 'schema: 1'"),
    (HEAD + "seed: -1", "f:4: seed: -1 is out of range; give a number >= 0"),
    (
        HEAD + "seed: 9223372036854775808",
        "f:4: seed: 9223372036854775808 is out of range; give a number < 9223",
    ),
    (HEAD + "plane: {inertia: -0.5}", "f:4: plane.inertia: -0.5 is out of range; give a number > 0"),
    (
        HEAD + "plane: {inertia: 1e-300}",
        "f:4: plane.inertia: 1e-300 is too small; give a number of at least 1e-12",
    ),
    (HEAD + "plane: {length: 1e300}", "f:4: plane.length: 1e+300 is out of range; give a number <= 1e+12"),
    (HEAD + "plane: {angle: -1.5}", "f:4: plane.angle: -1.5 is out of range; give a number > -1.5"),
    (
        HEAD + "plane: {friction: [1, 1, 1, 1, 1, -1]}",
        "f:4: plane.friction.5: -1 is out of range; give a number",
    ),
    (HEAD + "manifold: {curvature: -1}", "f:4: manifold.curvature: -1 is out of range; give a number >= 0"),
    (HEAD + "limits: {force: 0}", "f:4: limits.force: 0 is out of range; give a number > 0"),
    (
        HEAD + "lockstep: {on_stall: drpo}",
        "f:4: lockstep.on_stall: expected 'fail' or 'drop', found the text 'drpo'",
    ),
    (
        HEAD + "lockstep: {on_stall: 1}",
        "f:4: lockstep.on_stall: expected 'fail' or 'drop', found the number 1; write",
    ),
    # Time.
    (HEAD + "duration: 0", "f:4: duration: 0 is out of range; give a number > 0"),
    (HEAD + "step: -0.01", "f:4: step: -0.01 is out of range; give a number > 0"),
    (
        HEAD + "step: 1e-10",
        "f:4: step: 1e-10 s is not a whole number of nanoseconds; give at most nine decimals",
    ),
    (
        HEAD + "plane: {substep: 0.00000000025}",
        "f:4: plane.substep: 2.5e-10 s is not a whole number of nanoseconds",
    ),
    (HEAD + "duration: 3e9", "f:4: duration: 3000000000.0 is out of range; give a number <= 2147483647"),
    (
        HEAD + "duration: 0.015",
        (
            "f:4: duration: the duration 0.015 s is not a multiple of the step 0.01 s; "
            "use a duration of 0.01 or 0.02 s, or another step"
        ),
    ),
    (
        HEAD + "step: 0.007",
        "f:4: step: the duration 30.0 s is not a multiple of the step 0.007 s; use a duration",
    ),
    (
        HEAD + "duration: 0.001\nstep: 0.002",
        (
            "f:4: duration: the duration 0.001 s is not a multiple of the step 0.002 s (see line 5); "
            "use a duration of 0.002 s, or another step"
        ),
    ),
    # Controllers.
    (
        HEAD + "controller: pd",
        "f:4: controller: expected a mapping, found the text 'pd'; write {type: pd, ...}",
    ),
    (HEAD + "controller: {type: lrq}", "f:4: controller.type: unknown type 'lrq'; did you mean 'lqr'?"),
    (HEAD + "controller: {type: mpc}", "f:4: controller.type: unknown type 'mpc'; known: pd, lqr, arise"),
    (
        HEAD + "controller: {type: [pd]}",
        "f:4: controller.type: unknown type (a list of 1); known: pd, lqr, arise",
    ),
    (
        HEAD + "controller: {type: pd, gain: 1}",
        "f:4: controller.gain: unknown key 'gain'; did you mean 'gains'?",
    ),
    (
        HEAD + "controller: {type: lqr, q: [0, 1]}",
        "f:4: controller.q.0: 0 is out of range; give a number > 0",
    ),
    (HEAD + "controller: {type: lqr, r: 0}", "f:4: controller.r: 0 is out of range; give a number > 0"),
    (
        HEAD + "controller: {type: arise, smoothing: 0}",
        "f:4: controller.smoothing: 0 is out of range; give a number",
    ),
    (
        HEAD + "controller: {type: pd, trajectory: {type: sine}}",
        (
            "f:4: controller.trajectory: the pd controller follows no trajectory; "
            "remove 'trajectory', or use 'type: arise'"
        ),
    ),
    (
        HEAD + "controller: {type: lqr, trajectory: 0}",
        "f:4: controller.trajectory: the lqr controller follows no trajectory",
    ),
    (
        HEAD + "controller:\n  type: arise\n  trajectory: {type: cosine}",
        "f:6: controller.trajectory.type: unknown type 'cosine'; did you mean 'sine'?",
    ),
    (
        HEAD + "controller: {type: arise, trajectory: {type: constant, amplitude: 1}}",
        "f:4: controller.trajectory.amplitude: unknown key 'amplitude'; known: type, angle",
    ),
    # Robots.
    (
        "schema: 1\nswarm: {}",
        "f:2: swarm: no robots: neither 'agents' nor 'generate' is given; list 'agents', or use",
    ),
    (
        "schema: 1\nswarm:\n  agents: []\n  generate: {}",
        "f:2: swarm: both 'agents' and 'generate' are given; keep one",
    ),
    (
        listed(SI),
        "f:3: swarm.agents: a swarm needs at least two robots, found 1; add robots: torque and inertia are",
    ),
    (
        "schema: 1\nswarm: {generate: {single_integrator: 1}}",
        "f:2: swarm.generate: a swarm needs at least two robots, found 1; add robots",
    ),
    (
        listed(SI, DI, DI),
        "f:6: swarm.agents.2.id: robot 2 is listed twice (see line 5); give every robot its own id, e",
    ),
    (listed(SI, DI.replace("2", "0", 1)), "f:5: swarm.agents.1.id: 0 is out of range; give a number >= 1"),
    (
        listed(SI, DI.replace("2", "65536", 1)),
        "f:5: swarm.agents.1.id: 65536 is out of range; give a number <= 65535",
    ),
    (
        listed(SI, DI.replace("0.7", "-0.7")),
        "f:5: swarm.agents.1.mass: -0.7 is out of range; give a number > 0",
    ),
    (
        listed(SI, DI.replace("mass", "mas")),
        "f:5: swarm.agents.1.mas: unknown key 'mas'; did you mean 'mass'?",
    ),
    (
        listed(SI, DI.replace("mass: 0.7, ", "")),
        "f:5: swarm.agents.1.mass: 'mass' is missing; add 'mass: ...' (mass, kg)",
    ),
    (
        listed(SI, DI.replace("damping: 1, ", "")),
        (
            "f:5: swarm.agents.1.damping: 'damping' is missing; "
            "add 'damping: ...' (viscous damping c of its motion, N s/m; 0 is legal)"
        ),
    ),
    (
        listed(SI, DI.replace("double", "dubble")),
        "f:5: swarm.agents.1.kind: unknown kind 'dubble_integrator'; did you",
    ),
    (
        listed(SI, "{id: 2}"),
        "f:5: swarm.agents.1: 'kind' is missing; add 'kind: ...', one of single_integrator, double",
    ),
    (
        listed(SI, "2"),
        "f:5: swarm.agents.1: expected a mapping, found the number 2; write {kind: single_integrator, ...}",
    ),
    (
        listed(SI.replace("}", ", damping: 1}"), DI),
        (
            "f:4: swarm.agents.0.damping: a single integrator has no damping; "
            "remove it, or use 'kind: double_integrator'"
        ),
    ),
    (
        listed(SI.replace("}", ", velocity: 0.1}"), DI),
        "f:4: swarm.agents.0.velocity: a single integrator starts at velocity 0; remove it, or use",
    ),
    (
        listed(SI.replace("}", ", velocity: false}"), DI),
        "f:4: swarm.agents.0.velocity: a single integrator starts at",
    ),
    (
        listed(SI, DI.replace("-0.1", "-0.51")),
        "f:5: swarm.agents.1.position: -0.51 m is off the plane, whose half length is 0.5 m; keep",
    ),
    (
        listed(SI, DI.replace("-0.1", "0.1")),
        (
            "f:3: swarm.agents: the robots stand at one point (S3 = 0 kg^4 m^2), where torque and inertia "
            "cannot be steered independently; give them different positions, e.g. alternating +0.125 and"
        ),
    ),
    (listed(SI, DI.replace("-0.1", "0.1000001")), "f:3: swarm.agents: the robots stand at one point (S3 = "),
    (
        "schema: 1\nswarm:\n  generate: {single_integrator: 4, position: 0.6}",
        "f:3: swarm.generate.position: 0.6 m is off the plane, whose half length is 0.5 m; keep",
    ),
    (
        "schema: 1\nswarm: {generate: {single_integrator: 2, mass: [0.001, 0.001]}}",
        "f:2: swarm.generate.position: 3.794733192202055 m is off the plane",
    ),
    (
        "schema: 1\nswarm: {generate: {single_integrator: 2, position: far}}",
        "f:2: swarm.generate.position: expected a number or auto, found the text 'far'; write ",
    ),
    (
        "schema: 1\nswarm: {generate: {single_integrator: 2, position: true}}",
        "f:2: swarm.generate.position: expected a number, found true; write a number, e.g. 0.5",
    ),
    (
        "schema: 1\nswarm: {generate: {single_integrator: 2, mass: [2, 1]}}",
        "f:2: swarm.generate.mass: the smallest mass 2.0 exceeds the largest 1.0; write [smallest, largest]",
    ),
    (
        "schema: 1\nswarm: {generate: {single_integrator: 65535, double_integrator: 1}}",
        "f:2: swarm.generate: 65536 robots are more than there are ids; generate at most 65535 in all",
    ),
    (
        listed(SI, DI) + "manifold: {torque_max: 20, curvature: 0}",
        (
            "f:6: manifold: no positions of the robots (1.3 kg in all) have the inertia curvature*tau^2 + "
            "offset for |tau| > 1.76852 N m, and torque_max is 20.0; lower torque_max to 1.768, "
            "or use at least 166.3 kg of robots"
        ),
    ),
    # Faults.
    (
        HEAD + "faults: [{kind: kil, at: 1, agent: 1}]",
        "f:4: faults.0.kind: unknown kind 'kil'; did you mean 'kill'?",
    ),
    (
        HEAD + "faults: [{at: 1, agent: 1}]",
        "f:4: faults.0: 'kind' is missing; add 'kind: ...', one of kill, leave,",
    ),
    (
        HEAD + "faults: [{kind: kill, agent: 1}]",
        "f:4: faults.0.at: 'at' is missing; add 'at: ...' (time in s; the",
    ),
    (
        HEAD + "faults: [{kind: kill, at: -1, agent: 1}]",
        "f:4: faults.0.at: -1 is out of range; give a number >= 0",
    ),
    (
        HEAD + "faults: [{kind: kill, at: 30.006, agent: 1}]",
        "f:4: faults.0.at: 30.006 s is step 3001, after the last",
    ),
    (
        HEAD + "faults: [{kind: kill, at: 1, agent: 7}]",
        "f:4: faults.0.agent: there is no robot 7; name an existing",
    ),
    (
        HEAD + "faults: [{kind: loss, probability: 1.5}]",
        "f:4: faults.0.probability: 1.5 is out of range; give a number",
    ),
    (
        HEAD + "faults: [{kind: delay, steps: 1.5}]",
        "f:4: faults.0.steps: expected a whole number, found the number 1.5",
    ),
    (
        HEAD + "faults: [{kind: delay, steps: -1}]",
        "f:4: faults.0.steps: -1 is out of range; give a number >= 0",
    ),
    (
        HEAD + "faults:\n  - {kind: loss, probability: 0}\n  - {kind: loss, probability: 0}",
        "f:6: faults.1: a second loss (see line 5); keep one loss",
    ),
    (
        HEAD + "faults:\n  - {kind: delay, steps: 0}\n  - {kind: delay, steps: 0}",
        "f:6: faults.1: a second delay (see line 5); keep one delay",
    ),
    (
        HEAD + "faults:\n  - {kind: kill, at: 1, agent: 1}\n  - {kind: leave, at: 2, agent: 1}",
        "f:6: faults.1: robot 1 is killed, frozen or leaves twice (see line 5); keep one of them",
    ),
    (
        HEAD + "faults:\n  - {kind: join, at: 1, agent: 1}\n  - {kind: join, at: 2, agent: 1}",
        "f:6: faults.1: robot 1 joins twice (see line 5); keep one of them",
    ),
    (
        HEAD + "faults:\n  - {kind: kill, at: 1, agent: 1}\n  - {kind: join, at: 1.001, agent: 1}",
        "f:6: faults.1.at: robot 1 joins at step 100, but is out from step 100 (see line 5); let",
    ),
    (
        HEAD
        + "faults:\n  - {kind: loss, probability: .1, to: 2}\n  - {kind: loss, probability: .2, from: 1, agents: [2]}",
        "f:6: faults.1: a second loss for robot 2 at the same time (see line 5); keep one loss, or let it end ('to')",
    ),
    (
        HEAD + "faults: [{kind: reordering, probability: .1, agents: [1, 7]}]",
        "f:4: faults.0.agents.1: there is no robot 7; name an existing",
    ),
    (
        HEAD + "faults: [{kind: duplication, probability: .1, agents: []}]",
        "f:4: faults.0.agents: no robots are named; name some, or leave out 'agents' for all",
    ),
    (
        HEAD + "faults: [{kind: reordering, probability: .1, steps: 0}]",
        "f:4: faults.0.steps: 0 is out of range; give a number >= 1",
    ),
    (
        HEAD + "faults: [{kind: delay, steps: 1, from: 31}]",
        "f:4: faults.0.from: 31.0 s is step 3100, after the last step 3000; use a time within",
    ),
    (
        HEAD + "faults: [{kind: delay, steps: 1, from: 2, to: 1}]",
        "f:4: faults.0: the fault ends at 1.0 s, before it begins; use 'to' with a time after 2.0 s",
    ),
    (
        HEAD + "faults: [{kind: delay, steps: 1, from: 1, to: 1.004}]",
        "f:4: faults.0.to: the fault begins and ends with step 100; let it last a step or more",
    ),
    (
        HEAD + "faults: [{kind: clock_offset, agent: 1, offset: 1.0e-10}]",
        "f:4: faults.0.offset: 1e-10 s is not a whole number of nanoseconds; give at most nine decimals",
    ),
    (
        HEAD + "faults: [{kind: clock_offset, agent: 9, offset: 1}]",
        "f:4: faults.0.agent: there is no robot 9; name an existing",
    ),
    (
        HEAD + "faults: [{kind: lie, agent: 1}]",
        "f:4: faults.0: this robot tells the truth; give 'position_offset', 'position_factor' or 'mass_factor'",
    ),
    (
        HEAD + "faults: [{kind: lie, agent: 1, position_factor: 0}]",
        "f:4: faults.0.position_factor: 0.0 cannot be undone; give a number of at least 0.001 in magnitude",
    ),
    (
        HEAD + "faults: [{kind: lie, agents: [1], position_factor: 2}]",
        "f:4: faults.0.agents: unknown key 'agents'; did you mean 'agent'?",
    ),
    (
        HEAD + "faults: [{kind: join, at: 1, agent: 1}]",
        "f:3: swarm.generate: a swarm needs at least two robots at step 0, found 1: the others join",
    ),
    # Tags, aliases, nesting: nothing is executed, nothing explodes.
    (
        "!!python/object/apply:os.system ['true']",
        "f:1: the tag 'tag:yaml.org,2002:python/object/apply:os.system' is",
    ),
    (
        HEAD + "name: !!python/name:os.system x",
        "f:4: name: the tag 'tag:yaml.org,2002:python/name:os.system' is not",
    ),
    (
        HEAD + "name: !!binary aGk=",
        "f:4: name: the tag 'tag:yaml.org,2002:binary' is not allowed; remove the tag",
    ),
    (
        HEAD + "faults: !!set {a}",
        "f:4: faults: the tag 'tag:yaml.org,2002:set' is not allowed; remove the tag",
    ),
    (
        HEAD + "plane: !robot {angle: 0}",
        "f:4: plane: the tag '!robot' is not allowed; remove the tag: a scenario is",
    ),
    (
        HEAD + "seed: !!int '1.5'",
        "f:4: seed: the number 1.5 does not fit its tag 'tag:yaml.org,2002:int'; remove the",
    ),
    (HEAD + "seed: *one", "f:4: seed: the alias 'one' has no anchor before it; write the value itself"),
    (
        HEAD + "plane: &p {angle: *p}",
        "f:4: plane.angle: the alias 'p' has no anchor before it; write the value",
    ),
    ("[" * 40, "f:1: " + ".".join("0" * 32) + ": nested more than 32 deep; a scenario needs no such nesting"),
]


@pytest.mark.parametrize(("text", "expected"), CASES)
def test_the_error_names_line_field_and_remedy(text: str, expected: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        parse_scenario(text, source="f")
    assert str(caught.value).startswith(expected)
    assert str(caught.value).isprintable()
    assert caught.value.remedy
    assert isinstance(caught.value, InputError)


def test_python_parser_finds_the_same_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(yaml_tree, "_LOADER", yaml.SafeLoader)
    for text, expected in CASES:
        if "not valid YAML" not in expected:
            with pytest.raises(ScenarioError) as caught:
                parse_scenario(text, source="f")
            assert str(caught.value).startswith(expected)


def test_further_errors_are_counted() -> None:
    with pytest.raises(ScenarioError, match=r"^f:4: plane\.length: .* \(\+2 more\)$") as caught:
        parse_scenario(HEAD + "plane: {length: 0, gravity: 0}\nseed: x", source="f")
    assert caught.value.more == 2
    assert (caught.value.source, caught.value.line, caught.value.field) == ("f", 4, "plane.length")


def test_the_first_error_in_the_file_comes_first() -> None:
    with pytest.raises(ScenarioError, match=r"^f:1: seed: "):
        parse_scenario("seed: x\n" + HEAD + "name: 5", source="f")


@pytest.mark.parametrize(("name", "value"), [("torque_max", 1.768), ("mass", 166.3)])
def test_the_remedies_for_an_empty_preimage_work(name: str, value: float) -> None:
    masses = 0.6, 0.7
    torque = 20.0
    if name == "mass":
        masses = 0.6, value - 0.6
    else:
        torque = value
    agents = listed(SI.replace("0.6", repr(masses[0])), DI.replace("0.7", repr(masses[1])))
    parse_scenario(agents + f"manifold: {{torque_max: {torque}, curvature: 0}}")


def test_yaml_bomb_is_refused_at_once() -> None:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]" for n in range(1, 20)]
    with pytest.raises(ScenarioError, match=r"f:7: a6\.\d+: more than 2000000 values after expansion of aliases"):
        parse_scenario("\n".join(lines), source="f")


def test_nesting_by_aliases_is_limited_too() -> None:
    lines = ["a0: &a0 [x]", *(f"a{n}: &a{n} [*a{n - 1}]" for n in range(1, 40))]
    with pytest.raises(ScenarioError, match=r"f:32: a31\.0: nested more than 32 deep"):
        parse_scenario("\n".join(lines), source="f")


def test_aliases_within_reason_are_expanded() -> None:
    text = HEAD + "plane: {disturbance: {amplitude: &half 0.5, angular_frequency: *half}}"
    disturbance = parse_scenario(text).plane.disturbance
    assert (disturbance.amplitude, disturbance.angular_frequency) == (0.5, 0.5)


def test_too_long_text() -> None:
    with pytest.raises(ScenarioError, match=r"^f: more than 16777216 characters; shorten it"):
        parse_scenario("#" * (yaml_tree.LARGEST_TEXT + 1), source="f")


def write(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (b"schema: 1\nname: \xff\n", ":2: not UTF-8: byte 0xff at offset 16; save the file as UTF-8"),
        (
            "schema: 1\n".encode("utf-16-be"),
            ":1: not a text file: it has a NUL byte; give a scenario in YAML",
        ),
        (b"\x7fELF\x02\x01\x01\x00", ":1: not a text file: it has a NUL byte; give a scenario in YAML"),
        (
            b"#" * (16 * 2**20 + 1),
            ": larger than 16777216 bytes; shorten it; 'swarm.generate' stands for many robots",
        ),
    ],
)
def test_not_a_text_file(tmp_path: Path, data: bytes, expected: str) -> None:
    path = write(tmp_path / "x.yaml", data)
    with pytest.raises(ScenarioError) as caught:
        load_scenario(path)
    assert str(caught.value) == f"{path}{expected}"


def test_missing_file_names_a_near_one(tmp_path: Path) -> None:
    write(tmp_path / "pd_het_4.yaml", b"")
    with pytest.raises(ScenarioError, match=r"pd_hte_4\.yaml: no such file; did you mean 'pd_het_4\.yaml'\?$"):
        load_scenario(tmp_path / "pd_hte_4.yaml")
    with pytest.raises(ScenarioError, match=r"no such file; check the path$"):
        load_scenario(tmp_path / "no" / "x.yaml")


def test_what_is_no_file(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r": is a directory; give a scenario file in YAML$"):
        load_scenario(tmp_path)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ScenarioError, match=r"pipe: not a regular file; give a scenario file in YAML$"):
        load_scenario(tmp_path / "pipe")
    with pytest.raises(ScenarioError, match=r"/dev/zero: not a regular file"):
        load_scenario("/dev/zero")
    with pytest.raises(ScenarioError, match=r"x\\x00: cannot be read: .*; check the path and its permissions$"):
        load_scenario("x\0")
    with pytest.raises(ScenarioError, match=r"\.\.\.: cannot be read: File name too long; check the path and"):
        load_scenario("x" * 5000)


def test_unreadable_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> int:
        raise PermissionError(13, "Permission denied")

    path = write(tmp_path / "x.yaml", b"")
    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(ScenarioError, match=r"x\.yaml: cannot be read: Permission denied; check the path and its"):
        load_scenario(path)


def test_byte_order_mark_and_line_ends_of_other_systems(tmp_path: Path) -> None:
    path = write(tmp_path / "from afar.yaml", b"\xef\xbb\xbf" + HEAD.replace("\n", "\r\n").encode())
    assert load_scenario(path).name == "from afar"
