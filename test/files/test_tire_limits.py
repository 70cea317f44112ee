"""Every coefficient of a tire has a range: a tire is refused with the name of the coefficient, told of, or does what a
tire does."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np
import pytest
from tire_bench import CAR, EXAMPLE, ROOT, SEDAN, forces, load_at, tire

from solver.elements.tire_data import TireData, pack
from solver.elements.tire_limits import oddities
from solver.elements.tire_pacejka import rolling_radius
from solver.errors import SpecError
from solver.files.tir import read_tir

TIRES = {path.stem: read_tir(path) for path in (ROOT / 'config' / 'tires').glob('*.tir')}
TIRES |= {data.name: data for data in (EXAMPLE, SEDAN)}
FACTORS = (0.0, -1.0, 10.0, 0.1)
SMALL, LARGE = 0.1, 1.0  # slips where the force of a tire has its sign, whatever it pulls without slip


def insane(data: TireData) -> str:
    """What a tire on the road does not do; '' of one that does what tires do. From forces and heights alone, not from
    coefficients."""
    c = pack(data.values, data.version)
    R0, F0 = data['UNLOADED_RADIUS'], data['FNOMIN']
    element = tire(data)
    low, high = 0.5, 1.1  # of the radius: the height at which it carries its nominal load is between
    if not load_at(element, low * R0) > F0 > load_at(element, high * R0):
        return (
            f'it carries {load_at(element, low * R0):.4g} N at half its radius and '
            f'{load_at(element, high * R0):.4g} N at 1.1 times'
        )
    for speed in (0.0, 28.0):
        if not 0.5 * R0 < rolling_radius(c, F0, speed) < 1.4 * R0:
            return f'it rolls on {rolling_radius(c, F0, speed) / R0:.3g} radii'
    for load in (0.5 * F0, F0):
        for slip in (SMALL, LARGE):
            for sign in (1.0, -1.0):
                along, across = forces(c, kappa=sign * slip, Fz=load), forces(c, tan_alpha=sign * slip, Fz=load)
                both = forces(c, kappa=sign * SMALL, tan_alpha=SMALL, Fz=load, gamma=0.02)
                if not all(np.isfinite([*along.values(), *across.values(), *both.values()])):
                    return f'a force is not finite at slip {sign * slip:g}'
                if not (sign * along['fx'] > 0.0 > sign * across['fy']):
                    return f'a force has the wrong sign at slip {sign * slip:g}: {along["fx"]:.4g}, {across["fy"]:.4g}'
                if max(abs(along['fx']), abs(across['fy']), abs(both['fx']), abs(both['fy'])) > 6.0 * load:
                    return f'a force is larger than six times the load at slip {sign * slip:g}'
                if max(abs(across['mz']), abs(both['mz'])) > 0.6 * load * R0 or abs(across['mx']) > 0.6 * load * max(
                    data['WIDTH'], 0.7 * R0
                ):
                    return f'a moment turns the tire over at slip {sign * slip:g}'
        rolling = forces(c, Fz=load, V=28.0 * np.sqrt(R0 / 0.3))['my']  # cars of any size scale by Froude's number
        if not -0.3 * load * R0 < rolling <= 1e-9:
            return f'rolling resistance {rolling:.4g} N m drives, or holds the wheel'
    return ''


def changed(data: TireData) -> Iterator[tuple[str, TireData | SpecError]]:
    """Each coefficient of the file times each factor: (what, the tire or why it is refused)."""
    for key, value in data.values.items():
        for factor in FACTORS:
            try:
                yield (
                    f'{key} x {factor:g}',
                    TireData(name=data.name, version=data.version, values={**data.values, key: factor * value}),
                )
            except SpecError as error:
                yield f'{key} x {factor:g}', error


def silent(data: TireData) -> list[str]:
    """Changes of one coefficient after which the tire does what no tire does, and nobody is told which one it is."""
    known, found = set(oddities(data)), []
    for what, other in changed(data):
        key = what.partition(' ')[0]
        if isinstance(other, SpecError):
            if not re.search(rf'\b{key}\b', str(other)):
                found.append(f'{what}: refused without its name: {other}')
        elif not any(re.search(rf'\b{key}\b', text) for text in oddities(other) if text not in known) and (
            wrong := insane(other)
        ):
            found.append(f'{what}: {wrong}')
    return found


@pytest.mark.slow
@pytest.mark.parametrize('name', sorted(TIRES))
def test_each_coefficient_changed_alone_is_refused_told_or_sane(name: str) -> None:
    found = silent(TIRES[name])
    assert not found, '\n'.join(found)


def test_without_the_limits_the_same_changes_are_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    """The check can fail: with limits that say nothing a good part of the changes of one tire is noticed by what the
    tire does."""
    monkeypatch.setattr('solver.elements.tire_data.check', lambda *_: None)
    wild = {
        'Q_RE0': 0.3,
        'PKX2': 60.0,
        'PKY2': -1.8,
        'DREFF': 20.0,
        'Q_V1': 1500.0,
        'PCY1': 3.0,
        'VERTICAL_STIFFNESS': 2e3,
        'QSY1': -0.1,
    }
    for key, value in wild.items():
        assert insane(TireData(name='wild', version=61, values={**CAR.values, key: value})), key


@pytest.mark.parametrize('name', sorted(TIRES))
def test_the_tires_as_they_are_do_what_tires_do(name: str) -> None:
    assert insane(TIRES[name]) == ''
    if name != EXAMPLE.name:
        assert not oddities(TIRES[name])
