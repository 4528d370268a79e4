"""Files of a bundle, made from the templates beside this module."""

from __future__ import annotations

import shlex
from functools import cache
from typing import TYPE_CHECKING

from swarmabs_run.rendering import templates

if TYPE_CHECKING:
    from jinja2 import Environment


def render(template: str, **values: object) -> str:
    """Return the text that a template, such as ``restart.sh``, gives with values; XML is escaped.

    Raises
    ------
    jinja2.UndefinedError
        If the template names a value that is not given.
    """
    return _environment().get_template(f"{template}.j2").render(values)


@cache
def _environment() -> Environment:
    environment = templates("swarmabs_fleet")
    environment.filters["quote"] = shlex.quote
    return environment
