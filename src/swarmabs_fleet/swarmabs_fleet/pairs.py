"""Whom an operator tells what: the controller and its standby, or all robots; which one leads, a planned failover."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_config.graph import CONTROLLER, OBSERVER, RECORDER, RELEASE, SERVICES, standby_service
from swarmabs_core.errors import InputError, RunError
from swarmabs_core.pair_role import ROLE, ROLE_FOR, PairRole
from swarmabs_fleet.operate import HealthMonitor

if TYPE_CHECKING:
    from collections.abc import Mapping

    from swarmabs_fleet.operate import OperatorClient, Target

STOP, RESET = SERVICES[CONTROLLER][:2]
PAIRS = {"observer": OBSERVER, "controller": CONTROLLER}
"""The coordinators of which one of a pair leads, by their names in the fleet file."""
AGAIN = 1.0
"""Time, s, after which a controller that does not answer is told again to stop, which does no harm."""


def stop(operated: Target, client: OperatorClient, patience: float) -> list[str]:
    """Tell the controller and its standby to stop the swarm; return what went wrong with one of them.

    Where robots control the swarm by themselves tell all of them: one that hears it is enough, as it tells the others.

    Raises
    ------
    RunError
        If none confirms it.
    """
    problems = client.call_each(_told(operated, STOP), patience, interval=AGAIN)
    missed = [problem for problem in problems.values() if problem]
    if len(missed) == len(problems):
        raise RunError(missed[0])
    return [] if operated.decentralised else missed


def can_stop(operated: Target, client: OperatorClient) -> bool:
    """Return whether somebody can be told at once that the swarm is to stop."""
    ready = [client.finds(service) for service in _told(operated, STOP)]
    return any(ready)


def reset(operated: Target, client: OperatorClient, patience: float) -> list[str]:
    """Tell the controller and its standby to resume; return what went wrong with the one that does not lead.

    Robots that control the swarm by themselves are told as for `stop`.

    Raises
    ------
    RunError
        If the one that leads does not confirm it.
    """
    services = _told(operated, RESET)
    problems = client.call_each(services, patience)
    missed = [problem for problem in problems.values() if problem]
    if len(missed) == len(services):
        raise RunError(missed[0])
    if operated.decentralised:
        return []
    confirmed = [
        node for node, service in zip(operated.pair(CONTROLLER), services, strict=True) if not problems[service]
    ]
    if missed:
        (node,) = confirmed
        monitor = HealthMonitor({node: operated.hosts[node]})
        client.listen(monitor, patience, lambda: leads(monitor, node))
        if not leads(monitor, node):
            raise RunError(f"{missed[0]}; only {node} answered, which does not lead, so robots may not move")
    return missed


def failover(operated: Target, client: OperatorClient, kind: str, patience: float) -> str:
    """Let the standing-by one of a pair take over; return the name of the node that then leads.

    Parameters
    ----------
    operated : Target
        The swarm.
    client : OperatorClient
        The connection to it.
    kind : str
        One of `paired`.
    patience : float
        Time limit, s, for hearing both, for the answer, and for the takeover.

    Raises
    ------
    RunError
        If not exactly one leads while the other stands by, or the takeover does not happen.
    """
    pair = operated.pair(PAIRS[kind])
    monitor = HealthMonitor({node: operated.hosts[node] for node in pair})

    def doing(state: PairRole) -> list[str]:
        return [node for node in pair if monitor.value(node, ROLE) == state.value]

    client.listen(monitor, patience, lambda: len(doing(PairRole.LEADING)) == len(doing(PairRole.FOLLOWING)) == 1)
    if not (len(doing(PairRole.LEADING)) == len(doing(PairRole.FOLLOWING)) == 1):
        said = ", ".join(f"{node} {monitor.value(node, ROLE) or 'is silent'}" for node in pair)
        raise RunError(
            f"{operated.name}: {said}; a failover needs one that leads and one that stands by, so start both"
        )
    (leader,), (peer,) = doing(PairRole.LEADING), doing(PairRole.FOLLOWING)
    client.call(RELEASE.replace("~", leader), patience)
    client.listen(monitor, patience, lambda: doing(PairRole.LEADING) == [peer])
    if doing(PairRole.LEADING) != [peer]:
        leads = ", ".join(doing(PairRole.LEADING)) or "none"
        raise RunError(
            f"{operated.name}: {peer} has not taken over, {leads} leads; see the node's journal and try again"
        )
    return peer


def _told(operated: Target, service: str) -> tuple[str, ...]:
    """Return a service's name at the controller, and at its standby if there is one; or at each of the robots."""
    if operated.decentralised:
        own = f"~/{service.rpartition('/')[2]}"
        return tuple(own.replace("~", operated.robot(robot)) for robot in operated.robots)
    return (service, standby_service(service))[: len(operated.pair(CONTROLLER))]


def leads(monitor: HealthMonitor, node: str) -> bool:
    """Return whether one of a pair leads, by its latest diagnostics."""
    return monitor.value(node, ROLE) == PairRole.LEADING.value


def role(values: Mapping[str, str]) -> str:
    """Return what one of a pair does and for how long, empty for other nodes."""
    return f"{values[ROLE]} for {values[ROLE_FOR]} s" if ROLE in values and ROLE_FOR in values else ""


def has_standbys(operated: Target) -> bool:
    """Return whether any coordinator of this swarm has a standby, the recorder included."""
    return any(len(operated.pair(node)) > 1 for node in (*PAIRS.values(), RECORDER))


def paired(operated: Target) -> list[str]:
    """Return the keys of `PAIRS` whose coordinator has a standby in this swarm."""
    return [kind for kind, node in PAIRS.items() if len(operated.pair(node)) > 1]


def chosen(operated: Target, kind: str | None) -> list[str]:
    """Return the pairs of a failover: all, or the one that is named.

    Raises
    ------
    InputError
        If the swarm has none, or not this one.
    """
    pairs = [name for name in paired(operated) if kind in {None, name}]
    if not pairs:
        what = f"the {kind} has no standby" if kind else "no coordinator has a standby"
        raise InputError(f"{operated.name}: {what}; add 'standby: HOST' to coordinators.{kind or 'controller'}")
    return pairs
