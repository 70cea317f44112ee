"""Cases for the fuzzer: damaged input of every kind, the command that reads it, and what must hold of its answer."""

from __future__ import annotations

import importlib.util
import io
import os
import re
import tempfile
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fuzz_foreign
import fuzz_native
import numpy as np
from mcap.records import Channel, Metadata
from mutations import damage_bag, damage_bytes, damage_text, damage_yaml, pick, word

from mbd_sim_ros.bags.files import find_file
from mbd_sim_ros.bags.records import Messages, Reading
from mbd_sim_ros.commands.main import main
from solver.errors import BagError, MbdError, SpecError

ROOT = Path(__file__).parents[2]
CONFIG = ROOT / 'config'
SMALL = (
    'slider_crank',
    'four_bar',
    'pendulum',
    'double_pendulum',
    'spinning_top',
    'spring_mass',
    'rolling_disc',
    'chaplygin_sleigh',
    'andrews',
)
CARS = ('light_car_lane_change', 'light_car_straight', 'light_car_circle')
FULL = ('car_step_steer', 'car_rough_road')
EVERY = (*SMALL, *CARS, *FULL)
READERS = {'sweeps', 'comparisons', 'bags', 'databases', 'logs', 'parameters'}  # kinds of cases that run no scene
SHORT = ['--duration', '0.02']
REQUIRES = (
    'require: {yaw_rate: {rms: 2 %, max: 0.1 rad/s}, energy_error_max: 1.0}\nbudget: {real_time_factor: 1.5}\n',
    'require: {accuracy: {lateral_acceleration: {max: 5 %, delay: 5 ms}}, allow_suspect: true}\n',
    'require: {tire_load.front_left: {rms: 10 N}, position_drift_max: 1e-6, residual_max: 1e-3}\nswitches: {stops: '
    'off, drag: off}\n',
)
MAPPING = """channels:
  imu/wz: {channel: imu/wz, unit: rad/s, sign: 1, offset: 0.0}
  "tire/*/force/fz": {channel: "tire/*/force/fz"}
axes:
  - {channels: [imu/ax, imu/ay, imu/az], rpy_deg: [180, 0, 0]}
"""
TOLERANCES = """tolerances:
  "imu/w*": {rtol: 0.05, atol: 0.01, rating: 0.8}
  "odom/pose/*": {rtol: 0.02, shift: 0.05, peak: 0.1, rms: 0.1}
floor: 1.0e-6
"""

VEHICLES, EXAMPLES = CONFIG / 'vehicles', ROOT / 'docs' / 'examples'
LIVE_AXLE = 'vehicle.axles.front={{suspension: {axle}, drive: {drive}}}'
# vehicles of axles, each with the files it is put together from, as overrides in which a name stands for its file
CARS_OF_PARTS: tuple[tuple[dict[str, Path], tuple[str, ...]], ...] = (
    *(
        ({'car': VEHICLES / f'{name}.yaml'}, ('vehicle={car}',))
        for name in ('compact_fwd', 'pickup_awd', 'electric_4wd', 'formula_student', 'wishbone_car')
    ),
    ({'car': EXAMPLES / 'van.yaml'}, ('vehicle={car}',)),
    (
        {
            'car': VEHICLES / 'compact_fwd.yaml',
            'power': EXAMPLES / 'power.yaml',
            'converter': EXAMPLES / 'converter.yaml',
        },
        ('vehicle={car}', 'vehicle.engine.power={power}', 'vehicle.engine.power.converter={converter}'),
    ),
    (
        {'car': VEHICLES / 'full_car.yaml', 'power': EXAMPLES / 'power.yaml'},
        ('vehicle={car}', 'vehicle.engine.power={power}'),
    ),
    (
        {'car': VEHICLES / 'pickup_awd.yaml', 'box': EXAMPLES / 'steering_box.yaml'},
        ('vehicle={car}', 'vehicle.steering={box}'),
    ),
    (
        {
            'car': VEHICLES / 'pickup_awd.yaml',
            'axle': EXAMPLES / 'steered_live_axle.yaml',
            'drive': EXAMPLES / 'front_shaft.yaml',
            'box': EXAMPLES / 'drag_link_steering.yaml',
        },
        ('vehicle={car}', LIVE_AXLE, 'vehicle.steering={box}'),
    ),
    (
        {'car': VEHICLES / 'full_car.yaml', 'trailer': VEHICLES / 'trailers' / 'caravan.yaml'},
        ('vehicle={car}', 'trailer={trailer}'),
    ),
)


@dataclass(frozen=True, kw_only=True)
class Material:
    """Good recordings that are damaged: of a mechanism and of a car, a directory of CSV files, and one of the native
    library."""

    crank: Path
    car: Path
    csv: Path
    native: Path


def make_material(directory: Path, loaded: Sequence[str] = EVERY, *, native: bool = True) -> Material:
    """Record them, and load what the cases need, kernels for the scenes `loaded` too: children of this process have it
    at once. native: with what the cases of the native library need."""
    material = Material(**{name: directory / name for name in ('crank', 'car', 'csv', 'native')})
    if native:
        fuzz_native.make(material.native)
    for place, scene in ((material.crank, 'slider_crank'), (material.car, 'light_car_lane_change')):
        if not (place / 'metadata.yaml').exists():
            assert _quiet('run', scene, '--duration', '0.3', '--set', 'record.every=5', '--out', place) in (0, 1)
    for scene in loaded:
        _quiet('run', scene, '--duration', '0.005', '--no-record')
    for files, texts in CARS_OF_PARTS if loaded else ():
        _quiet(*_driven({name: str(file) for name, file in files.items()}, texts), '--duration', '0.005')
    if not material.csv.exists():
        assert _quiet('export', material.car, '--csv', material.csv) == 0
    for library in fuzz_foreign.NEEDS.values():
        with suppress(ImportError):
            importlib.import_module(library)
    with tempfile.TemporaryDirectory() as scratch:
        _quiet('compare', material.car, material.car)
        _quiet('evaluate', material.car, '--as', 'iso3888_2')
        _quiet('view', material.crank, '--out', f'{scratch}/page.html')
        _quiet('recover', material.crank, f'{scratch}/saved')
        if loaded:
            _quiet('replay', material.crank)
    return material


def _quiet(*words: object) -> int:
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        return main([*map(str, words), '--json'])


# arguments of the command; what else must hold ('' or the fault)
Made = tuple[list[str], Callable[[int, dict[str, Any]], str] | None]


def _scene_run(rng: np.random.Generator, file: str) -> list[str]:
    kind = rng.random()
    if kind < 0.75:
        return ['run', file, *SHORT, '--no-record']
    return ['run', file, *SHORT, '--out', 'run'] if kind < 0.9 else ['info', file, '--brief']


def _same_again(file: Path) -> Callable[[int, dict[str, Any]], str]:
    """A scene that is read is the same again when it is written out and read."""

    def look(code: int, _: dict[str, Any]) -> str:
        from solver.files.scene import load_scene, load_scene_text

        try:
            scene = load_scene(file)
        except MbdError:
            return ''
        return '' if load_scene_text(scene.resolved, file.stem) == scene else 'its resolved text is another scene'

    return look


def scenes(rng: np.random.Generator, at: Path, material: Material) -> Made:
    """Scene files with their mechanism in them."""
    kind = rng.random()
    name = str(pick(rng, SMALL if kind < 0.8 else CARS if kind < 0.95 else FULL))
    text = (CONFIG / 'scenes' / f'{name}.yaml').read_text()
    mechanism = CONFIG / 'mechanisms' / f'{name}.yaml'
    if mechanism.exists() and rng.random() < 0.7:
        damaged = damage_yaml(rng, mechanism.read_text())
        (at / 'mechanism.yaml').write_bytes(damaged)
        text = '\n'.join(
            'mechanism: mechanism.yaml' if line.startswith('mechanism:') else line for line in text.splitlines()
        )
        (at / 'scene.yaml').write_text(text)
    else:
        (at / 'scene.yaml').write_bytes(damage_yaml(rng, text))
    return _scene_run(rng, 'scene.yaml'), _same_again(at / 'scene.yaml')


def vehicles(rng: np.random.Generator, at: Path, material: Material) -> Made:
    """Vehicle files."""
    name, scene = ('light_car', 'light_car_lane_change') if rng.random() < 0.8 else ('full_car', 'car_step_steer')
    (at / 'vehicle.yaml').write_bytes(damage_yaml(rng, (CONFIG / 'vehicles' / f'{name}.yaml').read_text()))
    level = ['--set', f'fidelity={pick(rng, ("condensed", "full"))}'] if rng.random() < 0.1 else []
    return ['run', scene, *SHORT, '--no-record', '--set', f'vehicle={at / "vehicle.yaml"}', *level], None


def cars(rng: np.random.Generator, at: Path, material: Material) -> Made:
    """Vehicles that are put together from parts, one part of them damaged, at rest and rolling. (Levels that are
    measured or identified take longer than a case has, by right: they are runs and positions of the bench by the
    dozen.)"""
    files, texts = CARS_OF_PARTS[int(rng.integers(len(CARS_OF_PARTS)))]
    broken = str(pick(rng, list(files)))
    (at / 'part.yaml').write_bytes(damage_yaml(rng, files[broken].read_text()))
    places = {name: str(at / 'part.yaml' if name == broken else file) for name, file in files.items()}
    level = ['--set', f'fidelity={pick(rng, ("condensed", "full"))}'] if rng.random() < 0.2 else []
    return [*_driven(places, texts), *level, '--set', f'start.speed_kmh={pick(rng, (0, 40))}', *SHORT], None


def _driven(places: dict[str, str], texts: Sequence[str]) -> list[str]:
    """A run of a vehicle of CARS_OF_PARTS with its parts in these files."""
    return [
        'run',
        'car_step_steer',
        '--no-record',
        *(word for text in texts for word in ('--set', text.format(**places))),
    ]


def tires(rng: np.random.Generator, at: Path, material: Material) -> Made:
    """Tire property files."""
    file = pick(rng, (CONFIG / 'tires' / '205_55R16.tir', *sorted((ROOT / 'test' / 'data').glob('*.tir'))))
    (at / 'tire.tir').write_bytes(damage_text(rng, Path(str(file)).read_text(errors='replace')))
    side = pick(rng, ('front', 'rear'))
    if rng.random() < 0.2:
        return ['info', 'tire.tir'], None
    return [
        'run',
        'light_car_lane_change',
        *SHORT,
        '--no-record',
        '--set',
        f'vehicle.{side}.tire={at / "tire.tir"}',
    ], None


def overrides(rng: np.random.Generator, at: Path, material: Material) -> Made:
    """--set: keys that are there and odd values, and odd texts."""
    import yaml

    name = str(pick(rng, (*SMALL, *CARS)))
    from solver.files.scene import load_scene

    root = yaml.compose(load_scene(name).resolved, Loader=yaml.SafeLoader)
    keys: list[str] = []

    def walk(node: Any, path: str) -> None:
        entries = (
            []
            if isinstance(node.value, str)
            else [e if isinstance(e, tuple) else (k, e) for k, e in enumerate(node.value)]
        )
        for key, value in entries:
            here = f'{path}.{getattr(key, "value", key)}'.lstrip('.')
            keys.append(here)
            walk(value, here)

    walk(root, '')
    texts = []
    for _ in range(int(rng.integers(1, 4))):
        key = str(pick(rng, keys))
        kind = rng.random()
        value = word(rng).replace('\x00', '') if kind < 0.7 else word(rng, '1.0')
        text = f'{key}={value}'
        if rng.random() < 0.1:
            text = damage_bytes(rng, text.encode()).decode('utf-8', 'replace').replace('\x00', '')
        texts += ['--set', text]
    return ['run', name, *texts, *SHORT, '--no-record'], None


def maneuvers(rng: np.random.Generator, at: Path, material: Material) -> Made:
    """Maneuver files."""
    file = pick(rng, sorted((CONFIG / 'maneuvers').glob('*.yaml')))
    (at / 'maneuver.yaml').write_bytes(damage_yaml(rng, Path(str(file)).read_text()))
    return ['run', str(pick(rng, CARS)), *SHORT, '--no-record', '--maneuver', 'maneuver.yaml'], None


OPENCRG = """$CT
a curved road, banked
$
$ROAD_CRG
REFERENCE_LINE_INCREMENT = 5.0   ! m
REFERENCE_LINE_END_U     = 25.0
LONG_SECTION_V_RIGHT     = -4.0
LONG_SECTION_V_INCREMENT = 4.0
$
$ROAD_CRG_MODS
GRID_NAN_MODE = 2
REFPOINT_X    = -5.0
$
$ROAD_CRG_OPTS
BORDER_MODE_U = 4
BORDER_MODE_V = 2
$
$KD_DEFINITION
#:LRFI
U:reference line u,m,0,5
D:reference line phi,rad
D:reference line banking,m/m
D:long section 1,m
D:long section 2,m
D:long section 3,m
$
$$$$$$$$$$$$$$$$
**unused**      0.00      0.00      0.00      0.00
      0.00      0.01      0.00      0.00      0.00
      0.02      0.02      0.00      0.01 *missing*
      0.05      0.02      0.01      0.02      0.01
      0.09      0.02      0.00      0.01      0.00
      0.10      0.01      0.00      0.00      0.00
"""


def roads(rng: np.random.Generator, at: Path, material: Material) -> Made:
    """Road files, and OpenCRG files."""
    if rng.random() < 0.5:
        (at / 'road.crg').write_bytes(damage_text(rng, OPENCRG))
        (at / 'road.yaml').write_text(f'grids: [{at / "road.crg"}]\n')
        return ['run', str(pick(rng, CARS)), *SHORT, '--no-record', '--set', f'road={at / "road.yaml"}'], None
    file = pick(rng, sorted((CONFIG / 'roads').glob('*.yaml')))
    (at / 'road.yaml').write_bytes(damage_yaml(rng, Path(str(file)).read_text()))
    return ['run', str(pick(rng, CARS)), *SHORT, '--no-record', '--set', f'road={at / "road.yaml"}'], None


def requirements(rng: np.random.Generator, at: Path, material: Material) -> Made:
    """Blocks of what a scene requires, of its budget and of its switches."""
    text = (CONFIG / 'scenes' / 'light_car_lane_change.yaml').read_text()
    lines = [line for line in text.splitlines() if not line.startswith(('require', 'budget'))]
    block = damage_yaml(rng, str(pick(rng, REQUIRES)))
    (at / 'scene.yaml').write_bytes('\n'.join([*lines, '']).encode() + block)
    return _scene_run(rng, 'scene.yaml'), _same_again(at / 'scene.yaml')


def sweeps(rng: np.random.Generator, at: Path, material: Material) -> Made:
    """Files of sweeps: what they ask for, without running it."""
    from mbd_sim_ros.sweep.design import cases, load_sweep

    (at / 'sweep.yaml').write_bytes(damage_yaml(rng, (CONFIG / 'sweeps' / 'step_steer_mass.yaml').read_text()))

    def look(code: int, _: dict[str, Any]) -> str:
        try:
            sweep = load_sweep(at / 'sweep.yaml')
            if sweep.design.samples <= 1024:
                cases(sweep)
        except MbdError as error:
            return '' if '\n' not in str(error) else f'two lines: {error}'
        return ''

    return [], look


def comparisons(rng: np.random.Generator, at: Path, material: Material) -> Made:
    """Mappings and tolerances of compare, and CSV files."""
    kind = int(rng.integers(3))
    if kind == 0:
        (at / 'mapping.yaml').write_bytes(damage_yaml(rng, MAPPING))
        return ['compare', str(material.car), str(material.car), '--mapping', 'mapping.yaml'], None
    if kind == 1:
        (at / 'tolerances.yaml').write_bytes(damage_yaml(rng, TOLERANCES))
        return ['compare', str(material.car), str(material.car), '--tolerances', 'tolerances.yaml'], None
    file = pick(rng, sorted(material.csv.glob('*.csv')))
    text = Path(str(file)).read_text()
    (at / 'data.csv').write_bytes(damage_text(rng, text))
    return ['compare', 'data.csv', str(file)], None


def _content(path: Path) -> tuple[dict[str, list[tuple[int, bytes]]], dict[str, dict[str, str]]]:
    """All messages by topic, and the metadata."""
    names: dict[int, str] = {}
    found: dict[str, list[tuple[int, bytes]]] = {}
    metadata = {}
    reading = Reading(find_file(path))
    for record in reading:
        if isinstance(record, Messages):
            found.setdefault(names[record.channel], []).extend(zip(record.log_times, record.data))
        elif isinstance(record, Channel):
            names[record.id] = record.topic
        elif isinstance(record, Metadata):
            metadata[record.name] = record.metadata
    reading.require_whole()
    return {topic: sorted(messages) for topic, messages in found.items()}, metadata


def bags(rng: np.random.Generator, at: Path, material: Material) -> Made:
    """Recordings: what is read of a damaged one is what was recorded, or it is said."""
    good = find_file(material.crank if rng.random() < 0.5 else material.car)
    bytes_only = rng.random() < 0.5
    (at / 'bad.mcap').write_bytes(damage_bytes(rng, good.read_bytes()) if bytes_only else damage_bag(rng, good))
    command = str(pick(rng, ('recover', 'recover', 'export', 'export', 'compare', 'evaluate', 'view', 'replay')))
    arguments = {
        'recover': ['recover', 'bad.mcap', 'saved'],
        'export': ['export', 'bad.mcap', '--csv', 'csv'],
        'compare': ['compare', 'bad.mcap', str(good)],
        'evaluate': ['evaluate', 'bad.mcap', '--as', 'iso3888_2'],
        'view': ['view', 'bad.mcap', '--out', 'page.html'],
        'replay': ['replay', 'bad.mcap'],
    }[command]

    def look(code: int, told: dict[str, Any]) -> str:
        if not bytes_only:
            return ''
        before, about = _content(good)
        if command == 'recover':
            if code:
                return ''
            saved, _ = _content(at / 'saved')
            if any(not set(messages) <= set(before.get(topic, [])) for topic, messages in saved.items()):
                return 'recover gives what was not recorded'
            return 'recover says whole and it is not' if told['complete'] and saved != before else ''
        try:
            after, other = _content(at / 'bad.mcap')
        except BagError:
            return 'a damaged recording is read' if code == 0 else ''
        return '' if after == before and other == about else 'a damaged recording counts as whole'

    return arguments, look


def commands(rng: np.random.Generator, at: Path, material: Material) -> Made:
    """Command lines made of words of command lines."""
    vocabulary = (
        'run', 'info', 'export', 'compare', 'recover', 'replay', 'view', 'evaluate', 'maneuver', 'sweep', 'plan',
        'bench', 'study',
        'slider_crank', 'light_car_straight', str(material.car), str(material.crank), str(material.csv), '--set',
        '--out', '--no-record',
        '--duration', '0.01', '--csv', '--parquet', '--channel', 'odom/*', '--rtol', '--atol', '--exact', '--map',
        'a=b', 'imu/wz=imu/wz',
        '--mapping', '--tolerances', '--urdf', '--resolved', '--brief', '--balance', '--maneuver', 'brake', '--at',
        '--rate', '--width',
        '1e9', '--as', 'iso7401_step', '--list', '--strict', '--with', 'speed=1', '--vehicle', 'light_car', 'out',
        '/dev/null', '/dev/full',
        '/proc/none', '--', '--json', '--html', 'page.html', '--plot', 'p.png', '--offset', '--speed', '0', '\udcff',
        'a\0b',
    )  # fmt: skip
    first = str(pick(rng, ('run', 'info', 'export', 'compare', 'recover', 'replay', 'view', 'evaluate', 'maneuver')))
    rest = [str(pick(rng, vocabulary)) if rng.random() < 0.9 else word(rng) for _ in range(int(rng.integers(0, 6)))]
    if first == 'run':
        rest = [*rest, *SHORT]
    if first == 'maneuver':
        rest = rest[:1]
    if '--help' in rest:
        rest.remove('--help')
    return [first, *rest], None


COMMENTED = re.compile(r'    # \w+: [^ ]')  # a parameter, not a sentence


def parameters(rng: np.random.Generator, at: Path, material: Material) -> Made:
    """Parameter files of the node, up to where it would load its scene."""
    lines = (CONFIG / 'node.yaml').read_text().splitlines()
    given = [line.replace('# ', '', 1) if COMMENTED.match(line) and rng.random() < 0.5 else line for line in lines]
    text = '\n'.join(given)
    (at / 'node.yaml').write_bytes(damage_yaml(rng, text))

    def look(code: int, _: dict[str, Any]) -> str:
        from mbd_sim_ros.node import main as node

        def prepared(scene: str, overrides: Sequence[str]) -> Any:
            raise SpecError('prepared')

        node.prepare = prepared
        os.environ |= {'ROS_LOG_DIR': str(at / 'log'), 'ROS_DOMAIN_ID': '99'}
        ended = node.main(['--ros-args', '--params-file', str(at / 'node.yaml'), '-p', 'scene:=any'])
        return '' if ended in (1, 2) else f'the node ended with code {ended}'

    return [], look


def models(rng: np.random.Generator, at: Path, material: Material) -> Made:
    """Models of the native library."""
    return [], lambda *_: fuzz_native.models(rng, material.native)


def states(rng: np.random.Generator, at: Path, material: Material) -> Made:
    """States of its models."""
    return [], lambda *_: fuzz_native.states(rng, material.native)


def inputs(rng: np.random.Generator, at: Path, material: Material) -> Made:
    """Calls of its functions."""
    return [], lambda *_: fuzz_native.inputs(rng, material.native)


def units(rng: np.random.Generator, at: Path, material: Material) -> Made:
    """Units of co-simulation, as controllers of a scene."""
    return [*fuzz_native.units(rng, at, material.native), *SHORT, '--no-record'], None


HAS_ROS = importlib.util.find_spec('rclpy') is not None
CASES = (
    scenes,
    vehicles,
    cars,
    tires,
    overrides,
    maneuvers,
    roads,
    requirements,
    sweeps,
    comparisons,
    bags,
    fuzz_foreign.databases,
    fuzz_foreign.logs,
    commands,
    models,
    states,
    inputs,
    units,
)
NATIVE = {'models', 'states', 'inputs', 'units'}  # kinds that need the native library
NEEDS = fuzz_foreign.NEEDS | fuzz_native.NEEDS
KINDS: dict[str, Callable[[np.random.Generator, Path, Material], Made]] = {
    f.__name__: f
    for f in (*CASES, *([parameters] if HAS_ROS else []))
    if importlib.util.find_spec(NEEDS.get(f.__name__, 'numpy')) is not None
}
