"""What repeats the colours of the code repeats them correctly."""

from __future__ import annotations

import json
import re

import pytest
from tests.processes import ROOT

from swarmabs_bag.shown import colours
from swarmabs_core.messages import Kind
from swarmabs_core.systems.kinds import KINDS


def test_the_layout_of_foxglove_has_the_colours() -> None:
    layout = json.loads((ROOT / "src/swarmabs_bringup/foxglove/swarm.json").read_text(encoding="utf-8"))
    plots = {name: plot["paths"] for name, plot in layout["configById"].items() if name.startswith("Plot!")}
    assert {name.removeprefix("Plot!"): tuple(path["color"] for path in paths) for name, paths in plots.items()} == {
        "angle": (colours.PLANE,),
        "torque": (colours.TORQUE, colours.REFERENCE),
        "inertia": (colours.INERTIA, colours.REFERENCE),
        "positions": colours.ROBOTS,
    }


@pytest.mark.parametrize(
    ("file", "names"),
    [
        (
            "swarmabs_view/swarmabs_view/static/style.css",
            "angle reference error torque inertia si di dead stop grey",
        ),
        (
            "swarmabs_analysis/swarmabs_analysis/report/templates/report.css",
            "plane - error torque inertia single double failed safe-stop absent",
        ),
    ],
)
def test_the_light_theme_of_a_page_has_the_colours(file: str, names: str) -> None:
    found = dict(re.findall(r"--([a-z-]+): (#[0-9a-f]{6})", (ROOT / "src" / file).read_text().partition("}")[0]))
    quantities = (colours.PLANE, colours.REFERENCE, colours.ERROR, colours.TORQUE, colours.INERTIA)
    kinds = (KINDS[Kind.SINGLE_INTEGRATOR].colour, KINDS[Kind.DOUBLE_INTEGRATOR].colour)
    statuses = (colours.FAILED, colours.SAFE_STOP, colours.ABSENT)
    expected = dict(zip(names.split(), (*quantities, *kinds, *statuses), strict=True))
    assert {name: found.get(name) for name in expected if name != "-"} == {
        name: colour for name, colour in expected.items() if name != "-"
    }


def test_the_plate_of_rviz_and_foxglove_has_the_colour_of_the_plane() -> None:
    model = (ROOT / "src/swarmabs_bringup/urdf/plane.urdf").read_text()
    found = re.findall(r'<color rgba="(\S+) (\S+) (\S+) 1"', model)
    assert [tuple(map(float, each)) for each in found] == [
        pytest.approx(colours.parts(colours.tint(colours.PLANE, 0.25)), abs=1e-4)
    ]


def test_a_tint_lies_between_white_and_the_colour() -> None:
    assert colours.tint("#0072b2", 0.0) == "#ffffff" and colours.tint("#0072b2", 1.0) == "#0072b2"
    assert colours.parts(colours.tint("#000000", 0.5)) == pytest.approx((0.5, 0.5, 0.5), abs=0.003)
