"""The full car: what it consists of, its equilibrium, and figures that lie where passenger cars lie."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from saloon import full_car, without_bushings

from solver.analysis.figures import figures
from solver.analysis.kinematics_and_compliance import Rig
from solver.analysis.modes import eigenvalues, linearised, modes
from solver.analysis.typical_values import SALOON, typical_values
from solver.compiled.by_reference import Ref
from solver.elements.laws import Law, compile_laws, evaluate_law
from solver.elements.rigid_body import RigidBodySpec
from solver.elements.tire_pacejka import TIRE_COLUMNS
from solver.errors import SpecError
from solver.files.scene import load_scene
from solver.model.evaluate import prepare
from solver.model.frames import matrix
from solver.output.dependence import dense_jacobian
from solver.scene import Scene, StartSettings
from solver.simulation import Simulation
from solver.start.equilibrium import Equilibrium
from solver.start.newton import ConsistentState
from solver.vehicle.full_car import full_car_model
from solver.vehicle.parts import Bushing, mounting, rods

WEIGHT = 1576.0 * 9.81
PAGE = Path(__file__).resolve().parents[2] / 'docs' / 'cars.md'


@pytest.fixture(scope='module')
def standing() -> Simulation:
    return Simulation(
        load_scene('car_swept_steer', ['start={kind: equilibrium}', 'maneuver=maneuvers/straight_ahead.yaml'])
    )


@pytest.fixture(scope='module')
def found(standing: Simulation) -> dict[str, float]:
    return figures(standing)


def test_counts_are_those_of_the_reference_car(standing: Simulation) -> None:
    counts = standing.describe()
    assert counts['bodies'] == 53
    assert counts['joints'] == 49
    assert counts['bushings'] == 29
    assert counts['spring_dampers'] == 9
    assert counts['force_elements'] == 9
    assert counts['dof'] == 134
    assert counts['redundant_rows'] == []
    # the rank: 183 rows of joints and the imposed angle of the steering wheel
    assert counts['constraint_rows'] == 184
    assert counts['couplers'] == 1


def test_design_position_closes_every_joint_and_is_symmetric() -> None:
    model = prepare(full_car_model(full_car()))
    start = ConsistentState(model)
    state = Simulation(Scene(name='s', model=model.spec)).state
    start._constraints(state.q, state.v, state.angle, np.zeros(len(model.spec.inputs)))
    assert np.abs(start.phi).max() < 1e-14
    bodies = {b.name: b for b in model.spec.bodies}
    for name, left in bodies.items():
        if name.endswith('_left'):
            right = bodies[name.removesuffix('left') + 'right']
            assert right.position == pytest.approx(np.array(left.position) * (1, -1, 1), abs=1e-15)
            assert right.inertia == pytest.approx(np.array(left.inertia) * (1, 1, 1, -1, 1, -1), abs=1e-15)


def test_ideal_joints_leave_sixteen_degrees_of_freedom() -> None:
    """Chassis 6, wheel travels 4, wheel spins 4, rack against its elastic pinion 1, propeller shaft against its elastic
    gear 1."""
    simulation = Simulation(Scene(name='ideal', model=full_car_model(without_bushings(full_car()))))
    counts = simulation.describe()
    assert counts['bushings'] == 0
    assert counts['redundant_rows'] == []
    assert counts['dof'] == 16


def test_standing_car_is_in_equilibrium(standing: Simulation) -> None:
    """With its wheels held: forces, constraint forces and weight balance on every body to 1e-6 N or N m."""
    start = Equilibrium(standing.model)
    u = np.zeros(len(standing.model.spec.inputs))
    assert start.equilibrium(standing.state, u, hold=standing.channels.chassis) < 1e-6
    assert np.abs(start.phi).max() < 1e-12
    standing.reset()


def test_tires_carry_the_weight_and_the_car_stands_at_its_design_height(standing: Simulation) -> None:
    snapshot = standing.snapshot()
    fz = snapshot.tire[:, TIRE_COLUMNS.index('fz')]
    # in the state of the released brakes the vertical forces balance to the tolerance of the search
    assert fz.sum() == pytest.approx(WEIGHT, rel=1e-4)
    assert abs(snapshot.pose[0, 2]) < 0.004
    assert fz[0] == pytest.approx(fz[1], rel=0.01)


@pytest.mark.slow
def test_every_mode_is_stable(standing: Simulation) -> None:
    """At rest, brakes released: nothing grows, and what does not oscillate fast is damped; a link spinning freely would
    be undamped."""
    s, _ = eigenvalues(linearised(standing.model, standing.state, np.zeros(len(standing.model.spec.inputs))))
    assert len(s) == 2 * 134
    # one unstable root may come from the propeller shaft's weight off its line of bearings: its growth must take longer
    # than 1000 s
    assert s.real.max() < 1e-3
    assert all(mode.damping > 0.03 for mode in modes(standing) if mode.frequency > 0.5)


@pytest.mark.slow
@pytest.mark.parametrize('name', SALOON)
def test_figure_lies_where_passenger_cars_lie(standing: Simulation, found: dict[str, float], name: str) -> None:
    where = typical_values(standing.model.spec)[name]
    assert where.low <= found[name] <= where.high


@pytest.mark.slow
def test_the_page_of_cars_shows_these_figures(standing: Simulation, found: dict[str, float]) -> None:
    """To the four digits that are shown."""
    section = PAGE.read_text(encoding='utf-8').partition('## full_car')[2].partition('\n## ')[0]
    shown = dict(
        [cell.strip() for cell in line.split('|')[1:3]] for line in section.splitlines() if line.count('|') == 4
    )
    for name, where in typical_values(standing.model.spec).items():
        assert float(shown[where.text].partition(' ')[0]) == pytest.approx(found[name] * where.factor, rel=2e-3), name


def test_accelerations_balance_the_forces_of_every_body() -> None:
    """M a = f + A^T lam to the rounding of its largest terms, also about the axes of light shafts that no constraint
    holds."""
    s = Simulation(load_scene('car_swept_steer', ['start.speed_kmh=0']))
    start = ConsistentState(s.model)
    s.state.v[:-1, 3:] = 1e-3  # nothing may be still
    a, lam = start.acceleration(s.state.q, s.state.v, s.state.z, s.state.angle, s.inputs)
    bodies, A = s.model.tables.bodies, dense_jacobian(s.model, start.J)
    inertial = np.hstack([bodies.mass[:, None] * a[:-1, :3], np.einsum('bij,bj->bi', bodies.inertia, a[:-1, 3:])])
    left = inertial - start.f[:-1] - (A.T @ lam).reshape(-1, 6)
    assert np.abs(left).max() < 1e-14 * np.abs(lam).max()


def test_travel_curves_of_left_and_right_agree(standing: Simulation) -> None:
    curves = Rig(standing.model.spec).travel([-0.05, 0.0, 0.05])
    for axle in ('front', 'rear'):
        left, right = curves[f'{axle}_left'], curves[f'{axle}_right']
        # the steering column on one side is the only asymmetry: it turns with the subframe on its mounts
        assert left['camber'] == pytest.approx(right['camber'], abs=1e-4)
        assert left['toe'] == pytest.approx(right['toe'], abs=2e-4)
        assert left['load'] == pytest.approx(right['load'], rel=1e-3)
        assert np.all(np.diff(left['load']) > 0.0)
        assert np.all(np.diff(left['camber']) < 0.0)


def test_combined_mounts_act_like_the_single_ones() -> None:
    """Force and moment of two bushings under a small displacement and rotation equal those of the combined element."""
    i = RigidBodySpec(name='i', mass=1.0, inertia=(1, 1, 1, 0, 0, 0))
    j = RigidBodySpec(name='j', mass=1.0, inertia=(1, 1, 1, 0, 0, 0))
    one = Bushing(stiffness=(2e6, 3e6, 5e5, 100.0, 120.0, 40.0), axis=(1.0, 0.0, 0.0))
    points = ((0.15, 0.3, 0.2), (-0.05, 0.3, 0.2))
    combined = mounting('m', i, j, points, one, ideal='fixed').bushings[0]
    single = [mounting('m', i, j, (p,), one, ideal='fixed').bushings[0] for p in points]
    move, turn = np.array([1e-3, -2e-3, 3e-3]), np.array([0.011, -0.007, 0.02])

    def wrench(bushings) -> np.ndarray:
        total = np.zeros(6)
        for b in bushings:
            F, at = matrix(b.i.orientation), np.array(b.i.position)
            force = F @ (b.stiffness[:3] * (F.T @ (move + np.cross(turn, at))))
            total += np.concatenate([force, F @ (b.stiffness[3:] * (F.T @ turn)) + np.cross(at, force)])
        return total

    assert wrench([combined]) == pytest.approx(wrench(single), rel=1e-12)


@pytest.mark.parametrize('axis', [(0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (0.6, 0.8, 0.0), (1.0, 0.0, 0.0)])
@pytest.mark.parametrize('field', ['law_x', 'law_y', 'law_z'])
def test_a_bushing_at_the_right_is_the_mirror_image_of_that_at_the_left(axis, field) -> None:
    """A law that is five times as hard one way as the other, along every axis of the car: mirrored displacements,
    mirrored forces."""
    i = RigidBodySpec(name='i', mass=1.0, inertia=(1, 1, 1, 0, 0, 0))
    j, law = i.replace(name='j'), Law.table([[-0.01, -20000.0], [0.0, 0.0], [0.006, 1500.0], [0.01, 4000.0]])
    data = Bushing(stiffness=(1e6, 1e6, 1e6, 1.0, 1.0, 1.0), axis=axis, **{field: law})
    mirrored = np.array([1.0, -1.0, 1.0])

    def force(side: str, move: np.ndarray) -> np.ndarray:
        spec = mounting(side, i, j, ((0.0, 0.5, 0.3),), data, ideal='spherical', side=side).bushings[0]
        F = matrix(spec.i.orientation)
        laws = [Law.linear(k) if law is None else law for k, law in zip(spec.stiffness, spec.laws[:3], strict=False)]
        table = Ref(compile_laws(laws))
        return F @ [evaluate_law(table, k, x)[0] for k, x in enumerate((F.T @ move).tolist())]

    for move in 0.005 * np.concatenate([np.eye(3), -np.eye(3), [[0.7, -1.1, 1.6]]]):
        np.testing.assert_allclose(
            force('right', mirrored * move), mirrored * force('left', move), rtol=1e-12, atol=1e-9
        )


def test_a_symmetric_law_is_the_same_at_both_sides_to_the_bit() -> None:
    i = RigidBodySpec(name='i', mass=1.0, inertia=(1, 1, 1, 0, 0, 0))
    points = [
        [-0.012, -30000.0],
        [-0.008, -12800.0],
        [-0.004, -4800.0],
        [0.0, 0.0],
        [0.004, 4800.0],
        [0.008, 12800.0],
        [0.012, 30000.0],
    ]
    law = Law.table(points)
    data = Bushing(stiffness=(1e6, 1e6, 1e6, 1.0, 1.0, 1.0), law_x=law, law_y=law, law_z=law)
    for axis in ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0)):
        there = dataclasses.replace(data, axis=axis)
        (spec,) = mounting(
            'm', i, i.replace(name='j'), ((0.0, 0.5, 0.3),), there, ideal='spherical', side='right'
        ).bushings
        assert repr(spec.laws[:3]) == repr((law, law, law))


def test_mounts_that_couple_rotations_are_refused() -> None:
    i = RigidBodySpec(name='i', mass=1.0, inertia=(1, 1, 1, 0, 0, 0))
    with pytest.raises(SpecError, match=r"mounting 'm': points = .* couple two rotations"):
        mounting(
            'm',
            i,
            i.replace(name='j'),
            ((0, 0, 0), (1.0, 1.0, 0)),
            Bushing(stiffness=(1e6,) * 3 + (10.0,) * 3, axis=(0, 0, 1)),
            ideal='fixed',
        )


def test_rods_have_the_inertia_of_their_parallel_axes() -> None:
    """Two equal halves of a slender bar have the inertia of the whole bar."""
    whole = rods('w', [(2.0, (0, 0, 0), (0, 0.8, 0), 1e-6)])
    halves = rods('h', [(1.0, (0, 0, 0), (0, 0.4, 0), 1e-6), (1.0, (0, 0.4, 0), (0, 0.8, 0), 1e-6)])
    assert halves.inertia == pytest.approx(whole.inertia, abs=1e-12)
    assert whole.inertia[0] == pytest.approx(2.0 * 0.8**2 / 12.0)
    assert halves.position == pytest.approx((0, 0.4, 0))


def test_brake_shares_must_add_up() -> None:
    car = full_car()
    with pytest.raises(SpecError, match='shares of the four wheels'):
        dataclasses.replace(
            car, front=dataclasses.replace(car.front, brake=dataclasses.replace(car.front.brake, share=0.4))
        )


def test_rolling_start_is_smooth() -> None:
    """At speed nothing but the steady deceleration is left: shafts turn with their wheels and nothing else moves."""
    simulation = Simulation(
        Scene(name='roll', model=full_car_model(full_car()), start=StartSettings(kind='equilibrium', speed=20.0))
    )
    v = simulation.state.v
    names = simulation.model.body_names
    rate = v[names.index('wheel_rear_left'), 4]
    assert v[names.index('propshaft_front'), 3] == pytest.approx(3.2 * rate, rel=2e-3)
    assert np.abs(v[names.index('upright_rear_left'), 3:]).max() < 0.01
    assert np.abs(simulation.state.a[names.index('chassis'), :3]).max() < 0.3
