"""The common ``main`` of all nodes in lockstep: parameters, endpoints, start signal, loop, exit code."""

from __future__ import annotations

import signal
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

from swarmabs_config.graph import LOCKSTEP, Endpoints, endpoints, options_of
from swarmabs_core.declaration import DeclarationT, made_of, parameters_of
from swarmabs_core.errors import InputError, RunError
from swarmabs_core.parameters import SettingError
from swarmabs_ros.endpoints import Receiver, advertise
from swarmabs_ros.lockstep import INTERRUPTED, SLICE, Lockstep
from swarmabs_ros.parameters import declare_values, read
from swarmabs_ros.settings import LockstepSettings
from swarmabs_ros.start import SwarmNode, run_program

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping

    from rclpy.node import Node
    from rclpy.publisher import Publisher

    from swarmabs_config.graph import Driver, Option
    from swarmabs_core.messages import Topic
    from swarmabs_core.parameters import Parameter, Value
    from swarmabs_ros.lockstep import NodeSpec
    from swarmabs_ros.parameters import BySystem, Table
    from swarmabs_ros.status import StatusChannel


COMMON = parameters_of(LockstepSettings)
"""Parameters that every node in lockstep has."""


class Settings:
    """Checked parameter values, read as declarations, and the namespace of the node and the swarm."""

    def __init__(self, values: Mapping[str, Value], namespace: str = "/") -> None:
        self._values = values
        self.namespace = namespace

    def changed(self, values: Mapping[str, Value]) -> Settings:
        """Return these settings with other values of some parameters."""
        return Settings({**self._values, **values}, self.namespace)

    def chosen(self, declarations: BySystem[DeclarationT]) -> DeclarationT:
        """Return the declaration for the parent system with these values; errors as for `declared`."""
        return self.declared(declarations.chosen(self._values))

    def declared(self, declaration: type[DeclarationT]) -> DeclarationT:
        """Return a declaration with these values; raises `InputError` if they contradict each other."""
        try:
            return made_of(declaration, self._values)
        except SettingError as error:
            raise InputError(f"parameter {error}") from error

    def endpoints(
        self,
        node: str,
        driver: Driver,
        *also: Option,
        robots: int | None = None,
        members: Collection[int] | None = None,
        neighbours: Collection[int] = (),
    ) -> Endpoints:
        """Return the publications and subscriptions of a node with these parameters, by its name in the graph.

        The options `also` apply in addition to those from the parameters. `robots` is the number of robots that ever
        take part, by default that of the members. These are by default those in the parameters, or the robot itself.
        `neighbours` are the robots whose relays it reads.
        """
        if members is None:
            own = self._values.get("agent_id")
            members = cast("tuple[int, ...]", self._values.get("members", () if own is None else (own,)))
        count = len(members) if robots is None else robots
        options = options_of(self._values) | {*also}
        return endpoints(node, driver, options, robots=count, members=members, neighbours=neighbours)


def declared_settings(node: Node, own: Table, common: tuple[Parameter, ...] = ()) -> Settings:
    """Return the settings of a node, whose parameters it declares; errors and tables are those of `read`."""
    table, values = read(node, common, own)
    declare_values(node, table, values)
    return Settings(values, node.get_namespace())


@dataclass(frozen=True, slots=True)
class LockstepProgram:
    """The program of a node in lockstep.

    Parameters
    ----------
    name : str
        Its name in the graph, and its node name unless remapped.
    parameters : Table
        Its parameters beyond the common ones.
    make : callable
        Creates behaviour and endpoints from the parameters.
    """

    name: str
    parameters: Table
    make: Callable[[Settings, StatusChannel], NodeSpec]

    def __call__(self, args: list[str] | None = None) -> int:
        """Run until told to stop (SIGINT, SIGTERM); return the exit code of `run_program`."""
        return run_program(self.name, SwarmNode, self._run, args)

    def _run(self, node: Node, status: StatusChannel) -> None:
        settings = declared_settings(node, self.parameters, COMMON)
        _run(self.name, node, settings, self.make(settings, status), status)


def _run(role: str, node: Node, settings: Settings, spec: NodeSpec, status: StatusChannel) -> None:
    ends, common = spec.endpoints or settings.endpoints(role, LOCKSTEP), settings.declared(LockstepSettings)
    publishers = {topic: advertise(node, topic) for topic in ends.publications}
    inbox = Receiver(node, ends.subscriptions)
    loop = Lockstep(
        spec,
        inbox,
        publishers,
        status,
        topics=tuple(ends.subscriptions),
        stall_timeout=common.stall_timeout,
        repeat_after=common.repeat_after,
        repeat_steps=common.repeat_steps,
    )
    stopped = interrupted = False

    def stop(number: int, *_: object) -> None:
        nonlocal stopped, interrupted
        stopped, interrupted = True, number == signal.SIGINT
        loop.stop()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    problem: str | None = "the node failed"
    try:
        expected = expected_counterparts(common.match, (*ends.publications, *ends.subscriptions))
        begun = time.monotonic()
        for seconds in meeting(expected, publishers, inbox, lambda: time.monotonic() - begun):
            time.sleep(seconds)
            if stopped:
                break
        else:
            node.get_logger().info(f"ready: {sum(expected.values())} counterparts of {len(expected)} endpoints met")
            status.send("ready")
        while not stopped and not status.wait_for_start(SLICE):
            pass
        loop.run()
        problem = INTERRUPTED if interrupted else None
    except RunError as error:
        problem = str(error)
        raise
    finally:
        spec.on_exit(problem)


def meeting(
    expected: Mapping[Topic, int], publishers: Mapping[Topic, Publisher], inbox: Receiver, waited: Callable[[], float]
) -> Iterator[float]:
    """Yield the times, s, until the next look for counterparts, until a node has met them; it has `waited` so long, s.

    They are short where counterparts soon appear, and grow in large swarms, where hundreds of looking nodes delay each
    other.
    """
    while not _matched(expected, publishers, inbox):
        yield min(max(SLICE / 20.0, waited() / 10.0), SLICE)


def expected_counterparts(match: Iterable[str], used: Iterable[Topic]) -> dict[Topic, int]:
    """Return the number of counterparts by topic, among those that the node uses, from the values of the parameter.

    Raises
    ------
    InputError
        If a value is not a topic of the node with a number.
    """
    topics = {topic.name: topic for topic in used}
    expected = {}
    for text in match:
        try:
            name, number = text.split()
            expected[topics[name]] = int(number)
        except (ValueError, KeyError):
            raise InputError(f"parameter match: {text!r} is not 'TOPIC NUMBER' with a topic of this node") from None
    return expected


def _matched(expected: Mapping[Topic, int], publishers: Mapping[Topic, Publisher], inbox: Receiver) -> bool:
    """Return whether every endpoint has matched the required number of counterparts."""
    return all(
        (publishers[topic].get_subscription_count() if topic in publishers else inbox.publisher_count(topic)) >= number
        for topic, number in expected.items()
    )
