"""``swarm verify``."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import click

from swarmabs_analysis.comparison.table import deviation_table
from swarmabs_analysis.verification.base import VerificationResult
from swarmabs_analysis.verify import BagToVerify, open_to_verify
from swarmabs_bag.errors import repair_command
from swarmabs_cli.options import (
    Number,
    bags_argument,
    examples,
    json_option,
    named_scenario_option,
    namespace_option,
    node_option,
    set_option,
)
from swarmabs_cli.output import print_documents, print_tables, printable
from swarmabs_core.errors import InputError
from swarmabs_core.nodes import NodeName

_LINE_INTERVAL = 2.0


@click.command(
    epilog=examples(
        "verify runs/pd_het_4-001", "verify runs/pd_het_4-001 --node controller --set controller.gains=[4,3]"
    )
)
@bags_argument
@node_option("Recompute only this node: controller, observer, parent or agent:N; repeatable.")
@set_option("With --node: change a value for these nodes; repeatable.")
@click.option(
    "--tolerance",
    type=Number(min=0.0, max=1.0, max_open=True),
    default=0.0,
    metavar="T",
    help="Accept a number within T (1 + |b|) of the recomputed value b.  [default: 0, bit for bit]",
)
@namespace_option
@named_scenario_option()
@json_option
def verify(
    bags: tuple[Path, ...],
    *,
    nodes: tuple[NodeName, ...],
    overrides: tuple[str, ...],
    tolerance: float,
    namespace: str | None,
    scenario: str | None,
    as_json: bool,
) -> int:
    """Recompute every message of a bag and compare bit for bit.

    Each message is recomputed from the recorded scenario and the messages before it. The first difference is reported
    with topic, step, robot and field. A BAG is the folder of a run, its bag folder, or an .mcap file.

    With --node, only the messages of the named nodes are recomputed, if necessary with other settings, and the
    deviation of each field is reported. The nodes receive recorded messages: nothing reacts to what they answer.
    """
    if overrides and not nodes:
        raise InputError("--set needs --node; add it")
    if tolerance and nodes:
        raise InputError("--tolerance cannot be combined with --node; remove one of them")
    # Open all bags first, so that invalid input is rejected before any verification starts.
    opened = [open_to_verify(path, namespace=namespace, scenario=scenario) for path in bags]
    trials = [bag.trial(nodes, overrides) if nodes and isinstance(bag, BagToVerify) else None for bag in opened]
    verdicts = [
        bag
        if isinstance(bag, VerificationResult)
        else bag.verify(tolerance, _shown(bag.scenario.name, bag.scenario.steps), trial)
        for bag, trial in zip(opened, trials, strict=True)
    ]
    if as_json:
        documents = [verdict.to_dict() for verdict in verdicts]
        print_documents(documents)
    else:
        for verdict in verdicts:
            click.echo(describe(verdict))
            if verdict.trial.get("deviations"):
                print_tables(deviation_table(verdict.trial["deviations"]))
    return 0 if all(verdict.ok for verdict in verdicts) else 1


def describe(verdict: VerificationResult) -> str:
    """Describe the result in a few lines."""
    lines = [f"{verdict.bag}: {'ok' if verdict.ok else 'NOT ok'}"]
    if verdict.scenario is not None:
        how = f"agree within {verdict.tolerance:g}" if verdict.tolerance else "agree bit for bit"
        of = "" if verdict.expected_steps is None else f" of {verdict.expected_steps}"
        if verdict.trial:
            nodes = ", ".join(verdict.trial["nodes"])
            how = f"of {nodes} are compared" if verdict.difference is not None else f"of {nodes} agree bit for bit"
        lines.append(f"  {verdict.messages} messages of {verdict.steps}{of} steps {how}")
    if verdict.not_checkable:
        lines.append(f"  not checkable: {sum(verdict.not_checkable.values())} messages")
        lines.extend(f"    {number}: {reason}" for reason, number in verdict.not_checkable.most_common())
    lines.extend(
        f"  a second sender on {of}, steps {first} to {last}: nodes may have followed it, and its messages are not here"
        for of, (first, last) in verdict.second_senders.items()
    )
    if verdict.difference is not None:
        lines.append(f"  first difference: {verdict.difference}")
    if verdict.problem is not None:
        opened = verdict.scenario is not None
        lines.append(f"  damaged: {verdict.problem}{f'; {repair_command(verdict.bag)}' if opened else ''}")
    if verdict.ended_early is not None:
        lines.append(f"  the run ended early: {verdict.ended_early}")
    if verdict.lost is not None:
        lines.append(f"  not complete: repaired, {verdict.lost}; which messages are missing is not known")
    if verdict.digest is not None:
        lines.append(f"  digest {verdict.digest}")
    lines.extend(f"  note: {note}" for note in verdict.notes)
    return "\n".join(printable(line) for line in lines)


def _shown(name: str, steps: int) -> Callable[[int], None]:
    """Return a callback that reports progress on standard error every few seconds."""
    reported, latest = time.monotonic(), -1

    def show(step: int) -> None:
        nonlocal reported, latest
        if step == latest:
            return
        latest, now = step, time.monotonic()
        if now - reported >= _LINE_INTERVAL:
            reported = now
            click.echo(f"{name}: step {step} of {steps} verified", err=True)

    return show
