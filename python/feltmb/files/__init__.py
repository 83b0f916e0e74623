"""Files: read with clear errors, written whole or not at all, never overwritten unless asked."""

from feltmb.files.access import (
    NPZ_FAULTS,
    check_writable,
    is_file,
    plain_text,
    read_toml,
    why_missing,
    write_file,
    write_text,
)

__all__ = [
    "NPZ_FAULTS",
    "check_writable",
    "is_file",
    "plain_text",
    "read_toml",
    "why_missing",
    "write_file",
    "write_text",
]
