"""The moment against turning on the spot, which acts where nothing is said about turn slip: below 5 m/s it is that of
turn slip, above nothing is left of it."""

from __future__ import annotations

import numpy as np
import pytest
from contract import check_contract, check_tangents
from tire_bench import CAR, EXAMPLE, FLAT, HILLY, SEDAN, forces, tire, value, wheel

from solver.elements.marker import Marker
from solver.elements.smooth import smoother_step
from solver.elements.tire_data import PARKING_ENDS, PARKING_FULL, I, TireData, pack
from solver.elements.tire_pacejka import TWIST_LENGTH, TireSpec
from solver.elements.turn_slip import parking_moment, saturated_moment

R0, F0 = 0.316, 4200.0
SPEEDS = [0.0, 1.0, 3.0, 4.9, 6.0]  # m/s
H = 2e-3  # s, of the car on these tires


def turning(speed: float, yaw_rate: float, **motion):
    """A wheel that rolls at this speed [m/s] while it turns [rad/s]."""
    return wheel(velocity=(speed, 0.05 * speed, 0.0), spin=speed / 0.31, rates=(0.0, 0.0, yaw_rate), **motion)


@pytest.mark.parametrize('road', [FLAT, HILLY], ids=['flat', 'hilly'])
@pytest.mark.parametrize('speed', SPEEDS)
@pytest.mark.parametrize('cz', [0.0, 5e-4])
def test_contract_of_force_elements(speed: float, road, cz: float) -> None:
    element, kin, zp = (
        tire(EXAMPLE, road, mirrored=True, turn_slip=None),
        turning(speed, 0.8, camber=0.05),
        (0.001, 0.004, 0.02),
    )
    check_contract(element, kin, pair=False, power=cz > 0.0, tolerance=1e-10, zp=element.states(zp), cz=cz)


@pytest.mark.parametrize('state', ['flying', 'locked and sliding', 'sliding sideways'])
def test_tangents_where_the_wheel_does_not_roll(state: str) -> None:
    motion = {
        'flying': dict(position=(0.0, 0.0, 0.5), velocity=(1.0, 0.2, -0.5), rates=(0.0, 0.0, 3.0)),
        'locked and sliding': dict(velocity=(3.5, 0.3, 0.0), camber=0.03, rates=(0.0, 0.0, -0.7)),
        'sliding sideways': dict(velocity=(0.2, 4.0, 0.0), spin=1.0, rates=(0.0, 0.0, 0.7)),
    }[state]
    check_tangents(tire(road=HILLY, turn_slip=None), wheel(**motion), zp=(0.002, 0.01, -0.03), cz=5e-4)


def test_the_moment_tends_to_that_of_a_wheel_turned_on_the_spot() -> None:
    """M_z phi infinity (4.95) = QCRP1 R0 mu_y Fz sqrt(Fz/Fz0), with its slope QDZ8 R0 Fz/(1 - PECP1) over R0 phi_t at
    zero, against it."""
    c = pack(CAR.values, 61, parking=True)
    for Fz in (2500.0, F0, 6000.0):
        dfz = Fz / F0 - 1.0
        peak = (CAR['PDY1'] + CAR['PDY2'] * dfz) * Fz
        limit = 0.2 * R0 * peak * np.sqrt(Fz / F0)
        assert saturated_moment(c, peak, Fz) == pytest.approx(limit, rel=1e-12)
        assert parking_moment(c, 1e4, Fz, dfz, 1.0) == pytest.approx(-limit, rel=1e-3)
        assert parking_moment(c, 1e4, Fz, dfz, 0.3) == pytest.approx(-0.3 * limit, rel=1e-3)
        assert parking_moment(c, 1e-7, Fz, dfz, 1.0) == pytest.approx(
            2.0 * (CAR['QDZ8'] + CAR['QDZ9'] * dfz) * Fz * R0 * 1e-7, rel=1e-6
        )
    twist = np.linspace(-5.0, 5.0, 201)
    moment = np.array([parking_moment(c, x, F0, 0.0, 1.0) for x in twist])
    assert (np.diff(moment) < 0.0).all()
    np.testing.assert_allclose(moment, -moment[::-1], rtol=1e-12, atol=1e-12)


def test_law_is_that_of_turn_slip_on_the_spot() -> None:
    """Without camber and slip, at standstill (forward = 0), the moments of turn slip beside this one come from shifts
    of the slip alone."""
    bare = {k: v for k, v in CAR.values.items() if not k.startswith(('PH', 'PV', 'QDZ6', 'QDZ7', 'RH', 'RV', 'SSZ'))}
    full, parking = pack(bare, 61, turn_slip=True), pack(bare, 61, parking=True)
    for twist in (1e-3, 0.05, 0.3, 2.0):
        wanted = forces(full, twist=twist, forward=0.0, Fz=F0)['mz'] - forces(full, forward=0.0, Fz=F0)['mz']
        assert parking_moment(parking, twist, F0, 0.0, 1.0) == pytest.approx(wanted, rel=1e-6)
    assert I.PARKING != I.TURN_SLIP


def swung(
    turn_slip: bool | None, yaw_rate, steps: int, speed: float = 0.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(yaw rate [rad/s], moment [N m], twist [m]) of a wheel whose heading turns at yaw_rate(t)."""
    element = tire(turn_slip=turn_slip)
    z, found = element.states((0.0,) * (element.context.n_states - 1)), []
    for k in range(steps):
        rate = yaw_rate(k * H)
        r = element.evaluate(wheel(velocity=(speed, 0.0, 0.0), spin=speed / 0.3137, rates=(0.0, 0.0, rate)), zp=z, cz=H)
        z = tuple(r.z)
        found.append((rate, value(element, r, 'mz'), z[-2]))
    return tuple(np.array(found).T)  # type: ignore[return-value]


def test_a_wheel_on_the_spot_turns_as_with_turn_slip() -> None:
    """Turned 1.5 rad and back: the same state and, but for what shifts of the slip take of it there, the same
    moment."""
    parking, full, none = (
        swung(mode, lambda t: 0.5 if t < 3.0 else -0.5, round(6.0 / H)) for mode in (None, True, False)
    )
    np.testing.assert_allclose(parking[2], full[2], rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(parking[1], full[1], rtol=0.0, atol=0.01 * np.abs(full[1]).max())
    assert np.abs(none[1]).max() < 0.05 * np.abs(parking[1]).max()


@pytest.mark.parametrize('speed', [0.0, 3.0, 4.9])
def test_turning_back_and_forth_takes_energy_out(speed: float) -> None:
    """Over every cycle of a steady swing the moment does negative work on the wheel, beyond that of the slip; from rest
    it never gives back more than it took. Two cycles: the second one is steady, for the twist forgets within a fraction
    of one."""
    cycles = 2
    for amplitude, cycle in ((0.02, 1.0), (0.5, 1.0), (1.0, 2.0)):
        n = round(cycle / H)
        swing = lambda t, a=amplitude, w=2.0 * np.pi / cycle: a * w * np.sin(w * t)  # noqa: E731
        rate, moment, _ = swung(None, swing, cycles * n, speed)
        moment = moment - swung(False, swing, cycles * n, speed)[1]
        work = H * np.cumsum(rate * moment)
        assert work.max() <= 0.0
        assert (np.diff(work[n - 1 :: n]) < 0.0).all()


def test_the_moment_fades_smoothly_and_ends_exactly() -> None:
    """The step has the slopes 0, 0 at both ends up to the second; a wheel that is stopped and started through the fade
    has no jump."""
    for s, end in ((1e-4, 0.0), (1.0 - 1e-4, 1.0)):
        assert abs(smoother_step(s) - end) == pytest.approx(10.0 * 1e-12, rel=1e-3)
    assert [smoother_step(s) for s in (-1.0, 0.0, 0.5, 1.0, 2.0)] == [0.0, 0.0, 0.5, 1.0, 1.0]
    element, plain = tire(turn_slip=None), tire(turn_slip=False)
    speeds = np.concatenate([np.linspace(0.0, 7.0, 1750), np.linspace(7.0, 0.0, 1750)])  # 2 m/s^2
    z, y, moment = (0.0, 0.0, 0.0), (0.0, 0.0), []
    for speed in speeds:
        kin = wheel(velocity=(speed, 0.0, 0.0), spin=speed / 0.3137, rates=(0.0, 0.0, 0.4))
        r, s = element.evaluate(kin, zp=z, cz=H), plain.evaluate(kin, zp=y, cz=H)
        z, y = tuple(r.z), tuple(s.z)
        moment.append(value(element, r, 'mz') - value(plain, s, 'mz'))
        np.testing.assert_array_equal(r.f[:, :3], s.f[:, :3])
        assert (*z[:2], z[-1]) == y
    found = np.array(moment)
    assert (found[speeds >= PARKING_ENDS] == 0.0).all()
    assert np.abs(found[speeds <= PARKING_FULL]).max() > 100.0
    assert np.abs(np.diff(found)).max() < 0.02 * np.abs(found).max()  # on the spot it saturates in 0.3 s


@pytest.mark.parametrize('mirrored', [False, True])
def test_above_the_fade_a_tire_has_the_bits_of_one_without(mirrored: bool) -> None:
    """Forces, tangents and outputs; and whatever twist a wheel brings there decays over TWIST_LENGTH R0."""
    with_it, without = (tire(EXAMPLE, HILLY, mirrored=mirrored, turn_slip=mode) for mode in (None, False))
    for speed in (5.5, -6.0, 20.0):
        kin = turning(speed, 0.9, camber=0.05)
        a = with_it.evaluate(kin, zp=(0.001, 0.003, 0.02), cz=5e-4, tangents=True)
        b = without.evaluate(kin, zp=(0.001, 0.003), cz=5e-4, tangents=True)
        for name in ('f', 'Kq', 'Kv', 'out'):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
        np.testing.assert_array_equal(np.delete(a.z, 2), b.z)
        assert a.z[2] == pytest.approx(
            0.02 / (1.0 + 5e-4 * PARKING_ENDS / (TWIST_LENGTH * EXAMPLE['UNLOADED_RADIUS'])), rel=1e-12
        )


def test_the_state_crosses_the_end_of_the_fade_without_a_kink() -> None:
    """dz/dt just below and just above 5 m/s, at any twist: to what the roundings of |V| leave."""
    element = tire(turn_slip=None)
    for w in (0.0, 0.01, -0.05):
        below, above = (
            element.evaluate(wheel(velocity=(v, 0, 0), rates=(0, 0, 1.0)), zp=(0, 0, w), cz=1e-6).z[2]
            for v in (4.9999, 5.0001)
        )
        assert (below - w) / 1e-6 == pytest.approx((above - w) / 1e-6, rel=1e-4, abs=1e-6)


def test_data_that_have_no_turn_slip_have_none_of_it() -> None:
    backwards, heavy, light = (
        TireData(name='x', version=61, values={**CAR.values, **given})
        for given in ({'QDZ8': 0.1}, {'QDZ9': 0.08}, {'QDZ9': -0.15})
    )
    wrong = ((SEDAN, '6.1'), (backwards, 'QDZ8'), (heavy, 'at a load of 3 FNOMIN'), (light, 'at a load of 0 FNOMIN'))
    for data, why in (*wrong, (CAR, ''), (EXAMPLE, '')):
        spec = TireSpec(name='front', marker=Marker(body='b0'), data=data)
        assert spec.parks == spec.twists == (not why)
        assert why in data.lacks_turn_slip()
        assert tire(data, turn_slip=None).context.n_states == (3 if why else 4)
    for turn_slip in (True, False):
        spec = TireSpec(name='front', marker=Marker(body='b0'), data=CAR, turn_slip=turn_slip)
        assert (spec.parks, spec.twists) == (False, turn_slip)
