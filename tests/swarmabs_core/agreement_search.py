"""Every course that the agreement of four robots in a step can take, as far as others may tell apart.

The model has the production code decide. An adversary lets robots tell that others are silent, whether they are or not,
and chooses for every single decision what the robot has heard: any vote that each other robot has ever had, or none. It
may also let any robot do nothing from any time on, which is how it ends one.
"""

from collections.abc import Iterator, Sequence
from itertools import product
from typing import NamedTuple

from swarmabs_core.agreement import Agreement, Vote
from swarmabs_core.rank_sets import ranks

ROBOTS = 4
ALL = (1 << ROBOTS) - 1


class State(NamedTuple):
    """Chains of votes by robot, what robots hold and have done, and the parent; sets are bits.

    Attributes
    ----------
    dropped, done : tuple of int
        By robot: whom it has dropped, and with which robots it has completed the step (0: not yet).
    given : int
        Robots that have given their states to the parent.
    there : int
        Robots whose states the parent counts.
    ended : int
        Robots of whose end in this step the parent has been told.
    moved : int
        The robots with whose states the parent has moved on; 0 if it has not.
    quiet : int
        Robots that send nothing to the parent any more.
    clash : bool
        Whether the parent has been told too late, and has failed.
    """

    chains: tuple[tuple[Vote, ...], ...]
    held: tuple[int, ...]
    dropped: tuple[int, ...]
    done: tuple[int, ...]
    given: int = 0
    there: int = 0
    ended: int = 0
    moved: int = 0
    quiet: int = 0
    clash: bool = False


Votes = tuple[Vote | None, ...]


class Outcome(NamedTuple):
    """What an agreement says with these votes by rank."""

    votes: Votes
    own: Vote
    alike: bool
    settled: bool
    dropped: int
    outnumbered: bool


class DisagreementError(AssertionError):
    """Two robots, or a robot and the parent, have completed a step with different robots."""


class Search:
    """A search through all states.

    Parameters
    ----------
    links : sequence of int
        Whom each robot hears.
    silences : collection of pairs of int
        Which robot may tell of which other one that it is silent.
    timely : bool
        Whether the parent, and robots that are alive, answer before others have waited in vain, and so have given
        their states.
    """

    def __init__(
        self, links: Sequence[int], silences: Sequence[tuple[int, int]], held: Sequence[int], *, timely: bool = True
    ) -> None:
        self._links, self._silences, self._timely = links, silences, timely
        self._first = State(((),) * ROBOTS, tuple(held), (0,) * ROBOTS, (0,) * ROBOTS)
        self._known: dict[tuple[int, Votes, int, int, bool], Outcome] = {}
        self.seen: set[State] = {self._first}
        self.ends: set[tuple[int, tuple[int, ...], bool]] = set()

    def run(self) -> None:
        """Visit all states; raises `DisagreementError` if there is one."""
        waiting = [self._first]
        while waiting:
            state = waiting.pop()
            self._check(state)
            for after in self._after(state):
                if after not in self.seen:
                    self.seen.add(after)
                    waiting.append(after)

    def _check(self, state: State) -> None:
        if any(state.done):
            self.ends.add((state.moved, state.done, state.clash))
        late = any(dropped & state.moved for dropped in state.dropped)
        if state.clash or (late and not self._timely):  # the parent fails once it is told of the ends
            return
        # Who is left out may be wrong: it cannot complete the next step, since the others pass on nothing of it.
        outs = [
            chain[-1].out
            for chain, dropped in zip(state.chains, state.dropped, strict=True)
            if dropped and dropped == ALL & ~state.moved
        ]
        for robot, kept in enumerate(state.done):
            if kept not in {0, state.moved} and not any(out >> robot & 1 for out in outs):
                raise DisagreementError(state)

    def _after(self, state: State) -> Iterator[State]:
        if state.clash:
            return
        yield from self._parent(state)
        for robot in range(ROBOTS):
            if not state.done[robot]:
                yield from self._robot(state, robot)

    def _parent(self, state: State) -> Iterator[State]:
        left = ALL & ~state.ended
        if not state.moved and left and state.there & left == left:
            yield state._replace(moved=left)

    def _robot(self, state: State, robot: int) -> Iterator[State]:
        bit = 1 << robot
        if not state.quiet & bit and state.given & bit and not state.there & bit and not state.moved:
            yield state._replace(there=state.there | bit)  # it repeats its state
        own = state.chains[robot][-1:]
        for other in range(ROBOTS):  # it hears of states from those that it has not left out
            out = own[0].out if own else 0
            news = state.held[other] & ~state.held[robot]
            if other != robot and not out >> other & 1 and news and self._links[robot] >> other & 1:
                for one in ranks(news):
                    yield self._holding(state, robot, state.held[robot] | 1 << one)
        for outcome in self._outcomes(state, robot):
            yield from self._decided(state, robot, outcome)

    def _outcomes(self, state: State, robot: int) -> set[Outcome]:
        """Return what may follow from what a robot may have heard of the others."""
        chains = [
            chain[-1:] or (None,) if other == robot else (None, *chain) for other, chain in enumerate(state.chains)
        ]
        answers = (False, True) if state.moved and state.given >> robot & 1 else (False,)
        return {
            self._outcome(robot, votes, state.held[robot], answered=answered)
            for votes in product(*chains)
            for answered in answers
        }

    def _outcome(self, robot: int, votes: Votes, held: int, told: int = 0, *, answered: bool = False) -> Outcome:
        """Return what follows from votes, if the robot also tells of others that they are silent.

        It may have the parent's answer.
        """
        key = robot, votes, held, told, answered
        if (known := self._known.get(key)) is not None:
            return known
        agreement = Agreement(robot, self._links, ALL, ALL)
        for rank, vote in enumerate(votes):
            if vote is not None:
                agreement.take({rank: vote}, held)
        if told:
            agreement.tell(told, held)
        if answered:
            agreement.answer()
        found = Outcome(
            tuple(agreement.votes.get(rank) for rank in range(ROBOTS)),
            agreement.own,
            agreement.alike,
            agreement.settled,
            agreement.dropped,
            agreement.outnumbered,
        )
        self._known[key] = found
        return found

    def _decided(self, state: State, robot: int, outcome: Outcome) -> Iterator[State]:
        """Return what a robot may do with what it has heard."""
        bit, held, own = 1 << robot, state.held[robot], outcome.own
        if outcome.outnumbered:
            return
        told = self._voting(state, robot, own)
        if told is not state:
            yield told
        for one, other in self._silences:
            if one == robot and not own.silent >> other & 1:
                telling = self._outcome(robot, outcome.votes, held, 1 << other)
                if not telling.outnumbered:
                    yield self._voting(state, robot, telling.own)
        dropped = state.dropped[robot] | outcome.dropped
        if dropped != state.dropped[robot]:
            told = self._with(told, "dropped", robot, dropped)
            if robot == next(ranks(ALL & ~dropped)):  # it tells the parent, and then sends its state again
                there = told.given & bit & ~told.quiet
                clash = bool(told.moved & dropped)
                told = told._replace(ended=told.ended | dropped, there=there, clash=clash)
            yield told
            return
        if not outcome.alike or ALL & ~dropped & ~held:
            return
        if not state.given & bit:
            there = 0 if state.quiet & bit or state.moved else bit
            yield told._replace(given=state.given | bit, there=state.there | there)
            return
        if state.moved and outcome.settled:
            yield self._with(told, "done", robot, ALL & ~dropped)
        if state.moved and own.out:
            for other in ranks(ALL & ~own.out & ~bit):
                if state.done[other] >> robot & 1:
                    yield self._with(told, "done", robot, state.done[other])
        left = ALL & ~state.ended
        lacks = left & ~state.there if not ALL & ~own.out & ~state.given else 0  # not while one inside is late
        in_vain = not state.moved and state.there & bit and lacks
        if own.out and (in_vain or not self._timely) and own.waited != own.out:
            quiet = state.quiet | own.out if self._timely else state.quiet
            yield self._voting(told, robot, own.joined(Vote(waited=own.out)))._replace(quiet=quiet)

    def _voting(self, state: State, robot: int, vote: Vote) -> State:
        """Return the state with the robot's vote."""
        chain = state.chains[robot]
        if vote == Vote() or (chain and chain[-1] == vote):
            return state
        return self._with(state, "chains", robot, (*chain, vote))

    @staticmethod
    def _holding(state: State, robot: int, held: int) -> State:
        return Search._with(state, "held", robot, held)

    @staticmethod
    def _with(state: State, name: str, robot: int, value: object) -> State:
        values = list(getattr(state, name))
        values[robot] = value
        return state._replace(**{name: tuple(values)})
