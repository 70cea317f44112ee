"""mbd info: what a scene consists of, what became of the keys of a tire file, and what a recording says of its run."""

from __future__ import annotations

import argparse
import dataclasses
import os
from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mbd_sim_ros.commands import Result, add_scene, declare, names_of, offer, table
from solver.errors import MbdError, SceneError

if TYPE_CHECKING:
    from solver.files.tire_receipt import Entry
    from solver.findings import LevelReport
    from solver.scene import Scene
    from solver.vehicle.size import Size

Rows = list[tuple[str, ...]]  # of a table, its head first where it has one
UNITS = {'mass': 'kg', 'h': 's', 'duration': 's'}
STANDING = 'vehicle: {}\nstart: {{kind: equilibrium}}\nduration: 1\n'  # a vehicle on a flat road


def add(parsers: Any) -> None:
    """Declare the command."""
    what = 'show what a scene, a vehicle, a tire file (.tir) or a recording consists of'
    parser = declare(parsers, 'info', run, what, 'mbd info slider_crank\n  mbd info compact_fwd\n  mbd info bags/run')
    scene = add_scene(
        parser,
        'path of a scene, vehicle, tire file or recording, or a name in config/scenes, config/vehicles or (with .tir) '
        'config/tires',
    )
    kinds = (names_of('scenes'), names_of('vehicles'), names_of('tires', '.tir'))
    offer(scene, lambda: [name for names in kinds for name in names()], files=True)
    parser.add_argument(
        '--brief',
        action='store_true',
        help='leave out the figures of a vehicle and the errors of its level, which take seconds',
    )
    parser.add_argument(
        '--html', metavar='FILE', type=Path, help='write what is shown as a page; of a recording its curves'
    )
    instead = parser.add_mutually_exclusive_group()
    instead.add_argument(
        '--urdf', metavar='FILE', type=Path, help='write the spanning tree as URDF, as the node publishes it'
    )
    instead.add_argument(
        '--resolved',
        action='store_true',
        help='print the scene as one YAML text, with every include and --set in place',
    )


def run(args: argparse.Namespace) -> Result:
    """Load, compile and count."""
    from mbd_sim_ros import compiling
    from mbd_sim_ros.analysis.pages import write_text
    from solver import simulation_of
    from solver.analysis.figures import is_vehicle
    from solver.analysis.order_four import order_four
    from solver.elements.curved_grid import CurvedGrid

    if args.scene.lower().endswith('.tir'):
        return _tire_file(args)
    if args.scene.lower().endswith('.mcap') or (os.path.isdir(args.scene) and any(Path(args.scene).glob('*.mcap'))):
        return _recording(args)
    scene = scene_of(args.scene, args.overrides)
    if args.resolved:
        return Result(
            data={'status': 'ok', 'scene': scene.name, 'resolved': scene.resolved}, text=scene.resolved.rstrip()
        )
    compiling.tell(not args.json, scene.model)
    simulation = simulation_of(scene)
    if args.urdf is not None:
        write_text(args.urdf, simulation.urdf())
        return Result(data={'status': 'ok', 'scene': scene.name, 'urdf': str(args.urdf)}, text=f'wrote {args.urdf}')
    counts = simulation.describe()
    data = {
        'status': 'ok',
        'scene': scene.name,
        'title': scene.title,
        'hash': scene.hash,
        **counts,
        'coordinates': list(simulation.channels.joints),
        'inputs': list(simulation.channels.inputs),
        'maneuver': scene.maneuver.name,
        'integrator': scene.integrator.kind,
        'h': simulation.scene.integrator.h,
        'duration': scene.duration,
        'steps': simulation.scene.steps,
        'start': simulation.start.report(),
    }
    if not args.brief and (told := order_four(simulation)):
        data['order_four'] = told
    tables: list[tuple[str, Rows]] = []
    lines: list[str] = []
    if simulation.level is not None:
        data['fidelity'] = scene.fidelity
        level = simulation.level if args.brief else _with_errors(simulation.level, scene)
        data['level'], tables = dataclasses.asdict(level), _level(level)
        if not (args.brief or _steered(scene)):
            lines.append(
                'no error sheet: its maneuvers impose the angle of the steering wheel, which the vehicle has no '
                'input for'
            )
    if not args.brief and is_vehicle(simulation.scene.model):
        data['figures'], figures = _figures(simulation.scene)
        if isinstance(figures, str):
            lines.append(figures)
        else:
            tables.append(('Figures of the vehicle', figures))
    if scene.model.tires:
        data['tire_data'], receipts = _tires(scene)
        lines += receipts
    curved = [grid for grid in scene.model.road.grids if isinstance(grid, CurvedGrid)]
    if notes := [f'{grid.file or grid.sha256}: {note}' for grid in curved for note in grid.notes]:
        data['road_notes'] = notes
        lines.append('road' + ''.join(f'\n  {note}' for note in notes))
    rows: Rows = [
        (key.replace('_', ' '), f'{_text(value)} {UNITS.get(key, "")}'.rstrip())
        for key, value in data.items()
        if key not in ('status', 'figures', 'level', 'start', 'tire_data', 'road_notes') and value not in ('', [], {})
    ]
    rows.append(('start', str(simulation.start)))
    if args.html is not None:
        _page(args.html, scene, rows, tables, lines)
        data['html'] = str(args.html)
        lines.append(f'page: {args.html}')
    parts = [table(rows), *(table(one) for _, one in tables), *lines]
    return Result(data=data, text='\n\n'.join(parts))


def _page(file: Path, scene: Scene, rows: Rows, tables: Sequence[tuple[str, Rows]], lines: Sequence[str]) -> None:
    """The page of a scene or a vehicle. Raises BagError."""
    from mbd_sim_ros.analysis import pages
    from mbd_sim_ros.analysis.provenance import facts_of_scene

    blocks = [pages.heading('Scene'), pages.table([('', ''), *rows])]
    for title, one in tables:
        blocks += [pages.heading(title), pages.table(one)]
    if lines:
        blocks += [pages.heading('Notes'), pages.text(*(line for text in lines for line in text.splitlines()))]
    outside = [row[0] for _, one in tables for row in one if 'OUTSIDE' in row or 'FAILED' in row]
    said = f'outside of usual ranges: {", ".join(outside)}' if outside else ''
    ok = False if outside else None
    facts = facts_of_scene(scene.resolved, scene.name)
    pages.Page(title=scene.title or scene.name, verdict=said, ok=ok, facts=facts, blocks=blocks).write(file)


def _tire_file(args: argparse.Namespace) -> Result:
    """The receipt of a tire file: every key used, ignored (why) or defaulted (value)."""
    from solver.errors import suggestion
    from solver.files.scene import config_directories
    from solver.files.tir import read_tir
    from solver.files.tire_receipt import receipt, turn_slip_of, warnings
    from solver.files.yaml_tree import find

    asked = (('--set', args.overrides), ('--urdf', args.urdf), ('--resolved', args.resolved), ('--html', args.html))
    for name, given in asked:
        if given:
            raise SceneError(f'{args.scene}: {name} is for a scene, not for a tire file')
    roots = [Path(), *config_directories()]
    path = find(args.scene, [*roots, *(root / 'tires' for root in roots)])
    if path is None:
        known = {file.name for root in roots for file in (root / 'tires').glob('*.tir')}
        raise SceneError(
            f'tire {args.scene!r}: no such file, and no name in config/tires{suggestion(Path(args.scene).name, known)}'
        )
    data = read_tir(path)
    found = receipt(data)
    said, turning = warnings(data), turn_slip_of(data, None)
    rows = [('key', '', 'value', ''), *((e.key, e.fate, _text(e.value), e.why) for e in found)]
    object_ = {
        'status': 'ok',
        'tire': data.name,
        'version': data.version,
        'side': data.side,
        'turn_slip': turning,
        'receipt': [dataclasses.asdict(e) for e in found],
    }
    equations = f'{data.version // 10}.{data.version % 10}'
    head = table(
        [('tire', data.name), ('equations', equations), ('side', data.side), ('turn slip', turning), *_counts(found)]
    )
    return Result(data=object_ | {'warnings': said}, text='\n'.join([head, *said, '', table(rows)]))


def _recording(args: argparse.Namespace) -> Result:
    """The run in a recording: its scene, verdict and numerical error."""
    from mbd_sim_ros.bags.reader import read

    for name, given in (('--set', args.overrides), ('--urdf', args.urdf), ('--resolved', args.resolved)):
        if given:
            raise SceneError(f'{args.scene}: {name} is for a scene, not for a recording')
    run = read(args.scene, ('cmd_applied/*',))
    known: dict[str, Any] = {
        key: run.metadata[key] for key in ('scene', 'created', 'code_version', 'seed') if key in run.metadata
    }
    verdict = run.metadata.get('status', 'unknown')
    duration = float(run.time[-1] - run.time[0]) if len(run.time) else 0.0
    data: dict[str, Any] = {'status': 'ok', 'verdict': verdict, **known, 'duration': duration}
    data |= {
        'findings': run.findings,
        'errors': run.errors,
        'error_text': run.error_text,
        'reactions_text': run.reactions_text,
    }
    rows = [('recording', args.scene), ('verdict', verdict), ('error', run.error_text)]
    rows += [('reactions', run.reactions_text)] if run.reactions_text else []
    rows += [*((key.replace('_', ' '), text) for key, text in known.items()), ('duration', f'{duration:g} s')]
    rows += [('SUSPECT', str(one.get('text', one))) for one in run.findings]
    if args.html is not None:
        from mbd_sim_ros.analysis.run_page import write_page

        write_page([Path(args.scene)], args.html, rows=rows)
        data['html'] = str(args.html)
        rows.append(('page', str(args.html)))
    return Result(data=data, text=table(rows))


def _counts(found: list[Entry]) -> list[tuple[str, str]]:
    return [(fate, str(sum(e.fate == fate for e in found))) for fate in ('used', 'ignored', 'defaulted')]


def _tires(scene: Scene) -> tuple[list[dict[str, Any]], list[str]]:
    """Use of the keys of each tire that the scene has: (objects for JSON, texts)."""
    from solver.files.tire_receipt import receipt, turn_slip_of, warnings
    from solver.vehicle.wheel_end import told_of_fit

    objects, texts = [], []
    fit = told_of_fit(scene.model)
    distinct = {(t.data.source or t.data.name, t.turn_slip): t for t in scene.model.tires}
    for (name, _), tire in distinct.items():
        found, said = receipt(tire.data, turn_slip=tire.turn_slip), warnings(tire.data, tire.pressure)
        wheels = [
            t.name for t in scene.model.tires if (t.data.source or t.data.name, t.turn_slip) == (name, tire.turn_slip)
        ]
        said += [sentence for sentence in fit if sentence.partition(':')[0] in wheels]
        counts = ', '.join(f'{number} {"key" if number == "1" else "keys"} {fate}' for fate, number in _counts(found))
        text = f'tire {name} ({", ".join(wheels)}): {counts} (every one: mbd info FILE.tir, or --json)'
        turning = turn_slip_of(tire.data, tire.turn_slip)
        text += ''.join(f'\n  {sentence}' for sentence in (*said, f'turn slip: {turning}'))
        texts.append(text)
        entry = {'tire': name, 'wheels': wheels, 'turn_slip': turning}
        objects.append(entry | {'receipt': [dataclasses.asdict(e) for e in found], 'warnings': said})
    return objects, texts


def _with_errors(level: LevelReport, scene: Scene) -> LevelReport:
    """The report with the error sheet of a level, or of the full vehicle with switches off. It is measured once for a
    vehicle and takes some seconds then. None of a vehicle whose steering wheel has no angle to impose."""
    from solver.levels.error_sheet import error_sheet

    whole = scene.fidelity == 'full' and 'off' not in scene.switches.values()
    if whole or scene.fidelity == 'auto' or level.errors is not None or not _steered(scene):
        return level
    return dataclasses.replace(level, errors=error_sheet(scene.model, scene.fidelity, scene.switches))


def _steered(scene: Scene) -> bool:
    """True where a vehicle is steered by an angle, as the maneuvers of an error sheet do it."""
    return 'steering' in scene.model.inputs


def _level(level: LevelReport) -> list[tuple[str, Rows]]:
    """Titles and tables of a level: the parts that it leaves out, the range in which it holds, and its errors against
    the full vehicle."""
    parts: list[Rows] = [
        [('subsystem', '', 'why'), *((s.subsystem, 'on' if s.on else 'off', s.why) for s in level.switched)],
        [('lost',), *((text,) for text in level.lost)],
        [('valid for',), *((str(limit),) for limit in level.validity)],
        [
            ('measured and certified', 'where'),
            *((' '.join(f'{c.quantity} {c.of} {c.value:.3g} {c.unit}'.split()), c.where) for c in level.certified),
        ],
        [('not published',), *((name,) for name in level.absent)],
    ]
    found = level.errors or ()
    errors = [
        (e.maneuver, e.quantity, f'{100.0 * e.rms:.2g} %', f'{100.0 * e.largest:.2g} %', f'{e.peak:.4g} {e.unit}')
        for e in found
    ]
    parts.append([('maneuver', 'quantity', 'RMS error', 'largest', 'of the peak'), *errors])
    titles = (
        'Subsystems',
        'What it leaves out',
        'Where it holds',
        'Certified',
        'What it does not publish',
        'Error sheet',
    )
    return [(title, rows) for title, rows in zip(titles, parts, strict=True) if len(rows) > 1]


def scene_of(name: str, overrides: Sequence[str]) -> Scene:
    """The scene of that name or file; of a vehicle that is no scene: the vehicle standing on a flat road."""
    from solver.files.naming import included
    from solver.files.scene import known_names, load_scene, load_scene_text

    is_file = os.path.isfile(name)  # false of names that no file can have
    if is_file and _is_vehicle(Path(name)):
        return load_scene_text(STANDING.format(included(Path(name))), Path(name).stem, overrides)
    if name not in known_names() and not is_file:
        vehicles = known_names('vehicles')
        if name in vehicles:
            return load_scene_text(STANDING.format(f'vehicles/{name}.yaml'), name, overrides)
        if near := get_close_matches(name, vehicles, n=1):
            raise SceneError(
                f'{name!r}: no such file, and no name in config/scenes or config/vehicles; did you mean {near[0]!r}?'
            )
    return load_scene(name, overrides)


def _is_vehicle(file: Path) -> bool:
    """True where a file says which kind of vehicle it is; scenes have no key `kind`."""
    from yaml.nodes import MappingNode

    from solver.files.scene import config_directories
    from solver.files.yaml_tree import read

    root = read(file, config_directories())
    return isinstance(root, MappingNode) and any(key.value == 'kind' for key, _ in root.value)


def _figures(scene: Scene) -> tuple[dict[str, Any], Rows | str]:
    """The figures of the vehicle of a scene, standing on a flat road: (an object for JSON in SI units, a table, or why
    there is none)."""
    from solver.analysis.figures import all_figures, standing
    from solver.analysis.typical_values import TEXTS, typical_values
    from solver.vehicle.size import size_of

    try:
        found, failed = all_figures(standing(scene))
    except MbdError as error:
        return {'error': str(error)}, f'no figures of the vehicle: {error}'
    data: dict[str, Any] = {}
    ranges, size = typical_values(scene.model), size_of(scene.model)
    texts = driven_at(size)
    compared = f'of a {scene.model.category or "saloon"}' if ranges else 'none is known of this size'
    rows: list[tuple[str, ...]] = [('figure', 'value', compared, '', 'source')]
    for name, (text, unit, factor) in TEXTS.items():
        if name in failed:
            data[name] = {'error': failed[name]}
            rows.append((texts.get(name, text), 'none', '', 'FAILED', failed[name]))
        if name not in found or (ranges and name not in ranges):
            continue
        shown = f'{found[name] * factor:.4g} {unit}'
        if name not in ranges:
            rows.append((texts.get(name, text), shown, '', '', ''))
            continue
        where = ranges[name]
        within = where.low <= found[name] <= where.high
        data[name] = {
            'value': found[name],
            'low': where.low,
            'high': where.high,
            'within': within,
            'source': where.source,
        }
        low, high = (f'{x * factor:.4g}' for x in (where.low, where.high))
        rows.append((texts.get(name, text), shown, f'{low} to {high}', '' if within else 'OUTSIDE', where.source))
    others = {name: {'value': value} for name, value in found.items() if name not in data}
    return data | others, rows


def driven_at(size: Size) -> dict[str, str]:
    """Texts of figures with the speed that they belong to, of a vehicle that is no passenger car in size."""
    from solver.analysis.driven import FAST

    if size.length == 1.0:
        return {}
    return {'steering_sensitivity': f'lateral acceleration by steering wheel, at {3.6 * FAST * size.speed:.4g} km/h'}


def _text(value: object) -> str:
    if isinstance(value, dict):
        return ', '.join(f'{k} {v}' for k, v in value.items())
    if isinstance(value, list):
        return ', '.join(map(str, value))
    return f'{value:.6g}' if isinstance(value, float) else str(value)
