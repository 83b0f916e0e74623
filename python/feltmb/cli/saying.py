"""Lines for people on stdout."""

from __future__ import annotations

import click

__all__ = ["say"]


def say(text: str) -> None:
    """Print a line, folded between words where the screen is narrow."""
    from feltmb.cli.common import console
    from feltmb.cli.tables import folded_text

    click.echo(folded_text(text, console().width))
