"""``swarm info`` and ``swarm repair``: the contents of bags, and the repair of damaged ones."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import click

from swarmabs_bag.info import bag_info, render
from swarmabs_bag.repair import RepairReport, repair_bag
from swarmabs_cli.options import bag_argument, bags_argument, examples, json_option, output_option
from swarmabs_cli.output import print_documents, print_json, print_tables, printable


@click.command(epilog=examples("info runs/pd_het_4-001"))
@bags_argument
@json_option
def info(bags: tuple[Path, ...], *, as_json: bool) -> int:
    """Show what bags contain and whether they are complete.

    A BAG is the folder of a run, its bag folder, or an .mcap file.
    """
    found = [bag_info(path) for path in bags]
    if as_json:
        print_documents([asdict(one) for one in found])
    else:
        print_tables(*map(render, found))
    return 0 if all(one.complete for one in found) else 1


@click.command(epilog=examples("repair runs/pd_het_4-001"))
@bag_argument
@output_option("Folder of the repaired bag.  [default: BAG_repaired]")
@click.option("--in-place", is_flag=True, help="Replace the damaged files and keep them as NAME.damaged.")
@json_option
def repair(bag: Path, output: Path | None, *, in_place: bool, as_json: bool) -> int:
    """Repair a damaged bag and report what was lost.

    BAG is the folder of a run, its bag folder, or an .mcap file. A complete bag is left as it is. The exit code is 0
    whenever the result is a complete bag, even if messages were lost.
    """
    report = repair_bag(bag, output, in_place=in_place)
    if as_json:
        print_json(asdict(report))
    else:
        for line in _lines(report):
            click.echo(printable(line))
    return 0


def _lines(report: RepairReport) -> Iterator[str]:
    yield from report.problems
    for file in report.files:
        for problem in file.problems:
            yield f"{file.file}: {problem}"
        for part in file.lost:
            span = "" if part.start is None else f", recorded as {part.start:.9g} s to {part.end:.9g} s"
            yield f"lost: {part.bytes} bytes at byte {part.offset} of {Path(file.file).name}{span}"
    for topic in report.topics:
        lost = f", {topic.lost} known to be lost" if topic.lost else ""
        last = topic.last_complete_step
        step = "" if last is None or last < (report.first_step or 0) else f", complete up to step {last}"
        yield f"{topic.name}: {topic.messages} messages{lost}{step}"
    for name in report.lost_attachments:
        yield f"lost: attachment {name}"
    if report.last_complete_step is not None:
        yield _complete_steps(report)
    if report.undecided is not None:
        yield f"no repair can decide this: {report.undecided}"
    if report.output is None:
        yield f"{report.bag}: nothing to repair" if report.undecided else f"{report.bag} is complete: nothing to repair"
    else:
        yield f"wrote {report.messages} messages to {report.output}"


def _complete_steps(report: RepairReport) -> str:
    first, last = report.first_step, report.last_complete_step
    if first is None or last is None or last < first:
        return f"none of the steps 0 to {report.last_planned_step} is complete"
    return f"steps {first} to {last} of 0 to {report.last_planned_step} are complete"
