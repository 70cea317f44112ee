"""The tire element: the contract of force elements, signs by hand, relaxation, standstill, and what it does when it should do nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from contract import ContractContext, Element, Result, check_power_balance, check_purity, check_tangents, kinematics
from scipy.spatial.transform import Rotation

from solver.elements.magic_formula import I, slip_stiffness
from solver.elements.marker import Marker
from solver.elements.point_pair import Kinematics
from solver.elements.road import FrictionPatch, HeightGrid, RoadSpec, road_at
from solver.elements.tire_pacejka import OUTPUTS, TireData, TireSpec, compile_tires, tire_forces
from solver.errors import SpecError
from solver.vehicle.tir import read_tir

ROOT = Path(__file__).resolve().parents[2]
CAR = read_tir(ROOT / 'config' / 'tires' / '205_55R16.tir')
EXAMPLE = read_tir(ROOT / 'test' / 'reference' / 'externdata_225_50R17.tir')
SEDAN = read_tir(ROOT / 'test' / 'reference' / 'chrono_245_40R18.tir')
FLAT = RoadSpec()
WAVES = tuple(tuple(0.02 * np.sin(1.3 * i + 0.7 * j) for j in range(6)) for i in range(7))
HILLY = RoadSpec(
    point=(0.0, 0.0, 0.01),
    normal=(0.1, -0.08, 1.0),
    friction=0.8,
    grids=(HeightGrid(origin=(-1.0, -1.0), step=(0.4, 0.5), height=WAVES),),
    patches=(FrictionPatch(center=(0.0, 0.0), size=(1.0, 0.8), factor=0.5, blend=0.6),),
)
H = 1e-3


def tire(data: TireData = CAR, road: RoadSpec = FLAT, **spec) -> Element:
    """One tire on body b0, whose centre of mass lies off the wheel centre."""
    context = ContractContext(bodies=1, com=[(0.02, -0.01, 0.03)])
    table = compile_tires([TireSpec(name='tire', marker=Marker(body='b0'), data=data, **spec)], road, context)
    return Element(lambda kin, *a: tire_forces(table, context.laws(), kin, *a), context, n=1, outputs=OUTPUTS)


def wheel(
    *, position=(0.0, 0.0, 0.3), velocity=(0.0, 0.0, 0.0), spin=0.0, yaw=0.0, camber=0.0, pitch=0.0, rates=(0.0, 0.0, 0.0)
) -> Kinematics:
    """A wheel by the position and velocity of its centre [m, m/s, in W], spin and other rates in the wheel's axes [rad/s]."""
    R = Rotation.from_euler('ZXY', [yaw, camber, pitch]).as_matrix()
    w = np.array(rates) + [0.0, spin, 0.0]
    com = np.array([0.02, -0.01, 0.03])
    return kinematics([(np.array(position) + R @ com, R)], [(*(np.array(velocity) + R @ np.cross(w, com)), *w)])


def value(element: Element, result: Result, name: str) -> float:
    return float(element.output(result, name)[0])


STATES = {
    'cruising': (dict(velocity=(20.0, 0.5, 0.02), spin=65.0), (0.002, 0.01)),
    'braking, steered, cambered': (
        dict(velocity=(15.0, 1.2, -0.1), spin=42.0, yaw=0.2, camber=-0.08, pitch=1.0, rates=(0.3, 0.0, 0.5)),
        (-0.03, 0.02),
    ),
    'standing': (dict(yaw=0.3, camber=0.03), (0.004, -0.003)),
    'creeping': (dict(velocity=(0.3, 0.1, 0.0), spin=1.2), (0.004, -0.003)),
    'reversing': (dict(velocity=(-4.0, 0.3, 0.0), spin=-12.0, camber=0.05), (0.01, 0.03)),
    'spinning at standstill': (dict(velocity=(0.1, 0.0, 0.0), spin=60.0), (0.05, 0.0)),
    'touching down': (dict(position=(0.0, 0.0, 0.3164), velocity=(9.0, 0.0, -0.5), spin=30.0), (0.001, 0.001)),
    'flying': (dict(position=(0.0, 0.0, 0.5), velocity=(9.0, 1.0, -0.5), spin=30.0), (0.01, -0.02)),
    'on the rim': (dict(position=(0.0, 0.0, 0.21), velocity=(9.0, 1.0, -0.1), spin=31.0), (0.01, -0.02)),
    'lying flat': (dict(position=(0.0, 0.0, 0.06), velocity=(5.0, 0.3, -0.1), spin=20.0, camber=1.5, rates=(0.5, 0.0, 0.2)), (0.01, -0.02)),
    'strongly cambered': (dict(position=(0.0, 0.0, 0.13), velocity=(5.0, 0.0, -0.1), spin=20.0, camber=1.12), (0.01, -0.02)),
}


@pytest.mark.parametrize('road', [FLAT, HILLY], ids=['flat', 'hilly'])
@pytest.mark.parametrize('state', STATES)
@pytest.mark.parametrize('cz', [0.0, 5e-4])
def test_contract_of_force_elements(state: str, road: RoadSpec, cz: float) -> None:
    """Purity and exact tangents (complex step through the whole kernel, internal states included) in every regime."""
    motion, zp = STATES[state]
    element = tire(road=road)
    kin = wheel(**motion)
    check_purity(element, kin, zp=zp, cz=cz)
    check_tangents(element, kin, zp=zp, cz=cz)


@pytest.mark.parametrize('road', [FLAT, HILLY], ids=['flat', 'hilly'])
@pytest.mark.parametrize('state', STATES)
def test_power_of_the_force_is_what_energy_and_dissipation_say(state: str, road: RoadSpec) -> None:
    motion, zp = STATES[state]
    check_power_balance(tire(road=road), wheel(**motion), zp=zp, cz=5e-4, tolerance=1e-10)


@pytest.mark.parametrize('data', [EXAMPLE, SEDAN], ids=['6.1 with pressure', '5.2'])
def test_tangents_with_other_tires(data: TireData) -> None:
    motion, zp = STATES['braking, steered, cambered']
    kwargs = dict(pressure=220e3) if data is EXAMPLE else {}
    check_tangents(tire(data, HILLY, mirrored=True, **kwargs), wheel(**motion), zp=zp, cz=5e-4)


def test_load_deflection_and_its_energy() -> None:
    """10 mm: Fz = Fz0 (QFZ1 x + QFZ2 x^2), x = rho/R0, with QFZ1 so that the slope at nominal load is VERTICAL_STIFFNESS."""
    element = tire()
    result = element.evaluate(wheel(position=(0, 0, 0.306)), zp=(0, 0))
    q1 = np.sqrt((215e3 * 0.316 / 4200) ** 2 - 4 * 15.0)
    x = 0.01 / 0.316
    assert value(element, result, 'fz') == pytest.approx(4200 * (q1 * x + 15.0 * x * x), rel=1e-12)
    assert value(element, result, 'deflection') == pytest.approx(0.01, abs=1e-15)
    # the energy starts with the parabolic beginning: its excess over the integral is k1 e^2/6 + k2 e^3/15, e = 0.5 mm
    k1, k2, e = 4200 * q1 / 0.316, 4200 * 15.0 / 0.316**2, 5e-4
    assert value(element, result, 'energy') == pytest.approx(k1 * (0.01**2 / 2 + e * e / 6) + k2 * (0.01**3 / 3 + e**3 / 15), rel=1e-12)
    rho = np.roots([4200 * 15.0 / 0.316**2, 4200 * q1 / 0.316, -4200.0]).max()
    slope = [value(element, element.evaluate(wheel(position=(0, 0, 0.316 - rho - d)), zp=(0, 0)), 'fz') for d in (-1e-5, 1e-5)]
    assert (slope[1] - slope[0]) / 2e-5 == pytest.approx(215e3, rel=1e-6)


def load_at(element: Element, z: float, rise: float = 0.0) -> float:
    """Load [N] of an upright wheel with its centre at height z [m] that rises at `rise` [m/s]."""
    return value(element, element.evaluate(wheel(position=(0, 0, z), velocity=(0, 0, rise)), zp=(0, 0)), 'fz')


def test_load_never_pulls_and_begins_smoothly() -> None:
    """From 2 mm above the road to 20 mm below, sinking and rising fast: Fz >= 0, once differentiable, zero in the air."""
    element = tire(damping=3000.0)
    heights = np.linspace(0.318, 0.296, 2201)
    for rise in (-3.0, 0.0, 3.0):
        fz = np.array([load_at(element, z, rise) for z in heights])
        assert fz.min() >= 0.0
        assert fz[heights > 0.3165].max() == 0.0
        slope = np.diff(fz) / 1e-5
        assert np.abs(np.diff(slope)).max() < 0.03 * max(slope.max(), 1.0)  # a kink would be 1.0
    assert fz.max() == 0.0  # rising at 3 m/s the damper would pull harder than the spring pushes


def test_damping_is_the_stated_one_at_nominal_load() -> None:
    element = tire(damping=500.0)
    z = next(z for z in np.linspace(0.31, 0.28, 3001) if load_at(element, z) > 4200)
    fz = [load_at(element, z, v) for v in (0.1, -0.1)]
    assert (fz[1] - fz[0]) / 0.2 == pytest.approx(500.0, rel=1e-3)


def settled(element: Element, kin: Kinematics) -> Result:
    """The steady state: an implicit step so long that the contact deflections have relaxed."""
    return element.evaluate(kin, zp=(0.0, 0.0), cz=1e6)


def test_signs_of_slip_camber_and_forces() -> None:
    """Left hand side of docs/conventions.md: drive, side slip to the right, camber to the right, and the moments they cause."""
    element = tire()
    rolling = 20.0 / 0.3137
    drive = settled(element, wheel(velocity=(20, 0, 0), spin=1.05 * rolling))
    assert value(element, drive, 'kappa') > 0.03
    assert value(element, drive, 'fx') > 1000.0
    assert drive.f[0, 0] == pytest.approx(value(element, drive, 'fx'))
    right = settled(element, wheel(velocity=(20, -1, 0), spin=rolling))  # slides to the right
    assert value(element, right, 'alpha') == pytest.approx(np.arctan(0.05), rel=1e-3)
    assert value(element, right, 'fy') > 1000.0  # pushed to the left
    assert value(element, right, 'mz') < -10.0  # turned towards its motion
    assert value(element, right, 'mx') > 0.0  # the patch has moved to the left
    assert value(element, right, 'my') < 0.0  # rolling resistance
    lean = settled(element, wheel(velocity=(20, 0, 0), spin=rolling, camber=0.05))
    assert value(element, lean, 'gamma') == pytest.approx(0.05)
    assert value(element, lean, 'fy') < -50.0  # pulled to where the top leans (right)


def test_wrench_on_the_body_by_hand() -> None:
    """Force at the contact point below the wheel centre: torque about the centre of mass = M + (point - com) x F, in body axes."""
    element = tire(road=HILLY)
    kin = wheel(velocity=(15, 1, 0), spin=40.0, yaw=0.4, camber=0.1, pitch=0.7)
    r = element.evaluate(kin, zp=(0.01, 0.02))
    quaternion = [value(element, r, k) for k in ('qx', 'qy', 'qz', 'qw')]
    C = Rotation.from_quat(quaternion).as_matrix()
    F = C @ [value(element, r, k) for k in ('fx', 'fy', 'fz')]
    M = C @ [value(element, r, k) for k in ('mx', 'my', 'mz')]
    point = np.array([value(element, r, k) for k in ('px', 'py', 'pz')])
    np.testing.assert_allclose(r.f[0, :3], F, rtol=1e-12)
    np.testing.assert_allclose(kin.R[0] @ r.f[0, 3:], M + np.cross(point - kin.p[0], F), rtol=1e-10, atol=1e-9)
    assert abs(C[:, 0] @ kin.R[0][:, 1]) < 1e-15  # heading is in the wheel plane


def test_contact_frame_on_a_plane() -> None:
    """On a plane the contact point lies on it and in the wheel plane, and z of the frame is the normal."""
    slope = RoadSpec(point=(0, 0, 0.01), normal=(0.15, -0.1, 1.0))
    element = tire(road=slope)
    kin = wheel(yaw=0.5, camber=-0.1)
    r = element.evaluate(kin, zp=(0, 0))
    point = np.array([value(element, r, k) for k in ('px', 'py', 'pz')])
    C = Rotation.from_quat([value(element, r, k) for k in ('qx', 'qy', 'qz', 'qw')]).as_matrix()
    np.testing.assert_allclose(C[:, 2], slope.normal, atol=1e-14)
    assert np.dot(point - slope.point, slope.normal) == pytest.approx(0.0, abs=1e-15)
    assert (point - [0, 0, 0.3]) @ kin.R[0][:, 1] == pytest.approx(0.0, abs=1e-15)
    assert np.cross(C[:, 0], kin.R[0][:, 1]) @ (point - [0, 0, 0.3]) == pytest.approx(-(0.316 - value(element, r, 'deflection')), rel=1e-12)


def test_mirrored_tire_in_mirrored_motion_gives_the_mirrored_force() -> None:
    """y -> -y of everything (axial vectors the other way): equal to the last bits, with a tire that has every asymmetry."""
    left = tire(EXAMPLE)
    com = np.array([0.02, -0.01, 0.03])
    R = Rotation.from_euler('ZXY', [0.1, 0.06, 0.0])
    R_m = Rotation.from_euler('ZXY', [-0.1, -0.06, 0.0])
    v, w = np.array([15.0, 0.8, -0.1]), np.array([0.2, 47.0, 0.3])
    mirror, axial = np.array([1.0, -1.0, 1.0]), np.array([-1.0, 1.0, -1.0])
    context = ContractContext(bodies=1, com=[com * mirror])
    table = compile_tires([TireSpec(name='tire', marker=Marker(body='b0'), data=EXAMPLE, mirrored=True)], FLAT, context)
    right = Element(lambda kin, *a: tire_forces(table, context.laws(), kin, *a), context, n=1, outputs=OUTPUTS)
    p = np.array([0.0, 0.0, 0.3]) + R.as_matrix() @ com
    a = left.evaluate(kinematics([(p, R.as_matrix())], [(*v, *w)]), zp=(0.01, 0.02))
    b = right.evaluate(kinematics([(p * mirror, R_m.as_matrix())], [(*(v * mirror), *(w * axial))]), zp=(0.01, -0.02))
    np.testing.assert_allclose(b.f[0], a.f[0] * [*mirror, *axial], rtol=1e-12)
    unmirrored = tire(EXAMPLE).evaluate(kinematics([(p * mirror, R_m.as_matrix())], [(*(v * mirror), *(w * axial))]), zp=(0.01, -0.02))
    assert abs(unmirrored.f[0, 1] + a.f[0, 1]) > 1.0  # the asymmetry is there


def test_steady_state_is_the_slip_of_the_motion() -> None:
    """kappa = (omega r_e - Vx)/|Vx| and tan alpha = -Vy/|Vx|, to the bound's (slip/5)^2/2, forwards and in reverse."""
    element = tire()
    for v in (20.0, -20.0):
        free = settled(element, wheel(velocity=(v, 0, 0), spin=v / 0.31))
        r_e = v * (1.0 + np.sign(v) * value(element, free, 'kappa')) / (v / 0.31)
        r = settled(element, wheel(velocity=(v, 1.0, 0), spin=1.1 * v / 0.31))
        assert value(element, r, 'kappa') == pytest.approx((1.1 * v / 0.31 * r_e - v) / abs(v), abs=1e-3)
        assert np.tan(value(element, r, 'alpha')) == pytest.approx(-0.05, rel=1e-3)
        assert value(element, r, 'fy') < -1000.0  # against the side velocity in both directions


def test_reverse_rolling_is_forward_rolling_turned_half_round() -> None:
    """A symmetric tire seen from behind: velocity and spin reversed = the same wheel yawed by pi, so the wrench in W is equal."""
    element = tire()
    reverse = settled(element, wheel(velocity=(-12.0, 0.6, 0.0), spin=-36.0, camber=0.05))
    turned = settled(element, wheel(velocity=(-12.0, 0.6, 0.0), spin=36.0, yaw=np.pi, camber=-0.05))
    com = np.array([0.02, -0.01, 0.03])
    for r, kin in ((reverse, wheel(camber=0.05)), (turned, wheel(yaw=np.pi, camber=-0.05))):
        F, T = r.f[0, :3], kin.R[0] @ r.f[0, 3:] + np.cross(kin.R[0] @ com, r.f[0, :3])
        if r is reverse:
            reference = F, T
    np.testing.assert_allclose(F, reference[0], rtol=1e-10)
    np.testing.assert_allclose(T, reference[1], rtol=1e-9, atol=1e-8)


def march(element: Element, kin: Kinematics, steps: int, z=(0.0, 0.0), h: float = H) -> list[Result]:
    """Internal states by implicit Euler along a frozen motion."""
    results = []
    for _ in range(steps):
        results.append(element.evaluate(kin, zp=z, cz=h))
        z = tuple(results[-1].z)
    return results


@pytest.mark.parametrize('direction', ['lateral', 'longitudinal'])
def test_63_percent_after_one_relaxation_length(direction: str) -> None:
    """A step of small slip at 20 m/s: 1 - 1/e after sigma of travel. Step of implicit Euler 0.1 ms = 2 mm: error 2 mm/sigma/2/e."""
    element = tire()
    side, spin = (-0.1, 20.0 / 0.3137) if direction == 'lateral' else (0.0, 1.005 * 20.0 / 0.3137)
    motion = dict(velocity=(20, side, 0), spin=spin)
    name = 'alpha' if direction == 'lateral' else 'kappa'
    final = value(element, settled(element, wheel(**motion)), name)
    Fz = value(element, settled(element, wheel(**motion)), 'fz')
    c = compile_tires([TireSpec(name='t', marker=Marker(body='b0'), data=CAR)], FLAT, ContractContext(bodies=1)).c[0]
    dfz = Fz / 4200 - 1.0
    Kx, Ky = slip_stiffness(c, 0.0, Fz, dfz)
    sigma = -Ky / (120e3 * (1 + 0.10 * dfz)) if direction == 'lateral' else Kx / (380e3 * (1 + 0.17 * dfz))
    trace = march(element, wheel(**motion), 400, h=1e-4)
    travel = 20.0 * 1e-4 * np.arange(1, 401)
    history = np.array([value(element, r, name) for r in trace]) / final
    assert np.interp(sigma, travel, history) == pytest.approx(1.0 - np.exp(-1.0), abs=0.01)
    assert c[I.IS_61] == 1.0


def drop(element: Element, *, mass: float, gravity, seconds: float, velocity=(0.0, 0.0, 0.0), height: float = 0.297, h: float = H):
    """A wheel that cannot rotate, free to translate, by linearly implicit Euler; returns positions, velocities, outputs over time."""
    x, v, z = np.array([0.0, 0.0, height]), np.array(velocity, float), (0.0, 0.0)
    trace = []
    for _ in range(int(seconds / h)):
        r = element.evaluate(wheel(position=x, velocity=v), zp=z, cz=h, tangents=True)
        K, D = r.Kq[:3, :3], r.Kv[:3, :3]
        v = v + np.linalg.solve(mass * np.eye(3) - h * D - h * h * K, h * (r.f[0, :3] + mass * np.array(gravity) + h * K @ v))
        x = x + h * v
        end = element.evaluate(wheel(position=x, velocity=v), zp=z, cz=h)
        z = tuple(end.z)
        trace.append((x.copy(), v.copy(), end))
    return trace


def slope_gravity(grade: float, heading: float = 0.0) -> tuple[float, float, float]:
    """Gravity seen from a road inclined by `grade` [rad], downhill direction at `heading` from x."""
    g = 9.81
    return (g * np.sin(grade) * np.cos(heading), g * np.sin(grade) * np.sin(heading), -g * np.cos(grade))


def test_a_braked_wheel_on_a_slope_stands_without_creeping() -> None:
    """11.3 degrees, downhill obliquely: after 6 s the velocity is rounding error (a viscous tire model would creep by mm/s).

    The large vertical damping stands for the suspension, so that the bounce has died away."""
    element = tire(damping=6000.0)
    gravity = slope_gravity(0.2, 0.6)
    trace = drop(element, mass=400.0, gravity=gravity, seconds=6.0)
    x, v, r = trace[-1]
    assert np.abs(v).max() < 1e-9
    assert np.linalg.norm(x - trace[-1000][0]) < 1e-9
    np.testing.assert_allclose(r.f[0, :3], -400.0 * np.array(gravity), rtol=1e-8)
    assert np.linalg.norm(x[:2]) < 0.03  # it sagged by the contact deflection


def test_on_a_slope_steeper_than_friction_the_wheel_slides_with_bounded_force() -> None:
    element = tire(road=RoadSpec(friction=0.2))
    trace = drop(element, mass=400.0, gravity=slope_gravity(0.35), seconds=1.5)
    fx = np.array([value(element, r, 'fx') for _, _, r in trace])
    fz = np.array([value(element, r, 'fz') for _, _, r in trace])
    assert trace[-1][1][0] > 1.0
    assert (np.abs(fx) < 0.2 * 1.2 * fz + 1.0).all()
    assert fx[-1] < -0.5 * 0.2 * fz[-1]


def test_a_locked_wheel_slides_to_rest_and_recoils_little() -> None:
    """From 3 m/s: it stops, swings back by no more than the energy of the contact spring allows (0.5 m/s), and ends at rest."""
    element = tire()
    trace = drop(element, mass=400.0, gravity=(0, 0, -9.81), seconds=3.0, velocity=(3.0, 0.0, 0.0))
    v = np.array([v[0] for _, v, _ in trace])
    assert v.min() > -0.5
    assert abs(v[-1]) < 1e-6
    first = int(np.argmax(v < 0.0))
    assert 0.25 < first * H < 0.45  # 3 m/s over 0.8 to 1.1 g
    kappa = np.array([value(element, r, 'kappa') for _, _, r in trace])
    assert np.abs(kappa).max() < 1.0


def test_wheel_spin_at_standstill_has_bounded_slip_and_force() -> None:
    element = tire()
    trace = march(element, wheel(spin=200.0), 2000)
    kappa = np.array([value(element, r, 'kappa') for r in trace])
    fx, fz = (np.array([value(element, r, k) for r in trace]) for k in ('fx', 'fz'))
    assert 0.0 < kappa[-1] < 0.5
    assert (fx < 1.2 * fz).all()
    assert fx[-1] > 0.8 * fz[-1]


def test_deflections_vanish_in_the_air() -> None:
    """After 0.5 s at 20/s nothing is left: factor (1 + 0.02)^-500 = 5e-5; faster when the wheel turns."""
    element = tire()
    trace = march(element, wheel(position=(0, 0, 1.0)), 500, z=(0.02, -0.03))
    assert not np.any(trace[0].f)
    np.testing.assert_allclose(trace[-1].z, np.array([0.02, -0.03]) * 1.02**-500, rtol=1e-9)


@pytest.mark.parametrize('camber', [np.pi / 2, 1.5, -1.5, np.pi, 3.0, -np.pi / 2])
@pytest.mark.parametrize('height', [-0.1, 0.0, 0.05, 0.3, 2.0])
def test_a_wheel_that_lies_or_hangs_upside_down_gives_finite_numbers(camber: float, height: float) -> None:
    """Lying flat it has no friction; upside down it rolls like any wheel (its axis points the other way); never a NaN."""
    element = tire(road=HILLY)
    kin = wheel(position=(0.1, 0.2, height), velocity=(3, 1, -1), spin=20.0, camber=camber, rates=(1, 0, 2))
    r = element.evaluate(kin, zp=(0.01, 0.02), cz=1e-3, tangents=True)
    for a in r:
        assert np.isfinite(a).all()
    if 1.4 < abs(camber) < 1.7:
        assert [value(element, r, k) for k in ('fx', 'fy', 'mx', 'my', 'mz')] == [0.0] * 5
    assert value(element, r, 'fz') >= 0.0


def test_a_wheel_that_lies_flat_stands_on_its_sidewall() -> None:
    """It touches at half its width, 0.1025 m; at 0.09 m the deflection is R0 (1 - 0.09/0.1025), and the load is 1/flat of the spring."""
    element = tire()
    above = element.evaluate(wheel(position=(0, 0, 0.1031), camber=np.pi / 2), zp=(0, 0))
    assert not np.any(above.f)
    pressed = element.evaluate(wheel(position=(0, 0, 0.09), camber=np.pi / 2), zp=(0, 0))
    rho = 0.316 * (1.0 - 0.09 / 0.1025)
    assert value(element, pressed, 'deflection') == pytest.approx(rho, rel=1e-9)
    assert value(element, pressed, 'fz') == pytest.approx(load_at(element, 0.316 - rho) * 0.316 / 0.1025, rel=1e-9)


def test_the_load_of_a_leaning_wheel_has_a_potential() -> None:
    """From upright to flat, without damper: what sinking and leaning take from the motion is stored, but for the work of the side force."""
    data = TireData(name='elastic', version=61, values={**CAR.values, 'QSX2': 0.0, 'QSX3': 0.0, 'Q_V1': 0.0, 'Q_V2': 0.0}, side='symmetric')
    element = tire(data, RoadSpec(friction=1e-3), damping=0.0)
    for camber in (0.0, 0.4, 0.8, 1.0, 1.2, 1.4, np.pi / 2, 2.0, -1.0):
        height = 0.27 * max(abs(np.cos(camber)), 0.3)
        for motion in (dict(velocity=(0, 0, 0.3)), dict(rates=(1.0, 0, 0))):
            r = element.evaluate(wheel(position=(0, 0, height), camber=camber, **motion), zp=(0, 0))
            fz = value(element, r, 'fz')
            assert fz > 3000.0
            side_velocity = height * np.sign(np.cos(camber)) if 'rates' in motion else 0.0  # of the contact point, along y of the frame
            loss = -value(element, r, 'fy') * side_velocity
            assert value(element, r, 'dissipation') == pytest.approx(loss, rel=1e-9, abs=1e-9 * fz)


def test_the_load_never_leaves_the_contact_patch() -> None:
    """110 kN on one wheel, sliding: the overturning moment is at most half the width times the load; in normal driving nothing is cut."""
    element = tire()
    for side in (-8.0, 8.0):
        r = element.evaluate(wheel(position=(0, 0, 0.17), velocity=(20.0, side, -1.0), spin=60.0, camber=0.3), zp=(0, 0), cz=1e6)
        fz, mx = value(element, r, 'fz'), value(element, r, 'mx')
        assert fz > 1e5
        assert abs(mx) <= 0.1025 * fz * (1 + 1e-12)
    assert abs(mx) > 0.09 * fz  # it is reached
    free = element.evaluate(wheel(velocity=(20.0, -1.0, 0.0), spin=60.0), zp=(0, 0), cz=1e6)
    fy, fz = value(element, free, 'fy'), value(element, free, 'fz')
    assert value(element, free, 'mx') == pytest.approx(0.316 * fz * 0.03 * fy / 4200.0, rel=1e-12)


def test_friction_of_the_road_limits_the_force() -> None:
    """Ice patch with factor 0.1 under a locked wheel: a tenth of the force next to it, or a little less: the same slip is further
    beyond the peak, which has moved to a tenth of the slip."""
    road = RoadSpec(patches=(FrictionPatch(center=(10, 0), size=(4, 4), factor=0.1),))
    element = tire(road=road)
    dry, ice = (settled(element, wheel(position=(x, 0, 0.3), velocity=(20, 0, 0))) for x in (0.0, 10.0))
    assert 0.08 < value(element, ice, 'fx') / value(element, dry, 'fx') < 0.1
    assert value(element, ice, 'friction') == pytest.approx(0.1)


def test_growth_and_stiffening_with_speed_of_rotation() -> None:
    """At 60 rad/s: radius + R0 QV1 (omega R0/V0)^2, stiffness times 1 + QV2 omega R0/V0."""
    element = tire()
    turn = 60.0 * 0.316 / 16.7
    r = element.evaluate(wheel(position=(0, 0, 0.3), spin=60.0), zp=(0, 0))
    rho = 0.016 + 0.316 * 7e-4 * turn**2
    assert value(element, r, 'deflection') == pytest.approx(rho, rel=1e-12)
    q1, x = np.sqrt((215e3 * 0.316 / 4200) ** 2 - 60.0), rho / 0.316
    assert value(element, r, 'fz') == pytest.approx((1 + 0.045 * turn) * 4200 * (q1 * x + 15 * x * x), rel=1e-6)


def test_pressure_stiffens_the_tire() -> None:
    """20 % more pressure: PFZ1 * 0.2 = 14 % more load at the same deflection."""
    soft, hard = tire(), tire(pressure=1.2 * 230e3)
    load = [value(e, e.evaluate(wheel(), zp=(0, 0)), 'fz') for e in (soft, hard)]
    assert load[1] / load[0] == pytest.approx(1.14, rel=1e-12)


def test_height_under_the_wheel_is_the_road() -> None:
    """A wheel held 0.3 m above the road everywhere on a gentle grid has nearly the same deflection everywhere."""
    element = tire(road=HILLY)
    table = compile_tires([], HILLY, ContractContext(bodies=1)).road
    for x, y in ((0.0, 0.0), (0.7, -0.3), (-0.6, 0.9)):
        h, n, _ = road_at(table, x, y)
        r = element.evaluate(wheel(position=(x, y, h + 0.3)), zp=(0, 0))
        assert value(element, r, 'deflection') == pytest.approx(0.316 - 0.3 * n[2] / np.sqrt(1 - n[1] ** 2), abs=1e-12)


def test_refusals_name_tire_field_and_limit() -> None:
    with pytest.raises(SpecError, match="Tire 'front': low_speed"):
        TireSpec(name='front', marker=Marker(body='b0'), data=CAR, low_speed=0.0)
    with pytest.raises(SpecError, match='no NOMPRES'):
        TireSpec(name='front', marker=Marker(body='b0'), data=SEDAN, pressure=2e5)
    with pytest.raises(SpecError, match=r'PKX9.*did you mean'):
        TireData(name='x', version=61, values={**CAR.values, 'PKX9': 1.0})
    with pytest.raises(SpecError, match='version'):
        TireData(name='x', version=62, values=CAR.values)  # type: ignore[arg-type]
