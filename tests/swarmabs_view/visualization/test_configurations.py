"""RViz's configuration and Foxglove's layout show topics that there are, of types that fit."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Any

import pytest
import yaml
from tests.processes import ROOT

from swarmabs_core.messages import TOPICS
from swarmabs_view.visualization.ros_messages import DESCRIPTION, MARKERS, VISUAL_TOPICS, message_class

PACKAGE = ROOT / "src" / "swarmabs_bringup"
TYPES = {f"/{topic.name}": topic.ros_type for topic in (*VISUAL_TOPICS, *TOPICS)}
LAYOUT = json.loads((PACKAGE / "foxglove" / "swarm.json").read_text(encoding="utf-8"))
RVIZ = yaml.safe_load((PACKAGE / "rviz" / "swarm.rviz").read_text(encoding="utf-8"))
SHOWN_BY_RVIZ = {
    "rviz_default_plugins/MarkerArray": "visualization_msgs/msg/MarkerArray",
    "rviz_default_plugins/RobotModel": "std_msgs/msg/String",
}
PLOTTED = re.compile(r"(/[a-z_/]+)(?:\{(\w+)==\d+\})?\.(\w+)")


def displays(kind: str) -> list[dict[str, Any]]:
    return [display for display in RVIZ["Visualization Manager"]["Displays"] if display["Class"] == kind]


def test_rviz_shows_the_markers_in_the_frame_that_they_have() -> None:
    manager = RVIZ["Visualization Manager"]
    assert manager["Global Options"]["Fixed Frame"] == "world"
    (markers,) = displays("rviz_default_plugins/MarkerArray")
    assert markers["Enabled"] and markers["Topic"]["Value"] == f"/{MARKERS.name}"
    (model,) = displays("rviz_default_plugins/RobotModel")
    assert model["Description Topic"]["Value"] == f"/{DESCRIPTION.name}"


@pytest.mark.parametrize("display", RVIZ["Visualization Manager"]["Displays"], ids=lambda display: display["Name"])
def test_topics_of_rviz_exist(display: dict[str, Any]) -> None:
    for key in ("Topic", "Description Topic"):
        topic = display.get(key)
        if topic is None:
            continue
        assert TYPES[topic["Value"]] == SHOWN_BY_RVIZ[display["Class"]]
        (offered,) = (each.qos for each in VISUAL_TOPICS if f"/{each.name}" == topic["Value"])
        # A reader that asks for more than is offered hears nothing.
        assert topic["Durability Policy"] == "Volatile" or offered.durability == "transient_local"
        assert topic["Reliability Policy"] == "Best Effort" or offered.reliability == "reliable"


def leaves(node: Any) -> Iterator[str]:
    if isinstance(node, str):
        yield node
        return
    yield from leaves(node["first"])
    yield from leaves(node["second"])


def test_the_layout_has_every_panel_in_its_place() -> None:
    placed = list(leaves(LAYOUT["layout"]))
    assert len(placed) == len(set(placed))
    assert set(placed) == set(LAYOUT["configById"])


def test_the_3d_panel_shows_the_markers() -> None:
    (panel,) = (config for name, config in LAYOUT["configById"].items() if name.startswith("3D!"))
    assert panel["followTf"] == "world"
    assert panel["topics"][f"/{MARKERS.name}"] == {"visible": True}
    assert set(panel["topics"]) <= set(TYPES)


@pytest.mark.parametrize(
    "path",
    [path["value"] for config in LAYOUT["configById"].values() for path in config.get("paths", ())],
)
def test_plotted_fields_exist(path: str) -> None:
    parts = PLOTTED.fullmatch(path)
    assert parts, path
    topic, selected, field = parts.groups()
    fields = message_class(TYPES[topic]).get_fields_and_field_types()
    assert fields[field] == "double"
    assert selected is None or selected in fields


def test_other_panels_show_topics_that_exist() -> None:
    paths = [config["topicPath"] for config in LAYOUT["configById"].values() if "topicPath" in config]
    assert paths and set(paths) <= set(TYPES)
