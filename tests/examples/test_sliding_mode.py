"""The example package: installed as a user installs it, it controls simulations and runs of real processes."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from tests.docs.pages import ROOT
from tests.plugin_packages import SCALED, install

EXAMPLE = ROOT / "examples" / "sliding_mode"
SCENARIO = EXAMPLE / "sliding_mode.yaml"
LONGEST = 100.0
DISTURBANCE = 0.2 + 0.01 + 0.02
"""The scenario's disturbance and the friction that the controller leaves out (g1 and g4), N m."""
REACH, LAYER, SLOPE = 0.5, 0.1, 2.0
KINDS = {"SI": "single_integrator: 4", "DI": "double_integrator: 4", "large": "single_integrator: 5, double_integrator: 5"}

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


@pytest.fixture
def command(installed: Path, tmp_path: Path) -> Any:
    """Return a function that runs a command with the example and a law installed, and returns its output."""
    laws = tmp_path / "laws"
    install(laws, "law", "scaled", SCALED)
    path = os.pathsep.join((str(installed), str(laws), os.environ["PYTHONPATH"]))

    def run(*words: object, code: int = 0) -> str:
        done = subprocess.run(
            [sys.executable, "-m", "swarmabs_bringup.cli", *map(str, words)],
            env={**os.environ, "PYTHONPATH": path},
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=LONGEST,
            check=False,
        )
        assert done.returncode == code, done.stderr
        return done.stderr if code else done.stdout

    return run


@pytest.mark.system
@pytest.mark.usefixtures("nothing_survives")
@pytest.mark.parametrize("extra", [(), ("--agents-per-process", "2")], ids=["apart", "together"])
def test_processes_and_simulation_agree(command: Any, extra: tuple[str, ...]) -> None:
    words = (SCENARIO, "--duration", "1.5", "--set", "swarm.law={type: scaled, factor: 0.5}", "--json")
    run = json.loads(command("run", *words, *extra, "-o", "run"))
    simulated = json.loads(command("simulate", *words, "-o", "simulated"))
    assert (run["status"], run["steps"]) == ("ok", 150)
    assert run["digest"] == simulated["digest"]
    again = json.loads(command("simulate", "run", "-o", "again", "--json"))
    assert again["digest"] == run["digest"]


@pytest.mark.parametrize("kind", ["as it is", *KINDS])
def test_the_angle_follows_within_the_bound_of_the_boundary_layer(command: Any, kind: str) -> None:
    """In the layer |s| falls below layer D/reach, and the error below that divided by the slope (README.md)."""
    swarm = () if kind == "as it is" else ("--set", "swarm.agents=null", "--set", f"swarm.generate={{{KINDS[kind]}}}")
    command("simulate", SCENARIO, *swarm, "-o", "out")
    script = (
        "import json, math, sys\n"
        "from swarmabs_bringup.bag import load_arrays\n"
        "run = load_arrays('out')\n"
        "wanted = [0.3 * math.sin(0.5 * time) for time in run.time.tolist()]\n"
        "print(json.dumps([have - want for have, want in zip(run.angle.tolist(), wanted)]))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=_folder(command), capture_output=True, text=True, check=True, timeout=LONGEST
    )
    errors = [abs(error) for error in json.loads(done.stdout)]
    bound = LAYER * DISTURBANCE / (REACH * SLOPE)
    assert errors[0] == pytest.approx(0.1)
    assert max(errors[500:]) < bound
    assert max(errors[500:]) > 0.5 * bound  # the disturbance is there, and nothing else removes it


def _folder(command: Any) -> Path:
    return Path(command.__closure__[1].cell_contents)
