"""mbd fmu: a scene as a unit of co-simulation, FMI 2.0 or 3.0."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from mbd_sim_ros.commands import Result, add_scene, declare
from mbd_sim_ros.commands.build import add_target
from mbd_sim_ros.commands.scene_keys import add_keys, overrides_of


def add(parsers: Any) -> None:
    """Declare the command."""
    parser = declare(
        parsers, 'fmu', run, 'write a scene as a unit of co-simulation (FMI)', 'mbd fmu car_step_steer --out car.fmu'
    )
    add_scene(parser)
    parser.add_argument('--out', metavar='FILE', type=Path, help='archive to write (default: <scene>.fmu)')
    parser.add_argument(
        '--fmi', type=int, choices=(2, 3), default=2, help='version of the standard: 2.0 (default) or 3.0'
    )
    add_target(parser)
    add_keys(parser, 'vehicle', 'maneuver', 'fidelity', 'duration')


def run(args: argparse.Namespace) -> Result:
    """Write the archive."""
    from mbd_sim_ros import compiling
    from mbd_sim_ros.bags.recorder import code_version
    from mbd_sim_ros.native import library
    from mbd_sim_ros.native.fmu import write
    from mbd_sim_ros.native.kernels import target
    from solver import simulation_of
    from solver.errors import MbdError, refused
    from solver.files.scene import load_scene

    library.compiler()  # before anything that takes time
    scene = load_scene(args.scene, overrides_of(args))
    compiling.tell(not args.json, scene.model)
    file = args.out or Path(f'{scene.name}.fmu')
    try:
        wanted, version = target(args.target), code_version()
        size = write(simulation_of(scene), file, wanted, version=args.fmi, program=version)
    except OSError as error:
        raise MbdError(refused(error)) from None
    data = {'status': 'ok', 'out': str(file), 'fmi': f'{args.fmi}.0', 'target': args.target, 'bytes': size}
    return Result(data=data, text=f'{file}: FMI {args.fmi}.0, {size / 1e3:.0f} kB')
