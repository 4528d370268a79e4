"""The quality of service that a bag's publishers offered, as rclpy's profile."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rclpy.duration import Duration
from rclpy.qos import (
    QoSDurabilityPolicy,
    QoSHistoryPolicy,
    QoSLivelinessPolicy,
    QoSProfile,
    QoSReliabilityPolicy,
)

from swarmabs_bag.metadata import load_yaml

if TYPE_CHECKING:
    from collections.abc import Mapping

_POLICIES = {
    "history": QoSHistoryPolicy,
    "reliability": QoSReliabilityPolicy,
    "durability": QoSDurabilityPolicy,
    "liveliness": QoSLivelinessPolicy,
}
_DURATIONS = ("deadline", "lifespan", "liveliness_lease_duration")
_OFFERABLE = ("system_default", "keep_last", "keep_all", "reliable", "best_effort", "transient_local", "volatile")
_OFFERABLE_LIVELINESS = ("automatic", "manual_by_topic")
_INFINITE = 2**63 - 1
_USUAL_DEPTH = 10


def recorded_profiles(text: str) -> list[QoSProfile]:
    """Return the profiles of a channel's ``offered_qos_profiles``, each different one once.

    Policies that no publisher can offer, or that are not understood, are left as ROS 2 has them by default.

    Parameters
    ----------
    text : str
        YAML as rosbag2 writes it: policies by name, or, in bags of older versions, by number.
    """
    found = load_yaml(text)
    listed = found if isinstance(found, list) else []
    profiles: list[QoSProfile] = []
    for entry in listed:
        if isinstance(entry, dict):
            made = _profile(entry)
            if made not in profiles:
                profiles.append(made)
    return profiles


def _profile(entry: Mapping[str, Any]) -> QoSProfile:
    depth = entry.get("depth")
    arguments: dict[str, Any] = {
        "history": QoSHistoryPolicy.KEEP_LAST,
        "depth": depth if isinstance(depth, int) and 0 < depth < 2**31 else _USUAL_DEPTH,
    }
    for name, policies in _POLICIES.items():
        policy = _policy(policies, entry.get(name))
        if policy is not None:
            arguments[name] = policy
    for name in _DURATIONS:
        duration = _duration(entry.get(name))
        if duration is not None:
            arguments[name] = duration
    return QoSProfile(**arguments)


def _policy(policies: Any, value: object) -> Any:
    """Return the policy of a name or number, None if no publisher can offer it."""
    offerable = _OFFERABLE_LIVELINESS if policies is QoSLivelinessPolicy else _OFFERABLE
    for policy in policies:
        if policy.short_key in offerable and value in (policy.short_key, int(policy)) and not isinstance(value, bool):
            return policy
    return None


def _duration(value: object) -> Duration | None:
    """Return a finite duration, None for one that is not there, infinite or not understood."""
    if not isinstance(value, dict):
        return None
    seconds, nanoseconds = value.get("sec"), value.get("nsec")
    if not isinstance(seconds, int) or not isinstance(nanoseconds, int):
        return None
    total = seconds * 10**9 + nanoseconds
    return Duration(nanoseconds=total) if 0 < total < _INFINITE else None
