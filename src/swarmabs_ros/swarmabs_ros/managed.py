"""The ROS interface of a node in real time: lifecycle, parameters, an operator's services, diagnostics.

The thread that starts the node executes the steps. A second thread serves ROS; delays there do no harm, and it passes
requests for the behaviour to the first thread.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.publisher import Publisher
from rclpy.service import Service
from rclpy.subscription import Subscription
from std_srvs.srv import Trigger

from swarmabs_config.graph import DIAGNOSTICS, REALTIME, usual_topic
from swarmabs_core.errors import RunError, SwarmabsError
from swarmabs_core.realtime.base import Health, Level, Schedule
from swarmabs_ros.endpoints import LoopGroup, Receiver, advertise
from swarmabs_ros.realtime import IDENTIFIED, Engine, RealtimeLoop, read_clocks
from swarmabs_ros.status import notify
from swarmabs_ros.timing import StepClock

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from lifecycle_msgs.srv import ChangeState
    from rclpy.executors import Executor
    from rclpy.impl.rcutils_logger import RcutilsLogger
    from rclpy.lifecycle import LifecycleState

    from swarmabs_config.graph import Endpoints
    from swarmabs_core.messages import Messages, Topic
    from swarmabs_core.realtime.base import RealtimeBehaviour
    from swarmabs_ros.status import StatusChannel
    from swarmabs_ros.tuning import Tune, Tuning

    ChangeStateCallback = Callable[[ChangeState.Request, ChangeState.Response], ChangeState.Response]
    TriggerCallback = Callable[[Trigger.Request, Trigger.Response], Trigger.Response]

DIAGNOSTICS_PERIOD = 1.0
"""Time between two diagnostics messages, s."""
TOLD_WITHIN = 1.0
"""Time limit, s, of a process that is about to end for each answer and for its last diagnostics."""
SUCCESS, FAILURE, ERROR = (
    TransitionCallbackReturn.SUCCESS,
    TransitionCallbackReturn.FAILURE,
    TransitionCallbackReturn.ERROR,
)


@dataclass(frozen=True, slots=True)
class RealtimeSpec:
    """Specification of a node in real time.

    Parameters
    ----------
    phase : float
        Fraction of the period after which its step is due.
    endpoints : Endpoints, optional
        Its publications and subscriptions, if they do not follow from the graph and its parameters.
    wakes : tuple of Topic
        Topics whose messages are answered at once.
    services : mapping
        An operator's commands (``std_srvs/Trigger``) by name; the callables take the time, ns since 1970.
    settled : callable
        Returns whether the node does its work; may be called by any thread. Until then systemd regards it as starting.
    tune : callable, optional
        Returns a callable that installs the gains of other settings; raises `InputError` if they are invalid.
    """

    behaviour: RealtimeBehaviour
    phase: float
    endpoints: Endpoints | None = None
    wakes: tuple[Topic, ...] = ()
    services: Mapping[str, Callable[[int], Messages]] = field(default_factory=dict)
    settled: Callable[[], bool] = lambda: True
    tune: Tune | None = None


class RealtimeNode(LifecycleNode):
    """A lifecycle node around a `RealtimeLoop`."""

    def __init__(self, name: str) -> None:
        super().__init__(name, automatically_declare_parameters_from_overrides=True)
        self.notes: RcutilsLogger = self.get_logger()  # type: ignore[no-untyped-call]
        # In rclpy a transition request that does not fit the state would end the executor.
        self._service_change_state.callback = self._guarded(self._service_change_state.callback)
        self.failure: Exception | None = None
        """The error that keeps the node from working, None if there is none."""
        self.loop_group = LoopGroup()
        """Callback group of subscriptions that the loop serves itself, such as those of a drive."""
        self._loop: RealtimeLoop
        self._make: Callable[[], RealtimeSpec]
        self._endpoints: Endpoints
        self._schedule: Schedule
        self._status: StatusChannel
        self._tuning: Tuning
        self._executor: Executor
        self._settled: Callable[[], bool]
        self._is_ready = False
        self._clock_of_steps: StepClock | None = None
        self._before: tuple[object, ...] | None = None
        self._diagnostics = self.create_publisher(DiagnosticArray, DIAGNOSTICS, 10)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = self.create_timer(DIAGNOSTICS_PERIOD, self._diagnose, clock=steady)

    def prepare(
        self,
        make: Callable[[], RealtimeSpec],
        endpoints: Endpoints,
        schedule: Schedule,
        loop: RealtimeLoop,
        executor: Executor,
        status: StatusChannel,
        tuning: Tuning,
    ) -> None:
        """Set what configuration creates, and the parts of the process; call this before the executor runs."""
        self._make, self._endpoints, self._schedule = make, endpoints, schedule
        self._loop, self._executor, self._status, self._tuning = loop, executor, status, tuning
        tuning.serve(self, lambda: self.state)

    # Transitions

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Create behaviour and endpoints; if that fails, close what was opened."""
        self.failure = None
        try:
            self._configure()
        except Exception as error:  # noqa: BLE001 - rclpy would swallow it
            return self._refuse("configure", error)
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start executing steps, with the current gains."""
        self.failure = None
        try:
            if (install := self._tuning.taken()) is not None:
                self._loop.call(install)
            self._loop.activate()
        except Exception as error:  # noqa: BLE001 - rclpy would swallow it
            return self._refuse("activate", error)
        self.notes.info("active")
        self._status.send("ready")
        self._is_ready = False
        self._notify_ready()
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Halt and stop publishing; return an error if one is the cause."""
        try:
            self._loop.deactivate()
        except Exception as error:  # noqa: BLE001 - rclpy would swallow it
            self._refuse("halt", error)
        self.notes.info("deactivated: halted and silent")
        notify("STATUS=inactive")
        return ERROR if self.failure is not None else super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Release behaviour and endpoints."""
        return super().on_cleanup(state) if self._release() else ERROR

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Halt, and release behaviour and endpoints."""
        return super().on_shutdown(state) if self._release() else ERROR

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Release behaviour and endpoints, so that the node can be configured again."""
        return super().on_error(state) if self._release() else FAILURE

    # From the loop's thread

    def failed(self, error: Exception) -> None:
        """Record an error of the active behaviour, which has been halted, and leave the active state."""
        self.failure = error
        text = one_line(error)
        self.notes.error(f"halted after an error: {text}")
        self._status.send("failed", reason=text)
        self._executor.create_task(self._leave_active)

    # From the watchdog's thread

    def hung(self) -> None:
        """Report that halting hangs before the process ends; pending requests are answered first."""
        error = RunError(f"{self._loop.hang}; this process ends without stopping the robot's body")
        text = one_line(error)
        self.notes.fatal(text)
        self._status.send("failed", reason=text)
        notify(f"STATUS={text}")
        answered = threading.Event()
        self._executor.create_task(answered.set)
        answered.wait(TOLD_WITHIN)
        self.failure = error
        self._diagnose()
        self._diagnostics.wait_for_all_acked(Duration(seconds=TOLD_WITHIN))

    # From the executor's thread

    def bring_up(self) -> bool:
        """Configure and activate; return whether that was successful."""
        transitions = (self.trigger_configure, self.trigger_activate)
        return all(trigger() == SUCCESS for trigger in transitions)  # type: ignore[no-untyped-call]

    def end(self) -> None:
        """Shut down from any lifecycle state; called by the loop's thread once nothing else runs."""
        if self.state in {"unconfigured", "inactive", "active"}:
            self.trigger_shutdown()  # type: ignore[no-untyped-call]

    def _leave_active(self) -> None:
        if self.failure is not None and self.state == "active":
            self.trigger_deactivate()  # type: ignore[no-untyped-call]

    @property
    def state(self) -> str:
        """Lifecycle state: unconfigured, inactive, active, finalized, or that of a transition."""
        return str(self._state_machine.current_state[1])

    def _entities(self) -> tuple[Service | Subscription | Publisher, ...]:
        return (*self.services, *self.subscriptions, *self.publishers)

    def _configure(self) -> None:
        self._before = self._entities()
        spec = self._make()
        ends = spec.endpoints or self._endpoints
        publishers = {usual_topic(topic): advertise(self, topic, REALTIME) for topic in ends.publications}
        identified = [topic for topic in ends.subscriptions if usual_topic(topic) in IDENTIFIED]
        receiver = Receiver(self, ends.subscriptions, self.loop_group, identified)
        depths = {topic: qos.depth for topic, qos in ends.subscriptions.items()}
        self._clock_of_steps = StepClock(self._schedule, spec.phase)
        self._loop.attach(Engine(spec.behaviour, self._clock_of_steps, receiver, depths, publishers, spec.wakes))
        self._tuning.configured(spec.tune)
        self._settled = spec.settled
        for name, command in spec.services.items():
            self.create_service(Trigger, name, self._operating(command))

    def _release(self) -> bool:
        """Release all that configuration created, including a drive's endpoints; return whether that was successful."""
        try:
            self._loop.attach(None)
        except Exception as error:  # noqa: BLE001 - rclpy would swallow it
            self._refuse("halt", error)
            return False
        self._tuning.configured(None)
        if self._clock_of_steps is not None:
            self._status.send("timing", **self._clock_of_steps.report())
            self._clock_of_steps = None
        before, self._before = self._before, None
        for entity in self._entities():
            if before is None or entity in before:
                continue
            if isinstance(entity, Service):
                self.destroy_service(entity)
            elif isinstance(entity, Subscription):
                self.destroy_subscription(entity)
            else:
                self.destroy_publisher(entity)
        return True

    def _refuse(self, what: str, error: Exception) -> TransitionCallbackReturn:
        self.failure = error
        self.notes.error(f"cannot {what}: {one_line(error)}")
        if what == "configure":
            self._release()
        return FAILURE

    def _operating(self, command: Callable[[int], Messages]) -> TriggerCallback:
        """Return the callback of an operator's service."""

        def operate(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            try:
                self._loop.command(command)
                response.success = True
            except Exception as error:  # noqa: BLE001 - it is reported to the caller
                response.message = f"{self.get_name()}: {one_line(error)}"
            return response

        return operate

    def _guarded(self, callback: ChangeStateCallback) -> ChangeStateCallback:
        """Return a callback that answers with a failure instead of raising an error."""

        def guarded(request: ChangeState.Request, response: ChangeState.Response) -> ChangeState.Response:
            try:
                return callback(request, response)
            except Exception as error:  # noqa: BLE001 - rclpy's class is not public
                self.notes.warning(f"transition rejected in state {self.state}: {one_line(error)}")
                response.success = False
                return response

        return guarded

    def _diagnose(self) -> None:
        self._diagnostics.publish(diagnostic_array(self.get_name(), self.health(), read_clocks().system))
        if self.state == "active" and not self._is_ready:
            self._notify_ready()

    def _notify_ready(self) -> None:
        """Report to systemd that the node is ready, once it has settled: a restart of its unit waits for that."""
        self._is_ready = self._settled()
        notify("READY=1\nSTATUS=active" if self._is_ready else "STATUS=waiting until it leads or stands by")

    def health(self) -> Health:
        """Return the health of the node in any state."""
        try:
            level, text, values = self._loop.health(DIAGNOSTICS_PERIOD / 2.0)
        except Exception as error:  # noqa: BLE001 - it is the health of the node
            level, text, values = Level.ERROR, one_line(error), ()
        state = self.state
        if self.failure is not None:
            level, text = Level.ERROR, f"{state} after an error: {one_line(self.failure)}"
        elif state != "active":
            level, text = max(level, Level.WARN), f"{state}: {text}"
        return Health(level, text, (("state", state), *values))


def one_line(error: Exception) -> str:
    """Return an error in one line, with its class if it is not one of swarmabs."""
    text = " ".join(str(error).split())[:2000]
    return text if isinstance(error, SwarmabsError) else f"{type(error).__name__}: {text}"


def diagnostic_array(node: str, health: Health, now: int) -> DiagnosticArray:
    """Return the diagnostics message of a node in the form that ROS tools expect; `now` in ns since 1970.

    The name of the node also serves as the hardware id, because each robot has its own node.
    """
    status = DiagnosticStatus(
        level=bytes([health.level]),
        name=f"{node}: realtime",
        message=health.text,
        hardware_id=node,
        values=[KeyValue(key=name, value=text) for name, text in health.values],
    )
    array = DiagnosticArray(status=[status])
    array.header.stamp.sec, array.header.stamp.nanosec = divmod(now, 10**9)
    return array
