"""Measured data: records, sensors, and their files (CSV, MAT, NetCDF with a TOML beside them)."""

from feltmb.data.records import Array, InputMode, Record, Role, Sensor, StartPrior

__all__ = ["Array", "InputMode", "Record", "Role", "Sensor", "StartPrior"]
