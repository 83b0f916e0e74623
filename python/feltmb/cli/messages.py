"""Messages on stderr."""

from __future__ import annotations

import click

from feltmb.errors import message

__all__ = ["complain"]


def complain(text: str) -> None:
    """Print one message on stderr; names of files are made harmless and shortened."""
    click.echo(message(f"feltmb: {text}"), err=True)
