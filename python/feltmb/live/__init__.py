"""Live page: change a mechanism, see and hear it move, and compare it with a measurement.

:func:`serve` opens a page on 127.0.0.1 that simulates the changes of its user. The page stores its
state (changes and stroke), and the server only computes. After a lost connection the page therefore
continues in the same state, and two pages do not affect each other.
"""

from feltmb.live.server import serve

__all__ = ["serve"]
