"""``swarm replay``."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import click

from swarmabs_analysis.comparison.table import replay_parts
from swarmabs_analysis.replay.playback import Pace, choose_topics, play, shown
from swarmabs_analysis.replay.run import ReplayRun
from swarmabs_analysis.replay.source import open_source
from swarmabs_bag.reader import open_bag
from swarmabs_cli.options import (
    Number,
    bag_argument,
    examples,
    json_option,
    namespace_option,
    output_option,
    set_option,
)
from swarmabs_cli.output import print_json, print_warnings, results_folder
from swarmabs_cli.runs import print_summary, summed_up
from swarmabs_core.errors import InputError
from swarmabs_core.nodes import NodeName
from swarmabs_run.ending import end_asked
from swarmabs_run.run import Outcome

_POSITIVE = Number(0.0, min_open=True, max=1e6)
_WITH_NODE = ("output", "overrides", "in_process", "expect_same")
_WITHOUT_NODE = ("rate", "start", "loop", "topics", "wait", "network")


@click.command(
    epilog=examples(
        "replay runs/pd_het_4-001 --node controller --set controller.gains=[4,3]", "replay runs/pd_het_4-001 --rate 2"
    )
)
@bag_argument
@click.option(
    "--node", "nodes", multiple=True, metavar="NODE", help="controller, observer, parent or agent:N; repeatable."
)
@click.option("--in-process", is_flag=True, help="With --node: replay in one process, without DDS.")
@set_option("With --node: change a value for these nodes; repeatable.")
@click.option("--expect-same", is_flag=True, help="With --node: exit with 1 if the digest differs.")
@output_option("Folder of the replay.  [default: runs/NAME-replay-NNN]")
@click.option("--duration", type=_POSITIVE, metavar="SECONDS", help="Recorded time to replay.  [default: all]")
@click.option("--rate", type=_POSITIVE, help="Without --node: recorded time per real time.  [default: 1]")
@click.option("--start", type=Number(0.0), metavar="SECONDS", help="Without --node: recorded time at which to start.")
@click.option("--loop", is_flag=True, help="Without --node: start over at the end, until Ctrl-C.")
@click.option("--topics", metavar="NAME,NAME", help="Without --node: topics to play.  [default: all]")
@click.option("--wait", is_flag=True, help="Without --node: wait until every topic has a subscriber.")
@click.option("--network", is_flag=True, help="Without --node: publish to other machines, too.")
@namespace_option
@json_option
def replay(bag: Path, nodes: tuple[str, ...], *, as_json: bool, **options: Any) -> int:
    """Play a bag, or re-execute selected nodes against it.

    With --node, the named nodes are re-executed in lockstep on the recorded messages of all other nodes, without loss;
    the result is a new bag and a report of the differences. The replay is open loop: recorded nodes do not react.

    Without --node, every message is published at its recorded time in the current ROS domain.
    """
    wrong = next((name for name in (_WITHOUT_NODE if nodes else _WITH_NODE) if options[name]), None)
    if wrong is not None:
        option = {"overrides": "--set", "output": "--output"}.get(wrong, "--" + wrong.replace("_", "-"))
        remedy = "cannot be combined with --node; remove one of them" if nodes else "needs --node; add it"
        raise InputError(f"{option} {remedy}")
    return _replay(bag, nodes, as_json=as_json, **options) if nodes else _play(bag, as_json=as_json, **options)


def _replay(
    bag: Path,
    names: tuple[str, ...],
    *,
    overrides: tuple[str, ...],
    output: Path | None,
    duration: float | None,
    in_process: bool,
    expect_same: bool,
    namespace: str | None,
    as_json: bool,
    **_: object,
) -> int:
    """Try nodes out on a recording; return the exit code."""
    nodes = tuple(dict.fromkeys(NodeName.parse(name) for name in names))
    source = open_source(bag, namespace=namespace)
    if duration is not None:
        overrides = (*overrides, f"duration={duration!r}")
    made = ReplayRun(source, nodes, overrides, source.scenario(nodes, overrides))
    scenario = made.scenario
    folder = results_folder(output, f"{scenario.name}-replay")

    def compare(outcome: Outcome) -> dict[str, object]:
        return {"replay": made.result(folder, outcome.figures.get("digest")) if outcome.status == "ok" else None}

    run = made.in_process if in_process else made.live
    outcome, summary = summed_up(scenario, folder, lambda show: run(folder, show), compare)
    result = summary["replay"]
    tables = replay_parts(result) if result is not None else ()
    print_summary(scenario, summary, folder, outcome, *tables, as_json=as_json)
    failed = outcome.status != "ok" or (expect_same and result is not None and not result["same"])
    return 1 if failed else 0


def _play(
    path: Path,
    *,
    duration: float | None,
    rate: float | None,
    start: float | None,
    loop: bool,
    topics: str | None,
    wait: bool,
    network: bool,
    namespace: str | None,
    as_json: bool,
    **_: object,
) -> int:
    """Play a bag; return the exit code."""
    pace = Pace(1.0 if rate is None else rate, start or 0.0, duration, loop)
    bag = open_bag(path, namespace=namespace, several=True)
    if not network:  # a range that is set already, such as by the environment of a run, is kept
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    wanted = topics.split(",") if topics else ()
    playable, warnings = choose_topics(bag, wanted, one_swarm=namespace is not None)
    print_warnings(warnings)
    names = [topic.channel.name for topic in playable]
    with end_asked() as asked:
        click.echo(
            f"playing {', '.join(map(shown, names))} in ROS domain {os.environ.get('ROS_DOMAIN_ID') or 0}", err=True
        )
        count = play(bag, playable, pace, wait=wait, asked_to_end=asked)
    if as_json:
        print_json({"bag": str(bag.path), "topics": names, "messages": count})
    else:
        click.echo(f"{count} messages published")
    return 0
