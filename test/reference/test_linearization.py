"""Linear models about any state: closed forms of moving bodies, the modes of the analysis, other differences."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.signal

import solver
from solver.analysis.modes import eigenvalues, linearised, modes
from solver.errors import SpecError
from solver.reference.linearization import _Chart, linear_model

G = 9.81


def of_text(text: str, *overrides: str) -> solver.Simulation:
    return solver.simulation_of(solver.load_scene_text(text, 'test', overrides))


def test_a_mass_on_a_spring_has_its_frequency_and_answer() -> None:
    """1 kg, 100 N/m, 2 N s/m at its static deflection: 10 rad/s, damping ratio 0.1; C holds the place of its guide."""
    scene = solver.load_scene_text('mechanism: mechanisms/spring_mass.yaml\nduration: 1\nstart: {kind: equilibrium}\n')
    found = linear_model(solver.simulation_of(scene))
    assert (found.positions, found.rates, found.is_moving) == (1, 1, False)
    root = complex(-1.0, 10.0 * math.sqrt(1.0 - 0.01))
    assert sorted(np.linalg.eigvals(found.A), key=lambda s: s.imag) == pytest.approx([root.conjugate(), root], rel=1e-8)
    # the guide's coordinate is the place of the mass, its acceleration the third one of the chassis
    assert abs(found.C[found.outputs.index('guide'), 0]) == pytest.approx(abs(found.Z[2, 0]), rel=1e-9)


@pytest.mark.parametrize('steps', [0, 137, 400])
def test_a_pendulum_in_motion_has_the_stiffness_of_its_angle(steps: int) -> None:
    """I theta'' = -m g l sin(theta). The chart is flat where the bob moves on a circle: with c = m l^2 / I its
    coordinate is c sin(d) + (1 - c) d of an angle d from the state, so that -(m g l / I) cos(theta) - c theta'^2 is
    what a place adds to its own acceleration, and A^2 that times the identity."""
    simulation = of_text(
        'mechanism:\n  bodies: {bob: {mass: 2, inertia: [0.1, 0.1, 0.1], com: [0, 0, -1]}}\n'
        '  joints: {pivot: {kind: revolute, i: world, j: bob, at: [0, 0, 0], axis: [0, 1, 0]}}\n'
        'start: {coordinates: {pivot: {value: 0.7, rate: 3.0}}}\nduration: 1\n'
    )
    simulation.advance(steps)
    theta, rate = simulation.snapshot().joint_position[0], simulation.snapshot().joint_velocity[0]
    found = linear_model(simulation)
    stiffness = 2.0 * G * 1.0 / (0.1 + 2.0) * math.cos(theta) + 2.0 / 2.1 * rate**2
    assert pytest.approx(-stiffness * np.eye(2), abs=1e-7 * G) == found.A @ found.A
    assert found.is_moving and found.outputs[0] == 'pivot'


def test_a_spinning_body_has_its_nutation() -> None:
    """Free, principal moments 1, 2, 3 kg m^2, spinning about the third with 5 rad/s: the rates nutate with
    5 sqrt((3 - 1) (3 - 2) / (1 2)) rad/s [Euler]; in a chart that stands still, rotation vectors turn with half the
    spin."""
    simulation = of_text(
        'mechanism:\n  gravity: [0, 0, 0]\n'
        '  bodies: {top: {mass: 1, inertia: [1, 2, 3], angular_velocity: [0, 0, 5]}}\nduration: 1\n'
    )
    found = linear_model(simulation)
    assert (found.positions, found.rates) == (6, 6)
    imaginary = np.sort(np.linalg.eigvals(found.A).imag)
    assert imaginary[[0, 1, -2, -1]] == pytest.approx([-5.0, -2.5, 2.5, 5.0], rel=1e-7)
    assert np.abs(imaginary[2:-2]).max() < 1e-3  # rounding of defective zeros, to their root


def test_modes_are_those_of_the_analysis() -> None:
    """A planar double pendulum with springs and dampers in its hinges, in equilibrium: M, C, K and A of
    solver.analysis.modes, by analytic tangents, have the same eigenvalues."""
    simulation = of_text(
        'mechanism:\n  bodies:\n'
        '    one: {mass: 2, inertia: [0.2, 0.1, 0.15], position: [0.5, 0, 0]}\n'
        '    two: {mass: 1, inertia: [0.1, 0.3, 0.2], position: [1.4, 0, 0]}\n'
        '  joints:\n'
        '    a: {kind: revolute, i: world, j: one, at: [0, 0, 0], axis: [0, 1, 0]}\n'
        '    b: {kind: spherical, i: one, j: two, at: [1, 0, 0]}\n'
        '  bushings:\n'
        '    held: {i: {body: world, position: [1.5, 0.2, 0.1]}, j: {body: two, position: [0.1, 0.2, 0.1]},\n'
        '           stiffness: [900, 700, 800, 30, 20, 10], damping: [9, 7, 8, 0.3, 0.2, 0.1]}\n'
        'start: {kind: equilibrium}\nduration: 1\n'
    )
    found = linear_model(simulation)
    theirs, _ = eigenvalues(linearised(simulation.model, simulation.state, np.zeros(0)))

    def ordered(some: np.ndarray) -> np.ndarray:
        return np.array(sorted(some, key=lambda s: (round(abs(s), 5), s.imag)))

    assert not found.is_moving and found.A.shape == (2 * found.rates, 2 * found.rates)
    np.testing.assert_allclose(ordered(np.linalg.eigvals(found.A)), ordered(theirs), rtol=1e-6)


def test_inputs_and_outputs_are_those_of_a_force() -> None:
    """A force on 2 kg: D of its acceleration is 1/2, the transfer function to its place 1/(2 s^2)."""
    simulation = of_text(
        'mechanism:\n  gravity: [0, 0, 0]\n  inputs: [push]\n'
        '  bodies: {cart: {mass: 2, inertia: [1, 1, 1]}}\n'
        '  joints: {rail: {kind: prismatic, i: world, j: cart, at: [0, 0, 0], axis: [1, 0, 0]}}\n'
        '  applied_forces: {push: {marker: cart, force: [1, 0, 0], input: push}}\nduration: 1\n'
    )
    found = linear_model(simulation, np.array([3.0]))
    assert found.inputs == ('push',) and found.D[found.outputs.index('chassis/ax'), 0] == pytest.approx(0.5, rel=1e-9)
    assert found.is_moving and found.y[found.outputs.index('chassis/ax')] == pytest.approx(1.5)
    row = found.outputs.index('rail')
    top, bottom = scipy.signal.ss2tf(found.A, found.B, found.C[[row]], found.D[[row]])
    assert top[0] == pytest.approx([0.0, 0.0, 0.5], abs=1e-7) and bottom == pytest.approx([1.0, 0.0, 0.0], abs=1e-7)


@pytest.mark.slow
def test_a_car_that_drives_is_differentiated_alike_by_other_steps() -> None:
    """The light car at 20 m/s with its steering wheel turned: a direction of state and inputs together, by a
    difference of second order with steps of another size, agrees to 1e-6 of the largest entry; what an input of the
    steering wheel does appears in the yaw acceleration."""
    simulation = solver.simulation_of(solver.load_scene('light_car_step_steer', ['maneuver.steering.start=0.1']))
    simulation.advance(600)
    found = linear_model(simulation)
    chart = _Chart(simulation, np.array(simulation.inputs))
    n, m = found.positions, found.rates
    x0 = np.concatenate([np.zeros(n), chart.Lv @ chart.v0, chart.z0])
    rng = np.random.default_rng(1)
    d = np.concatenate([rng.standard_normal(n), rng.standard_normal(m), np.zeros(len(x0) - n - m)])
    sides = [chart.f(x0 + s * 3e-5 * d, chart.u0)[0] for s in (1.0, -1.0)]
    difference = (sides[0] - sides[1]) / 6e-5
    assert found.is_moving
    np.testing.assert_allclose(difference, found.A @ d, atol=1e-6 * np.abs(found.A).max() * np.abs(d).max())


def test_what_has_no_bodies_is_refused() -> None:
    simulation = of_text('mechanism: mechanisms/spring_mass.yaml\nduration: 1\n')
    with pytest.raises(SpecError, match='the scene has 0 inputs'):
        linear_model(simulation, np.zeros(2))
    single = solver.simulation_of(solver.load_scene('light_car_straight', ['fidelity=single_track']))
    with pytest.raises(SpecError, match='the level has none'):
        linear_model(single)


def test_modes_of_a_motion_are_told_apart() -> None:
    """modes() leaves velocities out, and says so where there are some."""
    simulation = of_text('mechanism: mechanisms/spring_mass.yaml\nduration: 1\n')
    simulation.advance(100)
    with pytest.warns(UserWarning, match='modes are those of a state of rest'):
        modes(simulation)
