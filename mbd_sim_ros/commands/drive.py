"""mbd drive: a car in a page of this machine, driven by keys or a gamepad, recorded as every run is."""

from __future__ import annotations

import argparse
import math
import os
import signal
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mbd_sim_ros.commands import SCENE_HELP, Result, add_settings, declare, names_of, offer, table
from mbd_sim_ros.commands.scene_keys import add_keys, overrides_of
from solver.errors import MbdError, SpecError

if TYPE_CHECKING:
    from mbd_sim_ros.drive.server import Server
    from mbd_sim_ros.drive.session import Session
    from mbd_sim_ros.node.loop import Loop

SCENE = 'handling_course'
LOOK = 0.1  # s between looks for signals and the end
# s that a drive of a given length may stand, not begun or paused; ten times as much holds a script for 20 minutes
PATIENCE = 120.0
SWITCH = 2e-5  # s after which a thread gives up the interpreter, as in mbd_sim_ros.node.main
EXAMPLE = """mbd drive handling_course             # the scene where none is given
  mbd drive car_lane_change --vehicle pickup_awd --ghost bags/first
  mbd drive --node simulator            # a running node: to look; the page takes the wheel"""


def add(parsers: Any) -> None:
    """Declare the command."""
    parser = declare(parsers, 'drive', run, 'drive a car in a web page of this machine, and record it', EXAMPLE)
    scene = parser.add_argument('scene', metavar='SCENE', nargs='?', help=f'{SCENE_HELP} (default: {SCENE})')
    offer(scene, names_of('scenes'), files=True)
    add_settings(parser)
    add_keys(parser, 'vehicle', 'fidelity')
    parser.add_argument(
        '--node',
        metavar='NAME',
        nargs='?',
        const='simulator',
        help='a running node instead of a scene (default: simulator)',
    )
    parser.add_argument(
        '--duration',
        metavar='SECONDS',
        type=float,
        help='end after so much simulated time; or when nobody has driven for 2 minutes, as an error',
    )
    parser.add_argument(
        '--rate',
        metavar='FACTOR',
        type=float,
        default=1.0,
        help='simulated seconds a second (default: 1; below it slow motion)',
    )
    parser.add_argument('--ghost', metavar='BAG', type=Path, help='an earlier run, drawn beside')
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        '--out', metavar='DIR', type=Path, help='new directory for the recording (default: bags/<scene>-<date>)'
    )
    where.add_argument('--no-record', action='store_true', help='record nothing')
    parser.add_argument(
        '--host',
        metavar='ADDRESS',
        default='127.0.0.1',
        help='where pages may come from (default: this machine alone, 127.0.0.1)',
    )
    parser.add_argument('--port', metavar='N', type=int, default=0, help='port of the page (default: a free one)')
    parser.add_argument('--no-browser', action='store_true', help='open no browser; the address is printed anyway')
    parser.add_argument('--look', action='store_true', help='pages may look, and not drive')
    parser.add_argument(
        '--steering-rate',
        metavar='RAD/S',
        type=float,
        default=4.0,
        help='of the steering wheel while a key is held (default: 4)',
    )
    parser.add_argument(
        '--return-rate',
        metavar='RAD/S',
        type=float,
        default=8.0,
        help='of the steering wheel when it is let go (default: 8)',
    )


def run(args: argparse.Namespace) -> Result:
    """Drive a scene, or a node."""
    from mbd_sim_ros.drive.server import Server

    if args.node is not None:
        for name, given in _of_scenes(args).items():
            if given:
                raise SpecError(f'--node {args.node}: {name} has no effect on a node that runs; leave it out')
    for name, low, high in (('steering_rate', 0.1, 40.0), ('return_rate', 0.1, 40.0), ('rate', 0.01, 10.0)):
        if not low <= getattr(args, name) <= high:
            raise SpecError(f'--{name.replace("_", "-")} {getattr(args, name):g}: must be between {low:g} and {high:g}')
    if args.duration is not None and not 0.0 < args.duration <= 1e6:
        raise SpecError(f'--duration {args.duration:g}: must be above 0 and at most 1e6 s')
    if not 0 <= args.port < 65536:
        raise SpecError(f'--port {args.port}: must be between 0 and 65535')
    server = Server(host=args.host, port=args.port, look=args.look, asked=args.node is not None)
    try:
        return _drive_scene(args, server) if args.node is None else _drive_node(args, server)
    finally:
        server.close()


def _of_scenes(args: argparse.Namespace) -> dict[str, Any]:
    """Arguments that say something of a scene: name on the command line -> value, or nothing."""
    return {
        'SCENE': args.scene, '--set': args.overrides, '--vehicle': args.vehicle, '--fidelity': args.fidelity,
        '--duration': args.duration, '--ghost': args.ghost, '--out': args.out, '--no-record': args.no_record,
        '--rate': args.rate != 1.0,
    }  # fmt: skip


def _drive_scene(args: argparse.Namespace, server: Server) -> Result:
    from mbd_sim_ros import interrupts

    duration = args.duration
    session = _session(args)
    scene, loop = session.simulation.scene, session.loop
    given_up = False
    session.show = server.show
    sys.setswitchinterval(SWITCH)
    interrupts.now(f'driving {scene.name}')
    with interrupts.held():
        try:
            session.start()
            server.start(session)
            announce(server, browser=not args.no_browser)
            given_up = stood(loop, PATIENCE if duration else math.inf)
        finally:
            server.tell()
            try:
                session.close(f'nobody drove for {PATIENCE:g} s' if given_up else _end())
            finally:
                server.close()
    if session.failed:
        raise MbdError(session.failed)
    if given_up:
        kept = f' (recorded in {", ".join(map(str, session.runs))})' if session.runs else ''
        raise MbdError(
            f'--duration {duration:g}: nobody drove for {PATIENCE:g} s, so the drive ended after '
            f'{session.simulation.t_ns * 1e-9:g} s{kept}; open the address in a browser and drive off, or leave '
            '--duration out: then it waits'
        )
    data = {
        'status': session.verdict['status'], 'findings': session.verdict['findings'], 'scene': scene.name,
        'recordings': [str(one) for one in session.runs], 'simulated_time': session.simulation.t_ns * 1e-9,
        'steps': loop.steps, 'overruns': loop.overruns, 'schedule_slips': loop.slips,
        'dropped_instants': session.unrecorded, **server.counts(),
    }  # fmt: skip
    driven = f'{data["simulated_time"]:.2f} s in the last run, {loop.steps} steps, {loop.overruns} late'
    rows = [('verdict', data['status']), ('driven', driven), _pages(server)]
    rows += [('recorded in', one) for one in data['recordings']]
    if session.unrecorded:
        rows.append(
            ('NOT RECORDED', f'{session.unrecorded} instants, for the disk was too slow; their inputs are there')
        )
    rows += [('SUSPECT', found['text']) for found in data['findings']]
    return Result(data=data, text=table(rows), code=0 if data['status'] == 'ok' else 1)


def stood(loop: Loop, patience: float) -> bool:
    """Wait for a signal or the end of the simulation; True where that stood still for so long [s] before."""
    from mbd_sim_ros import interrupts

    moved = time.monotonic()
    while not interrupts.event.wait(LOOK) and not loop.done.is_set():
        if not loop.paused:
            moved = time.monotonic()
        elif time.monotonic() - moved > patience:
            return True
    return False


def _session(args: argparse.Namespace) -> Session:
    """The scene, at its start and with all kernels compiled. Raises MbdError."""
    from mbd_sim_ros import compiling, interrupts
    from mbd_sim_ros.analysis.view.motion import read_motion
    from mbd_sim_ros.bags.published import load_published
    from mbd_sim_ros.drive.hands import Hands, Seat
    from mbd_sim_ros.drive.session import Session
    from solver import simulation_of
    from solver.engine.stepping import KINDS
    from solver.inputs.command_filter import commands_of

    ghost = None if args.ghost is None else read_motion(args.ghost)
    name = args.scene or SCENE
    interrupts.now(f'preparing {name}')
    duration, args.duration = args.duration or 0.0, None  # of the drive, not a key of the scene
    overrides = overrides_of(args)
    scene = load_published(name, overrides)
    if scene.fidelity == 'single_track':
        raise SpecError(f'scene {scene.name!r}: the level single_track has no bodies to draw; take --fidelity kc')
    if getattr(scene.model, 'tires', ()):
        wheels = scene.fidelity not in ('kc', 'auto')  # the handbrake needs brakes of single wheels, which kc has not
        more = [f'actuation.wheels={str(wheels).lower()}', 'actuation.steering=angle']
        scene = load_published(name, [*overrides, *more])
    if scene.integrator.kind not in KINDS:
        raise SpecError(
            f'integrator: kind = {scene.integrator.kind!r}: mbd drive steps with {" or ".join(KINDS)}; take one'
        )
    compiling.tell(not args.json, scene.model)
    simulation = simulation_of(scene)
    names = commands_of(simulation.channels.inputs, 'angle')
    seat = Seat.of(simulation.scene, names)
    simulation.advance(1, inputs=simulation.snapshot().inputs)  # compiles what a step needs
    simulation.reset()
    title = (scene.title or scene.name) + (f', with {Path(args.vehicle).stem}' if args.vehicle else '')
    hands = Hands(seat, steering_rate=args.steering_rate, return_rate=args.return_rate)
    return Session(
        simulation, names, hands, title=title, out=args.out, recording=not args.no_record,
        ghost=ghost, duration=duration, rate=args.rate,
    )  # fmt: skip


def _drive_node(args: argparse.Namespace, server: Server) -> Result:
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    from mbd_sim_ros import interrupts
    from mbd_sim_ros.drive.attached import Attached

    interrupts.now(f'looking for {args.node}')
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    try:
        desk = Attached(args.node, steering_rate=args.steering_rate, return_rate=args.return_rate)
        server.look = server.look or bool(desk.look)
        desk.show = server.show
        interrupts.now(f'driving {args.node}')
        with interrupts.held():
            try:
                server.start(desk)
                announce(server, browser=not args.no_browser)
                while not interrupts.received() and desk.spin(LOOK):
                    pass
            finally:
                ended = _end()
                server.close()
                desk.close()
    finally:
        rclpy.try_shutdown()
    data = {'status': 'ok', 'node': args.node, 'pictures': desk.frames, **server.counts()}
    shown = f'{desk.frames} pictures; {ended if interrupts.received() else "the node has ended"}'
    return Result(data=data, text=table([('node', args.node), ('shown', shown), _pages(server)]))


def _end() -> str:
    """Why a drive ends; a signal is the usual way, and needs no other sentence."""
    from mbd_sim_ros import interrupts

    if not interrupts.received():
        return 'stopped'
    interrupts.claim()
    return f'stopped by {signal.Signals(interrupts.received()).name}'


def _pages(server: Server) -> tuple[str, str]:
    return 'pages', f'{server.opened}; {server.refused} requests refused, {server.dropped} pictures left out'


def announce(server: Server, *, browser: bool) -> None:
    """Print the address, and open it in a browser where there is a display."""
    print(f'drive at {server.address} (Ctrl-C ends)', file=sys.stderr, flush=True)
    if server.open_to_others:
        print(
            'every machine that knows this address can drive; the connection is not encrypted',
            file=sys.stderr,
            flush=True,
        )
    shown = sys.platform in ('darwin', 'win32') or any(os.environ.get(name) for name in ('DISPLAY', 'WAYLAND_DISPLAY'))
    if browser and shown:
        import webbrowser

        # some browsers run in the terminal, and open() waits for their end
        threading.Thread(target=webbrowser.open, args=(server.address,), daemon=True).start()
