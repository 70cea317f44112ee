"""Turn slip: off it changes nothing, small it is camber, large it takes the grip and leaves the moment of a wheel
turned on the spot."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from contract import ContractContext, Element, check_contract, forcing
from tire_bench import CAR, EXAMPLE, FLAT, HILLY, SEDAN, forces, settled, tire, value, wheel

from solver.elements.marker import Marker
from solver.elements.tire_data import I, TireData, pack
from solver.elements.tire_pacejka import TWIST_LENGTH, TireSpec, compile_tires, tire_forces
from solver.elements.turn_slip import saturated_moment
from solver.errors import SpecError

R0, F0 = 0.316, 4200.0
ROLLING = 1.0 / 0.3137  # spin over speed of a free wheel [rad/m]
law = partial(forces, Fz=F0)


@pytest.fixture(scope='module')
def c() -> np.ndarray:
    return pack(CAR.values, 61, turn_slip=True)


STATES = {
    'curve': (dict(velocity=(15.0, -0.3, 0.02), spin=47.0, camber=0.04, rates=(0.1, 0.0, 0.8)), (0.002, 0.01, 0.01)),
    'tight curve, braking': (
        dict(velocity=(2.5, 0.2, 0.0), spin=7.0, yaw=0.3, camber=-0.08, rates=(0.0, 0.0, 1.5)),
        (-0.01, 0.02, -0.02),
    ),
    'parking': (dict(yaw=0.3, camber=0.06, rates=(0.0, 0.0, -0.6)), (0.0, 0.001, 0.02)),
    'creeping': (dict(velocity=(0.3, 0.02, 0.0), spin=1.1, camber=0.03, rates=(0.0, 0.0, 0.4)), (0.0, 0.001, 0.02)),
    'reversing': (dict(velocity=(-4.0, 0.3, 0.0), spin=-12.0, camber=0.05, rates=(0.0, 0.0, 0.5)), (0.01, 0.03, 0.02)),
    'flying': (
        dict(position=(0.0, 0.0, 0.5), velocity=(9.0, 1.0, -0.5), spin=30.0, rates=(0.0, 0.0, 3.0)),
        (0.01, -0.02, 0.02),
    ),
}


@pytest.mark.parametrize('road', [FLAT, HILLY], ids=['flat', 'hilly'])
@pytest.mark.parametrize('state', STATES)
@pytest.mark.parametrize('cz', [0.0, 5e-4])
def test_contract_of_force_elements(state: str, road, cz: float) -> None:
    motion, zp = STATES[state]
    element = tire(road=road, turn_slip=True)
    check_contract(element, wheel(**motion), pair=False, power=cz > 0.0, tolerance=1e-10, zp=element.states(zp), cz=cz)


def test_tangents_and_power_of_another_tire() -> None:
    """A file with its own load dependence, asymmetries and pressure, mirrored; PDYP4 and QDRP2 are in no file."""
    data = TireData(
        name='all', version=61, values={**EXAMPLE.values, 'PDYP4': 0.3, 'PDYP3': 2.0, 'PDXP3': 2.0, 'QDRP2': -1.5}
    )
    element = tire(data, HILLY, mirrored=True, pressure=220e3, turn_slip=True)
    for motion, zp in STATES.values():
        check_contract(element, wheel(**motion), pair=False, tolerance=1e-10, zp=element.states(zp), cz=5e-4)


@pytest.mark.parametrize('state', STATES)
def test_off_turn_slip_coefficients_change_nothing(state: str) -> None:
    """Same bits with the turn slip coefficients of the file and without: they are not read."""
    motion, zp = STATES[state]
    with_them = TireData(name='x', version=61, values={**CAR.values, 'PDXP1': 3.0, 'QCRP1': 2.0, 'PECP1': 0.9})
    a, b = (tire(data).evaluate(wheel(**motion), zp=zp[:2], cz=5e-4, tangents=True) for data in (CAR, with_them))
    for x, y in zip(a, b, strict=True):
        np.testing.assert_array_equal(x, y)


def test_without_spin_turn_slip_changes_nothing(c: np.ndarray) -> None:
    """phi = 0: every factor is 1, to rounding, in all slips and loads."""
    off = pack(CAR.values, 61)
    for at in (
        dict(kappa=0.05),
        dict(tan_alpha=0.1),
        dict(kappa=-0.1, tan_alpha=-0.05, Fz=6000.0),
        dict(tan_alpha=0.02, Fz=2000.0),
    ):
        a, b = law(off, **at), law(c, **at)
        for key in a:
            assert b[key] == pytest.approx(a[key], rel=1e-12, abs=1e-9), key


@pytest.mark.parametrize('data', [CAR, EXAMPLE], ids=['car', 'example'])
def test_small_camber_without_turning_is_as_without_turn_slip(data: TireData) -> None:
    """The camber part of the spin restores the camber stiffnesses of force (PKY6) and moment (QDZ8), (4.89) and
    (4.98)."""
    on, off = pack(data.values, 61, turn_slip=True), pack(data.values, 61)
    for Fz in (2500.0, F0, 6000.0):
        slope = [
            {k: np.imag(v) / 1e-30 for k, v in law(c, gamma=1e-30j, Fz=Fz + 0j, twist=0j).items()} for c in (on, off)
        ]
        assert slope[0]['fy'] == pytest.approx(slope[1]['fy'], rel=1e-3)
        assert slope[0]['mz'] == pytest.approx(slope[1]['mz'], rel=1e-3)


def test_turning_is_camber_over_one_minus_epsilon(c: np.ndarray) -> None:
    """Side force and moment rise with R0 phi_t 1/(1 - PECP1) = 2 times as fast as with the camber angle (4.76)."""
    d = 1e-6
    lean, turn = law(c, gamma=d), law(c, twist=d)
    assert turn['fy'] == pytest.approx(2.0 * lean['fy'], rel=1e-4)
    assert turn['mz'] == pytest.approx(2.0 * lean['mz'], rel=1e-4)
    assert turn['fy'] == pytest.approx(2.0 * CAR['PKY6'] * F0 * d, rel=1e-4)
    assert turn['mz'] == pytest.approx(2.0 * CAR['QDZ8'] * F0 * R0 * d, rel=1e-4)


def test_factors_by_hand(c: np.ndarray) -> None:
    """At R0 phi = 0.5 the peaks of Fx and Fy fall by cos arctan(0.4 0.5), the slope of Fy by cos arctan(0.5^2) (4.77),
    (4.79), (4.105)."""
    pure = pack({k: v for k, v in CAR.values.items() if k not in ('RBX1', 'RBY1')}, 61, turn_slip=True)
    zeta = 1.0 / np.hypot(1.0, 0.4 * 0.5)
    for key, slip, grid in (('fx', 'kappa', np.linspace(0, 1, 501)), ('fy', 'tan_alpha', np.linspace(-1.5, 1.5, 3001))):
        still, turned = (np.array([law(pure, **{slip: s}, twist=t)[key] for s in grid]) for t in (0.0, 0.5))
        assert turned.max() / still.max() == pytest.approx(zeta, rel=2e-3)
        if key == 'fy':
            slope = [-np.gradient(f, grid).min() for f in (still, turned)]
            assert slope[1] / slope[0] == pytest.approx(1.0 / np.hypot(1.0, 0.25), rel=2e-3)


def test_large_spin_takes_the_forces_monotonically(c: np.ndarray) -> None:
    """Peaks of Fx and Fy fall to nothing as R0 phi grows; the moment tends to M_z phi infinity (4.95), and on the spot
    it only rises.

    (A rolling wheel loses some of it on the way: the side force of the spin is a slip angle to the residual moment.)"""
    spins = np.geomspace(0.01, 1e3, 40)
    slips = np.linspace(-1.0, 1.0, 81)
    fx = [max(law(c, kappa=s, twist=x)['fx'] for s in slips) for x in spins]
    fy = [max(abs(law(c, tan_alpha=s, twist=x)['fy']) for s in slips) for x in spins]
    mz, on_the_spot = (np.array([-law(c, twist=x, forward=f)['mz'] for x in spins]) for f in (1.0, 0.0))
    assert (np.diff(fx) < 0.0).all()
    assert fx[-1] < 0.01 * fx[0]
    assert (np.diff(fy)[spins[1:] > 0.3] < 0.0).all()
    assert fy[-1] < 0.01 * fy[0]
    limit = 0.2 * CAR['PDY1'] * R0 * F0  # QCRP1, Fz = Fz0
    assert saturated_moment(c, CAR['PDY1'] * F0, F0) == pytest.approx(limit, rel=1e-12)
    assert mz[-1] == pytest.approx(limit, rel=2e-3)
    assert on_the_spot[-1] == pytest.approx(limit, rel=2e-3)
    assert (np.diff(on_the_spot) > 0.0).all()
    # of the order of a uniformly loaded square patch of 0.11 m sliding about its centre: mu Fz 0.383 side
    assert 0.5 < limit / (CAR['PDY1'] * F0 * 0.383 * 0.11) < 2.0
    assert saturated_moment(c, 2.0 * CAR['PDY1'] * F0, 2.0 * F0) == pytest.approx(2.0**1.5 * limit, rel=1e-12)


def test_side_slip_takes_the_spin_moment(c: np.ndarray) -> None:
    """At alpha = 90 degrees M_z phi infinity 2/pi arctan(QCRP2 R0 phi_t) is left (4.104)."""
    data = {**CAR.values, 'QDZ1': 0.0, 'QDZ2': 0.0}  # no trail
    bare = pack(data, 61, turn_slip=True)
    for twist in (0.5, 2.0, 20.0):
        left = -law(bare, tan_alpha=1e9, twist=twist)['mz']
        limit = saturated_moment(bare, CAR['PDY1'] * F0, F0)
        assert left == pytest.approx(limit * 2.0 / np.pi * np.arctan(0.1 * twist), rel=2e-3)
        assert left < -law(bare, twist=twist)['mz']


def test_a_wheel_on_a_circle_is_pushed_outwards_and_resists() -> None:
    """Left circle of 20 m: spin up, so the force of a wheel that leans to the right (-y) and a moment to the right;
    both PKY6, QDZ8 over (1 - PECP1), times R0/20 m."""
    on, off = tire(turn_slip=True), tire()
    V, R = 10.0, 20.0
    r_e = (1.0 + value(off, settled(off, wheel(velocity=(V, 0, 0), spin=V * ROLLING)), 'kappa')) / ROLLING
    for left in (1.0, -1.0):
        motion = dict(velocity=(V, 0.0, 0.0), spin=V / r_e, rates=(0.0, 0.0, left * V / R))
        r = on.evaluate(wheel(**motion), zp=(0.0, 0.0, 0.0), cz=1e6)
        plain = settled(off, wheel(**motion))
        Fz, fy, mz = (value(on, r, k) for k in ('fz', 'fy', 'mz'))
        assert abs(value(off, plain, 'fy')) < 1e-6 * Fz
        assert fy == pytest.approx(-left * 2.0 * (0.9 + 0.22 * (Fz / F0 - 1.0)) * Fz * R0 / R, rel=0.01)
        assert -left * mz == pytest.approx(2.0 * (0.14 - 0.01 * (Fz / F0 - 1.0)) * Fz * R0 * R0 / R, rel=0.05)
    lean = settled(off, wheel(velocity=(V, 0, 0), spin=V * ROLLING, camber=0.03))
    assert value(off, lean, 'fy') < 0.0


def test_reverse_is_forward_turned_half_round() -> None:
    """On a curve, cambered: velocity and spin reversed = the same wheel yawed by pi: equal wrench in W."""
    element = tire(turn_slip=True)
    zero = (0.0, 0.0, 0.0)
    com = np.array([0.02, -0.01, 0.03])
    wrench = []
    for kin in (
        wheel(velocity=(-12.0, 0.6, 0.0), spin=-36.0, camber=0.05, rates=(0.0, 0.0, 0.7)),
        wheel(velocity=(-12.0, 0.6, 0.0), spin=36.0, yaw=np.pi, camber=-0.05, rates=(0.0, 0.0, 0.7)),
    ):
        r = element.evaluate(kin, zp=zero, cz=1e6)
        wrench.append((r.f[0, :3], kin.R[0] @ r.f[0, 3:] + np.cross(kin.R[0] @ com, r.f[0, :3])))
    np.testing.assert_allclose(wrench[0][0], wrench[1][0], rtol=1e-9)
    np.testing.assert_allclose(wrench[0][1], wrench[1][1], rtol=1e-8, atol=1e-7)


def test_a_wheel_steered_on_the_spot() -> None:
    """0.3 rad/s at rest: the moment grows like a torsion spring, K R0/(TWIST_LENGTH R0) per rad, saturates below M_z
    phi infinity, does not creep away when the steering stops, and turns round when it is reversed."""
    element = tire(turn_slip=True)
    rate, h = 0.3, 1e-3
    z, moment = (0.0, 0.0, 0.0), []
    for k in range(5500):
        w = rate if k < 3000 else 0.0 if k < 4000 else -rate
        r = element.evaluate(wheel(rates=(0.0, 0.0, w)), zp=z, cz=h)
        z = tuple(r.z)
        moment.append(-value(element, r, 'mz'))
    Fz = value(element, r, 'fz')
    limit = 0.2 * (1.0 - 0.09 * (Fz / F0 - 1.0)) * R0 * Fz * np.sqrt(Fz / F0)
    slope = 2.0 * (0.14 - 0.01 * (Fz / F0 - 1.0)) * Fz * R0 / TWIST_LENGTH  # per rad of steering
    start = moment[0]  # tau of the standstill damping ahead
    assert moment[20] - start == pytest.approx(slope * rate * 20 * h, rel=0.05)
    assert max(moment) == pytest.approx(limit, rel=0.06)
    assert max(moment) < limit
    assert moment[3999] == pytest.approx(moment[3500], rel=1e-9)
    assert moment[3999] > 0.9 * moment[2999]
    assert moment[-1] < -0.5 * limit
    forces = np.array([abs(value(element, r, k)) for k in ('fx', 'fy')])
    assert forces.max() < 1e-3 * Fz


def test_mirrored_tire_in_the_mirrored_turn() -> None:
    left, right = tire(EXAMPLE, turn_slip=True), tire(EXAMPLE, turn_slip=True, mirrored=True)
    a = left.evaluate(
        wheel(velocity=(8.0, 0.2, 0.0), spin=25.0, camber=0.03, rates=(0.0, 0.0, 0.9)), zp=(0.0, 0.004, 0.01)
    )
    b = right.evaluate(
        wheel(velocity=(8.0, -0.2, 0.0), spin=25.0, camber=-0.03, rates=(0.0, 0.0, -0.9)), zp=(0.0, -0.004, -0.01)
    )
    for name, sign in (('fx', 1), ('fy', -1), ('fz', 1), ('mx', -1), ('my', 1), ('mz', -1)):
        assert value(right, b, name) == pytest.approx(sign * value(left, a, name), rel=1e-9), name


def test_twist_vanishes_in_the_air() -> None:
    element = tire(turn_slip=True)
    z = start = (0.02, -0.03, 0.05)
    for _ in range(100):
        z = tuple(element.evaluate(wheel(position=(0, 0, 1.0)), zp=z, cz=1e-3).z)
    np.testing.assert_allclose(z[:3], np.array(start) * 1.02**-100, rtol=1e-9)


def test_tires_with_and_without_turn_slip_side_by_side() -> None:
    """States are counted per tire: 3, 4, 3; each tire gives what it gives alone."""
    context = ContractContext(bodies=3)
    specs = [TireSpec(name=f't{k}', marker=Marker(body=f'b{k}'), data=CAR, turn_slip=k == 1) for k in range(3)]
    table = compile_tires(specs, context)
    assert table.state.tolist() == [0, 3, 7]
    assert context.n_states == 10
    element = Element(forcing(tire_forces, table, context.laws()), context, n=3, outputs=tire().outputs)
    one = wheel(position=(0.0, 0.0, 0.27), velocity=(6.0, 0.1, 0.0), spin=19.0, rates=(0.0, 0.0, 0.8))
    kin = type(one)(*(np.concatenate([a[:1]] * 3 + [a[1:]]) for a in one))
    r = element.evaluate(kin, zp=(0.001, 0.002, 0.0, 0.001, 0.002, 0.01, 0.0, 0.001, 0.002, 0.0), cz=5e-4)
    np.testing.assert_array_equal(r.f[0], r.f[2])
    assert abs(r.f[1, 1] - r.f[0, 1]) > 1.0
    assert r.z[0] == r.z[3] == r.z[7]


def test_refusals() -> None:
    with pytest.raises(SpecError, match=r"Tire 'front': turn_slip.*6\.1"):
        TireSpec(name='front', marker=Marker(body='b0'), data=SEDAN, turn_slip=True)
    for key, bad in (('QDZ8', 0.1), ('PKY6', 0.0), ('QDRP1', 2.0), ('PECP1', 1.0), ('QCRP1', 0.0)):
        data = TireData(name='x', version=61, values={**CAR.values, key: bad})
        with pytest.raises(SpecError, match=key):
            TireSpec(name='front', marker=Marker(body='b0'), data=data, turn_slip=True)
    assert pack(CAR.values, 61)[I.TURN_SLIP] == 0.0
