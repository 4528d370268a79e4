"""A message on its way from the wire to a bag: what it says, and the bytes that say so."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from swarmabs_core.cdr import agent_id_of, canonical, decode, encode
from swarmabs_core.messages import TOPIC_OF

if TYPE_CHECKING:
    from swarmabs_core.messages import Message, Topic

_new: Any = tuple.__new__  # of a NamedTuple: its own `__new__` is a Python function around it


class Record(NamedTuple):
    """A message with its bytes: decoded once and never encoded again.

    The robot that it is about is 0 for none; the payload is canonical CDR but for what `read` returns. Where a bag's
    own times are to be judged, there are its log time and when it was published by the bag, ns.
    """

    topic: Topic
    agent_id: int
    message: Message
    payload: bytes
    time: int | None = None
    published: int | None = None

    @classmethod
    def of(cls, message: Message) -> Record:
        """Return the record of a message that was made in this process.

        Raises
        ------
        MalformedMessageError
            If a field does not fit its type.
        """
        return cls(TOPIC_OF[type(message)], agent_id_of(message), message, encode(message))

    @classmethod
    def heard(cls, topic: Topic, data: bytes) -> Record:
        """Return the record of bytes from the wire or a bag, whatever padding holds; its own are canonical.

        Raises
        ------
        MalformedMessageError
            If they are no message of the topic.
        """
        message = decode(topic.message, data)
        parts = (topic, agent_id_of(message), message, canonical(topic.message, data), None, None)
        return _new(cls, parts)  # type: ignore[no-any-return]

    @classmethod
    def read(cls, topic: Topic, time: int, payload: bytes, published: int | None = None) -> Record:
        """Return the record of bytes from a bag, which stay as they are, to be judged.

        Raises
        ------
        MalformedMessageError
            If they are no message of the topic.
        """
        message = decode(topic.message, payload)
        return _new(cls, (topic, agent_id_of(message), message, payload, time, published))  # type: ignore[no-any-return]
