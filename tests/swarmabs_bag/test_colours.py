"""What repeats the colours of the code repeats them correctly."""

from __future__ import annotations

import json

import pytest
from tests.processes import ROOT

from swarmabs_bag import colours


def test_the_layout_of_foxglove_has_the_colours() -> None:
    layout = json.loads((ROOT / "src/swarmabs_bringup/foxglove/swarm.json").read_text(encoding="utf-8"))
    plots = layout["configById"]
    found = {
        name: [path["color"] for path in plots[f"Plot!{name}"]["paths"]] for name in ("angle", "torque", "inertia")
    }
    assert found == {
        "angle": [colours.PLANE],
        "torque": [colours.TORQUE, colours.REFERENCE],
        "inertia": [colours.INERTIA, colours.REFERENCE],
    }


def test_a_tint_lies_between_white_and_the_colour() -> None:
    assert colours.tint("#0072b2", 0.0) == "#ffffff" and colours.tint("#0072b2", 1.0) == "#0072b2"
    assert colours.parts(colours.tint("#000000", 0.5)) == pytest.approx((0.5, 0.5, 0.5), abs=0.003)
