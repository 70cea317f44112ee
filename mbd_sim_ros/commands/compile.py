"""mbd compile: fill the cache of compiled kernels, so that the first run starts at once."""

from __future__ import annotations

import argparse
import time
from typing import Any

from mbd_sim_ros.commands import SCENE_HELP, Result, declare, names_of, offer, table
from solver.errors import MbdError

# between them they use every kernel but those of rarely used elements and settings
SCENES = ('slider_crank', 'car_swept_steer')


def add(parsers: Any) -> None:
    """Declare the command."""
    parser = declare(
        parsers, 'compile', run, 'compile what scenes need, ahead of their first run', 'mbd compile car_swept_steer'
    )
    scenes = parser.add_argument(
        'scenes', metavar='SCENE', nargs='*', help=f'{SCENE_HELP} (default: {" ".join(SCENES)})'
    )
    offer(scenes, names_of('scenes'), files=True)


def run(args: argparse.Namespace) -> Result:
    """Start every scene and make one step."""
    from tqdm import tqdm

    from mbd_sim_ros import compiling
    from mbd_sim_ros.batch import warm_up
    from solver import simulation_of
    from solver.compiled.kernel import KERNELS
    from solver.files.scene import load_scene

    seconds: dict[str, float] = {}
    names = args.scenes or SCENES
    with tqdm(names, unit='scene', disable=None if not args.json else True, leave=False) as bar:
        for name in bar:
            bar.set_description(f'compiling {name}')
            begin = time.perf_counter()
            scene = load_scene(name)
            compiling.tell(not args.json, scene.model)
            warm_up(simulation_of(scene))
            if scene.integrator.step_policy == 'auto':  # which the node takes for constant
                warm_up(simulation_of(load_scene(name, ['integrator.step_policy=constant'])))
            seconds[name] = time.perf_counter() - begin
    if KERNELS.unkept:
        raise MbdError(KERNELS.unkept)
    rows = [(name, f'{value:.1f} s') for name, value in seconds.items()]
    cache = str(KERNELS.store.directory)
    return Result(data={'status': 'ok', 'seconds': seconds, 'cache': cache}, text=table(rows) + f'\ncache: {cache}')
