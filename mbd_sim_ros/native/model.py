"""A scene as a file for the native library: the memory image of its simulation, and the names of its numbers.

The file has a magic, the digest of all that follows (SHA-256), the fields of FIELDS (64-bit integers, in this order),
and the parts that these say the places of. mbd.c reads it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from mbd_sim_ros.native.channels import ACCOUNT_UNITS, Channel, channels_of
from mbd_sim_ros.native.image import CONSTANT, KERNEL, Image
from mbd_sim_ros.native.image import WRITTEN as SECTION_WRITTEN
from mbd_sim_ros.native.kernels import Kernel, addresses, compiled
from mbd_sim_ros.native.verdict import OF_MANEUVER, judged, told_by, unchecked
from mbd_sim_ros.native.watch import watch_of
from solver.compiled.kernel import address_of
from solver.engine.stepping import Stepping
from solver.errors import SpecError
from solver.inputs.command_filter import BANDWIDTH, RATE_LIMIT
from solver.inputs.maneuver import ACCELERATION, RATE, is_motion
from solver.simulation import Simulation
from solver.step.augmented_lagrangian import advance
from solver.step.interval import advance_adapting

MAGIC = b'mbd model 2\n'.ljust(16, b'\0')
FIELDS = (
    'size', 'h_ns', 'duration', 'adapts', 'entry', 'chassis',
    'constant_at', 'constant_size', 'written_at', 'written_size', 'fixups_at', 'fixups', 'kernels_at', 'kernels',
    'variables_at', 'variables', 'texts_at', 'texts_size', 'maneuver_at', 'runs', 'settled', 'inputs', 'motions_at',
    'motions',
    'tables', 'scheme', 'control', 'state_a', 'state_b', 'work', 'row', 'run', 'source', 'filter', 'numbers',
    'numbers_count',
    'counts', 'events', 'progress', 'limits_at', 'places_at', 'places', 'walls_at', 'walls', 'watch_at',
    'watch_size', 'memory_at', 'memory', 'scene', 'program', 'unchecked',
)  # fmt: skip
# What a run remembers besides state and account: `run` of mbd.c.
RUN = (
    'steps', 'swapped', 'audit', 'events', 'divided_intervals', 'iterations', 'factorizations', 'evaluations',
    'stagnated', 'residual_max', 'position_drift_max', 'velocity_drift_max', 'smallest_step', 'start',
    'mode', 'followed',
)  # fmt: skip
COUNTERS = ('steps', 'events', 'divided_intervals', 'iterations', 'factorizations', 'evaluations', 'stagnated')
LARGEST = {'residual_max': '1', 'position_drift_max': '1', 'velocity_drift_max': '1', 'smallest_step': 's'}
INPUT, OUTPUT, ACCOUNT, COUNTER = range(4)  # enum mbd_kind of mbd.h
# Steps behind the end of a scene at which its maneuver must give the last row again to count as settled.
FAR = (1, 2, 10, 100, 1_000, 10_000, 100_000, 1_000_000)


class Native(NamedTuple):
    """A scene for the library. content: of its file. kernels: those that a step of it calls. channels: its variables,
    in their order."""

    content: bytes
    kernels: list[Kernel]
    channels: list[Channel]


def native(simulation: Simulation, program: str = '', *, applied: bool = False) -> Native:
    """The scene of a simulation as a file for the library, at its start.

    program: the version that wrote it. applied: its maneuver is the inputs as they are applied in a run of the scene,
    those of a driver, an assistance and actuators among them; nobody sees the motion then. Raises SpecError, by name,
    for what lives in Python.
    """
    require_native(simulation, applied=applied)
    firsts, rows, settled, told = _maneuver(simulation, applied)
    simulation.reset()
    simulation.snapshot()  # outputs are there from now on
    engine, bodies = simulation.engine, simulation.bodies
    assert isinstance(engine, Stepping)
    row = np.array(simulation.inputs, float)[None, :]
    control = () if engine.adaptation is None else (engine.adaptation.control,)
    arguments = (bodies.model.tables, bodies.scheme, *control, *bodies.states, row, 0, 1)
    arguments += (0, True, bodies.work) if control else (True, bodies.work)
    entry = address_of(advance_adapting if control else advance, *arguments)
    run = np.zeros(len(RUN))  # whole numbers and floats, of 64 bits each
    run.view(np.int64)[RUN.index('audit')] = 1
    run[RUN.index('smallest_step')] = simulation.h
    names = simulation.channels.inputs
    motions = [name for name in names if is_motion(name, names)]
    source, filtered = np.zeros(len(names), np.int64), np.array([BANDWIDTH, RATE_LIMIT])
    commands = np.zeros((len(motions), 3))
    watch = watch_of(simulation)
    kernels = compiled()
    index, kernel_names = addresses(kernels)
    own = (bodies.scheme, *control, *bodies.states, bodies.work)
    image = Image(
        [bodies.model.tables],
        [*own, row, run, source, filtered, commands, bodies.numbers, watch.memory],
        list(bodies.model.elements.values()),
        index,
    )
    called = sorted({fixup.at for fixup in image.fixups if fixup.target == KERNEL} | {index[entry]})
    by_name = {kernel.name: kernel for kernel in kernels.values()}
    fixups = [f._replace(at=called.index(f.at)) if f.target == KERNEL else f for f in image.fixups]
    texts = _Texts()
    place = lambda part: image.place(part)[1]  # noqa: E731
    channels = channels_of(simulation)
    at_run, at_numbers = place(run), place(bodies.numbers)
    at_row, at_source = (place(row), place(source)) if row.size else (at_run, at_run)
    variables = [
        *(
            (texts.at(c.name), texts.at(c.unit), *((INPUT, at_row) if c.input else (OUTPUT, at_numbers)), 8 * c.place)
            for c in channels
        ),
        *(
            (texts.at(f'account/{name}'), texts.at(unit), ACCOUNT, place(getattr(bodies.account, name)), 0)
            for name, unit in ACCOUNT_UNITS.items()
        ),
        *((texts.at(name), texts.at('1'), COUNTER, at_run, 8 * RUN.index(name)) for name in COUNTERS),
        *((texts.at(name), texts.at(unit), ACCOUNT, at_run, 8 * RUN.index(name)) for name, unit in LARGEST.items()),
    ]
    of_control = (lambda field: place(getattr(control[0].value, field))) if control else (lambda field: at_run)
    moved = [
        (
            *(names.index(name + end) for end in ('', RATE, ACCELERATION)),
            int(name == 'steering'),
            place(commands) + 24 * k,
        )
        for k, name in enumerate(motions)
    ]
    limits = judged(simulation, texts, place, told, watch.names)
    parts = {
        'constant_at': image.sections[CONSTANT].tobytes(),
        'written_at': image.sections[SECTION_WRITTEN].tobytes(),
        'fixups_at': _words(fixups),
        'kernels_at': _words([texts.at(kernel_names[k]) for k in called]),
        'variables_at': _words((name, unit, kind, at + more) for name, unit, kind, at, more in variables),
        'maneuver_at': firsts.tobytes() + rows.tobytes(),
        'motions_at': _words(moved),
        'limits_at': limits.limits,
        'places_at': limits.places,
        'walls_at': limits.walls,
        'watch_at': watch.parts,
    }
    values = {
        'h_ns': simulation.h_ns, 'duration': simulation.scene.steps, 'adapts': len(control),
        'entry': called.index(index[entry]), 'chassis': bodies.chassis,
        'constant_size': len(parts['constant_at']), 'written_size': len(parts['written_at']),
        'fixups': len(fixups), 'kernels': len(called), 'variables': len(variables), 'motions': len(moved),
        'runs': len(firsts), 'settled': int(settled), 'inputs': len(names),
        'tables': place(bodies.model.tables), 'scheme': place(bodies.scheme),
        'control': place(control[0]) if control else at_run,
        'state_a': place(bodies.states[0]), 'state_b': place(bodies.states[1]), 'work': place(bodies.work),
        'row': at_row, 'run': at_run, 'source': at_source, 'filter': place(filtered),
        'numbers': at_numbers, 'numbers_count': bodies.numbers.size,
        **{field: of_control(field) for field in ('counts', 'events', 'progress')},
        'places': len(limits.places) // 8, 'walls': len(limits.walls) // 8, 'watch_size': len(watch.parts),
        'memory_at': place(watch.memory), 'memory': watch.memory.size,
        'scene': texts.at(simulation.scene.name), 'program': texts.at(program),
        'unchecked': texts.at(', '.join(unchecked())),
    }  # fmt: skip
    parts['texts_at'] = bytes(texts.content)
    values['texts_size'] = len(texts.content)
    content = _assembled(values, parts)
    return Native(content, [by_name[kernel_names[k]] for k in called], channels)


def require_native(simulation: Simulation, *, applied: bool = False) -> None:
    """Refuse, by name, a simulation of which a part lives in Python. Raises SpecError."""
    scene = simulation.scene
    if not isinstance(simulation.engine, Stepping):
        kind = f'integrator.kind = {scene.integrator.kind!r}: has no native form: take alf'
        level = "fidelity = 'single_track': has no native form: take another level of detail"
        raise SpecError(kind if simulation.of_bodies else level)
    sources, maneuver = simulation.sources, scene.maneuver
    steered = {'driver': 'a driver', 'speed': 'a speed that is kept'}
    closed = [key for key in steered if getattr(maneuver, key) is not None] if sources.driver is not None else []
    without = ' '.join(f'--set maneuver.{key}=null' for key in closed)
    for part, key, name, how in (
        (closed or None, 'maneuver', ' and '.join(steered[key] for key in closed), f' ({without})'),
        (sources.assistant, 'assistance', 'assistance', ''),
        (sources.actuators, 'actuation', 'actuators', ''),
        (sources.controllers or None, 'controllers', 'controllers', ''),
    ):
        if part is not None and not applied:
            raise SpecError(
                f'{key}: the scene has {name}, in Python alone: remove it from the scene{how} and do its part outside, '
                'or take the inputs as a run applies them (mbd build --as-applied)'
            )


class _Texts:
    """Texts, each once, with a zero behind it."""

    def __init__(self) -> None:
        self.content = bytearray(b'\0')
        self._known = {'': 0}

    def at(self, text: str) -> int:
        """Place of a text, which is added if it is not there."""
        if text not in self._known:
            self._known[text] = len(self.content)
            self.content += text.encode() + b'\0'
        return self._known[text]


def _words(values: Iterable[Any]) -> bytes:
    return np.array(list(values), np.int64).tobytes()


def _maneuver(
    simulation: Simulation, applied: bool
) -> tuple[np.ndarray, np.ndarray, bool, dict[str, tuple[str, float]]]:
    """(first steps of runs of equal rows, (n, nu) these rows, whether the last one stays, what checks tell of it) of
    the maneuver of a scene. applied: as a run of the scene applies it."""
    steps, source = simulation.scene.steps, simulation.source
    rows = np.zeros((0, len(simulation.channels.inputs)))
    if steps and applied:
        simulation.advance(steps)
        rows = np.array(simulation.applied)
        told = told_by(simulation, OF_MANEUVER, steps)
        simulation.reset()
    else:
        if steps:
            rows = source.table(0, steps)
        told = told_by(simulation, OF_MANEUVER, steps)
    bits = rows.view(np.int64)
    changes = np.flatnonzero(np.any(bits[1:] != bits[:-1], axis=1)) + 1
    firsts = np.concatenate([[0], changes]).astype(np.int64) if steps else np.zeros(0, np.int64)
    settled = False
    if steps and not applied and not simulation.scene.maneuver.bag:
        last = bits[-1]
        settled = all(np.array_equal(source.table(steps + far, 1).view(np.int64)[0], last) for far in FAR)
        simulation.sources.reset()  # nobody has asked yet
    return firsts, np.ascontiguousarray(rows[firsts]), settled, told


def _assembled(values: dict[str, int], parts: dict[str, bytes]) -> bytes:
    """The file: parts behind each other, each at a multiple of 64 bytes."""
    head = len(MAGIC) + 32 + 8 * len(FIELDS)
    body, at = b'', -(-head // 64) * 64
    for name, part in parts.items():
        values[name] = at
        padded = part + bytes(-len(part) % 64)
        body += padded
        at += len(padded)
    values['size'] = at
    fields = np.array([values[name] for name in FIELDS], np.int64).tobytes()
    rest = fields + bytes(-head % 64) + body
    return MAGIC + hashlib.sha256(rest).digest() + rest
