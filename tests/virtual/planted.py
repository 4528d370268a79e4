# ruff: noqa: T201 - it is a command
"""Faults of the kind that were once found late, planted in the sources while a search runs.

Each is a mistake that somebody could make in one place. The search must find each of them.

    python -m tests.virtual.planted                       # all of them, and what found them
    python -m tests.virtual.planted mixed_sets both_lead
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from itertools import count
from os import cpu_count
from types import ModuleType
from typing import NamedTuple

MINUTES = 10.0
"""Time of the processor within which each of them must be found."""


class Planted(NamedTuple):
    """A mistake: what it means, the module that has it, and there the right text, which occurs once, and the wrong."""

    name: str
    means: str
    module: str
    right: str
    wrong: str


PLANTED = (
    Planted(
        "stop_is_lost_in_a_takeover",
        "A silent controller does not take over the STOP of the leader.",
        "swarmabs_core.realtime.modes",
        "if commanded is Mode.RESET and step <= since:",
        "if not leading or (commanded is Mode.RESET and step <= since):",
    ),
    Planted(
        "a_restart_makes_a_majority",
        "A robot that restarts among a minority lets just those count that it hears.",
        "swarmabs_core.realtime.electorate",
        "        if self.since < 0:\n",
        "        if self.since <= 0:\n",
    ),
    Planted(
        "strangers_make_a_majority",
        "Robots that are heard and do not count help to a majority.",
        "swarmabs_core.rank_sets",
        "    return 2 * len(inside) > len(counted) or (",
        "    return 2 * len(there) > len(counted) or (",
    ),
    Planted(
        "age_of_old_states_saturates",
        "The age of a state that is passed on saturates, so that its step is a wrong one.",
        "swarmabs_core.realtime.relayed",
        "    return Motion(rank, status, step - state.step, tag, state.position, state.velocity, signature)",
        "    age = min(step - state.step, _OLDEST)\n"
        "    return Motion(rank, status, age, tag, state.position, state.velocity, signature)",
    ),
    Planted(
        "law_from_before_the_reset",
        "Robots join the law of one that has not heard of the newest RESET.",
        "swarmabs_core.realtime.peer",
        "[law for known, law in self._views if known == reset]",
        "[law for _, law in self._views]",
    ),
    Planted(
        "carried_away_robot_is_back_after_a_restart",
        "The memory of an observer keeps a robot that was carried away.",
        "swarmabs_core.realtime.observer",
        "        if role is Role.SILENT:\n"
        "            self._memory[agent_id] = self._states[agent_id]._replace(step=self._steps[agent_id])\n"
        "        else:\n"
        "            self._memory.pop(agent_id, None)\n",
        "        if role is Role.SILENT:\n"
        "            self._memory[agent_id] = self._states[agent_id]._replace(step=self._steps[agent_id])\n"
        "        elif role is Role.ACTIVE:\n"
        "            self._memory.pop(agent_id, None)\n",
    ),
    Planted(
        "removal_is_thrown_away_at_activation",
        "A removal that arrives while an observer is inactive is thrown away.",
        "swarmabs_ros.realtime",
        "        passing = {t: n for t, n in engine.depths.items() if not issubclass(t.message, SwarmEvent)}\n",
        "        passing = {t: n for t, n in engine.depths.items() if t.message is not SwarmEvent}\n",
    ),
    Planted(
        "one_counterpart_too_many_is_none",
        "A node does not find its counterparts if somebody else listens, too.",
        "swarmabs_ros.runner",
        "else inbox.publisher_count(topic)) >= number\n",
        "else inbox.publisher_count(topic)) == number\n",
    ),
    Planted(
        "file_that_was_never_begun_is_no_cut",
        "A repaired bag whose last file is empty does not say that it is cut off.",
        "swarmabs_bag.repair.bag",
        "    if last is not parts[-1] or (last.rebuilt is not None and last.rebuilt.end is None):\n",
        "    if last.rebuilt is not None and last.rebuilt.end is None:\n",
    ),
    Planted(
        "merge_of_cut_bags_lacks_nothing",
        "A merge of bags that were cut off does not name what comes after them.",
        "swarmabs_bag.merge",
        "        continued = ended_early in {None, CUT_OFF}\n",
        "        continued = ended_early is None\n",
    ),
    Planted(
        "mixed_sets",
        "A robot combines the sums of one observer with the other's abstract state.",
        "swarmabs_core.realtime.broadcasts",
        "abstract, sums, desired = map(first.__getitem__, senders)",
        "abstract, sums, desired = map(first.__getitem__, senders)\n"
        "                sums = first.get((BROADCASTS[1], not of.observer), sums)",
    ),
    Planted(
        "mixed_steps",
        "A robot takes the desired state of a later step than the sums.",
        "swarmabs_core.realtime.broadcasts",
        "        return self._sets.get(self.followed)\n",
        "        own = self._sets.get(self.followed)\n"
        "        heard = {} if own is None else self._heard.of(own.step + 1)\n"
        "        later = [m for m in heard.values() if getattr(m, 'mode', None) == Mode.RUN]\n"
        "        return own._replace(desired=later[0]) if own and later else own\n",
    ),
    Planted(
        "old_broadcasts",
        "A robot acts on broadcasts up to three times as old as it may.",
        "swarmabs_core.realtime.broadcasts",
        "if step - newest.step > self._age:",
        "if step - newest.step > 3 * self._age:",
    ),
    Planted(
        "deaf_after_a_restart",
        "A receiver that is bound to the first writer of an origin never accepts the next one.",
        "swarmabs_core.realtime.validation",
        "writer == bound[0] or self._ran - bound[1] > self.age(origin):",
        "writer == bound[0]:",
    ),
    Planted(
        "never_starts_again",
        "An observer that restarts waits for a robot that died before, although the swarm is under way.",
        "swarmabs_core.realtime.observer",
        "return step - self._under_way_since > self._age and len(self._states) >= FEWEST",
        "return False",
    ),
    Planted(
        "both_lead",
        "A standby that leads does not yield to its primary.",
        "swarmabs_core.realtime.leadership",
        "elif self._rank == STANDBY and self._agreed >= AGREED:",
        "elif self._agreed > AGREED:",
    ),
    Planted(
        "nobody_takes_over",
        "A standby that was stopped waits until it hears the other one.",
        "swarmabs_core.realtime.leadership",
        "if able and step >= max(self._until, self._able_since + patience):",
        'if able and step >= max(self._until, self._able_since + patience) and "stopped" not in self.why:',
    ),
    Planted(
        "stop_is_not_latched",
        "A robot stops while the newest broadcasts say STOP, and moves again as soon as they say RUN.",
        "swarmabs_core.realtime.broadcasts",
        "        return self._latch.stopped\n",
        "        return False\n",
    ),
    Planted(
        "grows_with_forged_ids",
        "What is heard is kept for ever.",
        "swarmabs_core.realtime.validation",
        "            self.add(state.agent_id, state, step)\n",
        "            self.add(state.agent_id, state, step)\n"
        "            self.__dict__.setdefault('kept', []).append(state)\n",
    ),
    Planted(
        "impostor_is_believed",
        "A second writer is counted, but what it says counts, too.",
        "swarmabs_core.realtime.validation",
        "        self._refused[origin] = count + 1, writer, self._ran\n        return True\n",
        "        self._refused[origin] = count + 1, writer, self._ran\n        return False\n",
    ),
    Planted(
        "follows_a_stale_leader",
        "A robot never leaves the coordinators that it has followed first.",
        "swarmabs_core.realtime.broadcasts",
        "if newest - trusted.get(self.followed, _LONG_AGO) > MOST_BEHIND:",
        "if newest - trusted.get(self.followed, _LONG_AGO) > 2**63:",
    ),
    Planted(
        "holds_through_a_clock_set_back",
        "A robot whose clock is set back keeps its command and what it has heard.",
        "swarmabs_core.realtime.agent",
        "return self._doubt(now) if set_back else ()",
        "return ()",
    ),
    Planted(
        "silent_robots_still_count",
        "The observer takes robots that have fallen silent for active for three times as long as it may.",
        "swarmabs_core.realtime.observer",
        "if step - state.step > self._age:",
        "if step - state.step > 3 * self._age:",
    ),
    Planted(
        "a_late_stop_is_refused",
        "A robot refuses a STOP that is late as outdated, as it refuses other broadcasts.",
        "swarmabs_core.realtime.broadcasts",
        "message.mode == Mode.STOP:\n            self._latch.stop(message.step)  # even if it is otherwise invalid\n",
        "message.mode == Mode.STOP and not untimely:\n            self._latch.stop(message.step)\n",
    ),
    Planted(
        "an_old_state_replaces_a_new_one",
        "Observer and plane take an older state of a robot instead of the newest.",
        "swarmabs_core.realtime.validation",
        "return known is None or state.step > known.step or",
        "return known is None or state.step != known.step or",
    ),
    Planted(
        "leads_although_cut_off",
        "An observer that hears no robot any more, but is heard, speaks on.",
        "swarmabs_core.realtime.observer",
        "if not self._hears_robots and not self._config.pair.single:",
        "if False:",
    ),
    Planted(
        "release_does_nothing",
        "A coordinator that is told to hand over goes on.",
        "swarmabs_core.realtime.leadership",
        "        self.leadership.release(self._schedule.step(now))\n",
        "",
    ),
    Planted(
        "a_robot_that_left_weighs_on",
        "The observer takes a robot that has left for one that is silent.",
        "swarmabs_core.realtime.observer",
        "        if state.status == Status.LEFT:\n            return Role.LEFT\n",
        "",
    ),
    Planted(
        "two_steps_are_missing",
        "A bag that continues in another file within a batch of steps lacks the first one of the rest.",
        "swarmabs_bag.run.writer",
        "            left = left[count:]",
        "            left = left[count + 1 :]",
    ),
    Planted(
        "a_closed_bag_is_not_on_the_disk",
        "A file of a bag is closed before it is on the disk.",
        "swarmabs_bag.run.writer",
        "            self._file.sync()\n            self._file.close()\n            self._complete",
        "            self._file.close()\n            self._complete",
    ),
    Planted(
        "repair_stops_at_the_first_damage",
        "A repair does not look for intact chunks behind a page that is lost.",
        "swarmabs_bag.repair.salvage",
        "                following = self._following(offset)\n",
        "                following = None\n",
    ),
    Planted(
        "a_merge_drops_messages_of_the_same_time",
        "Of messages on a topic with the same time of receipt, a merge takes one.",
        "swarmabs_bag.merge",
        "        return (received for _, received in ordered)",
        "        return iter({(one.time, one.record.topic): one for _, one in ordered}.values())",
    ),
    Planted(
        "losses_are_not_counted",
        "The figures of a recorder count one missing message less for each robot.",
        "swarmabs_bag.run.figures",
        "expected = sum(span.last - span.first + 1 for span in spans)",
        "expected = sum(span.last - span.first for span in spans)",
    ),
    Planted(
        "a_start_never_finds_its_counterparts",
        "Nodes wait for as many readers as there are writers of a topic.",
        "swarmabs_run.orchestration.plan",
        "        met |= {topic: publishers[topic] for topic",
        "        met |= {topic: subscribers[topic] for topic",
    ),
    Planted(
        "deaf_on_one_side",
        "A node starts as soon as others have discovered it, whether it has discovered them or not.",
        "swarmabs_ros.runner",
        "if topic in publishers else inbox.publisher_count(topic)) >= number",
        "if topic in publishers else number) >= number",
    ),
    Planted(
        "a_dead_process_counts_as_ready",
        "The start of a robot's process that ended and was started again is not awaited.",
        "swarmabs_run.orchestration.supervision",
        "            self.ready.discard(name)\n",
        "",
    ),
    Planted(
        "a_start_waits_for_ever",
        "The time limit of a start without progress is an hour.",
        "swarmabs_run.orchestration.process_run",
        "                elif now - news > START_SILENCE:",
        "                elif now - news > 3600.0:",
    ),
    Planted(
        "a_short_reset",
        "RESET is published for a tenth of its time.",
        "swarmabs_core.realtime.modes",
        "self._lasting = schedule.steps(RESET_SECONDS)",
        "self._lasting = schedule.steps(RESET_SECONDS / 10)",
    ),
    Planted(
        "no_guard",
        "A RESET opens the latch as soon as it is newer than the STOP.",
        "swarmabs_core.realtime.modes",
        "self.reset_step - self._stop_step <= self.guard",
        "self.reset_step <= self._stop_step",
    ),
    Planted(
        "the_law_survives_a_reset",
        "A controller that is reset continues its law.",
        "swarmabs_core.realtime.controller",
        "        self._mode.reset(step)\n        self._restart()\n",
        "        self._mode.reset(step)\n",
    ),
    Planted(
        "takes_over_as_it_comes_back",
        "A standby that was cut off takes over as it hears again: it counts the silence of that time.",
        "swarmabs_core.realtime.leadership",
        "step - max(self._heard, self._able_since - 1) > self._takeover:",
        "step - self._heard > self._takeover:",
    ),
    Planted(
        "takes_over_late",
        "A standby waits twice as long as it may.",
        "swarmabs_core.realtime.leadership",
        "step - max(self._heard, self._able_since - 1) > self._takeover:",
        "step - max(self._heard, self._able_since - 1) > 2 * self._takeover:",
    ),
    Planted(
        "listens_to_nobody",
        "A coordinator that starts leads before it can have heard the other one.",
        "swarmabs_core.realtime.leadership",
        "_LISTENS = {SINGLE: 0.0, PRIMARY: 1.0, STANDBY: 2.0}",
        "_LISTENS = {SINGLE: 0.0, PRIMARY: 0.0, STANDBY: 0.0}",
    ),
    Planted(
        "goes_on_after_a_pause",
        "A leader that stood still speaks on although it has been replaced.",
        "swarmabs_core.realtime.leadership",
        "elif not before <= step <= before + self._takeover:",
        "elif False:",
    ),
    Planted(
        "forgets_what_it_saw",
        "What happened while neither of a pair spoke is never reported.",
        "swarmabs_core.realtime.leadership",
        "kept = (self._begun.event(now, max(0, step), why=why), *self._kept)",
        "kept = (self._begun.event(now, max(0, step), why=why),)",
    ),
    Planted(
        "stands_where_it_stood",
        "The memory keeps robots that have come back, and an observer that restarts counts them there.",
        "swarmabs_core.realtime.observer",
        "            self._memory.pop(agent_id, None)\n",
        "            pass\n",
    ),
    Planted(
        "a_removed_robot_weighs_on",
        "An observer passes on that a robot was carried away, and counts it all the same.",
        "swarmabs_core.realtime.observer",
        "        self._states[removal.agent_id] = state._replace(status=Status.LEFT)\n",
        "",
    ),
    Planted(
        "says_that_all_follow",
        "The health of an observer leaves out silent robots.",
        "swarmabs_core.realtime.observer",
        "missing = count[Role.STOPPED] + count[Role.SILENT]",
        "missing = count[Role.STOPPED]",
    ),
    Planted(
        "moves_blindly",
        "A robot follows without a fresh measurement of its motion.",
        "swarmabs_core.realtime.agent",
        "return m is not None and abs(now - m.stamp) <= self._config.measurement_age_limit * 1e9",
        "return m is not None",
    ),
    Planted(
        "leaves_for_ever",
        "A robot that leaves says so without end.",
        "swarmabs_core.realtime.agent",
        "        self._leaving -= 1\n",
        "",
    ),
    Planted(
        "no_end_of_the_lane",
        "A force-driven robot does what is asked for, also at the end of its lane.",
        "swarmabs_core.realtime.envelope",
        "        if self._fits(position, velocity, command):\n            return command\n",
        "        return command\n",
    ),
    Planted(
        "half_is_a_majority",
        "Both halves of a swarm without coordinators go on.",
        "swarmabs_core.rank_sets",
        "or (2 * len(inside) == len(counted) and min(counted, default=0) in inside)",
        "or 2 * len(inside) == len(counted)",
    ),
    Planted(
        "a_minority_elects",
        "Robots that hear a minority decide that only they count.",
        "swarmabs_core.realtime.electorate",
        "if not majority or now != self._heard or step < self._heard_since:",
        "if now != self._heard or step < self._heard_since:",
    ),
    Planted(
        "who_is_gone_still_counts",
        "Robots that are away for long still count for a majority.",
        "swarmabs_core.realtime.electorate",
        "            self.since, self.counted = step, now\n",
        "            self.since, self.counted = step, now | self.counted\n",
    ),
    Planted(
        "heard_for_too_long",
        "A robot counts others as heard for ten times as long as it may.",
        "swarmabs_core.realtime.peer",
        "step - state.step <= 2 * self._age",
        "step - state.step <= 20 * self._age",
    ),
    Planted(
        "stop_is_not_passed_on",
        "Robots do not take over a STOP that was ordered at another one.",
        "swarmabs_core.realtime.modes",
        "return Orders(max(self.stop, other.stop), max(self.reset, other.reset))",
        "return self._replace(reset=max(self.reset, other.reset))",
    ),
    Planted(
        "reset_is_not_passed_on",
        "Robots that have heard of no STOP do not obey a RESET that was ordered at another one.",
        "swarmabs_core.realtime.modes",
        "(self.now is not Mode.RUN or known != Orders() or outlasted)",
        "(self.now is not Mode.RUN or known != Orders())",
    ),
    Planted(
        "integrals_drift_apart",
        "Robots compare the integrals of their laws, and keep their own.",
        "swarmabs_core.realtime.controller",
        "            self._generator.recall(self._memories[self._law_step])\n",
        "",
    ),
    Planted(
        "law_begins_anew_at_a_takeover",
        "A controller that takes over does not continue the law of its peer.",
        "swarmabs_core.realtime.controller",
        "if self._first_step != begun and self._mode.now is Mode.RUN:",
        "if False:",
    ),
    Planted(
        "waits_for_nobody",
        "An observer begins with the first robot that it hears.",
        "swarmabs_core.realtime.observer",
        "        if self._known() >= self._needed:\n            return True\n",
        "        if self._known():\n            return True\n",
    ),
    Planted(
        "plane_is_passed_on_to_nobody",
        "A robot does not pass on the plane's state if one of its neighbours has it.",
        "swarmabs_core.realtime.peer",
        "if plane is not None and all(told.plane_step >= min(plane.step, heard - 1)",
        "if plane is not None and any(told.plane_step >= min(plane.step, heard - 1)",
    ),
    Planted(
        "seals_are_not_checked",
        "A robot takes states of others that these have not signed.",
        "swarmabs_core.realtime.peer",
        "if not self._signatures.holds(state, motion.signature):",
        "if motion.signature and not self._signatures.sealed:",
    ),
    Planted(
        "a_minority_drops",
        "In lockstep robots without a majority go on without the others.",
        "swarmabs_core.agreement",
        "return bool(there and self.out) and not is_majority({*ranks(self.inside)}, there)",
        "return bool(there and self.out) and not self.inside",
    ),
    Planted(
        "who_has_yet_to_join_makes_a_majority",
        "Robots in lockstep that have yet to join count for the majority that goes on without silent ones.",
        "swarmabs_core.behaviours.peer",
        "self._graph, present, content.set_of(self._due()))",
        "self._graph, present, present if self._due() else 0)",
    ),
    Planted(
        "waits_for_what_is_not_said_any_more",
        "A robot in lockstep waits for a message of a neighbour that has gone on without it.",
        "swarmabs_core.behaviours.peer",
        "        passed = any(map(self._has_gone_on, self._waiting()))\n",
        "        passed = False\n",
    ),
    Planted(
        "reset_that_is_late_is_ignored",
        "A robot ignores a RESET that is older than the age limit of broadcasts.",
        "swarmabs_core.realtime.broadcasts",
        "        if isinstance(message, DesiredAbstractState) and message.mode == Mode.RESET and not problem:\n"
        "            self._reset(message.step, step)\n"
        "        problem = untimely or problem\n",
        "        problem = untimely or problem\n"
        "        if isinstance(message, DesiredAbstractState) and message.mode == Mode.RESET and not problem:\n"
        "            self._reset(message.step, step)\n",
    ),
    Planted(
        "leader_from_the_future_counts_as_alive",
        "A standby takes a leader for alive whose clock is so far ahead that robots refuse it.",
        "swarmabs_core.realtime.leadership",
        "        if message_step <= step + self._ahead:\n            self._heard = max(self._heard, message_step)\n",
        "        self._heard = max(self._heard, min(message_step, step + self._ahead))\n",
    ),
    Planted(
        "all_are_silent_once_one_is_out",
        "In lockstep an observer drops all robots when another node hangs, once one of them has ended or not begun.",
        "swarmabs_core.behaviours.observer",
        "heard = len(missing) < len(self._membership.publishing(self._gathering.step))",
        "heard = len(missing) < len([*self._membership])",
    ),
    Planted(
        "sequence_goes_on_in_the_next_file",
        "The numbers of messages do not begin anew in each file of a bag.",
        "swarmabs_bag.run.writer",
        "        self._first, self._last = None, 0\n        self._counts = dict.fromkeys(self._counts, 0)\n",
        "        self._first, self._last = None, 0\n",
    ),
    Planted(
        "last_events_are_not_missed",
        "A whole bag without the events of its end is confirmed.",
        "swarmabs_analysis.verification.lockstep",
        "for event in self._late.values() if whole or event.step < self.step - WINDOW]",
        "for event in self._late.values() if event.step < self.step - WINDOW]",
    ),
    Planted(
        "who_refuses_to_start_is_waited_for",
        "A robot's process that refuses to start is taken for one that the run can do without.",
        "swarmabs_run.orchestration.supervision",
        "return self.started and name in self.dispensable",
        "return name in self.dispensable",
    ),
    Planted(
        "sums_wait_for_the_old_clock",
        "A robot without coordinators sums up again only when its clock, which was set back, is as late as before.",
        "swarmabs_core.realtime.peer",
        "self._plane, self._summed = None, -1",
        "self._plane = None",
    ),
    Planted(
        "peer_of_the_old_clock_is_heard",
        "One of a pair whose clock was set back takes its silent peer for heard until the clock is as late again.",
        "swarmabs_core.realtime.leadership",
        "            self._heard = self._heard if step > before else _NEVER\n"
        "            self._spoke = self._able = _NEVER",
        "            self._spoke = self._able = _NEVER",
    ),
    Planted(
        "loop_waits_for_the_old_clock",
        "A node whose clock was set back begins no step until the clock is as late again.",
        "swarmabs_ros.timing",
        "elif self._made - current > MOST_BACK:",
        "elif current - self._made > MOST_BACK:",
    ),
    Planted(
        "removal_is_not_passed_on",
        "An observer does not tell those that start later that a robot was carried away.",
        "swarmabs_core.realtime.observer",
        "return (removal,)",
        "return ()",
    ),
    Planted(
        "brakes_by_an_old_measurement",
        "A robot with a silent sensor brakes by the velocity that it measured last, until it moves backwards.",
        "swarmabs_core.realtime.agent",
        "self._law.brake(m.velocity) if m is not None and self._fresh(now) else 0.0",
        "self._law.brake(m.velocity) if m is not None else 0.0",
    ),
    Planted(
        "hung_process_is_asked_to_end",
        "A process that hangs during the start is not killed, but asked to end.",
        "swarmabs_run.orchestration.process_run",
        "                        self._machine.signal(name, signal.SIGKILL)",
        "                        self._machine.signal(name, signal.SIGTERM)",
    ),
    Planted(
        "early_order_is_refused",
        "A steered node that hears an order before the one of an earlier step takes it for one of another swarm.",
        "swarmabs_core.behaviours.steering",
        "        if order.step > self._orders.known + 2:",
        "        if order.step > self._orders.known + 1:",
    ),
)

LATE = (
    "stop_is_lost_in_a_takeover",
    "deaf_on_one_side",
    "a_start_never_finds_its_counterparts",
    "two_steps_are_missing",
    "mixed_sets",
    "deaf_after_a_restart",
    "never_starts_again",
    "goes_on_after_a_pause",
    "forgets_what_it_saw",
    "a_merge_drops_messages_of_the_same_time",
)
"""Those of the kind that once was found by chance, in trials of minutes with real processes."""


class _Gardener(MetaPathFinder):
    """Finds a module with its right text replaced by the wrong one."""

    def __init__(self, planted: Planted) -> None:
        self._planted = planted

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname != self._planted.module:
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        assert spec is not None
        assert spec.origin is not None
        spec.loader = _Changed(fullname, spec.origin, self._planted)
        return spec


class _Changed(SourceFileLoader):
    def __init__(self, fullname: str, path: str, planted: Planted) -> None:
        super().__init__(fullname, path)
        self._planted = planted

    def get_code(self, fullname: str) -> object:  # type: ignore[override]
        return self.source_to_code(changed(self.get_data(self.path).decode(), self._planted), self.path)


def changed(source: str, planted: Planted) -> str:
    """Return the source of a module with a mistake; raises `ValueError` unless the right text occurs once."""
    if source.count(planted.right) != 1:
        raise ValueError(f"{planted.name}: {planted.module} has {planted.right!r} {source.count(planted.right)} times")
    return source.replace(planted.right, planted.wrong)


def search(planted: Planted, minutes: float) -> int:
    """Plant a mistake in this process, which has not imported the module yet, and search until it is found."""
    assert planted.module not in sys.modules
    sys.meta_path.insert(0, _Gardener(planted))
    from tests.virtual.disk import own_folder  # noqa: PLC0415 - only now, with the mistake
    from tests.virtual.search import trial  # noqa: PLC0415

    started = time.process_time()
    with own_folder():
        for seed in count(1):
            one, took = trial(seed), time.process_time() - started
            if one.broken:
                print(f"{planted.name}: found by seed {seed} within {took:.0f} s: {one.text}", flush=True)
                return 0
            if took > 60.0 * minutes:
                break
    print(f"{planted.name}: NOT FOUND within {took:.0f} s by {seed} seeds", flush=True)
    return 1


def main(arguments: list[str] | None = None) -> int:
    """Search for each mistake in a process of its own; return 1 if one is not found."""
    parser = argparse.ArgumentParser(prog="python -m tests.virtual.planted")
    parser.add_argument("names", nargs="*", help="by default all")
    parser.add_argument("--minutes", type=float, default=MINUTES, help="time of the processor for each")
    options = parser.parse_args(arguments)
    known = {planted.name: planted for planted in PLANTED}
    if unknown := [name for name in options.names if name not in known]:
        parser.error(f"no such mistake: {', '.join(unknown)}; there are {', '.join(known)}")
    if len(options.names) == 1:
        return search(known[options.names[0]], options.minutes)

    def alone(name: str) -> int:
        words = [sys.executable, "-m", "tests.virtual.planted", name, "--minutes", str(options.minutes)]
        return subprocess.run(words, check=False).returncode

    with ThreadPoolExecutor(cpu_count()) as pool:
        return max(pool.map(alone, options.names or known))


if __name__ == "__main__":
    sys.exit(main())
