"""Messages of the page from what is shown of a swarm: the same, live and from a bag."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from swarmabs_bag.swarm_state import Abstract, Instant, finite
from swarmabs_core.messages import EventKind, Kind
from swarmabs_view.protocol import Curves, Event, Frame, Robot, RobotStates

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from swarmabs_bag.swarm_state import RobotIdentity, ShownRobot, TimedEvent

_SHARED = tuple(name for name in Instant._fields if name in Frame.model_fields)
"""What a frame has of an instant, by the same names: all but its stamp."""
_KINDS = {kind.value: kind.name for kind in EventKind}


def frame_of(instant: Instant, robots: Sequence[ShownRobot], step_rate: float | None) -> Frame:
    """Return a step of the swarm, with its robots in the order of the hello.

    Parameters
    ----------
    instant : Instant
        What is shown of the whole swarm.
    robots : sequence of ShownRobot
        What is shown of each robot in that step.
    step_rate : float, optional
        Steps per second of wall time.
    """
    return Frame(
        robots=RobotStates(
            position=[robot.position for robot in robots],
            velocity=[robot.velocity for robot in robots],
            command=[robot.command for robot in robots],
            status=[robot.status for robot in robots],
        ),
        step_rate=step_rate,
        **{name: _plain(getattr(instant, name)) for name in _SHARED},
    )


def curves_of(instants: Sequence[Instant], *, replace: bool) -> Curves:
    """Return steps as points of the curves."""
    return Curves(
        replace=replace,
        time=[instant.time for instant in instants],
        angle=[instant.angle for instant in instants],
        reference=[instant.reference for instant in instants],
        torque=[instant.abstract.torque for instant in instants],
        desired_torque=[instant.desired.torque for instant in instants],
        inertia=[instant.abstract.inertia for instant in instants],
        desired_inertia=[instant.desired.inertia for instant in instants],
    )


def events_of(happened: Iterable[TimedEvent]) -> list[Event]:
    """Return events as the page shows them."""
    return [
        Event(
            step=event.step,
            time=time,
            agent=event.agent_id,
            kind=_KINDS.get(event.kind, str(event.kind)),
            value=finite(event.value),
            detail=event.detail,
        )
        for event, time in happened
    ]


def robots_of(identities: Iterable[RobotIdentity]) -> list[Robot]:
    """Return what does not change of robots."""
    return [
        Robot(
            id=robot.id,
            kind="double_integrator" if robot.kind is Kind.DOUBLE_INTEGRATOR else "single_integrator",
            mass=robot.mass,
            damping=robot.damping,
            joins=robot.joins,
        )
        for robot in identities
    ]


def _plain(value: Any) -> Any:
    """Return an abstract state by the names of its numbers, and anything else as it is."""
    return value._asdict() if isinstance(value, Abstract) else value
