"""Independent integrators (index 1 explicit; stabilised index 2 by BDF, Radau and IDA) and the step agree within their
error bars."""

from __future__ import annotations

import dataclasses
import importlib
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from closed_forms import driven_four_bar, falling_four_bar, heavy_body, steady_top
from convergence import error, scene_of
from ensemble import median, neighbours

from solver import simulation_of
from solver.errors import SpecError, StepError
from solver.files.scene import load_scene
from solver.reference.dense import MotionState
from solver.reference.engine import Following
from solver.reference.methods import Stabilised
from solver.simulation import Simulation

KINDS = ('reference_kkt', 'reference_bdf', 'reference_radau', 'reference_ida')


@pytest.fixture(params=KINDS)
def kind(request) -> str:
    """Every reference integrator, or the one asked for."""
    return request.param


PROBLEMS = {
    'heavy body': heavy_body(0.8),
    'falling four-bar': falling_four_bar(0.8),
    'driven four-bar': driven_four_bar(6.0),
}


@pytest.mark.parametrize('name', PROBLEMS)
def test_reference_integrators_reach_the_closed_forms(kind, name):
    """Positions to 1e-5, velocities to 1e-4, multipliers to 1e-3 over 0.8 s at tolerance 1e-9 (Gear methods lose four
    digits)."""
    problem = PROBLEMS[name]
    simulation = simulation_of(scene_of(problem, h=0.08, kind=kind, tolerance=1e-9))
    assert isinstance(simulation.engine, Following)
    worst = np.zeros(3)
    for _ in range(10):
        snapshot = simulation.advance()
        worst = np.maximum(worst, error(snapshot, problem.exact(snapshot.t_ns * 1e-9)))
    assert (worst < (1e-5, 1e-4, 1e-3)).all(), worst
    assert simulation.totals()['evaluations'] > 0


def test_independent_rows_are_chosen_anew_within_an_output_interval(kind):
    """The redundant four-bar over one interval: rows that are independent at its start become dependent on the way."""
    problem = PROBLEMS['falling four-bar']
    simulation = simulation_of(scene_of(problem, h=0.8, kind=kind, tolerance=1e-9))
    assert (error(simulation.advance(), problem.exact(0.8)) < (1e-5, 1e-4, 1e-3)).all()


class Agreement(NamedTuple):
    """How a mechanism scene is compared: overrides, duration [s], step [s], smallest number of unique reactions."""

    overrides: tuple[str, ...] = ()
    duration: float = 0.1
    h: float = 1e-3
    unique: int = 0


AGREEMENT = {
    'pendulum': Agreement(duration=0.9, unique=5),
    'double_pendulum': Agreement(duration=0.3, unique=10),
    'spring_mass': Agreement(duration=0.5, unique=5),
    'four_bar': Agreement(duration=0.6, unique=9),
    'four_bar_n': Agreement(('mechanism.loops=3',), duration=0.3, unique=20),
    'slider_crank': Agreement(('start.coordinates.slide.rate=-1',), duration=0.3, unique=14),
    'spinning_top': Agreement(duration=0.1, h=1e-4, unique=3),
    'torque_free_top': Agreement(duration=0.5),
    'bricard': Agreement(duration=0.5),  # its redundancy is shared by all of its rows
    'andrews': Agreement(duration=0.003, h=1e-5, unique=20),
    'flyball_governor': Agreement(('start.coordinates.shaft.rate=3',), duration=0.2, unique=20),
    'rolling_disc': Agreement(duration=0.5, unique=3),
    'knife_edge': Agreement(duration=0.5, unique=4),
    'chaplygin_sleigh': Agreement(duration=0.5, unique=4),
}
SCENES = Path(__file__).parents[2] / 'config' / 'scenes'
MECHANISMS = sorted(
    {*AGREEMENT, *(file.stem for file in SCENES.glob('*.yaml') if 'mechanism: mechanisms/' in file.read_text())}
)

# the others by both with `pytest -m long` only
BY_BOTH = ('double_pendulum', 'four_bar', 'bricard', 'rolling_disc', 'flyball_governor')
# explicit methods cannot resolve the governor's 4e4 N s/m at light bodies
PAIRS = [
    pytest.param(kind, name, marks=pytest.mark.long if kind == 'reference_ida' and name not in BY_BOTH else ())
    for name in MECHANISMS
    for kind in ('reference_kkt', 'reference_ida')
    if (kind, name) != ('reference_kkt', 'flyball_governor')
]
PAIRS += [
    pytest.param(*pair)
    for pair in (
        ('reference_bdf', 'flyball_governor'),
        ('reference_bdf', 'slider_crank'),
        ('reference_radau', 'slider_crank'),
    )
]


@pytest.mark.slow
@pytest.mark.parametrize(('kind', 'name'), PAIRS, indirect=['kind'])
def test_motion_and_unique_reactions_agree_within_both_error_bars(kind, name):
    """Every mechanism: within three times the change of the step's last halving plus the reference's change from 1e-7
    to 1e-9."""
    about = AGREEMENT.get(name, Agreement())
    scene = load_scene(name, about.overrides)

    def run(**settings) -> tuple[np.ndarray, np.ndarray, Simulation]:
        simulation = simulation_of(
            dataclasses.replace(scene, integrator=dataclasses.replace(scene.integrator, **settings))
        )
        snapshot = simulation.advance(round(about.duration / simulation.h))
        return np.concatenate([snapshot.pose.ravel(), snapshot.twist.ravel()]), snapshot.reactions, simulation

    ours = [run(h=step, kind='alf', mode='tolerance', tolerance=1e-11) for step in (about.h, about.h / 2)]
    loose, tight = (run(h=about.duration, kind=kind, tolerance=tolerance) for tolerance in (1e-7, 1e-9))
    shared = tight[2].describe()['reactions_not_unique']
    judged = np.array([row not in shared for row in tight[2].model.row_names], bool)
    assert judged.sum() >= about.unique
    for field, mask in ((0, slice(None)), (1, judged)):
        a, b = ours[0][field][mask], ours[1][field][mask]
        c, d = loose[field][mask], tight[field][mask]
        bar = np.abs(b - a).max(initial=0.0) + np.abs(d - c).max(initial=0.0)
        assert bar < 1e-2 * max(1.0, np.abs(d).max(initial=0.0))
        np.testing.assert_allclose(b, d, rtol=0, atol=3 * bar + 1e-9 * max(1.0, np.abs(d).max(initial=0.0)))


def test_analytic_jacobians_are_the_derivatives_of_the_residual(rng):
    """Central differences to 1e-6 of the largest entry, at random unknowns with dMu/dt = 0."""
    pytest.importorskip('scipy_dae')
    simulation = simulation_of(
        load_scene('slider_crank', ['integrator.kind=reference_bdf', 'mechanism.gravity=[1, -9, 2]'])
    )
    assert isinstance(simulation.engine, Following)
    solver = simulation.engine.solver
    assert isinstance(solver, Stabilised)
    y = np.concatenate(
        [
            solver.layout.pack(MotionState(simulation.state.q, simulation.state.v, simulation.state.z)),
            np.zeros(solver.size - solver.layout.end),
        ]
    )
    y[: solver.layout.end] += 0.1 * rng.normal(size=solver.layout.end)
    yp = rng.normal(size=len(y))
    yp[solver.Mu] = 0.0
    Jy, Jp = solver.jacobians(0.0, y, yp)
    for k, unit in enumerate(1e-6 * np.eye(len(y))):
        for J, moved in ((Jy, [(y + s * unit, yp) for s in (1, -1)]), (Jp, [(y, yp + s * unit) for s in (1, -1)])):
            if J is Jy and k >= solver.layout.end:
                assert not J[:, k].any()
                continue
            slope = (solver.residual(0.0, *moved[0]) - solver.residual(0.0, *moved[1])) / 2e-6
            np.testing.assert_allclose(J[:, k], slope, rtol=0, atol=1e-6 * max(1.0, np.abs(slope).max()))


def test_analytic_jacobians_with_internal_states(rng):
    """Light car at 20 m/s, tires and brakes disturbed: central differences to what rounding of its forces (1e5 N)
    leaves of them."""
    pytest.importorskip('scipy_dae')
    simulation = simulation_of(load_scene('light_car_straight', ['integrator.kind=reference_bdf']))
    assert isinstance(simulation.engine, Following)
    solver = simulation.engine.solver
    assert isinstance(solver, Stabilised)
    y, yp, at = solver.solver.y.copy(), solver.solver.yp.copy(), solver.layout
    y[at.z] += 1e-3 * rng.normal(size=y[at.z].shape)
    Jy, Jp = solver.jacobians(0.0, y, yp)
    rounding = 1e5 * np.finfo(float).eps / 1e-6
    for k, unit in enumerate(1e-6 * np.eye(len(y))[: at.end]):
        for J, moved in ((Jy, [(y + s * unit, yp) for s in (1, -1)]), (Jp, [(y, yp + s * unit) for s in (1, -1)])):
            slope = (solver.residual(0.0, *moved[0]) - solver.residual(0.0, *moved[1])) / 2e-6
            np.testing.assert_allclose(J[:, k], slope, rtol=0, atol=rounding + 1e-6 * max(1.0, np.abs(slope).max()))
    assert np.abs(Jy[at.v, at.z]).max() > 1e4  # the forces do depend on them


@pytest.mark.slow
def test_a_car_with_internal_states_runs_on_every_reference(kind):
    """Tires and brakes included: 10 ms of a step steer, positions to 1e-6 m and tire forces to 1 % of the load of the
    step's."""
    scene = load_scene(
        'light_car_straight', ['integrator.h=0.01', f'integrator.kind={kind}', 'integrator.tolerance=1e-6']
    )
    ours = Simulation(
        dataclasses.replace(scene, integrator=dataclasses.replace(scene.integrator, kind='alf', h=1e-3))
    ).advance(10)
    reference = simulation_of(scene).advance()
    np.testing.assert_allclose(reference.pose[:, :3], ours.pose[:, :3], rtol=0, atol=1e-6)
    np.testing.assert_allclose(reference.tire[:, :3], ours.tire[:, :3], rtol=0, atol=1e-2 * ours.tire[0, 2])


def test_reset_repeats_a_reference_run():
    problem = steady_top()
    simulation = simulation_of(scene_of(problem, h=0.05, kind='reference_kkt', tolerance=1e-8))
    first = simulation.advance(4)
    simulation.reset()
    np.testing.assert_array_equal(simulation.advance(4).pose, first.pose)


@pytest.mark.slow
def test_stabilised_methods_stop_at_a_singular_position_with_one_sentence():
    """Slider-crank at theta = 90 deg (0.39 s): rank 22 of 23. Most neighbours of the start stop there, as rounding lets
    them see it."""
    pytest.importorskip('scipy_dae')
    scene = load_scene(
        'slider_crank', ['integrator.kind=reference_bdf', 'integrator.h=0.1', 'integrator.tolerance=1e-8']
    )
    stopped = []
    for neighbour in neighbours(scene):
        simulation = simulation_of(neighbour)
        try:
            simulation.advance(10)
        except StepError as error:
            stopped.append(
                bool(re.match(r't = 0\.3[89]\d+ s, step \d: reference_bdf stopped: .* singular position', str(error)))
            )
        else:
            stopped.append(False)
    assert median(stopped) == 1, stopped


def test_a_missing_package_is_one_sentence_with_the_extra_to_install(monkeypatch):
    def missing(name, *args):
        raise ImportError(name)

    monkeypatch.setattr(importlib, 'import_module', missing)
    with pytest.raises(
        SpecError,
        match=r"integrator: kind = 'reference_ida': needs the package scikit-sundae; .*mbd_sim_ros\[references\]",
    ):
        simulation_of(load_scene('pendulum', ['integrator.kind=reference_ida']))


def test_inputs_of_a_reference_come_from_its_maneuver_only():
    simulation = simulation_of(load_scene('four_bar', ['integrator.kind=reference_kkt']))
    with pytest.raises(SpecError, match='follows the maneuver of its scene'):
        simulation.advance(1, np.zeros(3))


def test_the_step_refuses_the_kinds_of_the_references():
    with pytest.raises(SpecError, match="kind = 'reference_kkt': this engine knows alf, m_alf; use simulation_of"):
        Simulation(load_scene('pendulum', ['integrator.kind=reference_kkt']))
