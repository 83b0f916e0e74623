"""Units and quantities: what files and options accept; inside feltmb everything is SI."""

from feltmb.units.names import (
    ACCEPTED_UNITS,
    conversion_factor,
    convert,
    dimension_text,
    si_value,
    split_quantity,
)

__all__ = [
    "ACCEPTED_UNITS",
    "conversion_factor",
    "convert",
    "dimension_text",
    "si_value",
    "split_quantity",
]
