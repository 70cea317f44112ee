"""The same bits on every x86-64 processor with FMA: the libraries that choose their code by the processor do not enter
a run."""

from __future__ import annotations

import ast
import functools
import json
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from solver.compiled.kernel import kernel
from solver.disk import location

ROOT = Path(__file__).parents[2]
SCENES = (
    'slider_crank',
    'car_swept_steer',
    'light_car_lane_change',
    'car_rough_road',
    'car_cleat',
    'bricard',
    'flyball_governor',
)
SMALL = ('slider_crank',)
# what Haswell has of what LLVM knows, so that no instruction of a newer processor is used
HASWELL = (
    '+avx,+avx2,+bmi,+bmi2,+cmov,+cx16,+f16c,+fma,+fsgsbase,+lzcnt,+mmx,+movbe,+pclmul,+popcnt,+rdrnd,+sahf,+sse,+sse2,+sse3,+sse4.1,'
    '+sse4.2,+ssse3,+xsave,+xsaveopt'
)


try:
    from numpy._core._multiarray_umath import __cpu_dispatch__ as DISPATCHED
    from numpy._core._multiarray_umath import __cpu_features__ as FEATURES
except ImportError:  # numpy 1
    from numpy.core._multiarray_umath import __cpu_dispatch__ as DISPATCHED
    from numpy.core._multiarray_umath import __cpu_features__ as FEATURES

# instruction sets that numpy chooses on this processor
BEYOND_BASELINE = ' '.join(name for name in DISPATCHED if FEATURES.get(name))
# OpenBLAS ends at the first instruction that a processor lacks
NEWEST = 'SkylakeX' if FEATURES.get('AVX512F') else 'Zen'


@functools.cache
def bits(scenes: tuple[str, ...], *arguments: str, **environment: str) -> dict[str, dict[str, list[str]]]:
    """Digests that test/support/bits_of_runs.py prints in an environment."""
    command = [sys.executable, str(ROOT / 'test' / 'support' / 'bits_of_runs.py'), *arguments, *scenes]
    given = {**os.environ, 'PYTHONPATH': str(ROOT), **environment}
    done = subprocess.run(command, env=given, capture_output=True, text=True, check=False, timeout=600)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.slow
@pytest.mark.parametrize(
    'environment',
    [
        pytest.param({'OPENBLAS_CORETYPE': 'Haswell'}, marks=pytest.mark.long),
        # which has the code of Haswell
        pytest.param({'OPENBLAS_CORETYPE': NEWEST}, marks=pytest.mark.long if NEWEST == 'Zen' else ()),
        pytest.param(
            {'OPENBLAS_CORETYPE': 'Sandybridge', 'NPY_DISABLE_CPU_FEATURES': BEYOND_BASELINE}, marks=pytest.mark.long
        ),
        {'OPENBLAS_CORETYPE': 'Prescott', 'NPY_DISABLE_CPU_FEATURES': BEYOND_BASELINE},  # furthest from the one at hand
    ],
    ids=lambda environment: environment['OPENBLAS_CORETYPE'],
)
def test_neither_blas_nor_numpy_choose_the_bits_of_a_run(environment):
    assert bits(SCENES, **environment) == {'here': bits(SCENES, '--nudged')['here']}


@pytest.mark.slow
def test_nor_does_the_last_bit_of_what_numpy_chooses_by_the_processor():
    """All of it is replaced by functions that are one unit in the last place off, as on a processor with other vector
    instructions."""
    found = bits(SCENES, '--nudged')
    assert found['nudged'] == found['here']


def test_the_runs_are_not_all_the_same():
    """A digest that nothing enters would be equal everywhere."""
    found = bits(SCENES, '--nudged')['here']
    ends = [end for _, end in found.values()]
    assert len(set(ends)) == len(ends) == len(SCENES) + 1


@pytest.mark.long
@pytest.mark.slow
def test_kernels_compiled_for_an_older_processor_give_the_same_bits():
    cache = location() / 'haswell'  # so that it compiles once only
    older = bits(SMALL, NUMBA_CPU_NAME='haswell', NUMBA_CPU_FEATURES=HASWELL, MBD_CACHE_DIR=str(cache))
    assert older == bits(SMALL)


@kernel(inner=False)
def _elementary(x, y, out):
    out[0] = np.sin(x)
    out[1] = np.cos(x)
    out[2] = np.tan(x)
    out[3] = np.exp(y)
    out[4] = np.log(x)
    out[5] = np.arctan(y)
    out[6] = np.arctan2(y, x)
    out[7] = x**y
    out[8] = np.sqrt(x)


def test_kernels_call_the_elementary_functions_of_the_c_library():
    """So the digest in a target (solver.compiled.target) is one of theirs."""
    out = np.zeros(9)
    for k in range(4000):
        x = 0.003 + 0.003 * k
        y = 0.37 * x - 1.0
        _elementary(x, y, out)
        library = (
            math.sin(x),
            math.cos(x),
            math.tan(x),
            math.exp(y),
            math.log(x),
            math.atan(y),
            math.atan2(y, x),
            x**y,
            math.sqrt(x),
        )
        assert out.tolist() == list(library)


@pytest.mark.parametrize(
    'module', ['solver.elements.coordinate', 'solver.compiled.kernel', 'solver.compiled.by_reference']
)
def test_vector_functions_of_intel_are_off_whatever_is_imported_first(module):
    """numba takes SVML where it is installed, and decides when it is imported."""
    program = f'import {module}, numba; print(numba.config.DISABLE_INTEL_SVML)'
    environment = {**os.environ, 'PYTHONPATH': str(ROOT)}
    done = subprocess.run(
        [sys.executable, '-c', program], env=environment, capture_output=True, text=True, check=True, timeout=100
    )
    assert int(done.stdout) == 1


# Files of the solver whose results are only shown, that only judge, or that integrate independently of what they check.
SHOWN = (
    *(
        'analysis/',
        'reference/',
        'trade/',
        'quantities.py',
        'output/branches.py',
        'output/dependence.py',
        'files/urdf.py',
    ),
    'start/equilibrium_stability.py',
    # limits of coefficients of tires, which refuse or tell and give no number to a run
    *('elements/slip_limits.py', 'elements/upright_law.py'),
    'start/reach.py',  # says why a step has failed
)
# Files that tell numba what to compile for these functions, or are compiled by way of that.
FOR_NUMBA = ('compiled/dual.py', 'compiled/so3.py', 'compiled/lanes/dual.py', 'compiled/lanes/functions.py')
CHOSEN_BY_THE_PROCESSOR = {
    *(
        'sin',
        'cos',
        'tan',
        'exp',
        'exp2',
        'expm1',
        'log',
        'log2',
        'log10',
        'log1p',
        'sinh',
        'cosh',
        'tanh',
        'arcsin',
        'arccos',
        'arctan',
    ),
    *(
        'arctan2',
        'hypot',
        'power',
        'float_power',
        'cbrt',
        'dot',
        'vdot',
        'inner',
        'matmul',
        'tensordot',
        'linalg',
        'einsum',
        'polyfit',
    ),
    *('logspace', 'geomspace'),
}


def test_no_file_of_a_run_uses_what_the_processor_chooses():
    """Neither BLAS, LAPACK and numpy's elementary functions, outside of kernels, nor scipy; nor products of matrices in
    kernels.

    scipy.spatial is compiled for every processor alike, and calls none of these.
    """
    found = []
    for path in sorted((ROOT / 'solver').rglob('*.py')):
        name = path.relative_to(ROOT / 'solver').as_posix()
        if not name.startswith(SHOWN):
            found += [f'{name}:{line}: {what}' for line, what in _uses(ast.parse(path.read_text()), name in FOR_NUMBA)]
    assert found == []


def _uses(tree: ast.AST, in_kernel: bool = False) -> list[tuple[int, str]]:
    found = []
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.BinOp | ast.AugAssign) and isinstance(node.op, ast.MatMult):
            found.append((node.lineno, '@'))
        elif isinstance(node, ast.Import | ast.ImportFrom):
            names = [getattr(node, 'module', None) or '', *(alias.name for alias in node.names)]
            found += [
                (node.lineno, name) for name in names if name.split('.')[0] == 'scipy' and name != 'scipy.spatial'
            ]
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == 'np':
            banned = {'linalg', 'dot', 'vdot', 'matmul'} if in_kernel else CHOSEN_BY_THE_PROCESSOR
            found += [(node.lineno, f'np.{node.attr}')] if node.attr in banned else []
        compiled_here = isinstance(node, ast.FunctionDef) and any(
            'kernel' in ast.unparse(d) for d in node.decorator_list
        )
        found += _uses(node, in_kernel or compiled_here)
    return found
