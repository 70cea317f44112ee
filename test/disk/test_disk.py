"""What is kept on disk (solver.disk): whole or not there, whoever is killed and however full the disk is; never
believed when damaged."""

from __future__ import annotations

import json
import math
import os
import resource
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from solver import disk
from solver.disk import (
    KEPT,
    PART,
    PROOF,
    SIZE,
    USED,
    YOUNG,
    Store,
    alone,
    atomic_write,
    derived,
    digest,
    location,
    plain,
    sources,
    store_of,
)
from solver.errors import BagError

OLD, NEW = b'old' * 1000, b'new' * 2000


def in_a_child(do: Callable[[], None]) -> int:
    """What a forked process that does this ends with: 0, 1 for an OSError, or minus the signal."""
    child = os.fork()
    if child == 0:
        code = 2
        try:
            do()
            code = 0
        except (OSError, BagError):
            code = 1
        finally:
            os._exit(code)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def killed_at(line: int, do: Callable[[], None]) -> None:
    """Do something, and be killed at this line of solver.disk, counted as they are run, or within what it calls."""
    count = 0

    def trace(frame: Any, event: str, _: object) -> Any:
        nonlocal count
        if frame.f_code.co_filename != disk.__file__ and frame.f_code is not Path.write_bytes.__code__:
            return None
        count += event == 'line'
        if count == line:
            os.kill(os.getpid(), signal.SIGKILL)
        return trace

    sys.settrace(trace)
    do()


def write_whole(file: Path, content: bytes) -> None:
    with atomic_write(file) as part:
        part.write_bytes(content)


def in_store(file: Path, content: bytes) -> None:
    Store(file.parent, bounded=True).write(file.name, content, 'identity')


def kept_in_store(file: Path) -> bytes | None:
    return Store(file.parent).read(file.name, 'identity')


WAYS = {'file': (write_whole, Path.read_bytes), 'store': (in_store, kept_in_store)}


@pytest.mark.parametrize('way', WAYS)
def test_who_is_killed_at_any_line_leaves_the_old_or_the_new_one(way: str, tmp_path: Path) -> None:
    write, read = WAYS[way]
    write(tmp_path / 'value', OLD)
    found, line = [], 0
    while True:
        line += 1
        end = in_a_child(lambda line=line: killed_at(line, lambda: write(tmp_path / 'value', NEW)))  # type: ignore[misc]
        found.append(read(tmp_path / 'value'))
        left = [path for path in tmp_path.iterdir() if path.name != 'value']
        assert len(left) <= 1 and all(PART in path.name for path in left)
        for path in left:
            path.unlink()
        if end == 0:
            break
        assert end == -signal.SIGKILL
    assert line > 10
    assert found[0] == OLD and found[-1] == NEW
    # first the one, then the other, and nothing between them
    assert found == sorted(found, key=lambda content: content == NEW)


@pytest.mark.parametrize('way', WAYS)
@pytest.mark.parametrize('room', [0, 1, PROOF, 3000, len(NEW) - 1])
def test_a_full_disk_leaves_the_old_one_and_nothing_else(way: str, room: int, tmp_path: Path) -> None:
    """A limit of the size of a file stands for the disk."""
    write, read = WAYS[way]
    write(tmp_path / 'value', OLD)

    def without_room() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))
        write(tmp_path / 'value', NEW)

    assert in_a_child(without_room) == 1
    assert read(tmp_path / 'value') == OLD
    assert list(tmp_path.iterdir()) == [tmp_path / 'value']


def test_a_link_stays_and_a_device_is_written_itself(tmp_path: Path) -> None:
    (tmp_path / 'there').write_bytes(OLD)
    (tmp_path / 'link').symlink_to('there')
    write_whole(tmp_path / 'link', NEW)
    assert (tmp_path / 'link').is_symlink() and (tmp_path / 'there').read_bytes() == NEW
    write_whole(Path('/dev/null'), NEW)
    assert not Path('/dev/null').is_file()


def test_no_flipped_bit_no_shorter_file_and_no_other_identity_is_read(tmp_path: Path) -> None:
    store, file = Store(tmp_path), tmp_path / 'value'
    store.write('value', b'content', 'identity')
    data = file.read_bytes()
    assert (store.read('value', 'identity'), store.damaged) == (b'content', set())
    assert [store.read('value', *other) for other in (('another',), (), ('identity', ''), ('ident', 'ity'))] == [
        None
    ] * 4
    for place in range(len(data)):
        for bit in range(8):
            file.write_bytes(data[:place] + bytes([data[place] ^ (1 << bit)]) + data[place + 1 :])
            assert store.read('value', 'identity') is None
        file.write_bytes(data[:place])
        assert store.read('value', 'identity') is None
    file.write_bytes(data + b'\0')
    assert store.read('value', 'identity') is None
    assert store.damaged == {'value'}
    assert Store(tmp_path).read('none', 'identity') is None
    assert Store(tmp_path / 'value').read('below a file', 'identity') is None


def as_directory(file: Path) -> None:
    (file / 'something').mkdir(parents=True)


@pytest.mark.parametrize(
    'lies', [as_directory, lambda file: file.symlink_to(file), lambda file: file.symlink_to('/dev/full')]
)
def test_what_lies_in_the_way_of_a_value_is_replaced(lies: Callable[[Path], None], tmp_path: Path) -> None:
    lies(tmp_path / 'value')
    store = Store(tmp_path)
    assert store.read('value') is None
    store.write('value', NEW)
    assert store.read('value') == NEW and (tmp_path / 'value').is_file() and not (tmp_path / 'value').is_symlink()


def test_another_process_may_remove_the_directory_at_any_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store, removed = Store(tmp_path / 'store', bounded=True), []
    plain_whole = disk.atomic_write

    def whole_later(file: Path) -> Any:
        if len(removed) < 3:
            removed.append(file)
            file.parent.rmdir()
        return plain_whole(file)

    monkeypatch.setattr(disk, 'atomic_write', whole_later)
    store.write('value', NEW)
    assert len(removed) == 3 and store.read('value') == NEW


def aged(store: Store, name: str, age: float, size: int = 1) -> None:
    store.directory.mkdir(exist_ok=True)
    with (store.directory / name).open('wb') as file:
        file.truncate(size)  # which takes no room
    os.utime(store.directory / name, (time.time() - age,) * 2)


def names(store: Store) -> set[str]:
    return {path.name for path in store.directory.iterdir()}


def test_pruning_removes_what_is_old_and_above_the_size_what_is_oldest(tmp_path: Path) -> None:
    store = Store(tmp_path / 'store', bounded=True)
    for name, age in (('now', 0.0), ('day', 0.9 * YOUNG), ('month', 0.9 * KEPT), ('old', 1.1 * KEPT)):
        aged(store, name, age)
    aged(store, f'.fresh{PART}', 0.5 * YOUNG)  # a process may be writing it
    aged(store, f'.left{PART}', 1.1 * YOUNG)
    store.write('first', NEW)
    assert names(store) == {'now', 'day', 'month', 'first', f'.fresh{PART}'}
    for name, age in (('week', 7.0 * YOUNG), ('two', 2.0 * YOUNG), ('young', 0.9 * YOUNG)):
        aged(store, name, age, SIZE // 3)
    aged(store, 'old', 1.1 * KEPT)
    store.write('second', NEW)
    assert 'old' in names(store)  # one look at the beginning is enough
    Store(tmp_path / 'store').write('third', NEW)
    assert 'old' in names(store)  # what belongs to somebody has no bound
    Store(tmp_path / 'store', bounded=True).write('fourth', NEW)
    assert names(store) == {'now', 'day', 'two', 'young', 'first', 'second', 'third', 'fourth', f'.fresh{PART}'}


def test_a_process_looks_once_at_each_of_its_stores(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every start of a sweep, every level and every error is a value of its own: with a look for each, a start that is
    found anew took longer for the files of others than for itself."""
    monkeypatch.setenv('MBD_CACHE_DIR', str(tmp_path))
    looked: list[Path] = []
    monkeypatch.setattr(Store, 'prune', lambda self: looked.append(self.directory))
    for name in ('starts', 'levels', 'starts', 'starts', 'levels'):
        store_of(name).write('value', NEW)
    assert looked == [tmp_path / 'starts', tmp_path / 'levels']
    assert store_of('starts').read('value') == NEW


def test_a_use_is_noted(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.write('value', NEW)
    for age, noted in ((0.5 * USED, False), (1.5 * USED, True)):
        os.utime(tmp_path / 'value', (time.time() - age,) * 2)
        assert store.read('value') == NEW
        assert (time.time() - (tmp_path / 'value').stat().st_mtime < 0.1 * USED) is noted


def test_a_directory_is_one_process_s_alone(tmp_path: Path) -> None:
    with alone(tmp_path / 'out'):

        def another() -> None:
            with alone(tmp_path / 'out'):
                pass

        assert in_a_child(another) == 1
    assert in_a_child(another) == 0
    (tmp_path / 'file').touch()
    with pytest.raises(BagError, match='choose another place'), alone(tmp_path / 'file'):
        pass


def test_a_digest_tells_parts_and_their_borders_apart() -> None:
    found = [digest(), digest(''), digest('', ''), digest('ab'), digest('a', 'b'), digest('b', 'a'), digest('ä')]
    assert len(set(found)) == len(found)
    assert digest('ä') == digest('ä'.encode())


def test_the_digest_of_sources_knows_names_contents_and_new_files_and_no_places(tmp_path: Path) -> None:
    def of(name: str, *files: tuple[str, str]) -> str:
        for path, text in files:
            (tmp_path / name / 'top' / path).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name / 'top' / path).write_text(text)
        return sources(tmp_path / name / 'top')

    one = of('a', ('x.py', '1'), ('sub/y.py', '2'))
    assert one == of('b', ('x.py', '1'), ('sub/y.py', '2'), ('notes.txt', 'passed over'))
    others = [
        of('c', ('x.py', '1'), ('sub/y.py', '3')),
        of('d', ('x.py', '1'), ('sub/z.py', '2')),
        of('e', ('x.py', '1'), ('sub/y.py', '2'), ('w.py', '')),
        of('f', ('x.py', '12'), ('sub/y.py', '')),
    ]
    assert len({one, *others}) == 5
    assert sources(tmp_path / 'a' / 'top' / 'x.py') != one
    assert sources() == sources(Path(disk.__file__).parent)


def test_json_has_plain_numbers_and_null_where_there_is_none() -> None:
    value = {
        1: (np.float64(0.1), np.int64(3), np.bool_(True)),
        'a': [math.nan, -math.inf, np.float32(np.inf)],
        'place': Path('/a'),
        'none': None,
    }
    assert plain(value) == {'1': [0.1, 3, True], 'a': [None, None, None], 'place': '/a', 'none': None}
    assert json.loads(json.dumps(plain(value), allow_nan=False)) == plain(value)
    number = 0.1 + 0.2
    assert json.loads(json.dumps(plain([number, 5e-324, 1e308]))) == [number, 5e-324, 1e308]


def test_a_location_that_is_given_is_taken_and_a_user_without_a_home_has_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv('MBD_CACHE_DIR', str(tmp_path))
    assert location() == tmp_path
    derived('a', 'b', lambda: 1)
    assert [path.parent.name for path in tmp_path.rglob('a-*.json')] == ['levels']
    monkeypatch.delenv('MBD_CACHE_DIR')
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path / 'caches'))
    assert location() == tmp_path / 'caches' / 'mbd_sim_ros'
    monkeypatch.delenv('XDG_CACHE_HOME')
    monkeypatch.setattr(Path, 'home', lambda: (_ for _ in ()).throw(RuntimeError))
    assert location() == Path('/.cache/mbd_sim_ros')
