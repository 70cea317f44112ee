"""Starts of vehicles that were found before: in memory for the next simulation of this process, and on disk.

A start is named after all that it depends on: the model with every number in it, what is asked of the start, the
settings of the step, the inputs at t = 0, and the code. A scene that differs in its maneuver alone begins where the one
before began, bit for bit. What cannot be read is found anew; a start that fails is not kept, so its sentence is that of
the search.
"""

from __future__ import annotations

import dataclasses
import io
import json
import pickle
import platform
import threading
from collections import OrderedDict
from collections.abc import Callable, Sequence
from contextlib import suppress

import numba
import numpy as np

from solver.compiled.target import target
from solver.disk import digest, sources, store_of
from solver.model.spec import ModelSpec
from solver.model.state import State, copy_state
from solver.scene import Scene
from solver.start.placement import Changes
from solver.step.work import Scheme

MOST = 16  # starts that a process remembers; ten times as many hold 3 MB of the full car
ADDRESSES = ('weigh', 'step')  # fields of Scheme that say where code lies in this process
_remembered: OrderedDict[bytes, bytes] = OrderedDict()
_lock = threading.Lock()  # of its order


def start_of(
    scene: Scene, spec: ModelSpec, method: Scheme, u: np.ndarray, states: Sequence[State], find: Callable[[], Changes]
) -> Changes:
    """Result of find(), which assigns the states; both as they were found before, if they were.

    states: all that find() leaves behind. u (nu,): inputs at the start. Only starts of vehicles are kept: those of
    mechanisms take less than it takes to look for them.
    """
    if not spec.tires:
        return find()
    key = _key(scene, spec, method, u)
    name, store = f'{key.hex()}.start', store_of('starts')
    content = _remembered.get(key) or store.read(name, key)
    if content is None or not (changes := _taken(content, states)):
        changes = find()
        content = json.dumps(dataclasses.asdict(changes), allow_nan=False).encode() + b'\n' + _bytes(states)
        with suppress(OSError):
            store.write(name, content, key)
    with _lock:
        _remembered[key] = content
        _remembered.move_to_end(key)
        while len(_remembered) > MOST:
            _remembered.popitem(last=False)
    return changes


def _key(scene: Scene, spec: ModelSpec, method: Scheme, u: np.ndarray) -> bytes:
    settings = [value for name, value in method._asdict().items() if name not in ADDRESSES]
    numbers = [value.tobytes() if isinstance(value, np.ndarray) else repr(value) for value in settings]
    code = sources(), np.__version__, numba.__version__, platform.python_version(), repr(target())
    asked = repr(scene.start), repr(scene.integrator)
    return digest(_content(spec), *asked, *numbers, u.tobytes(), *code)


def _content(spec: ModelSpec) -> bytes:
    """Every number and name of a specification. It says nothing of which objects are the same, as pickle does
    otherwise."""
    file = io.BytesIO()
    pickler = pickle.Pickler(file, 5)
    pickler.fast = True
    pickler.dump(spec)
    return file.getvalue()


def _bytes(states: Sequence[State]) -> bytes:
    return b''.join(array.tobytes() for state in states for array in state)


def _taken(content: bytes, states: Sequence[State]) -> Changes | None:
    """Assign the states from what was kept; None where that is not of their size."""
    head, _, data = content.partition(b'\n')
    if len(data) != sum(array.nbytes for state in states for array in state):
        return None
    at = 0
    for state in states:
        arrays = []
        for array in state:
            arrays.append(np.frombuffer(data, array.dtype, array.size, at).reshape(array.shape))
            at += array.nbytes
        copy_state(State(*arrays), state)
    named = json.loads(head)
    return Changes(**named | {'wheels': tuple(named['wheels'])})  # JSON holds a list
