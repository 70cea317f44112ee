"""Memory of the step: what lies where, and that it is nothing but zeros."""

from __future__ import annotations

import numpy as np
import pytest

from solver import simulation_of
from solver.compiled.memory import LINE, zeros
from solver.files.scene import load_scene


@pytest.mark.parametrize(('shape', 'kind'), [(7, float), ((3, 6, 8), float), (0, float), ((0, 6), float), (1, int)])
def test_zeros_are_those_of_numpy_from_the_start_of_a_line_on(shape: int | tuple[int, ...], kind: type) -> None:
    for _ in range(20):  # numpy's begin anywhere
        found, expected = zeros(shape, kind), np.zeros(shape, kind)
        assert (found.shape, found.dtype, found.tobytes()) == (expected.shape, expected.dtype, expected.tobytes())
        assert found.flags.c_contiguous and found.flags.writeable
        assert found.size == 0 or found.ctypes.data % LINE == 0  # nothing lies nowhere


def test_the_matrix_of_a_step_begins_with_a_line_and_so_does_every_row_of_eight() -> None:
    saddle = simulation_of(load_scene('pendulum')).bodies.work.saddle
    assert saddle.B.shape[2] * saddle.B.itemsize == LINE
    assert {array.ctypes.data % LINE for array in saddle} == {0}
