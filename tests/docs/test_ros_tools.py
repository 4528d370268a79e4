"""The page on RViz and Foxglove names the topics and parameters that there are."""

from __future__ import annotations

from tests.docs.pages import read, rows, section

from swarmabs_view.visualization.node import PARAMETERS
from swarmabs_view.visualization.ros_messages import VISUAL_TOPICS

ROWS = [[cell.strip("`") for cell in row] for row in rows(section(read("docs/ros_tools.md"), "On topics of ROS"))]


def test_topics() -> None:
    assert [row[:3] for row in ROWS if len(row) == 4] == [
        [
            topic.name,
            topic.ros_type.replace("/msg/", "/"),
            f"{topic.qos.reliability} {topic.qos.durability} {topic.qos.depth}",
        ]
        for topic in VISUAL_TOPICS
    ]


def test_parameters() -> None:
    assert [row[:2] for row in ROWS if len(row) == 3] == [
        [each.name, repr(each.default).lower() if isinstance(each.default, bool) else repr(each.default)]
        for each in PARAMETERS
    ]
