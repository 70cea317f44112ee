"""The cache of compiled kernels (solver.compiled.cache): what its key depends on, damage, places that cannot be
written, many processes."""

from __future__ import annotations

import ast
import importlib
import os
import pickle
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
from numba.core.caching import _Cache
from toy_kernels import SOLVER, TOY, VALUES, Toys, package

from solver.compiled.cache import SETTINGS, Compiler
from solver.compiled.lanes.arrays import LaneArrayType
from solver.compiled.lanes.number import DIGEST, LANE, MASK
from solver.disk import PROOF, USED, digest

pytestmark = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason='about compiled code')


FOLDER = SOLVER / 'compiled'


def test_the_compiler_is_extended_in_its_folder_alone() -> None:
    """No name leads from a kernel to the code that adds two duals, so the key has those files whole. Intrinsics are
    called by name. Types of lanes have a digest of their own folder in their names.
    """
    assert DIGEST in LANE.name and DIGEST in MASK.name and DIGEST in LaneArrayType(1, ()).name
    for path in sorted([*SOLVER.rglob('*.py'), *(SOLVER.parent / 'mbd_sim_ros').rglob('*.py')]):
        text = path.read_bytes()
        if path.parent in (FOLDER, FOLDER / 'lanes') or b'numba' not in text:
            continue
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.ImportFrom) and (node.module or '').partition('.')[0] == 'numba':
                taken = {f'{node.module}.{alias.name}' for alias in node.names}
            elif isinstance(node, ast.Attribute) and ast.unparse(node).startswith('numba.extending.'):
                taken = {ast.unparse(node)}
            else:
                continue
            harmless = {'numba.extending.intrinsic', 'numba.core.types', 'numba.core.cgutils', 'numba.types'}
            harmless |= {'numba.core.event'}  # which only listens
            harmless |= {'numba.np.arraymath'}  # which is told beforehand that kernels call no BLAS
            assert taken <= harmless, f'{path}: {taken - harmless}'


def key(folder: Path) -> str:
    return Compiler(folder, Path('/proc/nowhere')).key


@pytest.mark.slow
def test_the_key_of_the_compiler_knows_code_files_and_settings_and_no_places(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = Path(shutil.copytree(FOLDER, tmp_path / 'compiled', ignore=shutil.ignore_patterns('__pycache__')))
    reference = key(folder)
    assert reference == key(FOLDER)
    file = folder / 'vec.py'
    text = file.read_text()
    for edit, same in (
        (lambda: '# more\n\n' + text, True),
        (lambda: text.replace('"""', '"""In other words: ', 1), True),
        (lambda: text + '\nMORE = 1\n', False),
        (lambda: text.replace(' * ', ' + ', 1), False),
    ):
        assert edit() != text
        file.write_text(edit())
        assert (key(folder) == reference) is same
    file.write_text(text)
    (folder / 'more.py').touch()
    assert key(folder) != reference
    (folder / 'more.py').unlink()
    assert key(folder) == reference
    for module, name, value in (
        (numba.config, 'BOUNDSCHECK', 1),
        (numba, '__version__', '0.1'),
        (np, '__version__', '0.1'),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(module, name, value)
            assert key(folder) != reference


@pytest.mark.slow
def test_a_remembered_key_is_believed_only_whole(tmp_path: Path) -> None:
    reference = Compiler(FOLDER, tmp_path).key
    (note,) = (tmp_path / 'syntax').iterdir()
    text = note.read_text()
    for damaged in ('', text.replace(reference, reference[::-1]), 'x' * 4000):
        note.write_text(damaged)
        assert Compiler(FOLDER, tmp_path).key == reference
        assert note.read_text() == text


def test_what_the_cache_relies_on_in_numba_is_there() -> None:
    """Dispatchers ask `_cache` for _Cache's methods; CompileResult takes itself apart and together again."""
    assert _Cache.__abstractmethods__ == {'cache_path', 'load_overload', 'save_overload', 'enable', 'disable', 'flush'}
    assert all(hasattr(numba.config, name) for name in SETTINGS)
    kept = numba.njit(cache=True)(importlib.import_module('solver.elements.smooth').ramp.py_func)
    assert isinstance(kept._cache, _Cache)


# Processes of their own on small kernels.


@pytest.fixture(scope='module')
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return package(tmp_path_factory.mktemp('toy'))


@pytest.fixture(scope='module')
def filled(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory of the three compiled kernels."""
    cache = tmp_path_factory.mktemp('filled')
    first, second = Toys(root, cache, cache / 'jobs').run({}, {})
    assert (first['values'], first['compiled'], first['err']) == (VALUES, 3, '')
    assert (second['values'], second['compiled'], second['err']) == (VALUES, 0, '')
    found = Path(first['cache'])
    assert sorted(p.name.partition('-')[0] for p in found.iterdir()) == [
        'elements.toy.square',
        'elements.toy.total',
        'elements.toy.twice',
    ]
    return found


def file_of(kernels: Path, name: str) -> Path:
    (found,) = kernels.glob(f'elements.toy.{name}-*')
    return found


def flipped(path: Path, places: list[int]) -> None:
    data = bytearray(path.read_bytes())
    for place in places:
        data[place] ^= 1 << abs(place) % 8
    path.write_bytes(data)


def in_code(path: Path) -> int:
    """A place in the instructions: after the header of the object file."""
    return path.read_bytes().index(b'\x7fELF') + 64 + 8


def as_if_whole(path: Path, value: Any, content: bytes = b'') -> None:
    content = content or pickle.dumps(value)
    path.write_bytes(digest(bytes.fromhex(path.name.rpartition('-')[2]), content).hex().encode() + b'\n' + content)


def as_directory(path: Path) -> None:
    path.unlink()
    path.mkdir()
    (path / 'something').touch()


def unreadable(path: Path) -> None:
    """For every user, root too: a link to itself."""
    path.unlink()
    path.symlink_to(path)


def forbidden(path: Path) -> None:
    path.chmod(0)


def as_another(path: Path) -> None:
    shutil.copyfile(file_of(path.parent, 'twice'), path)


DAMAGE: dict[str, Callable[[Path], object]] = {
    'empty': lambda path: path.write_bytes(b''),
    'one byte': lambda path: path.write_bytes(path.read_bytes()[:1]),
    'digest only': lambda path: path.write_bytes(path.read_bytes()[:PROOF]),
    'half': lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]),
    'last byte missing': lambda path: path.write_bytes(path.read_bytes()[:-1]),
    'longer': lambda path: path.write_bytes(path.read_bytes() + b'\0'),
    'bit of the digest': lambda path: flipped(path, [3]),
    'bit after the digest': lambda path: flipped(path, [PROOF + 2]),
    'bit of the code': lambda path: flipped(path, [in_code(path)]),
    'bits everywhere': lambda path: flipped(path, list(range(100, path.stat().st_size, 500))),
    'last bit': lambda path: flipped(path, [-1]),
    'random': lambda path: path.write_bytes(np.random.default_rng(1).bytes(5000)),
    'text': lambda path: path.write_text('a few words\n'),
    'another pickle': lambda path: path.write_bytes(pickle.dumps({'a': 1})),
    'whole, but no code': lambda path: as_if_whole(path, ('not', 'code')),
    'whole, but no pickle': lambda path: as_if_whole(path, None, b'abc'),
    'another kernel': as_another,
    'directory': as_directory,
    'link to itself': unreadable,
    'forbidden': forbidden,
}


@pytest.mark.slow
def test_damage_heals_with_one_line(root: Path, filled: Path, tmp_path: Path) -> None:
    # nothing is forbidden to root
    kinds = {kind: hurt for kind, hurt in DAMAGE.items() if kind != 'forbidden' or os.geteuid()}
    jobs = []
    for k, (kind, hurt) in enumerate(kinds.items()):
        kernels = Path(shutil.copytree(filled, tmp_path / f'{k}'))
        before = file_of(kernels, 'total').read_bytes()
        hurt(file_of(kernels, 'total'))
        assert kind in ('directory', 'link to itself', 'forbidden') or file_of(kernels, 'total').read_bytes() != before
        jobs.append({'cache': str(kernels)})
    answers = Toys(root, tmp_path, tmp_path / 'jobs').run(*jobs, *jobs)
    for kind, job, hurt, healed in zip(kinds, jobs, answers, answers[len(jobs) :], strict=False):
        path = file_of(Path(job['cache']), 'total')
        assert (kind, hurt['values'], hurt['err']) == (kind, VALUES, f'mbd: {path} was damaged; compiled anew\n')
        assert (kind, healed['values'], healed['compiled'], healed['err']) == (kind, VALUES, 0, '')
        assert len(list(path.parent.iterdir())) == 3


@pytest.mark.slow
def test_all_files_damaged_is_one_line_and_missing_ones_none(root: Path, filled: Path, tmp_path: Path) -> None:
    jobs = [{'cache': str(shutil.copytree(filled, tmp_path / name))} for name in ('all', 'missing', 'gone')]
    for path in (tmp_path / 'all').iterdir():
        flipped(path, [in_code(path)])
    file_of(tmp_path / 'missing', 'total').unlink()
    shutil.rmtree(tmp_path / 'gone')
    every, missing, gone = Toys(root, tmp_path, tmp_path / 'jobs').run(*jobs)
    assert (every['values'], every['compiled'], every['err'].count('\n')) == (VALUES, 3, 1)
    assert (missing['values'], missing['err']) == (VALUES, '')
    assert (gone['values'], gone['compiled'], gone['err']) == (VALUES, 3, '')


@pytest.mark.slow
def test_another_checkout_of_the_same_content_finds_the_kernels(root: Path, filled: Path, tmp_path: Path) -> None:
    elsewhere = package(tmp_path / 'elsewhere')
    text = TOY.replace('\n@kernel\n', '\n\n# a comment\n@kernel\n')  # every line moves
    (elsewhere / 'solver' / 'elements' / 'toy.py').write_text('"""Three kernels."""\n' + text)
    answer = Toys(elsewhere, filled.parent, tmp_path / 'jobs').run()[0]
    assert (answer['cache'], answer['values'], answer['compiled'], answer['err']) == (str(filled), VALUES, 0, '')


@pytest.mark.slow
def test_what_is_edited_while_a_process_runs_is_neither_read_nor_kept(root: Path, filled: Path, tmp_path: Path) -> None:
    """Nobody knows which of the two versions it imported."""
    elsewhere = package(tmp_path / 'elsewhere')
    source = elsewhere / 'solver' / 'compiled' / 'interruption.py'
    edit = {'first': [f'Path({str(source)!r}).write_text("")']}
    toys = Toys(elsewhere, tmp_path / 'cache', tmp_path / 'jobs')
    kept = toys.run(edit)[0]
    assert (kept['values'], kept['compiled'], kept['err']) == (VALUES, 3, '')
    assert not Path(kept['cache']).exists()


@pytest.mark.slow
@pytest.mark.parametrize('warm', [False, True])
def test_a_place_that_cannot_be_written_is_told_once_and_leaves_nothing(
    root: Path, filled: Path, tmp_path: Path, warm: bool
) -> None:
    """A full disk, as a limit of the size of files; a place below a file; /proc, where nobody makes directories."""
    temporary = tmp_path / 'temporary'
    temporary.mkdir()
    (tmp_path / 'file').write_text('')
    toys = Toys(root, filled.parent if warm else tmp_path / 'full', tmp_path / 'jobs', TMPDIR=str(temporary))
    answers = toys.run(
        {'limit': 300}, *[] if warm else [{'cache': str(tmp_path / 'file' / 'kernels')}, {'cache': '/proc/kernels'}]
    )
    for answer in answers:
        assert (answer['values'], answer['compiled']) == (VALUES, 0 if warm else 3)
        if warm:
            assert answer['err'] == ''
        else:
            assert answer['err'].startswith(f'mbd: compiled kernels cannot be kept in {answer["cache"]} (')
            assert answer['err'].count('\n') == 1
            assert 'set MBD_CACHE_DIR to' in answer['err']
    assert list(temporary.iterdir()) == []
    assert warm or list(Path(answers[0]['cache']).iterdir()) == []


@pytest.mark.long
@pytest.mark.slow
def test_processes_compile_at_once_while_the_directory_is_removed(root: Path, tmp_path: Path) -> None:
    cache = tmp_path / 'cache'
    toys = Toys(root, cache, tmp_path / 'jobs')
    processes = [toys.start() for _ in range(3)]
    jobs: list[list[dict[str, Any]]] = [[{}, {}], [{}, {}], [{'first': [REMOVE]}, {}]]
    for process, mine in zip(processes, jobs, strict=True):
        toys.send(process, mine)
    answers = [answer for process, mine in zip(processes, jobs, strict=True) for answer in toys.receive(process, mine)]
    assert [(a['values'], a['err']) for a in answers] == [(VALUES, '')] * len(answers)
    last = toys.run({}, {})[1]
    assert (last['values'], last['compiled'], last['err']) == (VALUES, 0, '')
    assert not list(cache.rglob('*.part*'))


REMOVE = """
import shutil, threading, time

def remove():
    for _ in range(100):
        shutil.rmtree(kernel.KERNELS.store.directory, ignore_errors=True)
        time.sleep(0.005)

threading.Thread(target=remove, daemon=True).start()
"""


@pytest.mark.slow
def test_a_start_counts_as_a_use(root: Path, filled: Path, tmp_path: Path) -> None:
    kernels = Path(shutil.copytree(filled, tmp_path / 'kernels'))
    old = time.time() - 9.0 * USED
    for path in kernels.iterdir():
        os.utime(path, (old, old))
    Toys(root, tmp_path, tmp_path / 'jobs').run({'cache': str(kernels)})
    assert [path.name for path in kernels.iterdir() if path.stat().st_mtime < old + USED] == [
        file_of(kernels, 'square').name
    ]  # it is inlined
