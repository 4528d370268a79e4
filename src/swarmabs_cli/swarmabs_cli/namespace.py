"""Which swarm of a bag that holds several: the option that all commands share that read one."""

from __future__ import annotations

import click

namespace_option = click.option("--namespace", metavar="NAME", help="Which swarm to read, if there are several in it.")
