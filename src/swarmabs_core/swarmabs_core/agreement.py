"""How robots without an observer agree, in a step, on going on without those that are silent.

Each robot has one `Vote` per step, whose sets only grow. Robots pass on all votes that they know, in any order and
repeatedly; of two votes of a robot the union counts. Sets are bits by rank, the order of ascending ids.

A robot tells which neighbours are silent. From what all have told it follows whom a robot still reaches, and it votes
to leave out the others. From then on it takes no state from them, and it does not complete the step unless all that it
reaches have voted alike. The states that they hold between them count in the step; who is left out and whose state
nobody holds is dropped. If no state is missing, and all of them have waited in vain for the parent, it must lack states
of some that are left out, and all these are dropped. Who has waited does not complete the step without that decision,
unless the parent answers: then one that they do not reach any more has made it, with a vote that nobody else knows.
Where none of them hears the parent, and none has its state of the step before, they wait for that in vain, and stop.

Only a majority of the robots that publish in the step may go on, or half of them with the one of lowest id.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from swarmabs_core.rank_sets import is_majority, ranks

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


class Vote(NamedTuple):
    """What a robot says in a step; every set is bits by rank.

    Attributes
    ----------
    silent : int
        Neighbours that it has not heard, not even repeating themselves, while it waited.
    out : int
        Robots that it does not reach any more past all silences that it knows.
    held : int
        Robots whose states of the step it held when `out` became what it is.
    waited : int
        The set `out` with which it waited in vain for the parent: to answer as it knew all states, or still for its
        state of the step before, which none that it reaches hears. Empty if it did not.
    """

    silent: int = 0
    out: int = 0
    held: int = 0
    waited: int = 0

    def joined(self, other: Vote) -> Vote:
        """Return the union with another vote of the robot."""
        return Vote(*(one | more for one, more in zip(self, other, strict=True)))


NOTHING = Vote()


class Agreement:
    """What a robot knows of the votes of a step.

    Parameters
    ----------
    rank : int
        Rank of this robot.
    links : sequence of int
        The robots that each robot hears, by rank, as bits.
    present : int
        The robots that pass on messages in the step.
    publishing : int
        Those of them that publish a state in it; none after the last step.

    Attributes
    ----------
    votes : dict
        The known votes by rank.
    """

    def __init__(self, rank: int, links: Sequence[int], present: int, publishing: int) -> None:
        self._rank, self._links = rank, links
        self._present, self._publishing = present, publishing
        self._decided: int | None = None
        self._answered = False
        self.votes: dict[int, Vote] = {}

    @property
    def own(self) -> Vote:
        """The vote of this robot."""
        return self.votes.get(self._rank, NOTHING)

    @property
    def out(self) -> int:
        """The robots that this one votes to leave out."""
        return self.own.out

    @property
    def inside(self) -> int:
        """The robots that this one reaches, itself among them."""
        return self._present & ~self.out

    def unheard(self, rank: int) -> int:
        """Return the robots with which a robot is out of contact: either has told that the other one is silent."""
        bits = self.votes.get(rank, NOTHING).silent
        for other, vote in self.votes.items():
            if vote.silent >> rank & 1:
                bits |= 1 << other
        return bits

    def tell(self, silent: int, held: int) -> bool:
        """Tell which neighbours are silent, given the states that this robot holds; return whether that is news."""
        return self.take({self._rank: Vote(silent)}, held)

    def wait(self) -> bool:
        """Tell that this robot waits in vain for the parent, unless that has answered; return whether that is news."""
        return not self._answered and self.take({self._rank: Vote(waited=self.out)}, 0)

    def take(self, votes: Mapping[int, Vote], held: int) -> bool:
        """Take votes, given the states that this robot holds; return whether they are news."""
        joined = {rank: self.votes.get(rank, NOTHING).joined(vote) for rank, vote in votes.items()}
        if all(self.votes.get(rank) == vote for rank, vote in joined.items()):
            return False
        self.votes |= joined
        out = self._present & ~self._reached()
        if out & ~self.out:
            self.votes[self._rank] = self.own.joined(Vote(out=out, held=held))
        return True

    def follow(self, dropped: int) -> None:
        """Go on as others have, with whom this robot is in contact: they have completed the step without these."""
        self._decided = dropped

    def answer(self) -> None:
        """Note that the parent has answered in the step."""
        self._answered = True

    @property
    def alike(self) -> bool:
        """Whether this robot leaves nobody out, or all that it reaches have voted to leave out the same ones."""
        return self._free or all(self.votes.get(rank, NOTHING).out == self.out for rank in ranks(self.inside))

    @property
    def waited(self) -> bool:
        """Whether all that this robot reaches leave out the same ones, and have waited in vain for the parent."""
        return bool(self.out) and self.out == self._all_waited

    @property
    def _all_waited(self) -> int:
        """The set with which all that this robot reaches have waited in vain for the parent; empty if there is none."""
        waited = {self.votes.get(rank, NOTHING).waited for rank in ranks(self.inside)}
        return waited.pop() if len(waited) == 1 else 0

    @property
    def _made_by_another(self) -> bool:
        """Whether only one that this robot does not reach any more can have made the decision that was waited for."""
        return self._answered and bool(self._all_waited)

    @property
    def _free(self) -> bool:
        """Whether this robot needs no votes of others: it leaves nobody out, or others have decided."""
        return not self.out or self._decided is not None or self._made_by_another

    @property
    def settled(self) -> bool:
        """Whether this robot may complete the step without `dropped`: it leaves nobody out, or that is decided."""
        return self._free or (self.alike and (not self.own.waited or self.waited))

    @property
    def dropped(self) -> int:
        """The robots that do not take part in the step and from then on, once it is settled."""
        if self._decided is not None:
            return self._decided
        if not self.out or not self.alike:
            return 0
        return self._all_waited if self.waited or self._made_by_another else self.out & ~self._held()

    @property
    def outnumbered(self) -> bool:
        """Whether those that this robot reaches are too few to go on without the others."""
        there = {*ranks(self._publishing)}
        return bool(there and self.out) and not is_majority({*ranks(self.inside)}, there)

    def _reached(self) -> int:
        """Return the robots that this one reaches past all silences that have been told."""
        reached = new = 1 << self._rank
        while new:
            near = 0
            for rank in ranks(new):
                near |= self._links[rank] & ~self.unheard(rank)
            new = near & self._present & ~reached
            reached |= new
        return reached

    def _held(self) -> int:
        """Return the robots whose states those inside held as they voted."""
        bits = 0
        for rank in ranks(self.inside):
            bits |= self.votes.get(rank, NOTHING).held
        return bits
