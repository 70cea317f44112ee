"""Runs as text: CSV files with one header line, `name [unit]`, first column `time [s]`; numbers survive the way back
bit for bit."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path

import numpy as np

from mbd_sim_ros.analysis import logs
from mbd_sim_ros.analysis.cells import UNIT
from mbd_sim_ros.analysis.tables import SUFFIXES, Table, TimeColumn, read_table
from mbd_sim_ros.bags import reader as bag
from mbd_sim_ros.bags.files import holds_recording
from mbd_sim_ros.bags.patterns import fits, fits_any
from mbd_sim_ros.bags.reader import Run, Series
from solver.disk import atomic_write
from solver.errors import BagError
from solver.units import UNITS

TIME = 'time [s]'
ROWS = 10_000  # written at once
NAME_MOST = 60  # characters of the name of a file
JOINT_UNITS = {
    'rotation': {'position': 'rad', 'velocity': 'rad/s', 'effort': 'N m'},
    'translation': {'position': 'm', 'velocity': 'm/s', 'effort': 'N'},
}
BLOCK_UNITS = {
    'pose': {'x': 'm', 'y': 'm', 'z': 'm'},
    'twist': {'vx': 'm/s', 'vy': 'm/s', 'vz': 'm/s', 'wx': 'rad/s', 'wy': 'rad/s', 'wz': 'rad/s'},
    'imu': {'ax': 'm/s^2', 'ay': 'm/s^2', 'az': 'm/s^2', 'wx': 'rad/s', 'wy': 'rad/s', 'wz': 'rad/s'},
    'force': {'fx': 'N', 'fy': 'N', 'fz': 'N', 'mx': 'N m', 'my': 'N m', 'mz': 'N m'},
}
MOTION_UNITS = BLOCK_UNITS['twist'] | BLOCK_UNITS['imu'] | dict.fromkeys(('dwx', 'dwy', 'dwz'), 'rad/s^2')
REACTION_UNITS = dict.fromkeys(('x', 'y', 'z', 'distance'), 'N') | dict.fromkeys(
    ('xy', 'xz', 'yz', 'zz', 'twist'), 'N m'
)
INPUT_UNITS = {
    'steering': 'rad',
    'steering_rate': 'rad/s',
    'steering_acceleration': 'rad/s^2',
    'drive_torque': 'N m',
    'brake_torque': 'N m',
    'steering_torque': 'N m',
}


def units(*runs: Run) -> Callable[[str], str]:
    """The unit of a column, '' where the recordings do not tell: joints by their kind, elements by the kind whose
    outputs they have, those on joint coordinates by the kind of these, reactions by their row (docs/conventions.md); of
    what is none of these that in SI of the unit in the header of a table.
    """
    stated: dict[str, str] = {}
    kinds: dict[str, str] = {}
    along: dict[str, str] = {}
    outputs: dict[str, list[str]] = {}  # element -> its outputs
    for run in runs:
        kinds = kinds or run.joint_kinds
        along = along or run.element_kinds
        stated = {name: UNITS.get(unit, (unit,))[0] for name, unit in run.stated.items()} | stated
        for column in run.names:
            topic, _, rest = column.partition('/')
            if topic == 'element_states':
                element, _, output = rest.rpartition('/')
                known = outputs.setdefault(element, [])
                if output not in known:
                    known.append(output)
    return lambda column: _unit(column, kinds, along, outputs) or stated.get(column, '')


@cache
def _element_units(found: tuple[str, ...], along: str) -> dict[str, str]:
    """Output -> unit of the kinds of elements with these outputs, as far as they agree; of all kinds where none has
    them. along: whether the coordinate of the element is a 'rotation' or a 'translation', '' where it is not known.
    """
    from solver.elements.registry import FORCES  # with the kernels of all elements: half a second

    candidates = [kind for kind in FORCES if tuple(kind.outputs) == found] or FORCES
    agreed: dict[str, set[str]] = {}
    for kind in candidates:
        for output, measure in kind.outputs.items():
            length, either, angle = measure.partition(' or ')
            known = {'rotation': angle, 'translation': length}.get(along, measure) if either else measure
            agreed.setdefault(output, set()).add(known or '1')
    return {output: next(iter(m)) for output, m in agreed.items() if len(m) == 1 and ' or ' not in next(iter(m))}


def _unit(column: str, kinds: Mapping[str, str], along: Mapping[str, str], outputs: Mapping[str, Sequence[str]]) -> str:
    topic, _, rest = column.partition('/')
    head, _, last = column.rpartition('/')
    if topic == 'joint_states':
        joint, _, part = rest.rpartition('/')
        of_joint = JOINT_UNITS.get(kinds.get(joint, ''), {})
        return of_joint.get(part, '')
    if topic == 'cmd_applied':
        torque = rest.startswith(('drive_torque_', 'brake_torque_'))  # of single wheels
        return 'N m' if torque else INPUT_UNITS.get(rest, '1' if rest == 'step' else '')
    if topic == 'tire_states':
        from solver.elements.tire_pacejka import TIRES

        return (TIRES.outputs[last] or '1') if last in TIRES.outputs else ''
    if topic == 'element_states':
        element = rest.rpartition('/')[0]
        return _element_units(tuple(outputs.get(element, ())), along.get(element, '')).get(last, '')
    if topic == 'energies':
        return 'J'
    if topic == 'body_motions':
        return MOTION_UNITS.get(last, '')
    if topic == 'reactions':  # a row of a joint or contact, or the one of what ties joint coordinates
        return (
            REACTION_UNITS.get(last, '') if '/' in rest else JOINT_UNITS.get(along.get(rest, ''), {}).get('effort', '')
        )
    block = BLOCK_UNITS.get(head.rpartition('/')[2], {})
    return block.get(last, '1' if last in ('qx', 'qy', 'qz', 'qw') else '')


def export(run: Run, directory: Path) -> list[Path]:
    """Write one CSV file per topic (slashes of its name as dots), each whole or not at all, and return them. Raises
    BagError when a file cannot be written."""
    unit = units(run)
    files = []
    try:
        directory.mkdir(parents=True, exist_ok=True)
        names_of_files = file_names(run.series)
        for topic, series in run.series.items():
            file = directory / f'{names_of_files[topic]}.csv'
            with atomic_write(file) as part, part.open('w', newline='', encoding='utf-8') as stream:
                writer = csv.writer(stream, lineterminator='\n')
                names = {c: c.removeprefix(topic + '/') for c in series.columns}
                writer.writerow(
                    [TIME, *(f'{n} [{unit(c)}]' if unit(c) or UNIT.search(n) else n for c, n in names.items())]
                )
                for begin in range(0, series.time_ns.size, ROWS):
                    seconds = (seconds_of(int(t)) for t in series.time_ns[begin : begin + ROWS])
                    values = np.column_stack([v[begin : begin + ROWS] for v in series.columns.values()])
                    writer.writerows([t, *row] for t, row in zip(seconds, values.tolist(), strict=True))
            files.append(file)
    except OSError as error:
        raise BagError(f'cannot write to {directory}: {error.strerror}; choose another place') from None
    return files


def file_names(topics: Iterable[str]) -> dict[str, str]:
    """Names of files, without ending, for topics: all different, none leads elsewhere, none is too long."""
    names: dict[str, str] = {}
    for topic in topics:
        name = re.sub(r'[\x00-\x1f]', '_', topic.replace('/', '.')).lstrip('.')[:NAME_MOST] or 'run'
        k = 1
        while (unique := name if k == 1 else f'{name}-{k}') in names.values():
            k += 1
        names[topic] = unique
    return names


def suspicion(run: Run) -> tuple[str, ...]:
    """Doubts about a recorded run: its own findings, and messages that were lost or merged in reading it."""
    said = run.metadata
    told = (*run.remarks, *run.told)
    damage, dropped = said.get('damage', ''), said.get('dropped_steps', '0')
    lacking = [f'the recording is not whole: {damage}'] if damage else []
    if dropped.strip('0'):
        lacking.append(f'{dropped} steps are missing in the recording: the disk was too slow for them')
    status = said.get('status', '' if 'resolved_scene' in said else 'ok')
    lacking += run.doubts
    if status == 'ok':
        return (*lacking, *told)
    if not status:  # a run ends with a verdict
        return (f'the run has no verdict: {said.get("end", "its recording was cut off")}', *lacking, *told)
    texts = [str(finding.get('text', '')) for finding in run.findings]
    return (f'the run is {status}' + (f': {"; ".join(texts)}' if texts else ''), *lacking, *told)


def must_match(run: Run, patterns: Sequence[str], place: str | Path) -> None:
    """Raise BagError for a pattern that no channel of the recording matches."""
    for pattern in patterns:
        if not any(fits(name, pattern) for name in run.names):
            raise BagError(f'{place}: no channel matches {pattern!r}{run.instead_of(pattern)}')


def seconds_of(t_ns: int) -> str:
    """Nanoseconds as decimal seconds, exactly."""
    sign, t_ns = '-' if t_ns < 0 else '', abs(t_ns)
    return f'{sign}{t_ns // 1_000_000_000}.{t_ns % 1_000_000_000:09d}'


def read(
    path: str | Path,
    channels: Sequence[str] = (),
    *,
    beside: Collection[str] = (),
    time: TimeColumn | None = None,
    databases: Sequence[Path] = (),
    log_times: bool = False,
) -> Run:
    """A recording (bags.reader.read), a table (tables.py), a measurement or CAN log (logs.py), or a directory of .csv
    files as export() writes them.

    channels: shell patterns of the columns to read; all without any. Columns of a table in a directory get the name of
    its topic in front; those of a single one are as in its header, unless none of these names is in `beside`, or fits
    `channels`, and one with the topic does. time: the column of tables that tells the time. databases: of the frames in
    a CAN log. The numbers are those of the file: `stated` of the run tells their units. Raises BagError (file, line,
    remedy).
    """
    path = Path(path)
    single = path.suffix.lower() in SUFFIXES and not path.is_dir()
    files = [path] if single else sorted(path.glob('*.csv')) if path.is_dir() else []
    log = path.suffix.lower() in logs.SUFFIXES and not path.is_dir()
    if not log and (not files or (path.is_dir() and holds_recording(path))):
        return bag.read(path, channels, log_times=log_times)
    table = logs.read_log(path, databases) if log else Table()
    for file in files:
        topic = file.stem.replace('.', '/')
        one = read_table(file, '' if single else topic, time)
        if single and _is_of(topic, one.names, beside, channels):
            one = read_table(file, topic, time)
        table.series |= one.series
        table.stated |= one.stated
        table.left_out |= one.left_out
        table.told += one.told if single else [f'{file.name}: {text}' for text in one.told]
    known = {topic: tuple(one.columns) for topic, one in table.series.items()}
    series = {
        topic: Series(one.time_ns, kept)
        for topic, one in table.series.items()
        if (kept := {n: v for n, v in one.columns.items() if not channels or fits_any(n, channels)})
    }
    return Run(series, left_out=table.left_out, known=known, stated=table.stated, told=tuple(table.told))


def _is_of(topic: str, names: Sequence[str], beside: Collection[str], channels: Sequence[str]) -> bool:
    """True where columns of a table are those of a topic: with its name in front they are among others that they are
    not among without."""

    def meets(found: Sequence[str]) -> bool:
        return any(name in beside or (channels and fits_any(name, channels)) for name in found)

    return not meets(names) and meets([f'{topic}/{name}' for name in names])
