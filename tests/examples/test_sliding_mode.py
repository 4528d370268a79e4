"""The example package: installed as a user installs it, it controls simulations and runs of real processes."""

from __future__ import annotations

import json
import math
import os
import shutil
import subprocess
import sys
from pathlib import Path
from textwrap import dedent

import pytest
from tests.docs.pages import ROOT
from tests.plugin_packages import SCALED, install

from swarmabs_config.scenario import load_scenario
from swarmabs_core.controllers import CONTROLLERS
from swarmabs_run.simulation import simulate

EXAMPLE = ROOT / "examples" / "sliding_mode"
SCENARIO = EXAMPLE / "sliding_mode.yaml"
LONGEST = 100.0
SWARMS = {
    "as it is": (),
    "SI": ("swarm={generate: {single_integrator: 4}}",),
    "DI": ("swarm={generate: {double_integrator: 4}}",),
    "large": ("swarm={generate: {single_integrator: 5, double_integrator: 5}}",),
}

pytestmark = pytest.mark.timeout(120)


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Install the example, without network, into a folder; return the folder."""
    folder = tmp_path_factory.mktemp("installed")
    source = tmp_path_factory.mktemp("source") / "sliding_mode"  # pip builds where the source is
    shutil.copytree(EXAMPLE, source)
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "install", "--no-deps", "--no-build-isolation"]
    words = [*pip, "--no-index", "--target", str(folder), str(source)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=LONGEST, check=False)
    assert done.returncode == 0, done.stderr
    return folder


def swarm(*words: object, cwd: Path, path: tuple[Path, ...]) -> str:
    """Run a command with folders of packages in the search path; return what it prints."""
    done = subprocess.run(
        [sys.executable, "-m", "swarmabs_cli", *map(str, words)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join((*map(str, path), os.environ["PYTHONPATH"]))},
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=LONGEST,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.system
@pytest.mark.usefixtures("nothing_survives")
@pytest.mark.parametrize("extra", [(), ("--agents-per-process", "2")], ids=["apart", "together"])
def test_processes_and_simulation_agree(installed: Path, tmp_path: Path, extra: tuple[str, ...]) -> None:
    said = "the module of the law is imported"
    install(tmp_path / "laws", "law", "scaled", f"import sys\nprint({said!r}, file=sys.stderr)\n{dedent(SCALED)}")
    path = (installed, tmp_path / "laws")
    words = (SCENARIO, "--duration", "1.5", "--set", "swarm.law={type: scaled, factor: 0.5}", "--json")
    run = json.loads(swarm("run", *words, *extra, "-o", "run", cwd=tmp_path, path=path))
    simulated = json.loads(swarm("simulate", *words, "-o", "simulated", cwd=tmp_path, path=path))
    assert (run["status"], run["steps"]) == ("ok", 150)
    assert run["digest"] == simulated["digest"]
    logs = sorted((tmp_path / "run" / "logs").glob("*.log"))
    assert [log.name for log in logs if said in log.read_text(encoding="utf-8")] == ["launcher.log"]  # before the forks
    again = json.loads(swarm("simulate", "run", "-o", "again", "--json", cwd=tmp_path, path=path))
    assert again["digest"] == run["digest"]
    bag = json.loads(swarm("info", "run", "--json", cwd=tmp_path, path=path))
    assert {"swarmabs-sliding-mode", "test-scaled"} <= bag["versions"].keys()
    schema = json.loads(swarm("scenario", "schema", cwd=tmp_path, path=path))
    assert "sliding_mode" in json.dumps(schema["properties"]["controller"])


@pytest.mark.parametrize("overrides", SWARMS.values(), ids=list(SWARMS))
def test_the_angle_follows_within_the_bound_of_the_boundary_layer(
    installed: Path, monkeypatch: pytest.MonkeyPatch, overrides: tuple[str, ...]
) -> None:
    """Within the layer |s| falls below layer D/reach and |e| below that divided by the slope."""
    monkeypatch.syspath_prepend(installed)
    for cache in ("_loaded", "_packages"):
        monkeypatch.setattr(CONTROLLERS, cache, {})
    scenario = load_scenario(SCENARIO, overrides)
    run = simulate(scenario)
    errors = [abs(have - 0.3 * math.sin(0.5 * time)) for time, have in zip(run.time, run.angle, strict=True)]
    layer, reach, slope = 0.1, 0.5, 2.0
    unknown = 0.2 + 0.01 + 0.02  # N m: the scenario's disturbance, and the friction g1 and g4 that the law leaves out
    bound = layer * unknown / (reach * slope)
    assert errors[0] == pytest.approx(0.1)
    assert 0.5 * bound < max(errors[500:]) < bound  # the disturbance is felt, and no more than that
