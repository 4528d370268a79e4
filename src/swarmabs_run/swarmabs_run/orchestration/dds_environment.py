"""What puts a process into a run's network: a profile, a participant id and a multicast group, by the environment."""

from __future__ import annotations

from swarmabs_config.graph import CONTROLLER, COORDINATORS, NODES

PARTICIPANT_VARIABLE = "SWARMABS_PARTICIPANT"
"""Environment variable that holds a process's participant id: one profile serves all processes of a run."""
GROUP_VARIABLE = "SWARMABS_GROUP"
"""Environment variable that holds the address of a process's multicast group."""
ROBOTS_GROUP, _CONTROLLER_GROUP, _GATHERERS_GROUP = "239.255.83.1", "239.255.83.2", "239.255.83.3"


def multicast_group(participant: int) -> str:
    """Return the address of the group to which a participant listens."""
    if participant >= COORDINATORS:
        return ROBOTS_GROUP
    # The parent controller is the one coordinator that does not hear the robots.
    return _CONTROLLER_GROUP if participant == NODES[CONTROLLER].participant else _GATHERERS_GROUP


def dds_environment(domain: int, profile_path: str) -> dict[str, str]:
    """Return the environment variables that put a process into a run's domain."""
    return {
        "ROS_DOMAIN_ID": str(domain),
        # LOCALHOST and SUBNET would make the middleware add transports of its own to those of the profile.
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT",
        "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp",
        "RMW_FASTRTPS_PUBLICATION_MODE": "SYNCHRONOUS",
        "FASTRTPS_DEFAULT_PROFILES_FILE": profile_path,
        "FASTDDS_DEFAULT_PROFILES_FILE": profile_path,
    }
