"""``swarm report``."""

from __future__ import annotations

from pathlib import Path

import click

from swarmabs_analysis.report import check_target, default_folder, make_report, write_file
from swarmabs_cli.options import bag_argument, examples, json_option, named_scenario_option, namespace_option
from swarmabs_cli.output import print_json


@click.command(epilog=examples("report runs/pd_het_4-001"))
@bag_argument
@click.option("--html", type=click.Path(path_type=Path), metavar="FILE", help="Write the page to this file.")
@click.option("--png", type=click.Path(path_type=Path), metavar="FILE", help="Write the overview to this file.")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Folder of report.html and report.png.  [default: that of the run]",
)
@namespace_option
@named_scenario_option()
@json_option
def report(
    bag: Path,
    html: Path | None,
    png: Path | None,
    output: Path | None,
    namespace: str | None,
    scenario: str | None,
    *,
    as_json: bool,
) -> int:
    """Write an HTML report and a picture of a run.

    BAG is the folder of a run, its bag folder, or an .mcap file. The report is one self-contained page. By default
    report.html and report.png are written to the folder of the run, or next to a single .mcap file. With only --html or
    only --png, only that file is written.
    """
    folder = default_folder(bag) if output is None else output
    if output is not None or (html is None and png is None):
        html, png = html or folder / "report.html", png or folder / "report.png"
    targets = [path for path in (html, png) if path is not None]
    if len({path.resolve() for path in targets}) < len(targets):
        raise click.UsageError(f"--html and --png both name {html}; name two files.")
    for path in targets:
        check_target(path)
    written_report = make_report(bag, namespace=namespace, scenario=scenario)
    contents = {html: written_report.html.encode() if html else b"", png: written_report.png if png else b""}
    written = []
    for target in targets:
        if write_file(target, contents[target]):
            click.echo(f"replaced an earlier report: {target}", err=True)
        written.append(str(target))
    if as_json:
        print_json({"files": written, "bag": str(written_report.bag), **written_report.numbers})
    else:
        for name in written:
            click.echo(name)
    return 0
