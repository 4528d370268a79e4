"""Node ``abstraction_observer``: the robots' states in, abstract and auxiliary state of the swarm out."""

from __future__ import annotations

import sys

from swarmabs_core.behaviours import Observer, ObserverConfig
from swarmabs_core.messages import ABSTRACT_STATE, AGENT_STATE, AUXILIARY_STATE, EVENTS, Messages
from swarmabs_core.parameters import Parameter
from swarmabs_ros.qos import requested
from swarmabs_ros.runner import GRAVITY, MEMBERS, SCHEDULE, NodeSpec, Settings, run_node
from swarmabs_ros.status import StatusChannel

PARAMETERS = (
    MEMBERS,
    SCHEDULE,
    GRAVITY,
    Parameter("ksd", 1.0, "damping that the double integrators' law adds, N s/m", minimum=0.0),
    Parameter("on_stall", "fail", "what becomes of a robot that does not answer", choices=("fail", "drop")),
)


def config(settings: Settings) -> ObserverConfig:
    """Return the behaviour's configuration."""
    return ObserverConfig(
        members=settings.integers("members"),
        period_ns=settings.integer("period_ns"),
        gravity=settings.number("gravity"),
        ksd=settings.number("ksd"),
        schedule=settings.schedule(),
        last_step=settings.last_step(),
    )


def make(settings: Settings, status: StatusChannel) -> NodeSpec:  # noqa: ARG001 - this node has nothing to report
    """Return behaviour and endpoints."""
    observer = Observer(config(settings))

    def drop() -> Messages:
        return observer.drop(observer.missing_agents(), "silent")

    return NodeSpec(
        observer,
        (EVENTS, ABSTRACT_STATE, AUXILIARY_STATE),
        {AGENT_STATE: requested(AGENT_STATE, depth=max(100, 4 * len(settings.integers("members"))))},
        on_stall=drop if settings.text("on_stall") == "drop" else None,
    )


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node("abstraction_observer", PARAMETERS, make, args)


if __name__ == "__main__":
    sys.exit(main())
