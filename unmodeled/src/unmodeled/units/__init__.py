"""Units and quantities in files and options; inside all values are in SI units."""

from unmodeled.units.names import (
    ACCEPTED_UNITS,
    TEMPERATURE_SCALES,
    conversion_factor,
    convert,
    dimension_text,
    number_and_unit,
    pretty,
    readable_unit,
    shows_gravity,
    si_value,
    split_quantity,
    stays_beside,
    to_si,
    unit_suffix,
    weight_hint,
    zero_and_factor,
)
from unmodeled.units.spelling import PIXEL, same_unit, spelled_unit, split_column

__all__ = [
    "ACCEPTED_UNITS",
    "PIXEL",
    "TEMPERATURE_SCALES",
    "conversion_factor",
    "convert",
    "dimension_text",
    "number_and_unit",
    "pretty",
    "readable_unit",
    "same_unit",
    "shows_gravity",
    "si_value",
    "spelled_unit",
    "split_column",
    "split_quantity",
    "stays_beside",
    "to_si",
    "unit_suffix",
    "weight_hint",
    "zero_and_factor",
]
