"""A message on its way from the wire to a bag: its content and its bytes."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from swarmabs_core.cdr import agent_id_of, canonical, decode, encode
from swarmabs_core.messages import topic_of

if TYPE_CHECKING:
    from swarmabs_core.messages import Message, Topic

_new = tuple.__new__
"""Makes a record of its values; `__new__` of a NamedTuple is a slower wrapper in Python."""


class Record(NamedTuple):
    """A message with its bytes, decoded once and never re-encoded.

    `agent_id` is 0 if the message concerns no robot. The payload is canonical CDR, except in records made by `read`.
    For checks of a bag's own times, `time` and `published` are its log and publish times, ns.
    """

    topic: Topic
    agent_id: int
    message: Message
    payload: bytes
    time: int | None = None
    published: int | None = None

    @classmethod
    def of(cls, message: Message) -> Record:
        """Return the record of a message created in this process.

        Raises
        ------
        MalformedMessageError
            If a field does not fit its type.
        """
        return cls(topic_of(message), agent_id_of(message), message, encode(message))

    @classmethod
    def heard(cls, topic: Topic, data: bytes) -> Record:
        """Return the record, in canonical form, of bytes from the wire or a bag.

        Raises
        ------
        MalformedMessageError
            If they are not a message of the topic.
        """
        message = decode(topic.message, data)
        parts = (topic, agent_id_of(message), message, canonical(topic.message, data), None, None)
        return _new(cls, parts)

    @classmethod
    def read(cls, topic: Topic, time: int, payload: bytes, published: int | None = None) -> Record:
        """Return the record of bytes from a bag, unchanged, so that they can be checked.

        Raises
        ------
        MalformedMessageError
            If they are not a message of the topic.
        """
        message = decode(topic.message, payload)
        return _new(cls, (topic, agent_id_of(message), message, payload, time, published))
