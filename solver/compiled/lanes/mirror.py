"""Tables, states and scratch of several simulations as one: the same NamedTuple with lanes in the place of numbers."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from solver.compiled.lanes import LANES
from solver.compiled.lanes.arrays import LaneArray
from solver.compiled.lanes.number import Lane
from solver.compiled.memory import zeros
from solver.errors import SpecError

# Numbers behind the last one that kernels may read (solver.model.saddle); ten times as many cost 9 KB a memory.
BEYOND = 16


class Mirror:
    """values: the NamedTuple of each simulation. value: the same with lanes, where arrays that are views of one memory
    are so again.

    Arrays and numbers of float become those of lanes. Integers, and what is named in `common`, are equal in all
    simulations; kernels see a copy of those of the first simulation. Under names that begin as one of `scratch`
    integers may differ. Lanes that are left over show the first simulation. Raises SpecError, which names the field,
    where shapes or what must be equal differ.
    """

    def __init__(self, values: Sequence[Any], common: Collection[str] = (), scratch: tuple[str, ...] = ()) -> None:
        self._common, self._scratch = frozenset(common), scratch
        self._pairs: dict[str, tuple[LaneArray, list[np.ndarray]]] = {}
        self._blocks = _blocks(_arrays(values[0], '', self._common))
        self.value = self._mirrored([*values, *[values[0]] * (LANES - len(values))], '')

    def _mirrored(self, values: list[Any], path: str) -> Any:
        first = values[0]
        if isinstance(first, tuple):
            return type(first)(
                *(self._mirrored([v[k] for v in values], f'{path}.{name}' if path else name)
                  for k, name in enumerate(first._fields))  # type: ignore[attr-defined]
            )  # fmt: skip
        if path in self._common or not _is_float(first):
            if not path.startswith(self._scratch) and any(not _alike(first, other) for other in values[1:]):
                raise SpecError(f'Ensemble: {path} differs between its simulations; make one Ensemble of those alike')
            return first.copy() if isinstance(first, np.ndarray) else first
        if not isinstance(first, np.ndarray):
            return Lane(values)
        if any(v.shape != first.shape for v in values):
            raise SpecError(
                f'Ensemble: the shape of {path} differs between its simulations; make one Ensemble of those alike'
            )
        array = self._lanes_of(first)
        for k, value in enumerate(values):
            array.numbers[..., k] = value
        self._pairs[path] = array, list(values)
        return array

    def _lanes_of(self, array: np.ndarray) -> LaneArray:
        if not array.size:
            return LaneArray(zeros((*array.shape, LANES)))
        start = array.ctypes.data
        begin, memory = next((begin, memory) for begin, end, memory in self._blocks if begin <= start < end)
        first = (start - begin) // 8
        return LaneArray(memory[first : first + array.size].reshape(*array.shape, LANES))

    def pairs(self, paths: Sequence[str]) -> list[tuple[LaneArray, list[np.ndarray]]]:
        """(array of lanes, those of the simulations) of fields by their names, for solver.compiled.lanes.transfer."""
        return [self._pairs[path] for path in paths]


def _is_float(value: Any) -> bool:
    return value.dtype == float if isinstance(value, np.ndarray) else isinstance(value, float)


def _alike(a: Any, b: Any) -> bool:
    return np.array_equal(a, b) if isinstance(a, np.ndarray) else a == b


def _arrays(value: Any, path: str, common: frozenset[str]) -> list[np.ndarray]:
    """The arrays of float that become lanes."""
    if isinstance(value, tuple):
        names = value._fields  # type: ignore[attr-defined]
        return [a for name, v in zip(names, value, strict=True)
                for a in _arrays(v, f'{path}.{name}' if path else name, common)]  # fmt: skip
    here = isinstance(value, np.ndarray) and value.dtype == float and value.size and path not in common
    return [value] if here else []


def _blocks(arrays: list[np.ndarray]) -> list[tuple[int, int, np.ndarray]]:
    """(first address, address behind the last, memory of lanes) of every memory that the arrays lie in."""
    spans: list[list[int]] = []
    for begin, end in sorted((a.ctypes.data, a.ctypes.data + a.nbytes) for a in arrays):
        if spans and begin < spans[-1][1]:
            spans[-1][1] = max(spans[-1][1], end)
        else:
            spans.append([begin, end])
    return [(begin, end, zeros(((end - begin) // 8 + BEYOND, LANES))) for begin, end in spans]
