"""The user's browser."""

from __future__ import annotations

import webbrowser

import click


def open_page(url: str) -> None:
    """Show a page in the user's browser, where there is one."""
    if not webbrowser.open(url):
        click.echo("warning: no browser could be started; open the address yourself", err=True)
