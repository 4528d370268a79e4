"""The files are what they claim to be, and the same bytes each time."""

from __future__ import annotations

import io
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import matplotlib as mpl
import pytest
from matplotlib.image import imread

from swarmabs_analysis.figures import FIGURES, draw_files
from swarmabs_analysis.figures.runs import find_runs
from swarmabs_analysis.figures.style import COLUMN, FORMATS, PAGE

WIDTHS = {"mappingEx": COLUMN, "posMapping": COLUMN, "PD_res": PAGE, "ARISE_res": PAGE, "ARISE_lg_swarm": PAGE}
TEXTS = {
    "mappingEx": ("preimage of both", "τₛ = 10 N m", "p₃, m"),
    "posMapping": ("edge of the hypercube", "lower bound", "A_c leaves A_A: |τ| = 2.288 N m", "inertia Jₛ, kg m²"),
    "PD_res": ("θ, rad", "ω, rad/s", "position p, m", "heterogeneous"),
    "ARISE_res": ("single integrators", "double integrators", "time, s"),
    "ARISE_lg_swarm": ("a) 20 robots", "d) 200 robots", "SI", "DI"),
}
# Drawing takes 1 to 3 s for each file, and more where all cores are busy.
pytestmark = pytest.mark.timeout(60)
SCRIPT = """
import hashlib, sys
from pathlib import Path
from swarmabs_analysis.figures import FIGURES, draw_files
from swarmabs_analysis.figures.runs import find_runs
for name in sys.argv[2:]:
    found = find_runs([Path(sys.argv[1])], FIGURES[name].scenarios)
    for file, content in draw_files(name, found, ("png", "svg")).items():
        print(file, hashlib.sha256(content).hexdigest())
assert "matplotlib.pyplot" not in sys.modules
"""


@pytest.mark.parametrize("name", FIGURES)
def test_files_are_pictures_of_the_printed_width_with_their_texts(name: str, short_runs: Path) -> None:
    files = draw_files(name, find_runs([short_runs], FIGURES[name].scenarios), FORMATS)
    assert files.keys() == {f"{name}.png", f"{name}.svg"}
    picture = imread(io.BytesIO(files[f"{name}.png"]), format="png")
    assert picture.shape[1] == pytest.approx(WIDTHS[name] * 300, abs=1)
    assert picture.std() > 0.05
    root = ET.fromstring(files[f"{name}.svg"])
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    assert float(root.attrib["width"].removesuffix("pt")) == pytest.approx(WIDTHS[name] * 72, abs=0.1)
    text = "\n".join("".join(element.itertext()) for element in root.iter("{http://www.w3.org/2000/svg}text"))
    for expected in TEXTS[name]:
        assert expected in text


def test_a_format_does_not_depend_on_the_others(short_runs: Path) -> None:
    found = find_runs([short_runs], FIGURES["PD_res"].scenarios)
    both = draw_files("PD_res", found, FORMATS)
    assert draw_files("PD_res", found, ["svg"]) | draw_files("PD_res", found, ["png"]) == both


def test_other_processes_give_the_same_bytes(short_runs: Path) -> None:
    names = ("mappingEx", "posMapping", "PD_res")
    found = [
        subprocess.run(
            [sys.executable, "-c", SCRIPT, short_runs, *names], capture_output=True, text=True, check=True, timeout=50
        ).stdout
        for _ in range(2)
    ]
    assert found[0] == found[1]
    assert len(found[0].splitlines()) == 6


def test_the_users_own_style_changes_nothing(short_runs: Path) -> None:
    found = find_runs([short_runs], FIGURES["PD_res"].scenarios)
    plain = draw_files("PD_res", found, FORMATS)
    with mpl.rc_context({"lines.linewidth": 7.0, "font.size": 20.0, "axes.grid": True, "svg.fonttype": "path"}):
        assert draw_files("PD_res", found, FORMATS) == plain
        assert mpl.rcParams["lines.linewidth"] == 7.0
