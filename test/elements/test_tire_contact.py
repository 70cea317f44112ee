"""The tire element: the contract of force elements, contact frame, signs by hand, and what it does when it should do
nothing."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from contract import ContractContext, Element, check_contract, check_tangents, forcing, kinematics
from scipy.spatial.transform import Rotation
from tire_bench import CAR, EXAMPLE, FLAT, HILLY, SEDAN, settled, tire, value, wheel

from solver.elements.marker import Marker
from solver.elements.road import FrictionPatch, RoadSpec, road_at
from solver.elements.tire_pacejka import OUTPUTS, TireData, TireSpec, compile_tires, tire_forces
from solver.errors import SpecError

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
    'lying flat': (
        dict(position=(0.0, 0.0, 0.06), velocity=(5.0, 0.3, -0.1), spin=20.0, camber=1.5, rates=(0.5, 0.0, 0.2)),
        (0.01, -0.02),
    ),
    'strongly cambered': (
        dict(position=(0.0, 0.0, 0.13), velocity=(5.0, 0.0, -0.1), spin=20.0, camber=1.12),
        (0.01, -0.02),
    ),
}


@pytest.mark.parametrize('road', [FLAT, HILLY], ids=['flat', 'hilly'])
@pytest.mark.parametrize('state', STATES)
@pytest.mark.parametrize('cz', [0.0, 5e-4])
def test_contract_of_force_elements(state: str, road: RoadSpec, cz: float) -> None:
    """In every regime: purity, states with their own rate, exact tangents (complex step through the whole kernel),
    power.

    With cz = 0 the states are given and have no rate, so there is no power of theirs to balance.
    """
    motion, zp = STATES[state]
    element = tire(road=road)
    kin = wheel(**motion)
    check_contract(element, kin, pair=False, power=cz > 0.0, tolerance=1e-10, zp=element.states(zp), cz=cz)


@pytest.mark.parametrize('data', [EXAMPLE, SEDAN], ids=['6.1 with pressure', '5.2'])
def test_tangents_with_other_tires(data: TireData) -> None:
    motion, zp = STATES['braking, steered, cambered']
    kwargs = dict(pressure=220e3) if data is EXAMPLE else {}
    check_tangents(tire(data, HILLY, mirrored=True, **kwargs), wheel(**motion), zp=zp, cz=5e-4)


def test_signs_of_slip_camber_and_forces() -> None:
    """Left hand side of docs/conventions.md: drive, side slip to the right, camber to the right, and the moments they
    cause."""
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
    """Force at the contact point below the wheel centre: torque about the centre of mass = M + (point - com) x F, in
    body axes."""
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
    assert np.cross(C[:, 0], kin.R[0][:, 1]) @ (point - [0, 0, 0.3]) == pytest.approx(
        -(0.316 - value(element, r, 'deflection')), rel=1e-12
    )


def test_mirrored_tire_in_mirrored_motion_gives_the_mirrored_force() -> None:
    """y -> -y of everything (axial vectors the other way): equal to the last bits, with a tire that has every
    asymmetry."""
    left = tire(EXAMPLE)
    com = np.array([0.02, -0.01, 0.03])
    R = Rotation.from_euler('ZXY', [0.1, 0.06, 0.0])
    R_m = Rotation.from_euler('ZXY', [-0.1, -0.06, 0.0])
    v, w = np.array([15.0, 0.8, -0.1]), np.array([0.2, 47.0, 0.3])
    mirror, axial = np.array([1.0, -1.0, 1.0]), np.array([-1.0, 1.0, -1.0])
    context = ContractContext(bodies=1, com=[com * mirror])
    table = compile_tires(
        [TireSpec(name='tire', marker=Marker(body='b0'), data=EXAMPLE, mirrored=True, turn_slip=False)], context
    )
    right = Element(forcing(tire_forces, table, context.laws()), context, n=1, outputs=OUTPUTS)
    p = np.array([0.0, 0.0, 0.3]) + R.as_matrix() @ com
    a = left.evaluate(kinematics([(p, R.as_matrix())], [(*v, *w)]), zp=(0.01, 0.02))
    b = right.evaluate(
        kinematics([(p * mirror, R_m.as_matrix())], [(*(v * mirror), *(w * axial))]), zp=(0.01, -0.02, 0.0)
    )
    np.testing.assert_allclose(b.f[0], a.f[0] * [*mirror, *axial], rtol=1e-12)
    unmirrored = tire(EXAMPLE).evaluate(
        kinematics([(p * mirror, R_m.as_matrix())], [(*(v * mirror), *(w * axial))]), zp=(0.01, -0.02)
    )
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
    """A symmetric tire seen from behind: velocity and spin reversed = the same wheel yawed by pi, so the wrench in W is
    equal."""
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


def test_rolling_resistance_due_to_the_longitudinal_force_turns_round_with_the_wheel() -> None:
    """QSY2 counts the force in the direction of rolling: braked in reverse = braked forward and seen from behind, (Fx,
    My) -> -(Fx, My)."""
    shifts = {k: 0.0 for k in CAR.values if k.startswith(('PHX', 'PVX', 'PEX4'))}
    plain, more = (tire(dataclasses.replace(CAR, values={**CAR.values, **shifts, 'QSY2': q})) for q in (0.0, 0.04))
    changes = {}
    for sign in (1.0, -1.0):
        kin = wheel(velocity=(12.0 * sign, 0.0, 0.0), spin=11.4 * sign / 0.3075)
        without, with_it = settled(plain, kin), settled(more, kin)
        fx = value(more, with_it, 'fx')
        assert sign * fx < -1000.0
        changes[sign] = value(more, with_it, 'my') - value(plain, without, 'my')
        load = value(more, with_it, 'fz') / 4200.0
        assert changes[sign] == pytest.approx(-0.04 * fx * 0.316 * load**0.9, rel=1e-6)  # positive: it drives
    assert changes[1.0] == pytest.approx(-changes[-1.0], rel=1e-6)


@pytest.mark.parametrize('camber', [np.pi / 2, 1.5, -1.5, np.pi, 3.0, -np.pi / 2])
@pytest.mark.parametrize('height', [-0.1, 0.0, 0.05, 0.3, 2.0])
def test_a_wheel_that_lies_or_hangs_upside_down_gives_finite_numbers(camber: float, height: float) -> None:
    """Lying flat it has no friction; upside down it rolls like any wheel (its axis points the other way); never a
    NaN."""
    element = tire(road=HILLY)
    kin = wheel(position=(0.1, 0.2, height), velocity=(3, 1, -1), spin=20.0, camber=camber, rates=(1, 0, 2))
    r = element.evaluate(kin, zp=(0.01, 0.02), cz=1e-3, tangents=True)
    for a in r:
        assert np.isfinite(a).all()
    if 1.4 < abs(camber) < 1.7:
        assert [value(element, r, k) for k in ('fx', 'fy', 'mx', 'my', 'mz')] == [0.0] * 5
    assert value(element, r, 'fz') >= 0.0


def test_friction_of_the_road_limits_the_force() -> None:
    """Ice patch with factor 0.1 under a locked wheel: a tenth of the force next to it, or a little less: the same slip
    is further beyond the peak, which has moved to a tenth of the slip."""
    road = RoadSpec(patches=(FrictionPatch(center=(10, 0), size=(4, 4), factor=0.1),))
    element = tire(road=road)
    dry, ice = (settled(element, wheel(position=(x, 0, 0.3), velocity=(20, 0, 0))) for x in (0.0, 10.0))
    assert 0.08 < value(element, ice, 'fx') / value(element, dry, 'fx') < 0.1
    assert value(element, ice, 'friction') == pytest.approx(0.1)


def test_height_under_the_wheel_is_the_road() -> None:
    """A wheel held 0.3 m above the road everywhere on a gentle grid has nearly the same deflection everywhere."""
    element = tire(road=HILLY)
    table = compile_tires([], ContractContext(bodies=1, road=HILLY)).road
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
