"""Definitions and hashes of message types, found among the installed packages."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from swarmabs_bag.errors import UnknownTypeError
from swarmabs_bag.schemas import message_schema
from swarmabs_core.messages import TOPICS


def install(prefix: Path, ros_type: str, text: str, nested: tuple[str, ...] = (), type_hash: str = "RIHS01_aa") -> None:
    package, _, short = ros_type.split("/")
    folder = prefix / "share" / package / "msg"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{short}.msg").write_text(text, encoding="utf-8")
    description = {
        "type_description_msg": {
            "type_description": {"type_name": ros_type},
            "referenced_type_descriptions": [{"type_name": name} for name in nested],
        },
        "type_hashes": [{"type_name": ros_type, "hash_string": type_hash}],
    }
    (folder / f"{short}.json").write_text(json.dumps(description), encoding="utf-8")


def test_text_is_the_definition_and_behind_it_every_nested_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    install(
        tmp_path,
        "a_msgs/msg/Outer",
        "b_msgs/Inner inner  # größe\nDeep deep\n",
        ("b_msgs/msg/Inner", "a_msgs/msg/Deep"),
    )
    install(tmp_path, "a_msgs/msg/Deep", "uint8 x\n")
    install(tmp_path, "b_msgs/msg/Inner", "a_msgs/Deep[] deeps\n", ("a_msgs/msg/Deep",))
    schema = message_schema("a_msgs/msg/Outer")
    line = "=" * 80
    assert schema.text == (
        "b_msgs/Inner inner  # größe\nDeep deep\n"
        f"\n{line}\nMSG: a_msgs/Deep\nuint8 x\n"
        f"\n{line}\nMSG: b_msgs/Inner\na_msgs/Deep[] deeps\n"
    )
    assert (schema.name, schema.type_hash) == ("a_msgs/msg/Outer", "RIHS01_aa")


def test_first_prefix_wins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("over", "under"):
        install(tmp_path / name, "a_msgs/msg/One", f"# {name}\n", type_hash=f"RIHS01_{name}")
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.pathsep.join(["", str(tmp_path / "over"), str(tmp_path / "under")]))
    assert message_schema("a_msgs/msg/One").type_hash == "RIHS01_over"


@pytest.mark.parametrize("ros_type", [*(topic.ros_type for topic in TOPICS), "sensor_msgs/msg/JointState"])
def test_hash_is_that_of_the_definition(ros_type: str) -> None:
    schema = message_schema(ros_type)
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(schema.text, ros_type))
    assert store.hash_rihs01(ros_type) == schema.type_hash


def test_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    with pytest.raises(UnknownTypeError, match="build or install the package nowhere_msgs") as caught:
        message_schema("nowhere_msgs/msg/Thing")
    assert str(tmp_path) in str(caught.value)


def test_missing_nested_type_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    install(tmp_path, "a_msgs/msg/Outer", "b_msgs/Inner inner\n", ("b_msgs/msg/Inner",))
    with pytest.raises(UnknownTypeError, match=r"message type b_msgs/msg/Inner: .* the package b_msgs"):
        message_schema("a_msgs/msg/Outer")


@pytest.mark.parametrize("name", ["Header", "std_msgs/Header", "std_msgs/srv/Header", "../msg/Header", "a/msg/B/C", ""])
def test_what_is_no_type_name_is_refused(name: str) -> None:
    with pytest.raises(UnknownTypeError, match="is not the full name of a message type"):
        message_schema(name)


@pytest.mark.parametrize("description", ["", "[]", "{}", '{"type_description_msg": 1}', '{"type_hashes": []}'])
def test_description_that_is_damaged_is_named(
    description: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    install(tmp_path, "a_msgs/msg/One", "uint8 x\n")
    (tmp_path / "share/a_msgs/msg/One.json").write_text(description, encoding="utf-8")
    with pytest.raises(UnknownTypeError, match="its type description is"):
        message_schema("a_msgs/msg/One")
