"""Cases for the fuzzer: damaged recordings of others, and the commands that read them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from mutations import damage_bytes, damage_yaml, pick

NEEDS = {'databases': 'rosbags', 'logs': 'asammdf'}  # kind -> library of an extra that writes its files


def _command(rng: np.random.Generator, file: str) -> list[str]:
    """A command that reads a recording of others."""
    mapped = ['--map', 'imu/vector/z=yaw_rate', '--map', 'steer/data=steering']
    command = str(pick(rng, ('export', 'export', 'compare', 'look', 'evaluate', 'run')))
    drive = f'maneuver={{bag: {file}, map: {{steering: {{channel: steer/data}}}}}}'
    return {
        'export': ['export', file, '--csv', 'csv'],
        'compare': ['compare', file, file, '--allow-missing'],
        'look': ['compare', file, '--look'],
        'evaluate': ['evaluate', file, '--as', 'iso7401_step', *mapped],
        'run': ['info', 'light_car_straight', '--brief', '--set', drive],
    }[command]


def databases(rng: np.random.Generator, at: Path, material: object) -> tuple[list[str], None]:
    """Recordings in SQLite, whole or packed in either way, with and without what is beside them. There is no checksum
    in one."""
    import foreign_bags as others

    kind = str(pick(rng, ('db3', 'db3', 'db3 file', 'db3 message')))
    messages = []
    for k in range(200):
        t = others.DAY + k * 10 * others.MS
        messages += [others.scalar('/steer', t, 0, 0.01 * k), others.vector('/imu', t, 0, t, 0.02 * k)]
    place = others.write(at / 'bag', messages, kind)
    file = next(path for path in place.iterdir() if path.suffix in ('.db3', '.zstd'))
    if rng.random() < 0.15:
        about = place / 'metadata.yaml'
        about.write_bytes(damage_yaml(rng, about.read_text()))
    else:
        file.write_bytes(damage_bytes(rng, file.read_bytes()))
    if rng.random() < 0.1:
        return ['recover', 'bag', 'saved'], None
    return _command(rng, str(pick(rng, (str(place), str(file))))), None


def logs(rng: np.random.Generator, at: Path, material: object) -> tuple[list[str], None]:
    """Measurements in MDF 4."""
    from asammdf import MDF, Signal

    t = np.arange(200) * 0.01
    named = {
        'steer/data': 0.1 * np.sin(t),
        'imu/vector/z': 0.2 * np.sin(t),
        'speed': 10.0 + t,
        'gear': np.ones(200, np.uint8),
    }
    with MDF(version='4.10') as mdf:
        mdf.append([Signal(values, t, name=name, unit='') for name, values in named.items()])
        mdf.save(at / 'good.mf4', overwrite=True)
    (at / 'bad.mf4').write_bytes(damage_bytes(rng, (at / 'good.mf4').read_bytes()))
    arguments = _command(rng, 'bad.mf4')
    return (['compare', 'bad.mf4', 'good.mf4'] if arguments[0] == 'export' else arguments), None
