"""Frames of the page have all that is shown of a swarm, by the same names."""

from __future__ import annotations

from swarmabs_bag.swarm_state import Abstract, Instant, ShownRobot
from swarmabs_view.frame import frame_of
from swarmabs_view.protocol import Frame

INSTANT = Instant(7, 70_000_000, 0.07, 0.1, -0.2, None, Abstract(1.0, None), Abstract(2.0, 0.5))


def test_a_frame_has_all_that_is_shown_but_the_stamp() -> None:
    assert set(Instant._fields) - set(Frame.model_fields) == {"stamp"}
    frame = frame_of(INSTANT, [ShownRobot(0.5, 0.0, None, "dead"), ShownRobot()], 250.0)
    assert frame.model_dump() == {
        "v": 1,
        "type": "frame",
        "step": 7,
        "time": 0.07,
        "angle": 0.1,
        "angular_velocity": -0.2,
        "reference": None,
        "abstract": {"torque": 1.0, "inertia": None},
        "desired": {"torque": 2.0, "inertia": 0.5},
        "robots": {
            "position": [0.5, None],
            "velocity": [0.0, None],
            "command": [None, None],
            "status": ["dead", None],
        },
        "step_rate": 250.0,
    }
