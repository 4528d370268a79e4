"""``swarm deploy``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click

from swarmabs_cli.options import json_option
from swarmabs_cli.output import print_findings, print_json, print_warnings
from swarmabs_config.fleet.loader import LoadedFleet, json_schema, load_fleet
from swarmabs_fleet.bundle import deploy as write
from swarmabs_fleet.check import check


@click.command()
@click.argument("paths", nargs=-1, metavar="FLEET.yaml...", type=click.Path(path_type=Path))
@click.option("-o", "--output", metavar="DIR", type=click.Path(path_type=Path), help="Folder of the bundles.")
@click.option(
    "--keys",
    metavar="DIR",
    type=click.Path(path_type=Path),
    help="Folder in which private keys are kept; what is there is used again.",
)
@click.option("--check", "checks", is_flag=True, help="Write nothing; say what would fail. Takes bundles, too.")
@click.option("--host", metavar="NAME", help="With --check: examine this machine as the fleet's host NAME.")
@click.option("--schema", is_flag=True, help="Print the JSON Schema of fleet files, for editors.")
@json_option
def deploy(
    paths: tuple[Path, ...],
    output: Path | None,
    keys: Path | None,
    host: str | None,
    *,
    checks: bool,
    schema: bool,
    as_json: bool,
) -> int:
    """Make a bundle for each host of a fleet: parameters, DDS profile, systemd units, scripts, keys.

    With --check any number of fleet files, folders of bundles and installed bundles are looked at instead.
    """
    if schema:
        print_json(json_schema())
        return 0
    if not paths:
        raise click.UsageError("Missing argument 'FLEET.yaml'.")
    if checks:
        if output is not None or keys is not None:
            raise click.UsageError("--check writes nothing; leave out -o and --keys")
        return print_findings(check(paths, host), as_json=as_json)
    if host is not None:
        raise click.UsageError("--host goes with --check")
    if len(paths) > 1:
        raise click.UsageError("one fleet at a time; several go with --check")
    if output is None:
        raise click.UsageError("name the folder of the bundles: -o DIR")

    loaded = load_fleet(paths[0])
    warnings = (*loaded.fleet.warnings(), *loaded.scenario.warnings())
    print_warnings(warnings)
    _show(loaded, output, write(loaded, output, keys), as_json=as_json)
    return 0


def _show(loaded: LoadedFleet, output: Path, folders: Sequence[Path], *, as_json: bool) -> None:
    fleet = loaded.fleet
    if as_json:
        print_json(
            {
                "fleet": fleet.name,
                "output": str(output),
                "domain": fleet.network.domain,
                "security": fleet.security.level,
                "bundles": [
                    {"host": folder.name, "address": fleet.host(folder.name).address, "folder": str(folder)}
                    for folder in folders
                ],
            }
        )
        return
    for folder in folders:
        click.echo(f"{folder.name:<16} {fleet.host(folder.name).address:<16} {folder}")
    click.echo("copy each to its host, and start there as root: install.sh")
