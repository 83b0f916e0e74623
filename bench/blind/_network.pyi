"""Networks of lumped masses; see lumped.py."""

import collections.abc
import typing

import numpy
import numpy.typing

class LumpedNetwork:
    """
    Network of lumped masses; see lumped.py.
    """
    def __init__(self, description: dict[str, typing.Any]) -> None: ...
    def simulate(
        self,
        parameters: typing.Annotated[numpy.typing.ArrayLike, numpy.float64],
        inputs: collections.abc.Sequence[typing.Annotated[numpy.typing.ArrayLike, numpy.float64]],
        segments: typing.Annotated[numpy.typing.ArrayLike, numpy.int32],
        starts: typing.Annotated[numpy.typing.ArrayLike, numpy.float64],
        wanted: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex] = [],
        wanted_states: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex] = [],
        forces: bool = False,
        unknown: typing.Annotated[numpy.typing.ArrayLike, numpy.float64] | None = None,
    ) -> tuple[
        numpy.typing.NDArray[numpy.float64],
        numpy.typing.NDArray[numpy.float64],
        numpy.typing.NDArray[numpy.float64],
        numpy.typing.NDArray[numpy.float64],
        numpy.typing.NDArray[numpy.float64],
    ]:
        """
        (outputs, ends, d_outputs, d_ends, forces) of segments (input, first, steps, row).
        """
    @property
    def parameters(self) -> int: ...
    @property
    def states(self) -> int: ...
