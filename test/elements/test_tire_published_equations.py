"""The compiled law against the published equations, over random tires and states."""

from __future__ import annotations

import numpy as np
import pytest
from published_magic_formula import State
from published_magic_formula import forces as published
from tire_bench import CAR, EXAMPLE, SEDAN, evaluate

from solver.elements.tire_data import DEFAULTS, TireData, pack

CLOSE = 1e-4  # of the load, and of load times radius
STATES = 1000
TWIST = ('PDXP', 'PKYP', 'PDYP', 'PHYP', 'PECP', 'QDTP', 'QCRP', 'QBRP', 'QDRP')
FIXED = (
    'FNOMIN',
    'UNLOADED_RADIUS',
    'VERTICAL_STIFFNESS',
    'WIDTH',
    'CAMMIN',
    'CAMMAX',
    'FZMAX',
    'NOMPRES',
    'LONGVL',
    'RHX1',
    'RHY1',
)
SIZES = {
    'PP': 0.1,
    'PD': 0.05,
    'PE': 0.3,
    'PK': 0.3,
    'PH': 0.003,
    'PV': 0.02,
    'RB': 1.0,
    'RC': 0.02,
    'RE': 0.2,
    'RH': 0.003,
    'RV': 0.2,
}
SIZES |= {
    'QSX': 0.02,
    'QSY': 0.002,
    'QB': 0.5,
    'QD': 0.01,
    'QE': 0.4,
    'QH': 0.003,
    'SS': 0.005,
    'QSX5': 1.0,
    'QSX6': 1.0,
    'L': 0.1,
}


def varied(data: TireData, rng: np.random.Generator) -> TireData:
    """The tire with every coefficient of the law changed by an amount that leaves it a tire."""
    values = dict(data.values)
    for key, default in DEFAULTS.items():
        if default is None or key in FIXED or key.startswith(TWIST) or key.endswith('STIFFNESS'):
            continue
        size = next((v for k, v in sorted(SIZES.items(), key=lambda item: -len(item[0])) if key.startswith(k)), 0.0)
        values[key] = data[key] + size * rng.uniform(-1.0, 1.0)
    if values['QSY7'] == 0.0 or data.version == 52:
        values['QSY7'] = 1.0
    values['PKY4'] = 2.0 if data.version == 52 else values['PKY4']
    values |= {'NOMPRES': 220e3, 'CAMMIN': -0.26, 'CAMMAX': 0.26, 'FZMAX': 4.0 * data['FNOMIN'], 'WIDTH': 10.0}
    for key in ('PFZ1', 'RBX1', 'RBY1', 'RCX1', 'RCY1'):
        values[key] = max(abs(values[key]), {'RB': 8.0, 'RC': 1.0}.get(key[:2], 0.0))
    return TireData(name=data.name, version=data.version, values=values)


def worst(data: TireData, states: State) -> dict[str, float]:
    """Largest difference of each force over the load, and of each moment over load times radius."""
    want = published(data.values, data.version, states)
    found = dict.fromkeys(want, 0.0)
    for k in range(len(states.Fz)):
        c = pack(data.values, data.version, float(states.pressure[k]))
        kappa, alpha, gamma, Fz, V, _ = (float(x[k]) for x in states)
        got = evaluate(c, kappa, np.tan(alpha), gamma, Fz, 1.0, V, 1.0, 0.0)
        for name, value in zip(want, got, strict=True):
            size = Fz * (data['UNLOADED_RADIUS'] if name[0] == 'm' else 1.0)
            found[name] = max(found[name], abs(value - want[name][k]) / size)
    return found


def drawn(data: TireData, count: int, rng: np.random.Generator) -> State:
    """States from the whole range of the fit; the camber away from 0, where |camber| is rounded over 1e-3."""
    return State(
        kappa=rng.uniform(-1.0, 1.0, count) ** 3,
        alpha=rng.uniform(-0.9, 0.9, count) * np.abs(rng.uniform(-1.0, 1.0, count)),
        gamma=rng.uniform(0.03, 0.22, count) * rng.choice((-1.0, 1.0), count),
        Fz=data['FNOMIN'] * rng.uniform(0.1, 2.5, count),
        Vx=rng.uniform(2.0, 60.0, count),
        pressure=220e3 * rng.uniform(0.7, 1.3, count),
    )


@pytest.mark.parametrize(('data', 'seed'), [(SEDAN, 52), (CAR, 61), (EXAMPLE, 62)], ids=['5.2', '6.1', '6.2'])
def test_the_law_is_that_of_the_published_equations(data: TireData, seed: int) -> None:
    """20 tires, 50 states each. Rounding of |camber| leaves less than 1e-3^2/(2 * 0.03) = 2e-5 rad."""
    rng = np.random.default_rng(seed)
    found = [worst(tire, drawn(tire, STATES // 20, rng)) for tire in (varied(data, rng) for _ in range(20))]
    largest = {name: max(one[name] for one in found) for name in found[0]}
    assert max(largest.values()) < CLOSE, largest


@pytest.mark.parametrize('data', [SEDAN, CAR, EXAMPLE], ids=['sedan', 'car', 'example'])
def test_the_tires_as_they_are_and_upright(data: TireData) -> None:
    """The delivered sets without any change, at camber 0."""
    states = drawn(data, 100, np.random.default_rng(1))
    nominal = data['NOMPRES'] or 220e3
    states = states._replace(
        gamma=0.0 * states.Fz,
        Fz=np.minimum(states.Fz, 0.9 * (data['FZMAX'] or np.inf)),
        pressure=0.0 * states.Fz + nominal,
    )
    found = worst(data, states)
    assert max(found.values()) < CLOSE, found
