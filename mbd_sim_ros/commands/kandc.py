"""mbd kandc: the curves of kinematics and compliance of a vehicle, as tables and a page."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from mbd_sim_ros.commands import Result, add_settings, declare, names_of, offer, table
from solver.errors import SpecError


def add(parsers: Any) -> None:
    """Declare the command."""
    parser = declare(
        parsers,
        'kandc',
        run,
        'curves of kinematics and compliance of a vehicle: toe, camber, load, ... over travel, roll, steering, forces',
        'mbd kandc compact_fwd --out out/compact\n  mbd kandc full_car --set '
        'vehicle.front.anti_roll_bar.stiffness=900 --travel 0.08',
    )
    vehicle = parser.add_argument(
        'vehicle', metavar='VEHICLE', help='path of a vehicle or scene file, or a name in config/vehicles'
    )
    offer(vehicle, names_of('vehicles'), files=True)
    add_settings(parser)
    parser.add_argument(
        '--out', metavar='DIR', type=Path, help='for report.html and a .csv per sweep (default: out/kandc-VEHICLE)'
    )
    parser.add_argument('--travel', metavar='M', type=float, help='wheel travel to either side (of a car 0.06 m)')
    parser.add_argument(
        '--steering', metavar='RAD', type=float, help='steering wheel to either side (road wheels of a car: 0.5 rad)'
    )
    parser.add_argument('--points', metavar='N', type=int, default=41, help='of a sweep (41)')


def run(args: argparse.Namespace) -> Result:
    """Move the vehicle on the bench, write tables and page."""
    from mbd_sim_ros import compiling, interrupts
    from mbd_sim_ros.analysis.kandc import FEWEST, MOST, figure_rows, measure, write_page, write_tables
    from mbd_sim_ros.analysis.provenance import facts_of_scene
    from mbd_sim_ros.commands.info import scene_of
    from solver.validate import finite

    for name in ('travel', 'steering'):
        if getattr(args, name) is not None:
            finite('mbd kandc', f'--{name}', getattr(args, name), low=0.0, strict=True)
    if not FEWEST <= args.points <= MOST:
        raise SpecError(f'mbd kandc: --points {args.points}: must be from {FEWEST} to {MOST}')
    scene = scene_of(args.vehicle, args.overrides)
    compiling.tell(not args.json, scene.model)
    interrupts.now(f'measuring {scene.name} on the bench')
    bench = measure(scene, travel=args.travel, steering=args.steering, points=args.points)
    directory = args.out or Path('out') / f'kandc-{Path(args.vehicle).stem}'
    files = write_tables(bench, directory)
    page = directory / 'report.html'
    write_page(bench, page, f'Kinematics and compliance of {scene.name}', facts_of_scene(scene.resolved, scene.name))
    notes = [f'{sweep.title}: {note}' for sweep in bench.sweeps for note in sweep.notes]
    data = {
        'status': 'ok',
        'vehicle': scene.name,
        'figures': bench.figures,
        'sweeps': {
            sweep.name: {'title': sweep.title, 'columns': {name: list(values) for name, values in sweep.columns()}}
            for sweep in bench.sweeps
        },
        'tables': [str(file) for file in files],
        'report': str(page),
        'notes': notes,
    }
    lines = [
        table(figure_rows(bench)),
        *(f'note: {note}' for note in notes),
        f'{len(files)} tables in {directory}, curves in {page}',
    ]
    return Result(data=data, text='\n'.join(lines))
