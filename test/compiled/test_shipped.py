"""Kernels that come with a wheel: taken where nothing is kept for this processor, and never where they do not fit."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from solver.compiled.target import V3, runs_v3

ROOT = Path(__file__).parents[2]
pytestmark = [
    pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason='about compiled code'),
    pytest.mark.skipif(not runs_v3(), reason='a processor without AVX2 and FMA'),
    pytest.mark.slow,
]
PROGRAM = """
import json, sys
from pathlib import Path
from numba.core import event
from solver import disk
from solver.compiled import kernel
from solver.compiled.so3 import matrix_of_quaternion
if len(sys.argv) > 1:
    kernel.KERNELS.shipped = disk.Store(Path(sys.argv[1]))
compiled = event.RecordingListener()
event.register('numba:compile', compiled)
values = matrix_of_quaternion((0.5, 0.1, -0.3, 0.8))
print(json.dumps([len(compiled.buffer), sorted(kernel.KERNELS.used), [value.hex() for value in values]]))
"""
FOR_V3 = {'NUMBA_CPU_NAME': V3[0], 'NUMBA_CPU_FEATURES': V3[1]}


def ran(cache: Path, *shipped: Path, **environment: str) -> tuple[int, list[str], list[str]]:
    """(events of the compiler, names of the kernels that were read or written, result) of a process."""
    given = {**os.environ, 'MBD_CACHE_DIR': str(cache), 'PYTHONPATH': str(ROOT), **environment}
    done = subprocess.run(
        [sys.executable, '-c', PROGRAM, *map(str, shipped)],
        env=given, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return tuple(json.loads(done.stdout))


@pytest.fixture(scope='module')
def shipped(tmp_path_factory) -> tuple[Path, list[str], list[str]]:
    """(directory of kernels for every processor, their names, the result of one)."""
    cache = tmp_path_factory.mktemp('wheel')
    events, names, values = ran(cache, **FOR_V3)
    assert events > 0 and names
    return cache / 'kernels', names, values


def test_what_fits_is_taken_and_nothing_is_compiled(shipped, tmp_path):
    directory, names, values = shipped
    assert ran(tmp_path, directory) == (0, names, values)
    assert not (tmp_path / 'kernels').exists()


def test_what_is_kept_for_this_processor_comes_first(shipped, tmp_path):
    directory, names, values = shipped
    events, own, found = ran(tmp_path)  # without those that came with the program
    assert events > 0 and found == values
    if own != names:  # this processor has more than V3
        assert ran(tmp_path, directory) == (0, own, values)


def test_a_damaged_one_is_compiled_anew(shipped, tmp_path):
    directory, names, values = shipped
    there = tmp_path / 'shipped'
    there.mkdir()
    for name in names:
        content = bytearray((directory / name).read_bytes())
        content[len(content) // 2] ^= 1
        (there / name).write_bytes(content)
    events, _, found = ran(tmp_path / 'cache', there)
    assert events > 0 and found == values


def test_none_is_taken_for_a_processor_that_somebody_asked_for(shipped, tmp_path):
    told = ran(tmp_path, NUMBA_CPU_NAME='haswell', NUMBA_CPU_FEATURES=V3[1])
    assert told[0] > 0
    program = 'from solver.compiled.target import runs_v3; print(runs_v3())'
    asked = {**os.environ, 'NUMBA_CPU_NAME': 'generic', 'PYTHONPATH': str(ROOT)}
    done = subprocess.run([sys.executable, '-c', program], env=asked, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == 'False'
