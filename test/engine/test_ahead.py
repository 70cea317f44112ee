"""Another process compiles what this one will need: it is read, waited for, given up and ended."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from numba.core import event

from solver.compiled import interruption
from solver.engine import ahead
from solver.engine.ahead import Ahead
from solver.files.scene import load_scene
from solver.simulation import Simulation

KERNEL = {'dispatcher': SimpleNamespace(py_func=SimpleNamespace(__module__='solver.x'))}


def missing() -> None:
    """A kernel is not kept, and is compiled."""
    with event.trigger_event('numba:compile', data=KERNEL):
        pass


def children() -> set[int]:
    """Processes that this one has started."""
    return {int(one) for task in Path('/proc/self/task').iterdir() for one in (task / 'children').read_text().split()}


@pytest.fixture(autouse=True)
def two_processors(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A machine that has two of them, and a process without other threads; no child is left."""
    monkeypatch.setattr(os, 'sched_getaffinity', lambda _: {0, 1})
    monkeypatch.setattr(threading, 'enumerate', lambda: [threading.main_thread()])
    before = children()
    yield
    assert children() <= before  # a worker of tests has others


def noting(file: Path, text: str = '') -> Callable[[], object]:
    return lambda: file.write_text(text or str(os.getpid()))


def test_parts_are_done_elsewhere_in_their_order(tmp_path: Path) -> None:
    before = ahead.elsewhere
    with Ahead(noting(tmp_path / 'one'), missing, noting(tmp_path / 'two')) as child:
        missing()
        missing()  # the second one forks nothing
        child.ready(1)
        assert (tmp_path / 'one').read_text() != str(os.getpid())
    child.ready(3)
    assert (tmp_path / 'one').read_text() == (tmp_path / 'two').read_text()
    assert ahead.elsewhere == before + 1
    child.ready(4)  # more than there are


def test_a_warm_start_forks_nothing(tmp_path: Path) -> None:
    with Ahead(noting(tmp_path / 'one')) as child:
        child.ready(1)
    missing()
    child.ready(1)
    assert not (tmp_path / 'one').exists()


@pytest.mark.parametrize('why', ['one processor', 'another thread', 'another thread compiles'])
def test_where_it_cannot_help_it_does_not(why: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if why == 'one processor':
        monkeypatch.setattr(os, 'sched_getaffinity', lambda _: {0})
    if why == 'another thread':
        monkeypatch.setattr(threading, 'enumerate', lambda: [threading.main_thread(), threading.Thread(name='x')])
    with Ahead(noting(tmp_path / 'one')) as child:
        if why == 'another thread compiles':
            thread = threading.Thread(target=missing)
            thread.start()
            thread.join()
        else:
            missing()
        child.ready(1)
    assert not (tmp_path / 'one').exists()


def test_what_fails_elsewhere_is_compiled_here(tmp_path: Path) -> None:
    with Ahead(lambda: 1 / 0, noting(tmp_path / 'two')) as child:
        missing()
        child.ready(2)
    assert not (tmp_path / 'two').exists()


def test_a_process_that_hangs_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ahead, 'HUNG', 0.2)
    with Ahead(lambda: time.sleep(600.0)) as child:
        missing()
        began = time.monotonic()
        child.ready(1)
    assert time.monotonic() - began < 5.0


def test_an_engine_that_never_starts_leaves_no_process() -> None:
    child = Ahead(lambda: time.sleep(600.0))
    with child:
        missing()
    copied = os.fork()
    if not copied:  # a copy of it in another process ends nothing
        child.__del__()
        os._exit(0)
    os.waitpid(copied, 0)
    assert os.waitpid(child._child, os.WNOHANG) == (0, 0)
    del child


def test_an_interruption_ends_both() -> None:
    def interrupted() -> None:
        with Ahead(lambda: time.sleep(600.0)) as child:
            missing()
            interruption.note(KeyboardInterrupt('enough'))
            child.ready(1)

    try:
        with pytest.raises(KeyboardInterrupt, match='enough'):
            interrupted()
    finally:
        interruption.forget()


def test_an_error_within_the_block_ends_it() -> None:
    def failing() -> None:
        with Ahead(lambda: time.sleep(600.0)):
            missing()
            raise ValueError('bad')

    with pytest.raises(ValueError, match='bad'):
        failing()


def test_an_engine_that_only_compiles_makes_no_step() -> None:
    """The part of the other process, here: tables without addresses, and nothing that would follow one."""
    from solver.engine.stepping import Stepping

    scene = load_scene('slider_crank')
    Simulation(scene).advance(1)  # in another process these kernels would be kept
    bare = Stepping(scene, bound=False)
    before = [array.copy() for array in bare.shown.state]
    bare.compile()
    assert all((a == b).all() for a, b in zip(before, bare.shown.state, strict=True))
