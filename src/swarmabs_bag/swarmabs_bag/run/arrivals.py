"""Messages of a run that have arrived, as arrays by step, so that work on many messages is work on few arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

import numpy as np

from swarmabs_config.graph import KEPT_STEPS
from swarmabs_core.arrays import PADDING, constant, layout_of, raw
from swarmabs_core.cdr import ENCAPSULATION, FRAME, SECOND
from swarmabs_core.errors import MalformedMessageError
from swarmabs_core.membership import UNPLANNED
from swarmabs_core.messages import Status

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from swarmabs_core.arrays import Integers
    from swarmabs_core.membership import Membership
    from swarmabs_core.messages import Family, Topic

    Rows = NDArray[np.void]

S = TypeVar("S", bound=np.generic)


class _Table:
    """The messages of a topic in canonical form.

    Attributes
    ----------
    layout : dtype
        The layout of each of them.
    rows, filled : ndarray, (places,)
        The messages as plain bytes, and whether they are there.
    """

    __slots__ = ("_content", "_expected", "_fixed", "filled", "layout", "rows")

    def __init__(self, layout: np.dtype[np.void], first: bytes, places: int) -> None:
        self.layout = layout
        self.rows: Rows = np.empty(places, np.dtype((np.void, layout.itemsize)))
        self.filled = np.zeros(places, dtype=bool)
        self._content = np.full(layout.itemsize, 255, dtype=np.uint8)
        for name, (kind, offset, *_) in (layout.fields or {}).items():
            if name.startswith(PADDING):
                self._content[offset : offset + kind.itemsize] = 0
        self._fixed = constant(layout) & self._content
        expected = np.frombuffer(first, layout).copy()
        expected["encapsulation"], expected["frame"] = np.void(ENCAPSULATION), np.void(FRAME)
        self._expected = raw(expected)[0]

    def read(self, payloads: bytes) -> Rows | None:
        """Return joined messages in canonical form; None if a head, the length of a list or a time is malformed."""
        content = np.frombuffer(payloads, np.uint8).reshape(-1, self.layout.itemsize) & self._content
        messages: Rows = content.view(self.layout)[:, 0]
        malformed = ((content ^ self._expected) & self._fixed).any() or (messages["nanosec"] >= SECOND).any()
        return None if malformed else messages


class Arrivals:
    """The messages on the topics of a run that have some in every step.

    They are kept from a number of past steps on until `KEPT_STEPS` steps later.

    Parameters
    ----------
    family : Family
        The topics.
    membership : Membership
        Which robots take part in which step.
    members : iterable of int
        Ids of all robots that ever take part.
    memory : int
        Number of past steps.
    system : int, optional
        Hash of the parent system, if the messages contain it.

    Attributes
    ----------
    newest : int
        The newest step of which there was a message, -1 before the first.
    """

    def __init__(
        self, family: Family, membership: Membership, members: Iterable[int], memory: int, system: int | None
    ) -> None:
        self._family, self._coordinated = family, family.stepwise[1:]
        self._membership = membership
        self._members = np.array(sorted(members))
        self._capacity = memory + KEPT_STEPS
        self._system = system
        self._tables: dict[Topic, _Table] = {}
        self.newest = -1

    def read(self, topic: Topic, payloads: Sequence[bytes], *, joined: bool) -> Rows | None:
        """Return messages of a topic in canonical form; if `joined`, a payload is several messages in a row.

        Returns None if one of them must be looked at by itself: if it is malformed, comes from an unknown robot or
        system or from before the start of the run, or is the last one of a robot.
        """
        table = self._tables.get(topic) or self._begun(topic, payloads[0])
        if table is None:
            return None
        sizes, size = set(map(len, payloads)), table.layout.itemsize
        if any(length % size for length in sizes) if joined else sizes != {size}:
            return None
        messages = table.read(b"".join(payloads))
        if messages is None or (self._system is not None and (messages["system"] != self._system).any()):
            return None
        if topic is not self._family.robot:
            return None if (messages["sec"] < 0).any() else messages
        strange = (self._members.take(self._columns(messages), mode="clip") != messages["agent_id"]).any()
        return None if strange or (messages["status"] == Status.LEFT).any() else messages

    def _begun(self, topic: Topic, payload: bytes) -> _Table | None:
        """Return a new table of messages like the first one of a payload, None if that is malformed."""
        try:
            layout = layout_of(topic, payload)
        except MalformedMessageError:
            return None
        first = payload[: layout.itemsize]
        if len(first) < layout.itemsize:
            return None
        table = _Table(layout, first, self._capacity * (len(self._members) if topic is self._family.robot else 1))
        if table.read(first) is None:
            return None
        self._tables[topic] = table
        return table

    def put(self, topic: Topic, agent_id: int, step: int, payload: bytes) -> bool:
        """Add a message in canonical form, of a held step; `agent_id` is 0 unless it is the state of a robot.

        Returns False if it differs from another in its place; then nothing is added.

        Raises
        ------
        MalformedMessageError
            If its lists are not as long as those of the first message of the topic.
        """
        table = self._tables.get(topic) or self._begun(topic, payload)
        if table is None or len(payload) != table.layout.itemsize:
            raise MalformedMessageError(topic.message.__name__, "lists of other lengths than in the messages before it")
        place = self._place(agent_id, step)
        if not table.filled[place]:
            table.rows[place] = np.void(payload)
            table.filled[place] = True
            self.newest = max(self.newest, step)
        return bool(table.rows[place].tobytes() == payload)

    def get(self, topic: Topic, agent_id: int, step: int) -> bytes | None:
        """Return a message of a held step, None if it is not there; parameters as for `put`."""
        table = self._tables.get(topic)
        if table is None or (agent_id and agent_id not in self._members):
            return None
        place = self._place(agent_id, step)
        return table.rows[place].tobytes() if table.filled[place] else None

    def _place(self, agent_id: int, step: int) -> int:
        """Return the place of a message in its table."""
        place = step % self._capacity
        return place * len(self._members) + int(np.searchsorted(self._members, agent_id)) if agent_id else place

    def _columns(self, states: Rows) -> Integers:
        return np.searchsorted(self._members, states["agent_id"])

    def add(self, topic: Topic, messages: Rows) -> bool:
        """Add messages that `read` has returned, of held steps, except states of robots that are out in their step.

        Returns False if one of them differs from another in its place; then nothing is added.
        """
        if not len(messages):
            return True
        table, steps = self._tables[topic], messages["step"].astype(np.int64)
        places = steps % self._capacity
        if topic is self._family.robot:
            columns = self._columns(messages)
            places = places * len(self._members) + columns
            if not self._all_take_part(int(np.min(steps)), int(np.max(steps))):
                taken = table.filled[places] | self._take_part(columns, steps)
                if not taken.all():
                    return self.add(topic, messages[taken])
        rows, new = messages.view(table.rows.dtype), ~table.filled[places]
        table.rows[places[new]] = rows[new]
        if (raw(table.rows[places]) != raw(rows)).any():
            return False
        table.filled[places] = True
        self.newest = max(self.newest, int(np.max(steps)))
        return True

    def _all_take_part(self, first: int, last: int) -> bool:
        """Return whether all robots publish their states in these steps."""
        membership = self._membership
        return len(membership.publishing(first)) == len(self._members) and last < membership.constant_until(first)

    def _take_part(self, columns: Integers, steps: Integers) -> NDArray[np.bool_]:
        """Return whether robots publish their states of steps."""
        spans = [self._membership.span(agent_id) for agent_id in self._members.tolist()]
        first = np.array([span.first for span in spans])
        last = np.array([UNPLANNED if span.last is None else span.last for span in spans])
        taking_part: NDArray[np.bool_] = (first[columns] <= steps) & (steps <= last[columns])
        return taking_part

    def complete(self, step: int) -> int:
        """Return the number of steps from a step on of which all messages are there, with the robots of this step."""
        tables, place, coordinated = self._tables, step % self._capacity, self._coordinated
        # That one of the few messages is missing is found faster than whether that of a robot is.
        if self.newest < step or not all(topic in tables and tables[topic].filled[place] for topic in coordinated):
            return 0
        places = np.arange(step, self.newest + 1) % self._capacity
        there = np.ones(len(places), dtype=bool)
        if self._membership.publishing(step):
            if (states := tables.get(self._family.robot)) is None:
                return 0
            there = self._by_step(self._family.robot, states.filled, step, places).all(axis=1)
        for topic in coordinated:
            there &= tables[topic].filled[places]
        gaps = np.flatnonzero(~there)
        return int(gaps[0]) if len(gaps) else len(there)

    def tables(self, step: int, count: int) -> dict[Topic, Rows]:
        """Return the messages of so many complete steps from a step on, with the robots of this step; see `Step`."""
        places = np.arange(step, step + count) % self._capacity
        tables = {}
        for topic, table in self._tables.items():
            rows = self._by_step(topic, table.rows, step, places).view(table.layout)
            if rows.size:
                tables[topic] = rows if topic is self._family.robot else rows[:, 0]
        return tables

    def _by_step(self, topic: Topic, values: NDArray[S], step: int, places: Integers) -> NDArray[S]:
        """Return a copy of values of a table, in rows for these steps and columns for the robots of a step."""
        table = values.reshape(self._capacity, -1)
        robots = self._membership.publishing(step)
        if topic is not self._family.robot or len(robots) == len(self._members):
            return table[places]
        return table[np.ix_(places, np.searchsorted(self._members, robots))]

    def forget(self, step: int, count: int = 1) -> None:
        """Forget the messages of so many steps from a step on."""
        for table in self._tables.values():
            table.filled.reshape(self._capacity, -1)[np.arange(step, step + count) % self._capacity] = False
