"""Node ``abstraction_observer``: the robots' states in, abstract and auxiliary state of the swarm out."""

from __future__ import annotations

import sys

from swarmabs_config.graph import OBSERVER
from swarmabs_core.behaviours import Observer, ObserverConfig, Steered
from swarmabs_core.friction import Friction
from swarmabs_core.membership import SILENT
from swarmabs_core.messages import Messages
from swarmabs_core.parameters import Parameter
from swarmabs_core.parent_response import ParentModel
from swarmabs_ros.runner import GRAVITY, MEMBERS, SCHEDULE, STEERED, NodeSpec, Settings, run_node
from swarmabs_ros.status import StatusChannel

PARAMETERS = (
    MEMBERS,
    SCHEDULE,
    GRAVITY,
    Parameter("ksd", 1.0, "damping that the double integrators' law adds, N s/m", minimum=0.0),
    Parameter(
        "type",
        "sum",
        "where the torque comes from: the sum over the robots, or the plane's motion",
        choices=("sum", "parent_response"),
    ),
    Parameter("inertia", 0.5, "parent_response: moment of inertia of the plane alone, kg m^2", above=0.0),
    Parameter(
        "friction",
        (0.01, 1000.0, 700.0, 0.02, 1000.0, 1.0),
        "parent_response: g1 to g6 of the bearing's friction: g1, g4 in N m, g2, g3, g5 in s/rad, g6 in N m s/rad",
        minimum=0.0,
        length=6,
    ),
    Parameter("bandwidth", 50.0, "parent_response: bandwidth of the torque's filter, rad/s", above=0.0),
    Parameter("on_stall", "fail", "what becomes of a robot that does not answer", choices=("fail", "drop")),
    STEERED,
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


def model(settings: Settings) -> ParentModel | None:
    """Return what the observer knows of the plane, if it is to watch it."""
    if settings.text("type") == "sum":
        return None
    friction = Friction(*settings.numbers("friction"))
    return ParentModel(settings.number("inertia"), friction, settings.number("bandwidth"))


def make(settings: Settings, status: StatusChannel) -> NodeSpec:  # noqa: ARG001 - this node has nothing to report
    """Return the behaviour, and what it answers to a stall."""
    observer = Observer(config(settings), model(settings))
    gate = Steered(observer) if settings.flag(STEERED.name) else None

    def drop() -> Messages:
        if gate is not None and not gate.open:  # it is not the robots who are waited for
            return ()
        silent = observer.silent_agents()
        return observer.drop(silent, SILENT) if silent else ()

    return NodeSpec(gate or observer, on_stall=drop if settings.text("on_stall") == "drop" else None)


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(OBSERVER, PARAMETERS, make, args)


if __name__ == "__main__":
    sys.exit(main())
