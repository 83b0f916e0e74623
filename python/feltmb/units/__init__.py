"""Units and quantities: what files and options accept; inside feltmb everything is SI."""

from feltmb.units.names import (
    ACCEPTED_UNITS,
    conversion_factor,
    convert,
    dimension_text,
)

__all__ = [
    "ACCEPTED_UNITS",
    "conversion_factor",
    "convert",
    "dimension_text",
]
