"""mbd view: a recording in motion, as a web page, a picture or a film."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from mbd_sim_ros.commands import Result, declare
from mbd_sim_ros.commands.replay import SCENE_HELP
from solver.errors import BagError

KINDS = ('.html', '.png', '.gif', '.mp4', '.rrd', '.json')
FILMS = ('.gif', '.mp4')
TAKEN_BY = {  # option -> what it changes
    'at': ('.png',),
    'rate': FILMS,
    'speed': FILMS,
    'width': ('.png', *FILMS),
    'scene': tuple(kind for kind in KINDS if kind != '.rrd'),
    'channel': tuple(kind for kind in KINDS if kind != '.rrd'),
    'ghosts': tuple(kind for kind in KINDS if kind != '.json'),
}
EXAMPLE = """mbd view bags/first --out out/first.html
  mbd view bags/coarse bags/fine --out out/both.html   # the second as a ghost
  mbd view bags/first --out out/first.png --at 1.5
  mbd view bags/first --out out/first.mp4 --speed 0.5
  mbd view bags/first --out out/first.json             # a layout for Foxglove
  mbd view bags/first --rerun                          # in the viewer of Rerun; --out out/first.rrd for another machine"""  # noqa: E501


def add(parsers: Any) -> None:
    """Declare the command."""
    parser = declare(parsers, 'view', run, 'show a recording in motion: a web page, a picture or a film', EXAMPLE)
    parser.add_argument('bag', metavar='BAG', type=Path, help='bag directory or .mcap file')
    parser.add_argument(
        'ghosts',
        metavar='GHOST',
        type=Path,
        nargs='*',
        default=[],
        help='further recordings, drawn as ghosts beside the first',
    )
    parser.add_argument('--out', metavar='FILE', type=Path, help=f'what to write, by its ending: {", ".join(KINDS)}')
    parser.add_argument(
        '--rerun', action='store_true', help='open the recordings in the viewer of Rerun (extra `rerun`)'
    )
    parser.add_argument(
        '--channel', metavar='PATTERN', action='append', default=[], help="curves to draw, e.g. 'imu/*' (repeatable)"
    )
    parser.add_argument('--scene', metavar='SCENE', help=SCENE_HELP)
    parser.add_argument(
        '--at', metavar='SECONDS', type=float, help='instant of a picture (default: the middle of the recording)'
    )
    parser.add_argument(
        '--rate', metavar='HZ', type=float, help='pictures a second of a film (default 25, of a GIF 12.5)'
    )
    parser.add_argument('--width', metavar='PIXELS', type=int, help='of a picture or film (default 1120)')
    parser.add_argument('--speed', metavar='FACTOR', type=float, help='speed of the motion in a film (default 1)')


def run(args: argparse.Namespace) -> Result:
    """Read, draw, write."""
    from mbd_sim_ros import interrupts
    from mbd_sim_ros.analysis.view import page, picture
    from mbd_sim_ros.analysis.view.motion import read_motion
    from mbd_sim_ros.bags.published import told

    file, channels = args.out, tuple(args.channel)
    if file is None and not args.rerun:
        raise BagError(f'nothing to show: give --out FILE, which may end in {", ".join(KINDS)}, or --rerun')
    if file is not None and file.suffix not in KINDS:
        raise BagError(f'--out {file}: its ending must be one of {", ".join(KINDS)}')
    for name, kinds in TAKEN_BY.items():
        if getattr(args, name) in (None, []) or (name == 'ghosts' if file is None else file.suffix in kinds):
            continue
        what = 'a further recording' if name == 'ghosts' else f'--{name}'
        where = '--rerun' if file is None else f'--out {file}'
        raise BagError(f'{where}: {what} has no effect there; leave it out, or write one of {", ".join(kinds)}')
    if args.rerun:
        from mbd_sim_ros.analysis.view.rerun import open_viewer

        open_viewer((args.bag, *args.ghosts))
        if file is None:
            return Result(data={'status': 'ok', 'file': None}, text='opened in Rerun')
    for name in ('rate', 'speed'):
        value = getattr(args, name)
        if value is not None and not 0.01 <= value <= 1000.0:
            raise BagError(f'--{name} {value:g}: must be between 0.01 and 1000')
    width = picture.WIDTH if args.width is None else args.width
    if not 160 <= width <= 8000:
        raise BagError(f'--width {width}: must be between 160 and 8000')
    if file.suffix == '.rrd':
        from mbd_sim_ros.analysis.view.rerun import write_rrd

        write_rrd((args.bag, *args.ghosts), file)
        size = file.stat().st_size
        return Result(data={'status': 'ok', 'file': str(file), 'bytes': size}, text=f'{file} ({size / 1e6:.2f} MB)')
    width -= width % 2  # films need even sizes
    interrupts.now(f'making {file}')
    if args.scene is not None and all((said := told(path)) is None or said.scene for path in (args.bag, *args.ghosts)):
        raise BagError(f'--scene {args.scene}: {args.bag} says which scene it is of; leave it out')
    motions = [read_motion(path, channels, args.scene) for path in (args.bag, *args.ghosts)]
    if file.suffix == '.html':
        page.write_page(motions, file, channels)
    elif file.suffix == '.json':
        from mbd_sim_ros.analysis.view.foxglove import write_layout

        write_layout(motions[0], args.bag, file, channels)
    elif file.suffix == '.png':
        picture.write_picture(motions, file, at=args.at, width=width, channels=channels)
    else:
        rate = args.rate or (25.0 if file.suffix == '.mp4' else 12.5)
        speed = args.speed or 1.0
        picture.write_film(
            motions, file, rate=rate, speed=speed, progress=not args.json, width=width, channels=channels
        )
    first = motions[0]
    data = {
        'status': 'ok',
        'file': str(file),
        'bytes': file.stat().st_size,
        'bodies': len(first.drawing.bodies),
        'instants': len(first.time),
        'begin': float(first.time[0]),
        'end': float(first.time[-1]),
        'doubts': [f'{m.name}: {text}' for m in motions for text in (*m.run.doubts, *m.run.remarks)],
    }
    return Result(data=data, text='\n'.join([f'{file} ({data["bytes"] / 1e6:.2f} MB)', *data['doubts']]))
