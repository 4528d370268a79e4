"""``swarm repair``: the repair of damaged bags, and the merge of several."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

import click

from swarmabs_bag.info import said_steps
from swarmabs_bag.merge import MergeReport, merge_bags
from swarmabs_bag.repair import RepairReport, repair_bag
from swarmabs_cli.options import bags_argument, examples, json_option, output_option
from swarmabs_cli.output import print_json, printable

_MOST_SHOWN = 20
"""Most gaps, contradictions and robots in a text; the JSON document has all."""


@click.command(
    epilog=examples("repair runs/pd_het_4-001", "repair --merge bags/primary bags/standby -o bags/both"),
)
@bags_argument
@output_option("Folder of the new bag.  [default: BAG_repaired; required with --merge]")
@click.option("--in-place", is_flag=True, help="Replace the damaged files and keep them as NAME.damaged.")
@click.option("--merge", is_flag=True, help="Merge bags that several recorders wrote of one run.")
@json_option
def repair(bags: tuple[Path, ...], output: Path | None, *, in_place: bool, merge: bool, as_json: bool) -> int:
    """Repair a damaged bag and report what was lost, or merge bags of one run.

    A BAG is the folder of a run, its bag folder, or an .mcap file. A complete bag is left as it is. The exit code is 0
    whenever the result is a complete bag, even if messages were lost.

    With --merge, the new bag contains what any of the bags contains. The exit code is 0 only if no message is known to
    be missing from it, and none differs.
    """
    if merge:
        return _merge(bags, output, in_place=in_place, as_json=as_json)
    if len(bags) > 1:
        raise click.UsageError("repair takes one BAG; add --merge to merge bags of one run.")
    report = repair_bag(bags[0], output, in_place=in_place)
    if as_json:
        print_json(asdict(report))
    else:
        _print(_lines(report))
    return 0


def _merge(bags: tuple[Path, ...], output: Path | None, *, in_place: bool, as_json: bool) -> int:
    if len(bags) < 2 or output is None or in_place:
        raise click.UsageError("--merge takes two or more BAGs and a new folder: --merge A B -o C, without --in-place.")
    report = merge_bags(bags, output)
    if as_json:
        print_json(asdict(report))
    else:
        _print(_merge_lines(report))
    return 0 if report.complete else 1


def _print(lines: Iterator[str]) -> None:
    for line in lines:
        click.echo(printable(line))


def _merge_lines(report: MergeReport) -> Iterator[str]:
    for bag in report.bags:
        if bag.repaired is not None:
            for line in _problems(bag.repaired):
                yield f"repaired first: {line}"
        yield f"{bag.bag}: {bag.messages} messages of {said_steps(bag.steps)}"
    for name, count in report.topics.items():
        yield f"/{name}: {count} messages"
    for gap in report.gaps[:_MOST_SHOWN]:
        robots = f" of {_said('robot', gap.robots)}" if gap.robots else ""
        topic = "every topic" if gap.topic is None else f"/{gap.topic}"
        yield f"missing: {topic}{robots}, {said_steps([(gap.first, gap.last)])}"
    for place in report.contradictions[:_MOST_SHOWN]:
        robot = f" of robot {place.robot}" if place.robot else ""
        yield f"different: /{place.topic}{robot}, step {place.step}; the first one received is kept"
    for kind, count in (("missing", len(report.gaps)), ("different", len(report.contradictions))):
        if count > _MOST_SHOWN:
            yield f"{kind}: {count - _MOST_SHOWN} more; --json lists them all"
    if report.ended_early is not None:
        yield f"ended early: {report.ended_early}"
    verdict = "nothing is known to be missing" if report.complete else "the bag is not complete"
    yield f"wrote {report.messages} messages to {report.output}; {verdict}"


def _said(word: str, numbers: Sequence[int]) -> str:
    more = f" and {len(numbers) - _MOST_SHOWN} more" if len(numbers) > _MOST_SHOWN else ""
    return f"{word}{'s' if len(numbers) > 1 else ''} {', '.join(map(str, numbers[:_MOST_SHOWN]))}{more}"


def _problems(report: RepairReport) -> Iterator[str]:
    yield from report.problems
    for file in report.files:
        for problem in file.problems:
            yield f"{file.file}: {problem}"
        for part in file.lost:
            span = "" if part.start is None else f", recorded as {part.start:.9g} s to {part.end:.9g} s"
            yield f"lost: {part.bytes} bytes at byte {part.offset} of {Path(file.file).name}{span}"


def _lines(report: RepairReport) -> Iterator[str]:
    yield from _problems(report)
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
