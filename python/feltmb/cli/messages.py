"""Messages on stderr."""

from __future__ import annotations

import click

from feltmb.errors import printable

__all__ = ["complain"]


def complain(text: str) -> None:
    """Print one message on stderr; control characters in names of files are escaped."""
    click.echo(printable(f"feltmb: {text}"), err=True)
