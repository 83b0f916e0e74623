"""Contact laws: force from any history of compression, for use outside a mechanism.

``law(name, **parameters)`` makes a law by its name in mechanism files.
"""

from feltmb.contact.hammers import HAMMERS, Hammer, hammer
from feltmb.contact.laws import (
    Law,
    law,
)
from feltmb.contact.tables import CORE_LAWS, LAWS

__all__ = [
    "CORE_LAWS",
    "HAMMERS",
    "LAWS",
    "Hammer",
    "Law",
    "hammer",
    "law",
]
