"""mbd study: regenerate a study, with its report, pictures and tables."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from mbd_sim_ros.commands import SCENE_HELP, Result, add_settings, declare, names_of, offer, table

BAR = '{percentage:3.0f}% |{bar:30}| {desc}'


class _Listing(argparse.RawDescriptionHelpFormatter):
    """Lists the studies below the help."""

    def format_help(self) -> str:
        from mbd_sim_ros.lab.studies import STUDIES, installed, summary

        here = installed()
        others = [name for name in STUDIES if name not in here]
        lines = [f'  {name:20} {summary(name)}\n' for name in here]
        more = f'in a checkout of the source only:\n  {", ".join(others)}\n' if others else ''
        return f'{super().format_help()}\nstudies:\n{"".join(lines)}{more}'


def add(parsers: Any) -> None:
    """Declare the command."""
    parser = declare(
        parsers,
        'study',
        run,
        'put a question to many runs and write a report with pictures and tables',
        'mbd study trade car_step_steer --set duration=4\n  mbd study mechanisms --n 1000 --seed 0',
    )
    parser.formatter_class = _Listing
    offer(parser.add_argument('name', metavar='NAME', help='one of the studies below'), _names)
    scene = parser.add_argument('scene', metavar='SCENE', nargs='?', help=f'of the study trade: {SCENE_HELP}')
    offer(scene, names_of('scenes'), files=True)
    add_settings(parser)
    parser.add_argument(
        '--workers',
        metavar='N',
        type=int,
        help='of the study trade: runs at a time (default: as many as there are cores)',
    )
    parser.add_argument(
        '--data',
        metavar='DIR',
        type=Path,
        help='of the study reality: directory with recordings of real vehicles (docs/reality.md)',
    )
    parser.add_argument(
        '--out', metavar='DIR', type=Path, help='directory of the report (default: out/NAME, or out/NAME/SCENE)'
    )
    parser.add_argument('--quick', action='store_true', help='a few runs only: for a first look, not for conclusions')
    parser.add_argument(
        '--n',
        metavar='N',
        type=int,
        help='of a study that draws samples (mechanisms, verdicts, change_points): how many',
    )
    parser.add_argument(
        '--seed', metavar='SEED', type=int, help='of a study that draws samples: of their series (default: 0)'
    )
    parser.add_argument('--strict', action='store_true', help='exit code 1 when a check is not met')


def _names() -> list[str]:
    from mbd_sim_ros.lab.studies import installed

    return installed()


def run(args: argparse.Namespace) -> Result:
    """Run the study, show its checks."""
    from tqdm import tqdm

    from mbd_sim_ros.bags.recorder import file_stem
    from mbd_sim_ros.lab import studies as study
    from solver.errors import BagError

    options = _options(args)  # a wrong name makes no directory
    out = args.out or Path('out') / args.name / (file_stem(options['scene'].name) if 'scene' in options else '')
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BagError(f'--out {out}: {error.strerror}; choose another place') from None
    with tqdm(total=1.0, bar_format=BAR, disable=args.json or not sys.stderr.isatty(), leave=False) as bar:

        def progress(text: str, done: float) -> None:
            bar.set_description_str(text, refresh=False)
            bar.update(min(1.0, done) - bar.n)

        figures = study.run(args.name, out, quick=args.quick, progress=progress, **options)
    missed = [check['name'] for check in figures['checks'] if not check['met']]
    failed = args.strict and bool(missed)
    data = {
        'status': 'failed' if failed else 'ok',
        'study': args.name,
        'quick': args.quick,
        'out': str(out),
        'report': str(out / 'report.md'),
        'page': str(out / 'report.html'),
        'missed': missed,
        **figures,
    }
    rows = [
        (c['name'], f'{c["value"]:.3g}', f'{c["limit"]:.3g}', '' if c['met'] else 'NOT MET') for c in figures['checks']
    ]
    text = [
        table([('check', 'value', 'limit', ''), *rows]),
        f'{len(missed)} of {len(rows)} checks not met',
        f'report: {out / "report.html"} (and report.md)',
    ]
    return Result(data=data, text='\n'.join(text if rows else text[-1:]), code=1 if failed else 0)


def _options(args: argparse.Namespace) -> dict[str, Any]:
    """Scene and workers of a study that wants a scene, n and seed of one that draws samples. Raises SpecError where a
    scene is missing, or one of them is given to another study."""
    from mbd_sim_ros.lab import studies
    from solver.errors import SpecError
    from solver.files.scene import load_scene

    if not studies.of_data(args.name):
        if args.data is not None:
            raise SpecError(f'study {args.name!r}: takes no recordings; remove --data')
        given_data: dict[str, Any] = {}
    elif args.data is None:
        raise SpecError(
            f'study {args.name!r}: --data is missing: a directory with recordings of real vehicles, which are not part '
            'of this project; docs/reality.md says where they are to be had'
        )
    else:
        given_data = {'data': args.data}
    samples = {key: value for key in ('n', 'seed') if (value := getattr(args, key)) is not None}
    if samples and not studies.draws(args.name):
        raise SpecError(f'study {args.name!r}: draws no samples; remove {", ".join("--" + key for key in samples)}')
    for key, least in (('n', 1), ('seed', 0)):
        if samples.get(key, least) < least:
            raise SpecError(f'--{key} = {samples[key]}: must be at least {least}')
    if not studies.of_scene(args.name):
        given = args.scene or (args.overrides and '--set') or (args.workers is not None and '--workers')
        if given:
            raise SpecError(f'study {args.name!r}: takes no scene, but {given!r} is given; remove it')
        return {**samples, **given_data}
    if args.scene is None:
        raise SpecError(f'study {args.name!r}: the scene is missing; e.g. mbd study {args.name} car_step_steer')
    if args.workers is not None and args.workers < 1:
        raise SpecError(f'--workers = {args.workers}: must be > 0')
    return {'scene': load_scene(args.scene, args.overrides), 'workers': args.workers}
