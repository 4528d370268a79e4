"""``swarm replay``."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import TYPE_CHECKING

import click

from swarmabs_analysis.comparison.table import deviation_table
from swarmabs_analysis.replay.answers import Answers
from swarmabs_analysis.replay.playback import Pace, choose_topics, play, shown
from swarmabs_analysis.replay.start import start_commands
from swarmabs_bag.reader import open_bag
from swarmabs_cli.options import Number, bag_argument, examples, json_option, namespace_option, node_option
from swarmabs_cli.output import print_json, print_tables, print_warnings
from swarmabs_core.errors import InputError
from swarmabs_run.ending import end_asked

if TYPE_CHECKING:
    from swarmabs_analysis.replay.answers import Comparison
    from swarmabs_core.nodes import NodeName

_POSITIVE = Number(0.0, min_open=True, max=1e6)


@click.command(epilog=examples("replay runs/pd_het_4-001 --rate 2", "replay runs/pd_het_4-001 --node controller"))
@bag_argument
@node_option("Leave this node to be tested: controller, observer, parent or agent:N; repeatable.")
@click.option("--expect-same", is_flag=True, help="With --node: exit with 1 if an answer differs.")
@click.option("--rate", type=_POSITIVE, help="Recorded time per real time.  [default: 1; with --node: any]")
@click.option("--start", type=Number(0.0), metavar="SECONDS", help="Without --node: recorded time at which to start.")
@click.option("--duration", type=_POSITIVE, metavar="SECONDS", help="Recorded time to play.  [default: all]")
@click.option("--loop", is_flag=True, help="Without --node: start over at the end, until Ctrl-C.")
@click.option("--topics", metavar="NAME,NAME", help="Topics to play.  [default: all]")
@click.option("--wait", is_flag=True, help="Without --node: wait until every topic has a subscriber.")
@click.option("--network", is_flag=True, help="Publish to other machines, too.")
@namespace_option
@json_option
def replay(
    bag: Path,
    nodes: tuple[NodeName, ...],
    *,
    expect_same: bool,
    rate: float | None,
    start: float | None,
    duration: float | None,
    loop: bool,
    topics: str | None,
    wait: bool,
    network: bool,
    namespace: str | None,
    as_json: bool,
) -> int:
    """Play a bag, for displays or for nodes under test.

    Every message is published at its recorded time in the current ROS domain, except for those of the nodes that are
    named by --node: start these yourself, in any language. The playback waits for each of their answers, and reports
    how they differ from the recording. A replay is open loop: recorded nodes do not react.
    """
    for name, value in {"start": start, "loop": loop, "wait": wait}.items() if nodes else ():
        if value:
            raise InputError(f"--{name} cannot be combined with --node; remove one of them")
    if expect_same and not nodes:
        raise InputError("--expect-same needs --node; add it")
    pace = Pace(rate or (math.inf if nodes else 1.0), start or 0.0, duration, loop)
    recorded = open_bag(bag, namespace=namespace, several=not nodes)
    answers = Answers(recorded, nodes) if nodes else None
    commands = tuple(start_commands(recorded, nodes)) if nodes else ()
    if not network:  # a range that is set already, such as by the environment of a run, is kept
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    playable, warnings = choose_topics(
        recorded, topics.split(",") if topics else (), one_swarm=namespace is not None or bool(nodes)
    )
    print_warnings(warnings)
    if answers is not None:
        playable = [topic for topic in playable if topic.channel.topic not in answers.not_played]
    names = [topic.channel.name for topic in playable]
    with end_asked() as asked:
        domain = os.environ.get("ROS_DOMAIN_ID") or 0
        click.echo(f"playing {', '.join(map(shown, names))} in ROS domain {domain}", err=True)
        if nodes:
            click.echo("waiting for the nodes under test; with the settings of the recording they start with", err=True)
            for command in commands:
                click.echo(f"  {command}", err=True)
        count = play(recorded, playable, pace, answers=answers, wait=wait, asked_to_end=asked)
    result = None if answers is None else answers.to_dict()
    if as_json:
        print_json({"bag": str(recorded.path), "topics": names, "messages": count, **(result or {})})
    else:
        click.echo(f"{count} messages published")
        if result is not None:
            _print_result(result)
    return 1 if result is not None and expect_same and not result["same"] else 0


def _print_result(result: Comparison) -> None:
    """Print how the answers of the nodes under test differ from the recording."""
    compared = f"{', '.join(result['nodes'])}: {result['compared']} messages compared with the recording"
    first = result["first_difference"]
    if first is None:
        click.echo(f"{compared}; {'no difference' if result['same'] else 'the last answers are missing'}")
        return
    robot = f" of robot {first['agent']}" if first["agent"] else ""
    click.echo(
        f"{compared}; first difference: step {first['step']}, {first['topic']}{robot}, {first['field']} is "
        f"{first['replayed']!r}, was {first['recorded']!r}"
    )
    print_tables(deviation_table(result["deviations"]))
