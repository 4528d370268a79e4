"""``swarm report``."""

from __future__ import annotations

from pathlib import Path

import click

from swarmabs_analysis.report import check_target, default_folder, make_report, write_file
from swarmabs_cli.options import bag_argument, json_option, namespace_option
from swarmabs_cli.output import print_json


@click.command()
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
@json_option
def report(
    bag: Path, html: Path | None, png: Path | None, output: Path | None, namespace: str | None, *, as_json: bool
) -> int:
    """Show a recorded run: one HTML page that needs nothing else, and an overview as PNG.

    BAG is a run's folder, its bag folder, or an .mcap file. Both files are written as report.html and report.png into
    the run's folder, or beside a lone .mcap file. With --html or --png alone, only what they name is written.
    """
    folder = default_folder(bag) if output is None else output
    if output is not None or (html is None and png is None):
        html, png = html or folder / "report.html", png or folder / "report.png"
    targets = [path for path in (html, png) if path is not None]
    if len({path.resolve() for path in targets}) < len(targets):
        raise click.UsageError(f"--html and --png both name {html}.")
    for path in targets:
        check_target(path)
    made = make_report(bag, namespace=namespace)
    written = []
    for target, content in ((html, made.html.encode()), (png, made.png)):
        if target is not None:
            if write_file(target, content):
                click.echo(f"replaced an earlier report: {target}", err=True)
            written.append(str(target))
    if as_json:
        print_json({"files": written, "bag": str(made.bag), **made.numbers})
    else:
        for name in written:
            click.echo(name)
    return 0
