"""``swarm doctor``."""

from __future__ import annotations

import click

from swarmabs_cli.options import json_option
from swarmabs_cli.output import print_findings
from swarmabs_run.doctor import examine


@click.command()
@json_option
def doctor(*, as_json: bool) -> int:
    """Check whether this machine can run swarms, and say what to do where it cannot."""
    return print_findings(examine(), as_json=as_json)
