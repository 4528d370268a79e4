"""``swarm deploy``."""

from __future__ import annotations

from pathlib import Path

import click

from swarmabs_cli.options import A_PATH, examples, json_option, output_option
from swarmabs_cli.output import print_findings, print_json, print_warnings
from swarmabs_config.fleet.loader import json_schema, load_fleet
from swarmabs_fleet.bundle import deploy as write
from swarmabs_fleet.check import check


@click.command(epilog=examples("deploy examples/fleet/lan.yaml -o bundles", "deploy examples/fleet/lan.yaml --check"))
@click.argument("paths", nargs=-1, metavar="FLEET.yaml...", type=A_PATH)
@output_option("Folder of the bundles.", metavar="DIR")
@click.option("--keys", metavar="DIR", type=A_PATH, help="Folder of the private keys; existing keys are reused.")
@click.option(
    "--revoke",
    metavar="NAME",
    multiple=True,
    help="With sros2: revoke the certificates of a host, or of one enclave; repeatable.",
)
@click.option("--check", "checks", is_flag=True, help="Write nothing; report what would fail.")
@click.option("--host", metavar="NAME", help="With --check: examine this machine as host NAME of the fleet.")
@click.option("--schema", is_flag=True, help="Print the JSON Schema of fleet files, for editors.")
@json_option
def deploy(
    paths: tuple[Path, ...],
    output: Path | None,
    keys: Path | None,
    host: str | None,
    revoke: tuple[str, ...],
    *,
    checks: bool,
    schema: bool,
    as_json: bool,
) -> int:
    """Generate a deployment bundle for each host of a fleet.

    A bundle holds parameters, the DDS profile, systemd units, scripts and keys. With --check, nothing is written: the
    command examines any number of fleet files, bundle folders and installed bundles, and reports what would fail.
    """
    if schema:
        print_json(json_schema())
        return 0
    if not paths:
        raise click.UsageError("Missing argument 'FLEET.yaml'.")
    if checks:
        if output is not None or keys is not None or revoke:
            raise click.UsageError("--check writes nothing; remove -o, --keys and --revoke")
        return print_findings(check(paths, host), as_json=as_json)
    if host is not None:
        raise click.UsageError("--host needs --check; add --check, or remove --host")
    if len(paths) > 1:
        raise click.UsageError("several fleets are named; name one, or add --check")
    if output is None:
        raise click.UsageError("no folder for the bundles; name one with -o DIR")
    loaded = load_fleet(paths[0])
    fleet = loaded.fleet
    print_warnings(loaded.warnings())
    bundles = [
        {"host": folder.name, "address": fleet.host(folder.name).address, "folder": str(folder)}
        for folder in write(loaded, output, keys, revoke)
    ]
    if as_json:
        about = {"fleet": fleet.name, "output": str(output), "domain": fleet.network.domain}
        print_json({**about, "security": fleet.security.level, "bundles": bundles})
    else:
        for bundle in bundles:
            click.echo(f"{bundle['host']:<16} {bundle['address']:<16} {bundle['folder']}")
        click.echo("copy each folder to its host, and run its install.sh there as root")
    return 0
