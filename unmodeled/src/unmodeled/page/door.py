"""Connections that have not shown the token: few at a time, and for a short time."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

#: Largest number of connections without the token, and time until they must show it [s].
MOST_STRANGERS, PATIENCE = 24, 5.0


def patient_protocol(token: str) -> type[asyncio.Protocol]:
    """A protocol of uvicorn that closes the oldest of too many connections without the token.

    Unfinished requests would else fill the server, which then refuses its own page.
    """
    from uvicorn.protocols.http.auto import AutoHTTPProtocol

    waiting: dict[Any, asyncio.TimerHandle] = {}

    class Patient(AutoHTTPProtocol):  # type: ignore[misc, valid-type]
        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            close: Callable[[], object] = transport.abort
            waiting[self] = self.loop.call_later(PATIENCE, close)
            if len(waiting) > MOST_STRANGERS:
                oldest = next(iter(waiting))
                _forget(waiting, oldest)
                oldest.transport.abort()

        def data_received(self, data: bytes) -> None:
            super().data_received(data)
            if self in waiting and (self.scope or {}).get("path", "").split("/")[1:2] == [token]:
                _forget(waiting, self)

        def connection_lost(self, exc: Exception | None) -> None:
            _forget(waiting, self)
            super().connection_lost(exc)

    return Patient


def _forget(waiting: dict[Any, asyncio.TimerHandle], connection: object) -> None:
    timer = waiting.pop(connection, None)
    if timer is not None:
        timer.cancel()
