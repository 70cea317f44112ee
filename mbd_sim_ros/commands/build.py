"""mbd build: scenes as files for a native library, and the library, which needs no Python."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from mbd_sim_ros.commands import SCENE_HELP, Result, add_settings, declare, names_of, offer, table
from mbd_sim_ros.commands.compile import SCENES
from mbd_sim_ros.commands.scene_keys import add_keys, overrides_of

TARGETS = ('v3', 'host')


def add(parsers: Any) -> None:
    """Declare the command."""
    parser = declare(
        parsers,
        'build',
        run,
        'write scenes, and a library that steps them without Python',
        'mbd build car_step_steer --out native',
    )
    scenes = parser.add_argument(
        'scenes', metavar='SCENE', nargs='*', help=f'{SCENE_HELP} (default: {" ".join(SCENES)})'
    )
    offer(scenes, names_of('scenes'), files=True)
    parser.add_argument('--out', metavar='DIR', type=Path, default=Path('native'), help='directory (default: native)')
    add_target(parser)
    parser.add_argument(
        '--as-applied',
        action='store_true',
        help='take the inputs as a run of the scene applies them, those of drivers and actuators too, for its maneuver',
    )
    add_keys(parser, 'vehicle', 'maneuver', 'fidelity', 'duration')
    add_settings(parser)


def add_target(parser: argparse.ArgumentParser) -> None:
    """Declare --target."""
    parser.add_argument(
        '--target',
        choices=TARGETS,
        default='v3',
        help='processors that the library runs on: v3, every x86-64 one with AVX2 and FMA (default), or host, this one',
    )


def run(args: argparse.Namespace) -> Result:
    """Write libmbd.so, mbd.h, the example, and a file for each scene."""
    from mbd_sim_ros import compiling
    from mbd_sim_ros.bags.recorder import code_version
    from mbd_sim_ros.native import library
    from mbd_sim_ros.native.kernels import target
    from mbd_sim_ros.native.model import native
    from solver import simulation_of
    from solver.disk import atomic_write
    from solver.errors import MbdError, refused
    from solver.files.scene import load_scene

    library.compiler()  # before anything that takes time
    kernels, sizes, version = {}, dict[str, int](), code_version()
    try:
        args.out.mkdir(parents=True, exist_ok=True)
        for name in args.scenes or SCENES:
            scene = load_scene(name, overrides_of(args))
            if f'{scene.name}.mbd' in sizes:
                raise MbdError(f'{name}: another scene is called {scene.name!r} too: build them into different --out')
            compiling.tell(not args.json, scene.model)
            made = native(simulation_of(scene), version, applied=args.as_applied)
            with atomic_write(args.out / f'{scene.name}.mbd') as part:
                part.write_bytes(made.content)
            kernels.update({kernel.name: kernel for kernel in made.kernels})
            sizes[f'{scene.name}.mbd'] = len(made.content)
        library.build(kernels.values(), target(args.target), args.out / library.NAME)
        library.copy_sources(args.out)
        sizes[library.NAME] = (args.out / library.NAME).stat().st_size
    except OSError as error:
        raise MbdError(refused(error)) from None
    rows = [(file, f'{size / 1e3:.0f} kB') for file, size in sizes.items()]
    data = {'status': 'ok', 'out': str(args.out), 'target': args.target, 'kernels': len(kernels), 'bytes': sizes}
    return Result(data=data, text=f'{table(rows)}\nin {args.out}, with {" and ".join(library.COPIED)}')
