"""Contact laws by themselves: force from any compression history, for use outside a mechanism.

``law(name, **parameters)`` makes a law by the name that mechanism files use.
"""

from feltmb.contact.laws import (
    Law,
    law,
)
from feltmb.contact.tables import CORE_LAWS, LAWS

__all__ = [
    "CORE_LAWS",
    "LAWS",
    "Law",
    "law",
]
