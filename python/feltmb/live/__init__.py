"""A live page: turn a screw, see the machine move, hear it, hold a measurement against it.

:func:`serve` opens a page on 127.0.0.1 that simulates what its reader turns. The page owns its
state (what is turned, what is played); the server only computes, so that a page that lost its
connection goes on where it was, and two pages do not disturb each other.
"""

from feltmb.live.server import serve

__all__ = ["serve"]
