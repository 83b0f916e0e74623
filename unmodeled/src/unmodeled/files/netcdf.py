"""NetCDF-4 files of many named series, made in memory.

A NetCDF-4 file is an HDF5 file whose dimensions are dimension scales. This module writes hundreds
of series directly with HDF5. The general libraries look up every dimension for every variable,
which takes ten times as long as the data.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Array = npt.NDArray[np.float64]

_COUNT = itertools.count()


class Variable(NamedTuple):
    """One named array of a file.

    Attributes
    ----------
    name, dimensions
        Names; a variable with the name of its only dimension is the coordinate of that dimension.
    values : ndarray
    unit, long_name
        Attributes ``units`` and ``long_name``.
    """

    name: str
    dimensions: tuple[str, ...]
    values: Array
    unit: str
    long_name: str


def encode(
    variables: Iterable[Variable], attributes: Mapping[str, str | int], *, compress: bool = True
) -> bytes:
    """Content of a NetCDF-4 file; variables are kept in their order.

    Parameters
    ----------
    variables
        Variables; all variables with the same dimension must have its length.
    attributes
        Attributes of the file.
    compress
        Whether the data are compressed without loss (shuffle and deflate).
    """
    import h5py
    import numpy as np
    from h5py import h5a, h5d, h5ds, h5f, h5p, h5s, h5t

    listed = list(variables)
    kind = h5py.string_dtype()
    text = h5t.py_create(kind, logical=True)
    scalar = h5s.create(h5s.SCALAR)

    def add_text(node: Any, name: str, value: str) -> None:
        # Invalid text cannot be encoded.
        content = value.encode("utf-8", "replace")
        h5a.create(node, name.encode(), text, scalar).write(np.array(content, dtype=kind))

    def make_layout() -> Any:
        layout = h5p.create(h5p.DATASET_CREATE)
        layout.set_attr_creation_order(h5p.CRT_ORDER_TRACKED | h5p.CRT_ORDER_INDEXED)
        layout.set_obj_track_times(False)
        return layout

    def add_dataset(name: str, values: Array, packed: bool) -> Any:
        layout = make_layout()
        if packed and values.size:
            layout.set_chunk(values.shape)
            layout.set_shuffle()
            layout.set_deflate(1)
        node = h5d.create(
            file, name.encode(), h5t.IEEE_F64LE, h5s.create_simple(values.shape), layout
        )
        if values.size:
            node.write(h5s.ALL, h5s.ALL, values)
        return node

    def add_scale(name: str, size: int, values: Array | None) -> Any:
        if values is not None:
            node = add_dataset(name, np.ascontiguousarray(values, dtype=float), False)
            label = name
        else:
            space = h5s.create_simple((size,))
            node = h5d.create(file, name.encode(), h5t.IEEE_F32BE, space, make_layout())
            label = f"This is a netCDF dimension but not a netCDF variable.{size:10d}"
        h5ds.set_scale(node, label.encode())
        return node

    access = h5p.create(h5p.FILE_ACCESS)
    access.set_fapl_core(1 << 20, False)
    creation = h5p.create(h5p.FILE_CREATE)
    creation.set_link_creation_order(h5p.CRT_ORDER_TRACKED | h5p.CRT_ORDER_INDEXED)
    creation.set_attr_creation_order(h5p.CRT_ORDER_TRACKED | h5p.CRT_ORDER_INDEXED)
    # HDF5 rejects a second open file with the same name, in memory too.
    name = f"unmodeled{next(_COUNT)}.nc".encode()
    file = h5f.create(name, h5f.ACC_TRUNC, creation, access)
    try:
        root = h5py.h5g.open(file, b"/")
        for key, value in attributes.items():
            if isinstance(value, str):
                add_text(root, key, value)
            else:
                h5a.create(root, key.encode(), h5t.STD_I64LE, scalar).write(np.array(value))
        scales: dict[str, Any] = {}
        coordinates = {v.name: v.values for v in listed if v.dimensions == (v.name,)}
        for v in listed:
            values = np.ascontiguousarray(v.values, dtype=float)
            for dimension, size in zip(v.dimensions, values.shape, strict=True):
                if dimension not in scales:
                    scales[dimension] = add_scale(dimension, size, coordinates.get(dimension))
            node = (
                scales[v.name] if v.name in coordinates else add_dataset(v.name, values, compress)
            )
            add_text(node, "units", v.unit)
            add_text(node, "long_name", v.long_name)
            if v.name not in coordinates:
                for axis, dimension in enumerate(v.dimensions):
                    h5ds.attach_scale(node, scales[dimension], axis)
        h5f.flush(file)
        content: bytes = file.get_file_image()
    finally:
        file.close()
    return content
