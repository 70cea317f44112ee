"""mbd drive: a car in a page of this machine, driven by keys or a gamepad, recorded as every run is."""

from __future__ import annotations

import argparse
import os
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mbd_sim_ros.commands import SCENE_HELP, Result, add_settings, declare, names_of, offer, table
from mbd_sim_ros.commands.scene_keys import add_keys, overrides_of
from solver.errors import MbdError, SpecError

if TYPE_CHECKING:
    from mbd_sim_ros.drive.server import Server

SCENE = 'handling_course'
LOOK = 0.1  # s between looks for signals and the end
SWITCH = 2e-5  # s after which a thread gives up the interpreter, as in mbd_sim_ros.node.main
EXAMPLE = """mbd drive
  mbd drive car_lane_change --vehicle pickup_awd --ghost bags/first
  mbd drive --node simulator            # a running node: to look; the page takes the wheel"""


def add(parsers: Any) -> None:
    """Declare the command."""
    parser = declare(parsers, 'drive', run, 'drive a car in a web page of this machine, and record it', EXAMPLE)
    scene = parser.add_argument('scene', metavar='SCENE', nargs='?', help=f'{SCENE_HELP} (default: {SCENE})')
    offer(scene, names_of('scenes'), files=True)
    add_settings(parser)
    add_keys(parser, 'vehicle', 'fidelity')
    parser.add_argument('--duration', metavar='SECONDS', type=float, help='end after so much simulated time')
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
        '--steering-rate', metavar='RAD/S', type=float, help='of the steering wheel while a key is held (default: 4)'
    )
    parser.add_argument(
        '--return-rate', metavar='RAD/S', type=float, help='of the steering wheel when it is let go (default: 8)'
    )


def run(args: argparse.Namespace) -> Result:
    """Prepare, serve, wait for the end."""
    from mbd_sim_ros import compiling, interrupts
    from mbd_sim_ros.analysis.view.motion import read_motion
    from mbd_sim_ros.bags.published import load_published
    from mbd_sim_ros.drive import hands
    from mbd_sim_ros.drive.server import Server
    from mbd_sim_ros.drive.session import Session
    from solver import simulation_of
    from solver.engine.stepping import KINDS
    from solver.inputs.command_filter import commands_of

    rates = {}
    for name in ('steering_rate', 'return_rate'):
        value = getattr(args, name)
        if value is not None:
            if not 0.1 <= value <= 40.0:
                raise SpecError(f'--{name.replace("_", "-")} {value:g}: must be between 0.1 and 40 rad/s')
            rates[name] = value
    if args.duration is not None and not 0.0 < args.duration <= 1e6:
        raise SpecError(f'--duration {args.duration:g}: must be above 0 and at most 1e6 s')
    if not 0.01 <= args.rate <= 10.0:
        raise SpecError(f'--rate {args.rate:g}: must be between 0.01 and 10')
    if not 0 <= args.port < 65536:
        raise SpecError(f'--port {args.port}: must be between 0 and 65535')
    duration, args.duration = args.duration or 0.0, None  # of the drive, not a key of the scene
    name = args.scene or SCENE
    interrupts.now(f'preparing {name}')
    overrides = overrides_of(args)
    scene = load_published(name, overrides)
    if getattr(scene.model, 'tires', ()):
        scene = load_published(name, [*overrides, 'actuation.wheels=true', 'actuation.steering=angle'])  # the handbrake
    if scene.integrator.kind not in KINDS:
        raise SpecError(
            f'integrator: kind = {scene.integrator.kind!r}: mbd drive steps with {" or ".join(KINDS)}; take one'
        )
    compiling.tell(not args.json, scene.model)
    simulation = simulation_of(scene)
    if not simulation.of_bodies:
        raise SpecError(
            f'scene {scene.name!r}: its level of detail has no bodies to draw; take another, e.g. --fidelity kc'
        )
    names = commands_of(simulation.channels.inputs, 'angle')
    seat = hands.Seat.of(simulation.scene, names)
    simulation.advance(1, inputs=simulation.snapshot().inputs)  # compiles what a step needs
    simulation.reset()
    ghost = None if args.ghost is None else read_motion(args.ghost)
    session = Session(
        simulation, names, hands.Hands(seat, **rates), title=scene.title or scene.name, out=args.out,
        recording=not args.no_record, ghost=ghost, duration=duration, rate=args.rate,
    )  # fmt: skip
    try:
        server = Server(session, host=args.host, port=args.port, look=args.look)
    except BaseException:
        session.close('not started')
        raise
    session.show = server.show
    sys.setswitchinterval(SWITCH)
    interrupts.now(f'driving {scene.name}')
    with interrupts.held():
        try:
            session.start()
            server.start()
            announce(server, browser=not args.no_browser)
            while not interrupts.event.wait(LOOK) and not session.loop.done.is_set():
                pass
        finally:
            ended = 'stopped by ' + signal.Signals(interrupts.received()).name if interrupts.received() else 'stopped'
            if interrupts.received():
                interrupts.claim()  # that is how a drive ends
            server.tell()
            try:
                session.close(ended)
            finally:
                server.close()
    if session.failed:
        raise MbdError(session.failed)
    loop = session.loop
    data = {
        'status': session.verdict['status'], 'findings': session.verdict['findings'], 'scene': scene.name,
        'recordings': [str(one) for one in session.runs], 'simulated_time': simulation.t_ns * 1e-9, 'steps': loop.steps,
        'overruns': loop.overruns, 'schedule_slips': loop.slips, 'pages': server.opened, 'refused': server.refused,
        'dropped_pictures': server.dropped, 'unread_messages': server.unread,
    }  # fmt: skip
    rows = [
        ('verdict', data['status']),
        ('driven', f'{data["simulated_time"]:.2f} s in the last run, {loop.steps} steps, {loop.overruns} late'),
    ]
    rows.append(('pages', f'{server.opened}; {server.refused} requests refused, {server.dropped} pictures left out'))
    rows += [('recorded in', one) for one in data['recordings']]
    rows += [('SUSPECT', found['text']) for found in data['findings']]
    return Result(data=data, text=table(rows), code=0 if data['status'] == 'ok' else 1)


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

        webbrowser.open(server.address)
