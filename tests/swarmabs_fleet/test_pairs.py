"""Coordinators with a standby as an operator sees and commands them; their nodes are simulated."""

import json
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from math import inf, isfinite

import pytest
from tests.swarmabs_fleet.fleets import EXAMPLES

from swarmabs_cli import main
from swarmabs_cli.fleet import operate
from swarmabs_core.errors import InputError, RunError
from swarmabs_fleet import pairs
from swarmabs_fleet.operate import HealthMonitor, OperatorClient, target

PRIMARY, STANDBY = "parent_controller", "parent_controller_standby"
SERVICES = {
    f"{prefix}swarm/{name}": node
    for prefix, node in (("", PRIMARY), ("standby/", STANDBY))
    for name in ("stop", "reset")
}


@dataclass
class Nodes(OperatorClient):
    """Two controllers by what they do; one that does nothing is dead."""

    doing: dict[str, str]
    takes_over: bool = True
    left: dict[str, str] = field(default_factory=dict)
    called: list[str] = field(default_factory=list)
    repeats: bool = False

    def call_each(self, services: Sequence[str], patience: float, *, interval: float = inf) -> dict[str, str]:
        self.called += services
        self.repeats = isfinite(interval)
        return {name: "" if self.doing[SERVICES[name]] else f"{name} was not found" for name in services}

    def call(self, service: str, patience: float) -> None:
        self.called.append(service)
        node, _, name = service.partition("/")
        assert (name, self.doing[node]) == ("release", "leads")
        if self.takes_over:
            (other,) = self.doing.keys() - {node}
            self.doing |= {node: "stands by", other: "leads"}

    def listen(self, monitor: HealthMonitor, patience: float, enough: Callable[[], bool]) -> None:
        for node, role in self.doing.items():
            if role and node in monitor.hosts:
                monitor.hear(node, 0, "", {"role": role, "left": self.left.get(node, "")}, 0.0)
        enough()


@pytest.mark.parametrize(
    ("primary", "standby", "work"),
    [
        ("leads", "stands by", "stop reset"),
        ("stands by", "leads", "stop reset"),
        ("leads", "", "stop reset"),
        ("", "leads", "stop reset"),
        ("stands by", "", "stop"),
        ("", "listens", "stop"),
        ("", "", ""),
    ],
)
def test_a_stop_needs_either_controller_and_a_reset_the_one_that_leads(primary: str, standby: str, work: str) -> None:
    dead = [name for name, role in (("swarm/", primary), ("standby/swarm/", standby)) if not role]
    with target(EXAMPLES["standby"]) as swarm:
        for command, name in ((pairs.stop, "stop"), (pairs.reset, "reset")):
            nodes = Nodes({PRIMARY: primary, STANDBY: standby})
            if name in work:
                assert command(swarm, nodes, 0.0) == [f"{prefix}{name} was not found" for prefix in dead]
            else:
                with pytest.raises(RunError, match=f"{dead[0]}{name} was not found"):
                    command(swarm, nodes, 0.0)
            assert nodes.called == [f"swarm/{name}", f"standby/swarm/{name}"]
            assert nodes.repeats == (name == "stop"), "a repeated reset could undo a later stop"
    with target(EXAMPLES["lan"]) as swarm:
        nodes = Nodes({PRIMARY: "alone"})
        assert pairs.stop(swarm, nodes, 0.0) == []
        assert nodes.called == ["swarm/stop"]


@pytest.mark.parametrize(("confirming", "code"), [(("leads",), 0), (("stands by",), 1), ((), 1)])
def test_the_observer_that_leads_confirms_a_removal(
    confirming: tuple[str, ...], code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for roles in (("leads", "stands by"), ("stands by", "leads")):
        doing = dict(zip(("abstraction_observer", "abstraction_observer_standby"), roles, strict=True))
        nodes = Nodes(doing, left={node: "1 2" for node, role in doing.items() if role in confirming})
        monkeypatch.setattr(nodes, "carried_away", lambda *_: nullcontext())
        monkeypatch.setattr(operate, "joined", lambda _, nodes=nodes: nullcontext(nodes))
        assert main(["remove", str(EXAMPLES["standby"]), "2"]) == code
        assert ("only a silent robot can be removed" in capsys.readouterr().err) == bool(code)


def test_a_failover_swaps_those_that_are_ready_for_it() -> None:
    with target(EXAMPLES["standby"]) as swarm:
        nodes = Nodes({PRIMARY: "leads", STANDBY: "stands by"})
        assert [pairs.failover(swarm, nodes, "controller", 0.0) for _ in range(3)] == [STANDBY, PRIMARY, STANDBY]
        for primary, standby, words in (
            ("leads", "", f"{PRIMARY} leads, {STANDBY} is silent"),
            ("leads", "listens", f"{STANDBY} listens"),
            ("leads", "leads", "a failover needs one that leads and one that stands by"),
        ):
            nodes = Nodes({PRIMARY: primary, STANDBY: standby})
            with pytest.raises(RunError, match=words):
                pairs.failover(swarm, nodes, "controller", 0.0)
            assert nodes.called == []
        alone = Nodes({PRIMARY: "leads", STANDBY: "stands by"}, takes_over=False)
        with pytest.raises(RunError, match=f"{STANDBY} has not taken over, {PRIMARY} leads"):
            pairs.failover(swarm, alone, "controller", 0.0)
        assert pairs.chosen(swarm, None) == ["observer", "controller"]
    with target(EXAMPLES["lan"]) as swarm, pytest.raises(InputError, match=r"add 'standby: HOST' to coordinators\.obs"):
        pairs.chosen(swarm, "observer")


def test_the_command_tells_which_coordinators_lead_after_a_failover(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for words, expected in (
        ([], f"pair: {STANDBY} leads, on spare\n"),
        (
            ["--json"],
            {"swarm": "pair", "leaders": [{"coordinator": "controller", "leader": STANDBY, "host": "spare"}]},
        ),
    ):
        nodes = Nodes({PRIMARY: "leads", STANDBY: "stands by"})
        monkeypatch.setattr(operate, "target", lambda _: target(EXAMPLES["standby"]))
        monkeypatch.setattr(operate, "joined", lambda _, nodes=nodes: nullcontext(nodes))
        assert main(["failover", str(EXAMPLES["standby"]), "controller", "--timeout", "0.1", *words]) == 0
        printed = capsys.readouterr().out
        assert (json.loads(printed) if words else printed) == expected


def test_a_failover_of_a_fleet_without_standbys_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["failover", str(EXAMPLES["lan"])]) == 2
    assert "no coordinator has a standby; add" in capsys.readouterr().err


def test_an_operator_on_another_host_is_told_where_to_work(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("swarmabs_fleet.operate.problem_of", lambda _: "no such address")
    for command in ("status", "stop", "failover"):
        assert main([command, str(EXAMPLES["standby"])]) == 2
        assert "run this on base (192.168.50.1) or spare (192.168.50.2)\n" in capsys.readouterr().err


def test_a_role_is_shown_with_its_duration() -> None:
    assert pairs.role({"role": "leads", "role for, s": "20"}) == "leads for 20 s"
    assert pairs.role({"state": "active"}) == ""
