"""``swarm figures``."""

from __future__ import annotations

import os
from pathlib import Path

import click

from swarmabs_analysis.figures import FIGURES, draw_files
from swarmabs_analysis.figures.runs import find_made, find_runs, make_run
from swarmabs_analysis.figures.style import FORMATS, Format
from swarmabs_analysis.report import write_file
from swarmabs_bag.run_folder import RunFolder
from swarmabs_cli.options import examples, json_option
from swarmabs_cli.output import print_json
from swarmabs_config.scenario import Scenario
from swarmabs_config.scenarios import load_builtin
from swarmabs_core.errors import InputError, RunError
from swarmabs_run.run import Outcome, RunOptions
from swarmabs_run.simulated_run import simulate_run
from swarmabs_view.terminal import shown_progress


@click.command(epilog=examples("figures", "figures PD_res -o figures --format svg"))
@click.argument("names", nargs=-1, metavar="[FIGURE]...")
@click.option(
    "-o",
    "--output",
    default="figures",
    show_default=True,
    type=click.Path(path_type=Path),
    help="Folder of the figures.",
)
@click.option(
    "--from",
    "bags",
    multiple=True,
    type=click.Path(path_type=Path),
    metavar="BAG|FOLDER",
    help="Bag, or folder of runs, to draw from; repeatable.",
)
@click.option("--simulate", "make", flag_value="simulate", help="Make missing runs in this process.")
@click.option("--run", "make", flag_value="run", help="Make missing runs with one process per robot over DDS.")
@click.option(
    "--format", "formats", multiple=True, type=click.Choice(("png", "svg")), help="Repeatable.  [default: png, svg]"
)
@json_option
def figures(
    names: tuple[str, ...],
    output: Path,
    bags: tuple[Path, ...],
    make: str | None,
    formats: tuple[Format, ...],
    *,
    as_json: bool,
) -> int:
    """Draw the figures of the paper from recorded runs.

    FIGURE is a label in the paper's source: mappingEx, posMapping, PD_res, ARISE_res or ARISE_lg_swarm; the default is
    all of them. Without --from, the runs are simulated, which gives the same bits as `run`, and kept in DIR/runs for
    the next time. With --from, every run that a figure needs must be there, unless --simulate or --run makes those that
    are missing.
    """
    for name in names:
        if name not in FIGURES:
            raise click.UsageError(f"unknown figure {name!r}; choose from {', '.join(FIGURES)}")
    chosen = {name: figure.scenarios for name, figure in FIGURES.items() if name in names or not names}
    needed = [name for scenarios in chosen.values() for name in scenarios]
    sources = find_runs(bags, needed, lambda reason: click.echo(f"warning: skipped: {reason}", err=True))
    if not bags or make is not None:
        make = make or "simulate"
        sources = find_made(output / "runs", [name for name in needed if name not in sources]) | sources
    missing = [name for name in needed if name not in sources]
    if missing and make is None:
        needing = {name: [figure for figure in chosen if name in chosen[figure]] for name in missing}
        told = "; ".join(f"{name} (for {', '.join(labels)})" for name, labels in needing.items())
        raise InputError(
            f"--from has no bag of {told}; add it, name the figures to draw, or make it with --simulate or --run"
        )
    for source in sources.values():
        if source.altered:
            click.echo(f"warning: {source.bag} is a variant of the built-in {source.scenario.name}", err=True)
    runs = output / "runs"
    _make_folder(runs if missing else output)
    try:
        for name in missing:
            scenario = load_builtin(name)
            with shown_progress(scenario) as show:
                execute = _run_processes if make == "run" else simulate_run
                sources[name] = make_run(scenario, runs, execute, RunOptions(on_progress=show))
        files: dict[str, bytes] = {}
        for name in chosen:
            click.echo(f"drawing {name}", err=True)
            files |= draw_files(name, sources, formats or FORMATS)
        written = [output / name for name in files]
        for path in written:
            write_file(path, files[path.name])
    except OSError as error:
        raise RunError(f"{output}: {error.strerror or error}; free space or choose another folder with -o") from error
    if as_json:
        bags_used = {name: str(sources[name].bag) for name in needed}
        print_json({"files": [str(path) for path in written], "bags": bags_used, "made": missing})
    else:
        for path in written:
            click.echo(path)
    return 0


def _run_processes(scenario: Scenario, folder: RunFolder, options: RunOptions) -> Outcome:
    from swarmabs_run.orchestration.lockstep_run import LockstepRun  # noqa: PLC0415 - needs ROS

    return LockstepRun(scenario, folder, options).run()


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK | os.X_OK):
            raise InputError(f"{folder} cannot be written; choose another folder with -o")
    except OSError as error:
        raise InputError(f"{folder} cannot be created: {error.strerror}; choose another folder with -o") from error
