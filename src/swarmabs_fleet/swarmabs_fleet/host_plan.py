"""One host of a fleet: its nodes, the names and locations of its files, and the templates that generate them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from swarmabs_config.fleet.participants import NodePlan, nodes_on, operator_hosts
from swarmabs_core.realtime.instruments import TopicSettings
from swarmabs_run.rendering import templates

if TYPE_CHECKING:
    from swarmabs_config.fleet.model import Fleet

PUBLIC_KEYS = "keystore/seals.txt"
"""The file of a bundle with the public keys of robots and plane, in a fleet whose states are signed."""


@dataclass(frozen=True)
class HostPlan:
    """One host of a fleet as set up by its bundle."""

    fleet: Fleet
    name: str

    @cached_property
    def nodes(self) -> tuple[NodePlan, ...]:
        """The nodes that run on the host."""
        return nodes_on(self.fleet, self.name)

    @cached_property
    def roles(self) -> tuple[str, ...]:
        """The names of the DDS profiles that it needs: for its nodes, for drivers and for operator tools."""
        roles = {str(node.role) for node in self.nodes}
        parts = self.fleet.coordinators
        if any(node.robot and isinstance(node.robot.drive, TopicSettings) for node in self.nodes):
            roles.add("driver")
        if parts.plane.type == "driver" and parts.plane.host == self.name:
            roles.add("driver")
        if self.name in operator_hosts(self.fleet):
            roles.add("operator")
        return tuple(sorted(roles))

    @property
    def address(self) -> str:
        """The address that DDS uses for it."""
        return self.fleet.address(self.name)

    @property
    def installed(self) -> str:
        """The folder of the installed bundle."""
        return f"{self.fleet.installation.prefix}/{self.fleet.name}"

    @property
    def service(self) -> str:
        """The prefix of all unit names, and the name of the nodes' state folder in ``/var/lib``."""
        return f"swarmabs-{self.fleet.name}"

    @property
    def state(self) -> str:
        """The folder that nodes write to."""
        return f"/var/lib/{self.service}"

    @property
    def target(self) -> str:
        """The name of the unit that starts and stops all nodes."""
        return f"{self.service}.target"

    @property
    def python(self) -> str:
        """The Python interpreter that runs the nodes."""
        wheels = self.fleet.ros(self.name) == "wheels"
        return f"{self.fleet.installation.checkout}/.venv/bin/python" if wheels else "/usr/bin/python3"

    @property
    def tunnel_heading(self) -> str:
        """The first line of a tunnel configuration, by which the scripts recognise files of this fleet."""
        return f"# swarmabs fleet {self.fleet.name}"

    def tools(self, role: str) -> str:
        """Return the name of the security enclave of the tools of a role, ``operator`` or ``driver``."""
        return f"{role}_{self.name.replace('-', '_')}"

    @property
    def keystore(self) -> str:
        """The folder of the certificates, with the keys of nodes below."""
        return f"{self.installed}/keystore"

    def enclave(self, name: str) -> str:
        """Return the security enclave of a node or of tools."""
        return f"/{self.fleet.name}/{name}"

    def render(self, template: str, **values: object) -> str:
        """Return the text of a template, such as ``restart.sh``, for this host; XML is escaped.

        Raises
        ------
        jinja2.UndefinedError
            If the template uses a value that is not given.
        """
        return templates("swarmabs_fleet").get_template(f"{template}.j2").render(values, host=self, fleet=self.fleet)
