"""Node ``parent_controller`` in real time: it answers each state of the plane, and lets an operator stop the swarm."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from parent_controller.node import PARAMETERS as LOCKSTEP, law_of, manifold_of, with_law
from swarmabs_config.graph import CONTROLLER, SERVICES
from swarmabs_core.messages import PLANE_STATE, Mode
from swarmabs_core.parameters import Parameter
from swarmabs_core.realtime.base import CONTROLLER_PHASE
from swarmabs_core.realtime.controller import RealtimeController, RealtimeControllerConfig
from swarmabs_core.realtime.plausibility import Bounds
from swarmabs_ros.managed import RealtimeNode, RealtimeSpec
from swarmabs_ros.realtime_runner import choose, run_realtime, schedule_of
from swarmabs_ros.runner import GRAVITY

if TYPE_CHECKING:
    from swarmabs_ros.runner import Settings

_MODES = {"run": Mode.RUN, "stop": Mode.STOP}
PARAMETERS = (
    *choose(LOCKSTEP, "plane.inertia", "plane.friction"),
    *choose(LOCKSTEP, "manifold.curvature", "manifold.offset", "manifold.torque_max"),
    GRAVITY,
    Parameter("plane_length", 1.0, "length of the plane, m", above=0.0),
    Parameter("plane_age_limit", 0.1, "age of the plane's state from which on nothing is asked for, s", above=0.0),
    Parameter(
        "start_mode",
        "run",
        "run: the swarm moves as soon as it is there; stop: it waits for a reset",
        choices=tuple(_MODES),
    ),
)


def table(node: RealtimeNode) -> tuple[Parameter, ...]:
    """Return the node's parameters, among them those of the law that is asked for."""
    return with_law(node, PARAMETERS)


def make(settings: Settings, node: RealtimeNode) -> RealtimeSpec:  # noqa: ARG001 - it needs no more of its node
    """Return the behaviour."""
    config = RealtimeControllerConfig(
        schedule=schedule_of(settings),
        bounds=Bounds(settings.number("gravity"), settings.number("plane_length")),
        manifold=manifold_of(settings),
        start_mode=_MODES[settings.text("start_mode")],
        plane_age_limit=settings.number("plane_age_limit"),
        clock_tolerance=settings.number("clock_tolerance"),
    )
    controller = RealtimeController(config, lambda: law_of(settings))
    return RealtimeSpec(
        controller,
        CONTROLLER_PHASE,
        wakes=(PLANE_STATE,),
        services=dict(zip(SERVICES[CONTROLLER], (controller.stop, controller.reset), strict=True)),
    )


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_realtime(CONTROLLER, table, make, args)


if __name__ == "__main__":
    sys.exit(main())
