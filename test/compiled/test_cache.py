"""The cache of compiled kernels (solver.compiled.cache): what its key depends on, damage, places that cannot be written, many processes."""

from __future__ import annotations

import ast
import importlib
import os
import pickle
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import CodeType
from typing import Any

import numba
import numpy as np
import pytest
from numba.core.caching import _Cache
from numba.core.dispatcher import Dispatcher
from toy_kernels import SOLVER, TOY, VALUES, Toys, package

from solver.compiled.cache import DIGEST, FOLDERS, KEPT, KEPT_SECONDS, SETTINGS, KernelCache, Sources, Store, _prune, digest

pytestmark = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason='about compiled code')


def solver_modules() -> Iterator[tuple[str, ast.Module]]:
    """(path below solver/, syntax) of every file."""
    for path in sorted(SOLVER.rglob('*.py')):
        yield path.relative_to(SOLVER).as_posix(), ast.parse(path.read_bytes())


def test_every_kernel_is_in_a_folder_of_the_key() -> None:
    with_kernels = set()
    for path, tree in solver_modules():
        for node in ast.walk(tree):
            decorators = node.decorator_list if isinstance(node, ast.FunctionDef) else [node.func] if isinstance(node, ast.Call) else []
            names = {ast.unparse(d.func if isinstance(d, ast.Call) else d).rpartition('.')[2] for d in decorators}
            if names & {'kernel', 'njit', 'jit', 'intrinsic', 'overload', 'overload_attribute', 'register_model'}:
                with_kernels.add(path.partition('/')[0])
    assert with_kernels == set(FOLDERS)


def test_kernels_take_nothing_from_files_outside_of_the_key() -> None:
    """A constant is compiled into the code."""
    kernels = 0
    for path, tree in solver_modules():
        if path.partition('/')[0] not in FOLDERS:
            continue
        foreign = set()
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and (node.module or '').partition('.')[0] == 'solver':
                folder = (node.module or '').partition('.')[2].partition('.')[0]
                foreign |= {name.asname or name.name for name in node.names if (folder or name.name) not in FOLDERS}
        module = importlib.import_module('solver.' + path.removesuffix('.py').removesuffix('/__init__').replace('/', '.'))
        for value in vars(module).values():
            if isinstance(value, Dispatcher) and value.__module__ == module.__name__:
                kernels += 1
                assert not names_in(value.py_func.__code__) & foreign, f'{path}: {value.__name__}'
                assert isinstance(value._cache, KernelCache), f'{path}: {value.__name__} is not kept'
    assert kernels > 150


def names_in(code: CodeType) -> set[str]:
    return set(code.co_names).union(*(names_in(c) for c in code.co_consts if isinstance(c, CodeType)))


@pytest.fixture(scope='module')
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the solver, to be edited: a part of it, for a key takes a second of all."""
    copy = tmp_path_factory.mktemp('tree') / 'solver'
    for folder in FOLDERS:
        (copy / folder).mkdir(parents=True)
        shutil.copy(min((SOLVER / folder).glob('[a-z]*.py')), copy / folder)
    for name, *_ in EDITS.values():
        (copy / name).parent.mkdir(exist_ok=True)
        shutil.copy(SOLVER / name, copy / name)
    return copy


def key(root: Path, base: Path | None = None) -> str:
    return Sources(root, base or Path('/proc/nowhere')).key


@pytest.fixture(scope='module')
def reference(tree: Path) -> str:
    """The key of what has not been edited."""
    return key(tree)


EDITS: dict[str, tuple[str, Callable[[str], str], bool]] = {
    'a template': ('vehicle/corner.py', lambda text: text + '\nMORE = 1\n', True),
    'a reader': ('files/scene.py', lambda text: text + '\nMORE = 1\n', True),
    'the simulation': ('simulation.py', lambda text: text + '\nMORE = 1\n', True),
    'a comment': ('elements/smooth.py', lambda text: '# more\n\n' + text, True),
    'docstrings': ('elements/smooth.py', lambda text: text.replace('"""', '"""In other words: ', 1), True),
    'a kernel': ('elements/smooth.py', lambda text: text.replace('0.5', '0.25', 1).replace('2.0', '4.0', 1), False),
    'the start': ('start/newton.py', lambda text: text + '\nMORE = 1\n', False),
}


@pytest.mark.slow
@pytest.mark.parametrize('what', EDITS)
def test_only_what_decides_about_kernels_changes_the_key(tree: Path, reference: str, what: str) -> None:
    name, edit, same = EDITS[what]
    before = (tree / name).read_text()
    assert edit(before) != before
    (tree / name).write_text(edit(before))
    after = key(tree)
    (tree / name).write_text(before)
    assert (after == reference) is same


@pytest.mark.slow
def test_the_key_knows_new_files_and_settings_and_no_places(
    tree: Path, reference: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    elsewhere = Path(shutil.copytree(tree, tmp_path / 'elsewhere'))
    assert key(elsewhere) == reference
    (tree / 'linear' / 'more.py').write_text('')
    assert key(tree) != reference
    (tree / 'linear' / 'more.py').unlink()
    assert key(tree) == reference
    monkeypatch.setattr(numba.config, 'BOUNDSCHECK', 1)
    assert key(tree) != reference


@pytest.mark.slow
def test_a_remembered_key_is_believed_only_whole(tree: Path, tmp_path: Path) -> None:
    reference = key(tree, tmp_path)
    (note,) = tmp_path.iterdir()
    text = note.read_text()
    for damaged in ('', text.replace(reference, reference[::-1]), 'x' * 4000):
        note.write_text(damaged)
        assert key(tree, tmp_path) == reference
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
    assert sorted(p.name.partition('-')[0] for p in found.iterdir()) == ['elements.toy.square', 'elements.toy.total', 'elements.toy.twice']
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


def as_if_whole(path: Path, value: Any) -> None:
    content = pickle.dumps(value)
    path.write_bytes(digest(bytes.fromhex(path.name.rpartition('-')[2]), content) + content)


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
    'digest only': lambda path: path.write_bytes(path.read_bytes()[:DIGEST]),
    'half': lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]),
    'last byte missing': lambda path: path.write_bytes(path.read_bytes()[:-1]),
    'longer': lambda path: path.write_bytes(path.read_bytes() + b'\0'),
    'bit of the digest': lambda path: flipped(path, [3]),
    'bit after the digest': lambda path: flipped(path, [DIGEST + 2]),
    'bit of the code': lambda path: flipped(path, [in_code(path)]),
    'bits everywhere': lambda path: flipped(path, list(range(100, path.stat().st_size, 500))),
    'last bit': lambda path: flipped(path, [-1]),
    'random': lambda path: path.write_bytes(np.random.default_rng(1).bytes(5000)),
    'text': lambda path: path.write_text('a few words\n'),
    'another pickle': lambda path: path.write_bytes(pickle.dumps({'a': 1})),
    'whole, but no code': lambda path: as_if_whole(path, ('not', 'code')),
    'whole, but no pickle': lambda path: path.write_bytes(digest(bytes.fromhex(path.name.rpartition('-')[2]), b'abc') + b'abc'),
    'another kernel': as_another,
    'directory': as_directory,
    'link to itself': unreadable,
    'forbidden': forbidden,
}


@pytest.mark.slow
def test_damage_heals_with_one_line(root: Path, filled: Path, tmp_path: Path) -> None:
    kinds = {kind: hurt for kind, hurt in DAMAGE.items() if kind != 'forbidden' or os.geteuid()}  # nothing is forbidden to root
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
def test_no_flipped_bit_and_no_shorter_file_is_read(filled: Path, tmp_path: Path) -> None:
    store = Store(tmp_path, tmp_path)
    store.directory = tmp_path
    name, identity = 'elements.toy.total-0', b'identity'
    path = tmp_path / name
    store.write(name, identity, ['code', 1.5])
    whole = path.read_bytes()
    assert store.read(name, identity) == ['code', 1.5]
    assert store.read(name, b'another') is None
    for place in range(len(whole)):
        for bit in range(8):
            path.write_bytes(whole[:place] + bytes([whole[place] ^ (1 << bit)]) + whole[place + 1 :])
            assert store.read(name, identity) is None
        path.write_bytes(whole[:place])
        assert store.read(name, identity) is None


@pytest.mark.slow
def test_another_checkout_of_the_same_content_finds_the_kernels(root: Path, filled: Path, tmp_path: Path) -> None:
    elsewhere = package(tmp_path / 'elsewhere')
    text = TOY.replace('\n@kernel\n', '\n\n# a comment\n@kernel\n')  # every line moves
    (elsewhere / 'solver' / 'elements' / 'toy.py').write_text('"""Three kernels."""\n' + text)
    answer = Toys(elsewhere, filled.parent, tmp_path / 'jobs').run()[0]
    assert (answer['cache'], answer['values'], answer['compiled'], answer['err']) == (str(filled), VALUES, 0, '')


@pytest.mark.slow
def test_a_changed_callee_is_never_met_by_old_code(root: Path, filled: Path, tmp_path: Path) -> None:
    elsewhere = package(tmp_path / 'elsewhere')
    (elsewhere / 'solver' / 'elements' / 'toy.py').write_text(TOY.replace('x * x', 'x * x * x'))
    answer = Toys(elsewhere, filled.parent, tmp_path / 'jobs').run()[0]
    assert answer['cache'] != str(filled)
    assert (answer['values'], answer['compiled'], answer['err']) == ([100.0, 200.0], 3, '')


@pytest.mark.slow
def test_what_is_edited_while_a_process_runs_is_neither_read_nor_kept(root: Path, filled: Path, tmp_path: Path) -> None:
    """Nobody knows which of the two versions it imported."""
    elsewhere = package(tmp_path / 'elsewhere')
    source = elsewhere / 'solver' / 'elements' / 'toy.py'
    edit = {'first': [f'Path({str(source)!r}).write_text("")']}
    toys = Toys(elsewhere, tmp_path / 'cache', tmp_path / 'jobs')
    kept = toys.run(edit)[0]
    assert (kept['values'], kept['compiled'], kept['err']) == (VALUES, 3, '')
    assert not Path(kept['cache']).exists()


@pytest.mark.slow
@pytest.mark.parametrize('warm', [False, True])
def test_a_place_that_cannot_be_written_is_told_once_and_leaves_nothing(root: Path, filled: Path, tmp_path: Path, warm: bool) -> None:
    """A full disk, as a limit of the size of files; a place below a file; /proc, where nobody makes directories."""
    temporary = tmp_path / 'temporary'
    temporary.mkdir()
    (tmp_path / 'file').write_text('')
    toys = Toys(root, filled.parent if warm else tmp_path / 'full', tmp_path / 'jobs', TMPDIR=str(temporary))
    answers = toys.run({'limit': 300}, *[] if warm else [{'cache': str(tmp_path / 'file' / 'kernels')}, {'cache': '/proc/kernels'}])
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
    assert not list(cache.rglob('*.tmp'))


REMOVE = """
import shutil, threading, time

def remove():
    for _ in range(100):
        shutil.rmtree(kernel.STORE.directory, ignore_errors=True)
        time.sleep(0.005)

threading.Thread(target=remove, daemon=True).start()
"""


def test_pruning_keeps_the_newest_and_those_used_within_a_day(tmp_path: Path) -> None:
    now = time.time()
    ages = [0.0, 60.0, 0.5 * KEPT_SECONDS, 0.9 * KEPT_SECONDS, 2.0 * KEPT_SECONDS, 30.0 * KEPT_SECONDS]
    for k, age in enumerate(ages):
        (tmp_path / f'kernels-{k}').mkdir()
        (tmp_path / f'kernels-{k}' / 'file').touch()
        os.utime(tmp_path / f'kernels-{k}', (now - age, now - age))
    (tmp_path / 'something else').touch()
    _prune(tmp_path, 'kernels-*')
    assert sorted(p.name for p in tmp_path.iterdir()) == ['kernels-0', 'kernels-1', 'kernels-2', 'kernels-3', 'something else']
    for k in range(4):
        os.utime(tmp_path / f'kernels-{k}', (now - (k + 2) * KEPT_SECONDS,) * 2)
    _prune(tmp_path, 'kernels-*')
    assert sorted(p.name for p in tmp_path.glob('kernels-*')) == [f'kernels-{k}' for k in range(KEPT)]


@pytest.mark.slow
def test_a_start_counts_as_a_use(root: Path, filled: Path, tmp_path: Path) -> None:
    old = time.time() - 9.0 * KEPT_SECONDS
    os.utime(filled, (old, old))
    Toys(root, filled.parent, tmp_path / 'jobs').run()
    assert filled.stat().st_mtime > old + KEPT_SECONDS
