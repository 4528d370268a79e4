"""An observer that takes the swarm's torque from the plane's response and not from the robots."""

from __future__ import annotations

from swarmabs_core.behaviours.base import StepAheadError, refuse_conflict
from swarmabs_core.behaviours.observer import Observer, ObserverConfig
from swarmabs_core.messages import AGENT_STATE, PLANE_STATE, Message, Messages, PlaneState, Topic
from swarmabs_core.parent_response import ParentModel, TorqueEstimator


class ParentResponseObserver(Observer):
    """Estimates the torque; inertia, sums and membership are those of the robots, whom it hears all the same.

    Parameters
    ----------
    config : ObserverConfig
        Configuration of the observer.
    model : ParentModel
        The plane.
    """

    def __init__(self, config: ObserverConfig, model: ParentModel) -> None:
        super().__init__(config)
        self._estimator = TorqueEstimator(model, config.period_ns / 1e9)
        self._plane: PlaneState | None = None
        self._announced = -1

    def handle(self, message: Message) -> Messages:
        """Take a robot's state or the plane's; with the last one of a step answer as every observer."""
        if not isinstance(message, PlaneState):
            return super().handle(message)
        if message.step > self._gathering.step:
            raise StepAheadError("plane", got=message.step, expected=self._gathering.step)
        if message.step == self._gathering.step:
            if self._plane is not None:
                refuse_conflict(self._plane, message, PLANE_STATE.name)
            self._plane = message
        return self._proceed()

    def awaits(self) -> tuple[Topic, ...]:
        """Wait for robots' states and the plane's."""
        return (AGENT_STATE, PLANE_STATE) if super().awaits() else ()

    def missing(self) -> tuple[int, tuple[str, ...]]:
        """Return the current step, and the robots not yet heard, or else the plane."""
        step, robots = super().missing()
        return step, robots or ("plane_sim",)

    def _proceed(self) -> Messages:
        """Say at once who is no member any more, since the plane may wait for it; sum up with the plane's state."""
        if not self._complete():
            return ()
        events: Messages = ()
        if self._announced < self._gathering.step:
            self._announced = self._gathering.step
            events = self._announce()
        plane, self._plane = self._plane, None
        if plane is None:
            return events
        summed, sums = self._sum_up()
        torque, rate = self._estimator.update(plane.angle, plane.angular_velocity, summed.inertia)
        return (*events, summed._replace(torque=torque, torque_rate=rate), sums)


def make_observer(config: ObserverConfig, model: ParentModel | None) -> Observer:
    """Return the observer that sums up the robots, or, with a model of the plane, the one that watches it."""
    return Observer(config) if model is None else ParentResponseObserver(config, model)
