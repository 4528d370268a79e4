"""Plane, recorder and robots without an observer on a simulated clock; messages are late or lost, robots end."""

from heapq import heappop, heappush
from itertools import count
from random import Random

from swarmabs_config import configure
from swarmabs_config.scenario import Scenario
from swarmabs_core.behaviours import Behaviour, Observer, Patience
from swarmabs_core.cdr import decode, encode
from swarmabs_core.errors import RunError
from swarmabs_core.membership import SILENT
from swarmabs_core.messages import EventKind, Message, Messages, RecordingProgress, Relay, SwarmEvent, topic_of
from swarmabs_core.nodes import NodeKind, NodeName
from swarmabs_run.simulation import Network, behaviour_of, nodes_in_process, peers_in_process

SECONDS = 1.0
"""Silence, s, from which on a robot concludes."""
LATE = 0.02
"""Longest delay of a message, s."""
REPEAT = 0.2
"""Time, s, after which a node that has said nothing repeats what it has said last."""
LOOKS = 0.05
"""Time, s, after which a node looks again at the clock, or whether it is still frozen."""
PLANE, RECORDER = 0, -1


class World:
    """A run in simulated time.

    Attributes
    ----------
    dead : set of int
        Robots that have ended unplanned.
    frozen : set of int
        Robots that do nothing, but hear later what they have missed.
    cut : set of (int, int)
        Pairs of robots of which the second does not hear the first any more.
    stopped : dict
        Robots that have stopped by themselves, and what they said.
    recorded : dict
        What has reached the recorder, by topic.
    """

    def __init__(self, scenario: Scenario, draw: Random, *, loss: float = 0.0, window: bool = False) -> None:
        self.scenario, self.draw, self.loss = scenario, draw, loss
        parent = peers_in_process(scenario)[NodeName(NodeKind.PARENT)]
        self.plane = parent.behaviour
        self.peers = {
            peer.agent_id: peer for peer in configure.peers(scenario, configure.members(scenario), recorded=window)
        }
        self.patience = {robot: Patience(peer, SECONDS) for robot, peer in self.peers.items()}
        self.hears = {PLANE: set(parent.hears)} | {robot: set(peer.needs) for robot, peer in self.peers.items()}
        self.time = 0.0
        self.dead: set[int] = set()
        self.frozen: set[int] = set()
        self.cut: set[tuple[int, int]] = set()
        self.stopped: dict[int, str] = {}
        self.recorded: dict[str, set[bytes]] = {}
        self.said: dict[int, list[Message]] = {}
        self.log: list[tuple[int, Message]] = []
        self.spoke: dict[int, float] = {}
        self.ends: dict[int, int] = {}
        self.arrivals: dict[tuple[int, int], float] = {}
        self.events: list[tuple[float, int, int, Message | None]] = []
        self._numbers = count()

    def end_at(self, robot: int, messages: int) -> None:
        """Let a robot end when it has sent so many messages."""
        self.ends[robot] = messages

    def run(self, until: float) -> None:
        """Run for a time, s."""
        if not self.said:
            for node, behaviour in ((PLANE, self.plane), *self.peers.items()):
                self.said[node], self.spoke[node] = [], 0.0
                self._say(node, behaviour.start())
                self._at(self.draw.random() * LOOKS, node, None)
        until += self.time
        while self.events and self.events[0][0] <= until:
            self.time, _, node, message = heappop(self.events)
            if node in self.dead or node in self.stopped:
                continue
            if node in self.frozen:
                self._at(self.time + LOOKS, node, message)
                continue
            try:
                self._do(node, message)
            except RunError as error:
                if node == PLANE:
                    raise
                self.stopped[node] = str(error)

    def _do(self, node: int, message: Message | None) -> None:
        if message is not None:
            behaviour = self.plane if node == PLANE else self.peers[node]
            if behaviour.awaits():
                self._say(node, behaviour.handle(message))
            return
        if node != PLANE:
            self._say(node, self.patience[node].look(self.time))
        if self.time - self.spoke[node] >= REPEAT:
            newest = self.said[node][-1].step if self.said[node] else 0
            self.said[node] = [said for said in self.said[node] if said.step > newest - 3]
            for said in self.said[node]:
                self._send(node, said)
            self.spoke[node] = self.time
        self._at(self.time + LOOKS, node, None)

    def _say(self, node: int, messages: Messages) -> None:
        for message in messages:
            if self.ends.get(node, 1) <= 0:
                self.dead.add(node)
                return
            if node in self.ends:
                self.ends[node] -= 1
            self.said[node].append(message)
            self.log.append((node, message))
            self.spoke[node] = self.time
            self._send(node, message)

    def _send(self, node: int, message: Message) -> None:
        topic = topic_of(message)
        if not isinstance(message, Relay):
            self.recorded.setdefault(topic.name, set()).add(encode(message))
        for other, topics in self.hears.items():
            reliable = isinstance(message, SwarmEvent)
            heard = topic in topics and (node, other) not in self.cut
            if heard and (reliable or self.draw.random() >= self.loss):
                before = self.arrivals.get((node, other), 0.0)
                self.arrivals[node, other] = max(before, self.time + self.draw.random() * LATE)
                self._at(self.arrivals[node, other], other, message)

    def _at(self, time: float, node: int, message: Message | None) -> None:
        heappush(self.events, (time, next(self._numbers), node, message))

    def progress(self, step: int) -> None:
        """Tell all robots that a step is recorded."""
        for robot in self.peers:
            self._at(self.time, robot, RecordingProgress(0, 0, step))

    def said_by(self, robot: int) -> list[Message]:
        """Return what a robot has said, without repetitions."""
        return [message for node, message in self.log if node == robot]

    @property
    def drops(self) -> dict[int, int]:
        """The steps from which on robots are dropped, as recorded; not those whose end was planned."""
        events = (decoded(data) for data in self.recorded.get("swarm/events", ()))
        return {e.agent_id: e.step for e in events if e.kind == EventKind.DEAD and e.detail == SILENT}


def decoded(data: bytes) -> SwarmEvent:
    """Return an event."""
    event = decode(SwarmEvent, data)
    assert isinstance(event, SwarmEvent)
    return event


class Ending:
    """A robot that says nothing from a step on."""

    def __init__(self, robot: Behaviour, end: int) -> None:
        self._robot, self._end = robot, end

    def start(self) -> Messages:
        return self._before_end(self._robot.start())

    def handle(self, message: Message) -> Messages:
        return self._before_end(self._robot.handle(message))

    def _before_end(self, messages: Messages) -> Messages:
        return tuple(message for message in messages if message.step < self._end)


def central(scenario: Scenario, drops: dict[int, int]) -> dict[str, set[bytes]]:
    """Return what all publish if there is an observer, which drops robots at these steps, because they say nothing."""
    nodes = nodes_in_process(scenario)
    for robot, step in drops.items():
        name = NodeName(NodeKind.AGENT, robot)
        nodes[name] = nodes[name]._replace(behaviour=Ending(nodes[name].behaviour, step))
    observer = behaviour_of(nodes, NodeName(NodeKind.OBSERVER), Observer)
    network = Network(nodes.values())
    network.start()
    found: dict[str, set[bytes]] = {}
    left = dict(drops)
    for message in network.deliver():
        found.setdefault(topic_of(message).name, set()).add(encode(message))
        now = [robot for robot, step in left.items() if step == observer.step]
        if now:  # at once, since the others do not wait for one that has yet to join
            network.pending.extend(observer.drop(now, SILENT))
            left = {robot: step for robot, step in left.items() if robot not in now}
    return found
