"""Runs of a slow simulator in a folder, from which an interrupted diagnosis continues."""

from __future__ import annotations

import base64
import hashlib
import inspect
import pickle
import re
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from types import FunctionType, MethodType
from typing import Any

import numpy as np

from unmodeled.data import Array
from unmodeled.errors import InvalidParameter
from unmodeled.files import Store, digest_of, is_file

FORM = 1


class StoredRuns:
    """Outputs of runs by the hash of their arguments, one file each, complete or absent.

    Runs of another function, or with other names of inputs, outputs or parameters, are in another
    folder below the given one. ``model.json`` there says what they belong to.

    ``names``: those of arguments and outputs, by kind.

    Raises
    ------
    InvalidParameter
        Nothing identifies the function.
    """

    def __init__(self, folder: Path, function: Any, names: Any, model: str):
        try:
            parts = [*_identity(function)]
        except (TypeError, OSError, AttributeError, pickle.PicklingError) as error:
            raise InvalidParameter(
                f"model {model}: its runs cannot be cached, because nothing identifies its "
                f"function ({error}); expected a function from a file, or one with an attribute: "
                'function.version = "1", which you change when its results change'
            ) from None
        key = digest_of(FORM, names, parts)
        slug = re.sub(r"[^0-9A-Za-z_.-]+", "_", model)[:40].strip("._") or "model"
        self._store = Store(Path(folder).expanduser() / f"{slug}-{key[:16]}")
        self._description = {
            "form": FORM,
            "model": model,
            "names": names,
            "function": [*map(str, parts)],
        }

    def get(self, key: bytes, shape: tuple[int, int]) -> Array | None:
        """Outputs of a run, (n, ny); None: they are not stored, or were damaged."""
        found = self._store.get(key.hex())
        if found is None:
            return None
        values = np.frombuffer(base64.b64decode(found["values"]), dtype="<f8")
        return values.reshape(shape).astype(np.float64)

    def put(self, key: bytes, values: Array) -> None:
        """Store the outputs of a run."""
        if self._description:
            self._store.put("model", self._description)
            self._description = {}
        text = base64.b64encode(np.ascontiguousarray(values, dtype="<f8").tobytes()).decode()
        self._store.put(key.hex(), {"values": text})


def _identity(value: Any) -> Iterator[str]:
    """What identifies a function: its ``version``, or else the file that defines it and its data.

    A change of any line of that file counts as a change of the function. Changes of other files,
    of libraries and of programs that it calls are not seen.
    """
    version = getattr(value, "version", None)
    if version is not None:
        yield f"version {version}"
    elif isinstance(value, partial):
        yield from _identity(value.func)
        yield from _data((value.args, sorted(value.keywords.items())))
    elif isinstance(value, MethodType):
        yield from _identity(value.__func__)
        yield from _state(value.__self__)
    elif isinstance(value, FunctionType):
        yield f"{value.__qualname__}, sha256 of its source {_source(value)}"
        for cell in value.__closure__ or ():
            yield from _data(cell.cell_contents)
    elif inspect.isroutine(value):
        raise TypeError(f"{type(value).__name__} has no source")
    else:
        yield f"{type(value).__qualname__}, sha256 of its source {_source(type(value))}"
        yield from _state(value)


def _state(value: Any) -> Iterator[str]:
    for name, part in sorted(vars(value).items()):
        yield name
        yield from _data(part)


def _data(value: Any) -> Iterator[str]:
    if callable(value) and not isinstance(value, type):
        yield from _identity(value)
    else:
        yield f"sha256 of its data {hashlib.sha256(pickle.dumps(value, 4)).hexdigest()}"


def _source(definition: Any) -> str:
    """SHA-256 of the file of a definition; of its own text if it is in a notebook."""
    path = inspect.getsourcefile(definition)
    if path is not None and is_file(Path(path)):
        return hashlib.sha256(Path(path).read_bytes()).hexdigest()
    return hashlib.sha256(inspect.getsource(definition).encode()).hexdigest()
