"""Contact laws by themselves: force from any compression history, for use outside a mechanism.

``law(name, **parameters)`` makes a law by the name that mechanism files use.
"""

from feltmb.contact.law import (
    Law,
    law,
)

__all__ = [
    "Law",
    "law",
]
