"""Numeric variables of MAT files of versions 4 and 5, read without a library.

A library in C reads beyond its memory if a size, a type or a flag of a damaged file is wrong. Here
each of them is compared with what is there. Layout: MathWorks, MAT-File Format.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from unmodeled.data.records import Array
from unmodeled.data.series import MOST_NUMBERS, limit_text

#: Data types of elements as types of NumPy, and of elements of arrays.
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8",
          13: "u8"}  # fmt: skip
_MATRIX, _PACKED = 14, 15
#: Classes of arrays that hold no numbers, and those of numbers.
_OTHERS = {1: "cell", 2: "struct", 3: "object", 4: "text", 5: "sparse", 16: "function",
           17: "object"}  # fmt: skip
_NUMBERS = range(6, 16)
_COMPLEX = 0x0800  # flag of an array
#: Types of the numbers of version 4.
_OLD = ("f8", "f4", "i4", "i2", "u2", "u1")
MOST_VARIABLES = 100_000


class Variable(NamedTuple):
    """A variable: its numbers, (rows, columns, ...), or why it has none."""

    name: str
    values: Array
    why: str = ""


def mat_variables(data: bytes) -> Iterator[Variable]:
    """Variables of a file.

    Raises
    ------
    ValueError
        The file is damaged, or holds more numbers than a measured file may.
    """
    read = _version_4 if data[:4].count(0) and len(data) > 20 else _version_5
    numbers = 0
    for count, variable in enumerate(read(data)):
        numbers += variable.values.size
        if numbers > MOST_NUMBERS or count > MOST_VARIABLES:
            raise ValueError(f"{numbers} numbers in {count + 1} variables; {limit_text()}")
        yield variable


def _version_5(data: bytes) -> Iterator[Variable]:
    if len(data) < 128 or data[126:128] not in (b"IM", b"MI"):
        raise ValueError("has no header of MAT version 5")
    order = "<" if data[126:128] == b"IM" else ">"
    at, room = 128, 8 * MOST_NUMBERS + len(data)
    while at < len(data):
        kind, content, end = _element(memoryview(data), at, order, f"byte {at}")
        if kind == _PACKED:
            unpacked = _unpacked(content, room)
            room -= len(unpacked)
            kind, content, _ = _element(memoryview(unpacked), 0, order, f"byte {at}")
        if kind != _MATRIX:
            raise ValueError(f"byte {at}: data type {kind}, expected an array (14)")
        yield _array(content, order, f"variable at byte {at}")
        at = end


def _unpacked(content: memoryview, room: int) -> bytes:
    """Content of a packed variable: its size is not known before."""
    unpacker, parts, rest = zlib.decompressobj(), bytearray(), bytes(content)
    while rest and not unpacker.eof:
        parts += unpacker.decompress(rest, 1 << 20)
        rest = unpacker.unconsumed_tail
        if len(parts) > room:
            raise ValueError(f"unpacks to more than {len(parts)} bytes; {limit_text()}")
    return bytes(parts)


def _element(data: memoryview, at: int, order: str, where: str) -> tuple[int, memoryview, int]:
    """Type and content of an element, and the place after it."""
    if at + 8 > len(data):
        raise ValueError(f"{where} ends too early")
    kind, size = struct.unpack_from(order + "II", data, at)
    begin, end = at + 8, at + 8 + size + (-size % 8 if kind != _PACKED else 0)
    if kind >> 16:  # a small element: size and type in four bytes
        kind, size, begin, end = kind & 0xFFFF, kind >> 16, at + 4, at + 8
        if size > 4:
            raise ValueError(f"{where}: a small element has {size} bytes")
    if begin + size > len(data):
        raise ValueError(f"{where}: an element exceeds its array")
    return kind, data[begin : begin + size], end


def _array(content: memoryview, order: str, where: str) -> Variable:
    """A variable from its elements: flags, size, name, numbers."""
    parts: list[tuple[int, memoryview]] = []
    at = 0
    while at < len(content) and len(parts) < 4:
        kind, part, at = _element(content, at, order, where)
        parts.append((kind, part))
    if not parts or len(parts[0][1]) < 4:
        raise ValueError(f"{where} ends too early")
    (flags,) = struct.unpack_from(order + "I", parts[0][1])
    own = flags & 0xFF
    if own in _OTHERS:
        named = [bytes(p) for k, p in parts[1:] if k == 1]
        return Variable(_text(named[0] if named else b""), np.zeros(0), _OTHERS[own])
    if own not in _NUMBERS:
        raise ValueError(f"{where}: class {own}, which does not exist")
    if len(parts) < 4:
        raise ValueError(f"{where} ends too early")
    (_, name), (kind, numbers) = parts[2], parts[3]
    if flags & _COMPLEX:
        return Variable(_text(bytes(name)), np.zeros(0), "complex numbers")
    if kind not in _TYPES or parts[1][0] != 5:
        wrong = kind if kind not in _TYPES else parts[1][0]
        raise ValueError(f"{where}: an element has data type {wrong}, which does not exist there")
    shape = [n for (n,) in struct.iter_unpack(order + "i", parts[1][1][: len(parts[1][1]) & ~3])]
    return Variable(_text(bytes(name)), _shaped(numbers, order + _TYPES[kind], shape, where))


def _shaped(numbers: memoryview, kind: str, shape: list[int], where: str) -> Array:
    """Numbers column by column as an array."""
    size = math.prod(shape) * np.dtype(kind).itemsize
    if not 1 <= len(shape) <= 32 or min(shape) < 0 or size > len(numbers):
        told = " x ".join(map(str, shape[:32]))
        raise ValueError(f"{where}: {len(numbers)} bytes for {told} numbers")
    values = np.frombuffer(numbers[:size], dtype=kind).astype(np.float64)
    return values.reshape(shape, order="F")


def _version_4(data: bytes) -> Iterator[Variable]:
    at = 0
    while at < len(data):
        if at + 20 > len(data):
            raise ValueError(f"the variable at byte {at} ends too early")
        order = "<" if struct.unpack_from("<i", data, at)[0] in range(5000) else ">"
        kind, rows, columns, imaginary, length = struct.unpack_from(order + "5i", data, at)
        where = f"variable at byte {at}"
        (first, rest), precision = divmod(kind, 1000), kind // 10 % 10
        of = kind % 10
        if first not in (0, 1) or rest >= 100 or precision >= len(_OLD) or of > 2:
            raise ValueError(f"{where}: type {kind}, expected one of MAT version 4")
        if min(rows, columns) < 0 or not 1 <= length <= 1000 or imaginary not in (0, 1):
            raise ValueError(f"{where}: {rows} x {columns} numbers, a name of {length} bytes")
        begin = at + 20 + length
        size = rows * columns * np.dtype(_OLD[precision]).itemsize
        name = _text(data[at + 20 : begin].partition(b"\0")[0])
        why = "text" if of == 1 else "sparse" if of == 2 else "complex numbers" * imaginary
        content = memoryview(data)[begin : begin + size]
        values = np.zeros(0) if why else _shaped(
            content, order + _OLD[precision], [rows, columns], where
        )  # fmt: skip
        yield Variable(name, values, why)
        at = begin + size * (1 + imaginary)


def _text(name: bytes) -> str:
    return name.decode("utf-8", "replace")
