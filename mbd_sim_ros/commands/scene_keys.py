"""Options that stand for keys of a scene, which --set may have too: --vehicle, --maneuver, --fidelity, --duration."""

from __future__ import annotations

import argparse

from mbd_sim_ros.commands import names_of, offer

KEYS = {
    'vehicle': ('FILE', 'another vehicle: a path, or a name in config/vehicles'),
    'maneuver': ('FILE', 'another maneuver: a path, or a name in config/maneuvers'),
    'fidelity': (
        'LEVEL',
        'another level of detail: full, condensed, kc, single_track, or auto: as the scene is planned',
    ),
    'duration': ('SECONDS', 'simulated time instead of the duration in the scene'),
}
LEVELS = ('full', 'condensed', 'kc', 'single_track', 'auto')
FOLDERS = {'vehicle': 'vehicles', 'maneuver': 'maneuvers'}


def add_keys(parser: argparse.ArgumentParser, *keys: str, does: str = '') -> None:
    """Declare options for these keys of KEYS. does: what else they do."""
    for key in keys:
        name, text = KEYS[key]
        action = parser.add_argument(
            f'--{key}', metavar=name, type=float if key == 'duration' else str, help=text + does
        )
        if key in FOLDERS:
            offer(action, names_of(FOLDERS[key]), files=True)
        elif key == 'fidelity':
            offer(action, lambda: LEVELS)


def overrides_of(args: argparse.Namespace) -> list[str]:
    """The options that were given, and behind them --set, which may change a part of what they name.

    Raises SpecError where both give the whole of a key, and SceneError for a file that there is not.
    """
    from solver.errors import SpecError
    from solver.files.naming import included
    from solver.files.overrides import keys_of
    from solver.files.scene import find_file

    given = {key: value for key in KEYS if (value := getattr(args, key, None)) is not None}
    for override in args.overrides:
        key, *parts = keys_of(override.partition('=')[0]) or ('',)
        if key in given and not parts:
            raise SpecError(f'--set {override}: --{key} is given too; keep one of them')
    values = {
        key: included(find_file(value, FOLDERS[key])) if key in FOLDERS else value for key, value in given.items()
    }
    return [*(f'{key}={value}' for key, value in values.items()), *args.overrides]
