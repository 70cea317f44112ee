"""What compiled code knows of the arrays it is given: their inner lengths, by `sixes` and by the type of a `Ref`."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numba
import numpy as np
import pytest

from solver.compiled import by_reference
from solver.compiled.by_reference import Ref
from solver.compiled.kernel import address_of, invoke, kernel, sixes
from solver.files.scene import load_scene
from solver.simulation import Simulation
from solver.step.settings import IntegratorSettings

compiled = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason='about compiled code')


class Inside(NamedTuple):
    points: np.ndarray


class Tables(NamedTuple):
    blocks: np.ndarray
    inside: Inside
    scale: float
    count: int


def tables(rng, n: int, width: int = 6, inner: int = 3) -> Tables:
    return Tables(rng.normal(size=(n, width, width)), Inside(rng.normal(size=(n, inner))), float(rng.normal()), n)


def new_reader():
    """A compiled function of its own, with no specialisation yet."""

    @numba.njit
    def read(t, i, j, k):
        return t.blocks[i, j, k], t.inside.points[i, k], t.scale, t.count, t.blocks.shape, t.inside.points.shape

    return read


@pytest.mark.parametrize(('width', 'inner'), [(6, 3), (6, 4), (5, 3), (4, 7)])
def test_a_ref_addresses_every_element_whatever_the_inner_lengths(rng, width, inner):
    read = new_reader()
    value = tables(rng, 4, width, inner)
    for i, j, k in np.ndindex(4, width, min(width, inner)):
        element, point, *rest = read(Ref(value), i, j, k)
        assert (element, point) == (value.blocks[i, j, k], value.inside.points[i, k])
        assert rest == [value.scale, 4, value.blocks.shape, value.inside.points.shape]


@compiled
def test_inner_lengths_are_part_of_the_type_and_the_first_is_not(rng):
    read = new_reader()
    for n in (1, 2, 5):
        assert Ref(tables(rng, n)).type == Ref(tables(rng, 0)).type
        read(Ref(tables(rng, n)), 0, 0, 0)
    assert len(read.signatures) == 1
    for width, inner in ((6, 4), (5, 3), (3, 6)):  # also of an array in a nested tuple
        other = tables(rng, 3, width, inner)
        assert Ref(other).type != Ref(tables(rng, 3)).type
        assert read(Ref(other), 2, 2, 1)[:2] == (other.blocks[2, 2, 1], other.inside.points[2, 1])
    assert len(read.signatures) == 4


@compiled
def test_the_type_is_what_numba_sees_however_often_it_is_asked(rng, monkeypatch):
    """Types are kept by the structure of a value: they must be those of a value that is looked at for the first
    time."""
    variants = [
        tables(rng, 3),
        tables(rng, 3, 5),
        tables(rng, 3, 6, 4),
        tables(rng, 3)._replace(scale=2),
        tables(rng, 0),
    ]
    variants.append(variants[0]._replace(blocks=np.zeros((3, 6, 6), np.int64)))
    variants.append(variants[0]._replace(inside=Inside(np.zeros(3))))
    kept = [(Ref(value).type, Ref(value).type) for value in variants for _ in range(2)]
    monkeypatch.setattr(by_reference, '_KNOWN', {})
    for (first, again), value in zip(kept, [value for value in variants for _ in range(2)], strict=True):
        by_reference._KNOWN.clear()
        anew = Ref(value).type
        assert first is again and first == anew and first.name == anew.name and first.inner == anew.inner
    assert len({first.name for first, _ in kept}) == len(variants) - 1  # the one without rows is as the one with three


@compiled
def test_a_function_of_one_ref_type_refuses_arrays_of_other_inner_lengths(rng):
    read = new_reader()
    read(Ref(tables(rng, 3)), 0, 0, 0)
    read.disable_compile()
    assert read(Ref(tables(rng, 8)), 7, 5, 2)
    with pytest.raises(TypeError, match='No matching definition'):
        read(Ref(tables(rng, 3, inner=4)), 0, 0, 0)


def test_a_ref_shares_its_arrays_and_takes_new_numbers(rng):
    value = tables(rng, 3)
    shared = Ref(value)
    value.blocks[1, 2, 3] = 7.0
    shared.assign(scale=-0.5)
    read = new_reader()
    assert read(shared, 1, 2, 2)[2] == shared.scale == -0.5

    @numba.njit
    def write(t):
        t.blocks[1, 2, 3] *= 2.0

    write(shared)
    assert value.blocks[1, 2, 3] == 14.0


def test_arrays_without_a_plain_layout_are_refused(rng):
    value = tables(rng, 4)
    fixed = value.blocks.copy()
    fixed.flags.writeable = False
    # no address of a number
    between = np.zeros(value.blocks.nbytes + 1, np.uint8)[1:].view(float).reshape(value.blocks.shape)
    for blocks in (value.blocks[::2], np.asfortranarray(value.blocks), fixed, between):
        with pytest.raises(ValueError, match='writable C-contiguous'):
            Ref(value._replace(blocks=blocks))


@numba.njit
def through_sixes(array):
    known = sixes(array)
    known += 1
    return known.shape, known.strides, known.size


@pytest.mark.parametrize('dtype', [np.float64, np.complex128])
@pytest.mark.parametrize('inner', [(6,), (6, 6)])
@pytest.mark.parametrize('n', [0, 1, 7])
def test_sixes_are_the_same_array(rng, dtype, inner, n):
    """Also in a function that counts references: the array is still there when it is left."""
    array = rng.normal(size=(n, *inner)).astype(dtype)
    expected = array + 1
    shape, strides, size = through_sixes(array)
    assert (shape, size) == (array.shape, array.size)
    assert n == 0 or strides == array.strides  # those of an empty array mean nothing
    np.testing.assert_array_equal(array, expected)


@compiled
def test_the_compiler_knows_the_lengths_of_sixes_behind_an_address(rng):
    """A kernel that is called through its address writes the right elements of arrays in the middle of their memory."""
    memory = np.zeros((5, 6, 6))
    f, K = rng.normal(size=(3, 6)), memory[1:4]
    before = f.copy()
    _call(address_of(_fill, f, K), f, K)
    np.testing.assert_array_equal(K, before[:, :, None] * np.arange(6.0))
    np.testing.assert_array_equal(f, before + 100.0)
    assert not memory[[0, 4]].any()


@kernel(borrow=True)
def _fill(f, K):
    f = sixes(f)
    K = sixes(K)
    for i in range(len(f)):
        for j in range(6):
            for k in range(6):
                K[i, j, k] = f[i, j] * k
            f[i, j] += 100.0


@kernel
def _call(address, f, K):
    invoke(address, (f, K))


class Given(NamedTuple):
    f: np.ndarray
    K: np.ndarray
    inside: Inside
    add: float
    wanted: bool


@compiled
@pytest.mark.parametrize('wanted', [True, False])
def test_a_record_crosses_an_address_field_by_field(rng, wanted: bool) -> None:
    """Arrays, a table by reference, a number and a truth value; the arrays are those that were given."""
    f, K, points = np.zeros((3, 6)), np.zeros((2, 6, 6)), Ref(Inside(rng.normal(size=(4, 3))))
    address = address_of(_fill_record, Given(f, K, points, 0.0, True))
    _call_record(address, f, K, points, 2.5, wanted)
    assert (f[2, 5], f.sum()) == ((points.points[3, 2] + 2.5, points.points[3, 2] + 2.5) if wanted else (0.0, 0.0))
    assert (K[1, 4, 3], K.sum()) == (2.5, 2.5)


@compiled
@pytest.mark.parametrize('wrong', ['a table by value', 'every second row'])
def test_what_address_of_never_compiles_for_is_refused_in_a_record_too(rng, wrong: str) -> None:
    f, K, points = np.zeros((3, 6)), np.zeros((2, 6, 6)), Inside(rng.normal(size=(4, 3)))
    address = address_of(_fill_record, Given(f, K, Ref(points), 0.0, True))
    with pytest.raises(
        numba.core.errors.TypingError, match='by Ref' if wrong == 'a table by value' else 'C-contiguous'
    ):
        if wrong == 'a table by value':
            _call_record(address, f, K, points, 2.5, True)
        else:
            _call_record(address, np.zeros((6, 6))[::2], K, Ref(points), 2.5, True)


@kernel(borrow=True)
def _fill_record(given):
    if given.wanted:
        given.f[2, 5] = given.inside.points[3, 2] + given.add
    given.K[1, 4, 3] = given.add


@kernel
def _call_record(address, f, K, inside, add, wanted):
    invoke(address, (Given(f, K, inside, add, wanted),))


@compiled
def test_a_step_is_compiled_once_for_models_of_all_sizes() -> None:
    """What a step is given has the same type for a pendulum, a slider-crank and ten loops of four bars."""
    scenes = [load_scene('pendulum'), load_scene('slider_crank'), load_scene('four_bar_n', ['mechanism.loops=10'])]
    simulations = [Simulation(dataclasses.replace(scene, integrator=IntegratorSettings())) for scene in scenes]
    given = {(s.bodies.work.type, s.scheme.type, s.model.tables.type, s.bodies.states[0].type) for s in simulations}
    assert len(given) == 1
