"""RViz's configuration and Foxglove's layout show topics that there are, of types that fit."""

import json
import re
from collections.abc import Iterator
from typing import Any

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


def test_rviz_shows_topics_that_exist_and_the_markers_in_the_frame_that_they_have() -> None:
    manager = RVIZ["Visualization Manager"]
    assert manager["Global Options"]["Fixed Frame"] == "world"
    shown = set()
    for display in manager["Displays"]:
        for topic in (display[key] for key in ("Topic", "Description Topic") if key in display):
            shown.add((display["Class"], topic["Value"], display["Enabled"]))
            assert TYPES[topic["Value"]] == SHOWN_BY_RVIZ[display["Class"]]
            (offered,) = (each.qos for each in VISUAL_TOPICS if f"/{each.name}" == topic["Value"])
            # A reader that asks for more than is offered hears nothing.
            assert topic["Durability Policy"] == "Volatile" or offered.durability == "transient_local"
            assert topic["Reliability Policy"] == "Best Effort" or offered.reliability == "reliable"
    assert ("rviz_default_plugins/MarkerArray", f"/{MARKERS.name}", True) in shown
    assert f"/{DESCRIPTION.name}" in {topic for kind, topic, _ in shown if kind == "rviz_default_plugins/RobotModel"}


def leaves(node: Any) -> Iterator[str]:
    if isinstance(node, str):
        yield node
    else:
        yield from (*leaves(node["first"]), *leaves(node["second"]))


def test_the_layout_of_foxglove_has_every_panel_in_its_place_with_topics_and_fields_that_exist() -> None:
    panels: dict[str, Any] = LAYOUT["configById"]
    assert sorted(leaves(LAYOUT["layout"])) == sorted(panels)
    (panel,) = (config for name, config in panels.items() if name.startswith("3D!"))
    assert panel["followTf"] == "world"
    assert panel["topics"][f"/{MARKERS.name}"] == {"visible": True}
    topics = [config["topicPath"] for config in panels.values() if "topicPath" in config]
    assert topics and {*panel["topics"], *topics} <= set(TYPES)
    plotted = [path["value"] for config in panels.values() for path in config.get("paths", ())]
    assert plotted
    for path in plotted:
        parts = PLOTTED.fullmatch(path)
        assert parts, path
        topic, selected, field = parts.groups()
        fields = message_class(TYPES[topic]).get_fields_and_field_types()
        assert fields[field] == "double" and (selected is None or selected in fields), path
