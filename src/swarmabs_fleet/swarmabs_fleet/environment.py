"""Environment files of the nodes, which systemd and a shell read alike."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from swarmabs_config.fleet.participants import DRIVERS, OPERATOR
from swarmabs_fleet.places import Places, enclave
from swarmabs_run.orchestration.dds_environment import PARTICIPANT_VARIABLE, dds_environment

if TYPE_CHECKING:
    from collections.abc import Mapping

    from swarmabs_config.fleet.model import Fleet
    from swarmabs_config.fleet.participants import NodePlan

_PLAIN = re.compile(r"[A-Za-z0-9_./:-]+")


def environment_file(variables: Mapping[str, str]) -> str:
    """Return the text of an environment file; no value needs quotes.

    Raises
    ------
    ValueError
        If one would: what a fleet file may hold has been checked, so this is a mistake of the program.
    """
    for name, value in variables.items():
        if not _PLAIN.fullmatch(value):
            raise ValueError(f"{name}={value!r} needs quotes")
    return "".join(f"{name}={value}\n" for name, value in variables.items())


def node_environment(fleet: Fleet, node: NodePlan) -> dict[str, str]:
    """Return the environment of a node beyond that of the workspace."""
    own = _environment(fleet, node.host, node.role, node.participant)
    return own | {
        "OPENBLAS_NUM_THREADS": "1",
        "PYTHONNOUSERSITE": "1",
        "PYTHONSAFEPATH": "1",
        "PYTHONUNBUFFERED": "1",
    }


def tool_environment(fleet: Fleet, host: str, role: str) -> dict[str, str]:
    """Return the environment of tools of a role, ``operator`` or ``driver``, on a host."""
    number = OPERATOR if role == "operator" else DRIVERS[0]
    variables = _environment(fleet, host, role, number)
    if "ROS_SECURITY_KEYSTORE" in variables:
        variables["ROS_SECURITY_ENCLAVE_OVERRIDE"] = enclave(fleet, tool_enclave(role, host))
    return variables


def tool_enclave(role: str, host: str) -> str:
    """Return the name of the enclave of a host's tools of a role."""
    return f"{role}_{host.replace('-', '_')}"


def _environment(fleet: Fleet, host: str, role: str, participant: int) -> dict[str, str]:
    installed = Places.of(fleet, host).installed
    variables = dds_environment(fleet.network.domain, f"{installed}/dds/{role}.xml")
    variables[PARTICIPANT_VARIABLE] = str(participant)
    if fleet.security.level == "sros2":
        variables |= {
            "ROS_SECURITY_ENABLE": "true",
            "ROS_SECURITY_STRATEGY": "Enforce",
            "ROS_SECURITY_KEYSTORE": f"{installed}/keystore",
        }
    return variables
