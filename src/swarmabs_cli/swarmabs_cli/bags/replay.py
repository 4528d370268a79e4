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
from swarmabs_cli.options import bag_argument, json_option, namespace_option, output_option, set_option
from swarmabs_cli.output import print_json, print_warnings, results_folder
from swarmabs_cli.runs import print_summary, summed_up
from swarmabs_core.errors import InputError
from swarmabs_core.publishers import NodeName
from swarmabs_run.ending import end_asked
from swarmabs_run.run import Outcome

_POSITIVE = click.FloatRange(0.0, min_open=True, max=1e6)
_WITH_NODE = ("output", "overrides", "in_process", "expect_same")
_WITHOUT_NODE = ("rate", "start", "loop", "topics", "wait", "network")


@click.command()
@bag_argument
@click.option(
    "--node", "nodes", multiple=True, metavar="NODE", help="controller, observer, plane or agent:N; repeatable."
)
@click.option("--in-process", is_flag=True, help="Replay in one process without DDS, as fast as possible.")
@set_option("Change a value for the nodes; repeatable.")
@click.option("--expect-same", is_flag=True, help="Exit with code 1 if the digest is another one.")
@output_option("Folder of the replay.  [default: runs/NAME-replay-NNN]")
@click.option("--duration", type=_POSITIVE, metavar="SECONDS", help="How much to replay, in recorded time.")
@click.option("--rate", type=_POSITIVE, help="Without --node: recorded time per real time.  [default: 1]")
@click.option(
    "--start", type=click.FloatRange(0.0), metavar="SECONDS", help="Without --node: where in the bag to begin."
)
@click.option("--loop", is_flag=True, help="Without --node: begin again at the end, until Ctrl-C.")
@click.option("--topics", metavar="NAME,NAME", help="Without --node: what to play.  [default: all]")
@click.option("--wait", is_flag=True, help="Without --node: begin when every topic has a reader.")
@click.option("--network", is_flag=True, help="Without --node: play to other machines too, not to this one alone.")
@namespace_option
@json_option
def replay(bag: Path, nodes: tuple[str, ...], *, as_json: bool, **options: Any) -> int:
    """Replay a bag: to nodes under test, or, without --node, to whoever listens.

    With --node the nodes named are computed anew from what was recorded of all others, in lockstep and without loss;
    the result is a new bag and how it differs. This is open loop: nothing reacts to the new answers but the other nodes
    under test.

    Without --node every message is published at its time in the caller's ROS domain.
    """
    wrong = next((name for name in (_WITHOUT_NODE if nodes else _WITH_NODE) if options[name]), None)
    if wrong is not None:
        option = {"overrides": "--set", "output": "--output"}.get(wrong, "--" + wrong.replace("_", "-"))
        raise InputError(f"{option} is for a replay {'without' if nodes else 'with'} --node; leave one of them out")
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
    print_summary(summary, folder, outcome, *(replay_parts(result) if result is not None else ()), as_json=as_json)
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
    """Play a bag to whoever listens; return the exit code."""
    pace = Pace(1.0 if rate is None else rate, start or 0.0, duration, loop)
    bag = open_bag(path, namespace=namespace, several=True)
    if not network:  # who has set a range has decided already, such as the environment of a run
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
