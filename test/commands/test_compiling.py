"""The bar while kernels compile: kernels of the solver are counted, on a terminal, and never where the output is no
terminal or is JSON."""

from __future__ import annotations

import io
import os
import pty
import subprocess
import sys
import termios
from pathlib import Path
from types import SimpleNamespace

import pytest
from numba.core import event
from terminals import written

from mbd_sim_ros import compiling

# Kernels that are told to be compiled, one while another is: what numba's dispatcher tells, without its compiler.
SCRIPT = """
import sys
from types import SimpleNamespace
from numba.core import event
from mbd_sim_ros import compiling

def kernel(module):
    return {'dispatcher': SimpleNamespace(py_func=SimpleNamespace(__module__=module))}

compiling.tell(sys.argv[1] == 'shown', SimpleNamespace(tires=()))
for _ in range(3):
    with event.trigger_event('numba:compile', data=kernel('solver.model.evaluate')):
        with event.trigger_event('numba:compile', data=kernel('solver.compiled.vec')):
            pass
    with event.trigger_event('numba:compile', data=kernel('numba.np.arrayobj')):
        pass
print('done')
"""
# Kernels that a scene needs without a cache: MBD_CACHE_DIR is empty.
COUNT = """
import sys
from numba.core import event
from mbd_sim_ros import compiling
from mbd_sim_ros.batch import warm_up
from solver import load_scene, simulation_of
bar = compiling.Bar(shown=False)
event.register('numba:compile', bar)
warm_up(simulation_of(load_scene(sys.argv[1])))
print(bar.count)
"""


def printed(shown: str, *, terminal: bool) -> str:
    """The standard error of the script on a terminal, or on a pipe."""
    environment = {**os.environ, 'PYTHONPATH': os.pathsep.join(sys.path), 'TERM': 'xterm'}
    command = [sys.executable, '-c', SCRIPT, shown]
    if not terminal:
        return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=True).stderr
    ours, theirs = pty.openpty()
    termios.tcsetwinsize(theirs, (40, 120))
    subprocess.run(command, env=environment, stdout=subprocess.DEVNULL, stderr=theirs, timeout=60, check=True)
    os.close(theirs)
    return written(ours).decode()


def test_a_terminal_sees_how_many_of_how_many_kernels() -> None:
    text = printed('shown', terminal=True)
    assert f'compiling, once for a version: 6 of about {compiling.OF_MECHANISM} kernels' in text
    assert f': 7 of about {compiling.OF_MECHANISM}' not in text  # those of numba itself are not counted
    assert text.rpartition('\r')[2].strip() == ''  # and nothing of it stays


def test_a_pipe_and_json_see_nothing() -> None:
    assert printed('shown', terminal=False) == printed('hidden', terminal=True) == ''


def test_a_bar_that_is_too_short_grows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, 'stderr', io.StringIO())
    bar = compiling.Bar(shown=True)
    bar.total = 2
    details = {'dispatcher': SimpleNamespace(py_func=SimpleNamespace(__module__='solver.x'))}
    for status in (event.EventStatus.START, event.EventStatus.END) * 3:
        bar.notify(event.Event('numba:compile', status, data=details))
    assert bar.count == 3 and '3 of about 3 kernels' in sys.stderr.getvalue()


@pytest.mark.long
@pytest.mark.parametrize(
    ('scene', 'about'), [('slider_crank', compiling.OF_MECHANISM), ('car_step_steer', compiling.OF_CAR)]
)
def test_about_so_many_kernels_are_compiled(scene: str, about: int, tmp_path: Path) -> None:
    """A quarter more or less is as good for a bar."""
    environment = {**os.environ, 'PYTHONPATH': os.pathsep.join(sys.path), 'MBD_CACHE_DIR': str(tmp_path)}
    done = subprocess.run(
        [sys.executable, '-c', COUNT, scene], env=environment, capture_output=True, text=True, timeout=900, check=True
    )
    assert int(done.stdout) == pytest.approx(about, rel=0.25)


WITHOUT_BLAS = """
import sys
import numba, numpy as np
from mbd_sim_ros import compiling
compiling.without_blas()
numba.njit(lambda x: x + x)(1.0)
print('scipy.linalg' in sys.modules)
a = np.arange(6.0).reshape(2, 3)
print(numba.njit(lambda a, b: np.dot(a, b))(a, np.ascontiguousarray(a.T)).tolist())
import scipy.linalg
print(scipy.linalg.det(np.eye(2)))
"""


@pytest.mark.slow
def test_numba_begins_without_blas_and_finds_it_when_it_is_asked_for() -> None:
    environment = {**os.environ, 'PYTHONPATH': os.pathsep.join(sys.path)}
    done = subprocess.run(
        [sys.executable, '-c', WITHOUT_BLAS], env=environment, capture_output=True, text=True, timeout=120, check=True
    )
    assert done.stdout.splitlines() == ['False', '[[5.0, 14.0], [14.0, 50.0]]', '1.0']
