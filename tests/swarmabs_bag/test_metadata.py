"""rosbag2's texts, word for word."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from swarmabs_bag.metadata import BagChannel, FileRecord, bag_metadata, dump_yaml, qos_profile, write_metadata
from swarmabs_config.graph import Qos

QOS = """\
- history: keep_last
  depth: 1000
  reliability: reliable
  durability: transient_local
  deadline:
    sec: 9223372036
    nsec: 854775807
  lifespan:
    sec: 9223372036
    nsec: 854775807
  liveliness: automatic
  liveliness_lease_duration:
    sec: 9223372036
    nsec: 854775807
  avoid_ros_namespace_conventions: false
"""


def test_qos_is_a_list_of_one_full_profile_in_lower_case() -> None:
    assert dump_yaml([qos_profile(Qos("reliable", 1000, "transient_local"))]) == QOS


def test_metadata_file_word_for_word(tmp_path: Path) -> None:
    profiles = dump_yaml([qos_profile(Qos("reliable", 1000, "transient_local"))])
    topics = [
        BagChannel("/a", "a_msgs/msg/A", "RIHS01_1", profiles, message_count=3),
        BagChannel("/b", "a_msgs/msg/A", "RIHS01_1", profiles),
    ]
    files = [FileRecord("x.mcap", 5, 12, 3)]
    write_metadata(tmp_path, bag_metadata(topics, files=files, custom_data={"key": "no: thing"}))
    qos = QOS.replace("\n", "\n      ").rstrip()

    def topic(name: str, count: int) -> str:
        return f"""\
  - topic_metadata:
      name: {name}
      type: a_msgs/msg/A
      serialization_format: cdr
      offered_qos_profiles:
      {qos}
      type_description_hash: RIHS01_1
    message_count: {count}
"""

    assert (tmp_path / "metadata.yaml").read_text(encoding="utf-8") == (
        f"""\
rosbag2_bagfile_information:
  version: 9
  storage_identifier: mcap
  duration:
    nanoseconds: 7
  starting_time:
    nanoseconds_since_epoch: 5
  message_count: 3
  topics_with_message_count:
{topic("/a", 3)}{topic("/b", 0)}  compression_format: ''
  compression_mode: ''
  relative_file_paths:
  - x.mcap
  files:
  - path: x.mcap
    starting_time:
      nanoseconds_since_epoch: 5
    duration:
      nanoseconds: 7
    message_count: 3
  custom_data:
    key: 'no: thing'
  ros_distro: jazzy
"""
    )
    assert [path.name for path in tmp_path.iterdir()] == ["metadata.yaml"]


def test_long_text_stays_on_one_line() -> None:
    text = "why " * 200
    assert dump_yaml({"reason": text}).count("\n") == 1


def test_line_breaks_and_terminal_codes_are_escaped() -> None:
    text = "two\nlines \x1b[31m"
    dumped = dump_yaml({"reason": text})
    assert "\x1b" not in dumped
    assert yaml.safe_load(dumped) == {"reason": text}


def test_failed_write_leaves_the_older_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_metadata(tmp_path, {"version": 9})
    before = (tmp_path / "metadata.yaml").read_text(encoding="utf-8")

    def refuse(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", refuse)
    with pytest.raises(OSError, match="No space left"):
        write_metadata(tmp_path, {"version": 10})
    assert [path.name for path in tmp_path.iterdir()] == ["metadata.yaml"]
    assert (tmp_path / "metadata.yaml").read_text(encoding="utf-8") == before
