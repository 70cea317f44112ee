"""The verdict of the native library is that of the checks in Python: the same findings in the same words."""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fuzz_native import OK, Library

from mbd_sim_ros.native import library
from mbd_sim_ros.native.kernels import target
from mbd_sim_ros.native.model import Native, native
from mbd_sim_ros.native.verdict import FIELDS, JUDGED, OF_ACCOUNT, OF_SCENE, unchecked
from mbd_sim_ros.native.watch import FOLLOWED
from solver import load_scene, simulation_of
from solver.analysis.envelope import Envelope
from solver.analysis.verdict import evidence_of, findings
from solver.checks.account import ENERGY_ERROR_MAX
from solver.checks.registry import BY_NAME, CHECKS
from solver.checks.resolution import TURN_PER_STEP
from solver.simulation import Simulation

HERE = Path(__file__).parent
CRANK, CAR, LIGHT, TRAILER = 'slider_crank', 'car_step_steer', 'light_car_straight', 'saloon_with_trailer'
# Name -> scene and settings: rows with penalties, tires, bushings, a trailer; schemes whose limits differ.
MODELS: dict[str, tuple[str, list[str]]] = {
    'crank': (CRANK, ['integrator.form=condensed']),
    'damped': (CRANK, ['integrator.rho_inf=0', 'integrator.penalty=1e12', 'integrator.form=condensed']),
    'fourth': (CRANK, ['integrator.order=4', 'integrator.rho_inf=1', 'require.residual_max=1e-3']),
    'top': ('torque_free_top', []),
    'light': (LIGHT, []),
    'car': (CAR, []),
    'trailer': (TRAILER, ['maneuver={}', 'start.speed=5']),
}
COMMON = {'not_finite', 'energy_error_max', 'residual_max', 'resolution', 'phase', 'turn_per_step', 'unseen'}
OF_MODEL = {
    'crank': {'position_drift_max', 'velocity_drift_max', 'contradiction'},
    'damped': {'light_body', 'penalty'},
    'light': {'chatter', 'tire_deflection'},
    'car': {'chatter', 'tire_deflection', 'rotation'},
}
STEPS = 8  # made before the account is changed
BEYOND = 'maneuver={steering: {kind: step, start: 0.1, rise: 0.8, value: 1.5}}'


class Judging(Library):
    """The library with the doors of watched.c, and a model in it."""

    def __init__(self, there: Path, content: bytes) -> None:
        super().__init__(there)
        so = self._so
        so.mbd_finding.restype, so.mbd_finding.argtypes = ctypes.c_char_p, [ctypes.c_void_p, ctypes.c_int]
        so.probe_span.restype, so.probe_span.argtypes = ctypes.c_void_p, [ctypes.c_void_p, ctypes.c_int]
        so.probe_look.argtypes = [ctypes.c_void_p, ctypes.c_int64, ctypes.c_char_p]
        code, self.model = self.made(content)
        assert code == OK
        self.so: Any = so

    def findings(self) -> list[str]:
        """All sentences of the verdict."""
        return [self.so.mbd_finding(self.model, k).decode() for k in range(self.verdict(self.model))]

    def put(self, field: str, values: np.ndarray) -> None:
        """Write a field of the account."""
        raw = np.ascontiguousarray(values, float).tobytes()
        ctypes.memmove(self.so.probe_span(self.model, FIELDS.index(field)), raw, len(raw))


@pytest.fixture(scope='module')
def built(tmp_path_factory) -> tuple[Path, dict[str, Any], dict[str, bytes]]:
    """(directory of a library for all MODELS, their simulations, their files)."""
    there = tmp_path_factory.mktemp('verdict')
    simulations = {name: simulation_of(load_scene(scene, settings)) for name, (scene, settings) in MODELS.items()}
    made = {name: native(simulation) for name, simulation in simulations.items()}
    link(there, *made.values())
    return there, simulations, {name: one.content for name, one in made.items()}


def link(there: Path, *models: Native) -> None:
    """Build the library with its doors."""
    called = {kernel.name: kernel for made in models for kernel in made.kernels}
    sources = (str(HERE / 'watched.c'),)
    library.build(called.values(), target('v3'), there / library.NAME, sources=sources, exported=('mbd_*', 'probe_*'))


def built_alone(there: Path, simulation: Simulation) -> tuple[Path, bytes]:
    """(directory of a library for it, its file)."""
    made = native(simulation)
    link(there, made)
    return there, made.content


def said(check, finding) -> str:
    """A finding in the words of the library: without numbers of the run in its reason, or of its axes in its remedy."""
    numbers = finding.text[finding.text.index(' (') : finding.text.index('). ') + 3]
    if check is ENERGY_ERROR_MAX:
        return f'{check.reason[0].upper()}{check.reason[1:]}{numbers}{check.remedy}'
    return finding.text.partition('). ')[0] + f'). {check.remedy}' if check is TURN_PER_STEP else finding.text


def drawn(rng: np.random.Generator, simulation) -> dict[str, np.ndarray]:
    """An account in which checks find something or not, as it comes."""
    account, model = simulation.bodies.account, simulation.model
    values: dict[str, np.ndarray] = {}
    for field in FIELDS:
        shape = getattr(account, field).shape
        values[field] = 10.0 ** rng.uniform(-9.0, 2.0, shape)
    for field, count in (
        ('residual', len(model.body_names)), ('turn', len(model.body_names)), ('position', model.n_rows),
        ('velocity', model.n_rows), ('contradiction', model.n_rows), ('shake', len(model.spec.tires)),
        ('wound', len(simulation.channels.elements)),
    ):  # fmt: skip
        values[field][1:] = rng.uniform(0.0, 1.0), rng.integers(max(count, 1))
    for field in ('position', 'velocity', 'contradiction'):  # nothing is noted of rows that are not there
        values[field] *= bool(model.n_rows)
    values['kick'][:, 2] = rng.integers(len(model.body_names), size=2)
    for field in ('kinetic', 'potential'):
        values[field].sort()
    values['steps'][:] = rng.choice([1.0, 1e2, 1e6])
    values['energy'][:] = rng.choice([1.0, 1.0, np.inf, -1.0])
    values['time'][:] = simulation.k * simulation.h - rng.choice([0.0, simulation.h])
    return values


@pytest.mark.parametrize('name', MODELS)
def test_the_account_is_judged_as_in_python_whatever_it_says(built, name):
    there, simulations, contents = built
    simulation, judging = simulations[name], Judging(there, contents[name])
    simulation.reset()
    simulation.advance(STEPS)
    assert judging.step(judging.model, STEPS) == OK
    rng, required = np.random.default_rng(11), simulation.scene.require.limits
    seen: dict[str, int] = {}
    for _ in range(200):
        for field, values in drawn(rng, simulation).items():
            getattr(simulation.bodies.account, field)[...] = values
            judging.put(field, values)
        evidence = evidence_of(simulation)
        found = [
            said(check, finding)
            for check in dict.fromkeys(OF_ACCOUNT)
            if check not in OF_SCENE
            for finding in check.findings(evidence, required)
        ]
        assert judging.findings() == found
        for sentence in found:
            quantity = sentence.partition(' (')[2].partition(' ')[0]
            seen[quantity] = seen.get(quantity, 0) + 1
    assert COMMON | OF_MODEL.get(name, set()) <= seen.keys()
    assert {key for key, count in seen.items() if count == 200} <= {'light_body'}  # which follows from the settings


def moved(rng: np.random.Generator, simulation) -> np.ndarray:
    """Numbers of a snapshot with some bodies, joints and loads elsewhere, by a little or by far."""
    shown = simulation.snapshot()
    for pose in shown.pose:
        if rng.random() < 0.2:
            pose[:3] += rng.normal(size=3) * 10.0 ** rng.uniform(-2.0, 0.5)
        if rng.random() < 0.2:
            q = pose[3:] + rng.normal(size=4) * 10.0 ** rng.uniform(-2.0, 0.3)
            pose[3:] = q / np.linalg.norm(q)
    shown.joint_position[:] += rng.normal(size=len(shown.joint_position)) * 10.0 ** rng.uniform(-2.0, 1.0)
    shown.tire[:, 2] *= 10.0 ** rng.uniform(-1.0, 1.0, len(shown.tire))
    return np.array(shown.numbers)


@pytest.mark.parametrize('name', ['light', 'car', 'trailer'])
def test_a_motion_is_followed_as_in_python_wherever_it_goes(built, name):
    there, simulations, contents = built
    simulation = simulations[name]
    simulation.reset()
    simulation.advance(STEPS)
    rng, judging, seen = np.random.default_rng(4), Judging(there, contents[name]), set[str]()
    names = {check.name for check in FOLLOWED}
    for _ in range(60):
        judging.reset(judging.model)
        envelope, k = Envelope(simulation), 0
        for _ in range(int(rng.integers(1, 8))):
            k += int(rng.choice([20, 20, 500]))
            numbers = moved(rng, simulation)
            judging.so.probe_look(judging.model, k, numbers.tobytes())
            envelope.look_at(np.array([k * simulation.h_ns]), numbers[None])
        found = [finding.text for finding in envelope.findings() if finding.quantity in names]
        told = [text for text in judging.findings() if text.partition(' (')[2].partition(' ')[0] in names]
        assert told == found
        seen |= {text.partition(' (')[2].partition(' ')[0] for text in found}
    wanted = {'under_road', 'suspension', 'wheel_axis', 'crossed', 'rollover'}
    assert wanted | ({'articulation'} if name == 'trailer' else set()) <= seen


# Settings of a scene -> findings of its run. None: whatever Python finds, and it finds something.
RUNS: list[tuple[str, list[str], list[str] | None]] = [
    (CRANK, ['duration=1'], []),
    (CRANK, ['duration=2', 'integrator.h=0.02', 'integrator.mode=fixed', 'integrator.iterations=1'], None),
    (LIGHT, ['duration=0.2', 'maneuver={drive_torque: {kind: sine, amplitude: 1, frequency: 333}}'], ['input']),
    (LIGHT, ['duration=2', 'integrator.h=0.006', 'require={}'], ['chatter']),
    (LIGHT, ['duration=1', 'vehicle.steering.lock=0.5', 'start.speed=5', BEYOND], ['resolution', 'steering_end']),
]


@pytest.mark.parametrize(('scene', 'settings', 'quantities'), RUNS)
def test_a_run_has_the_findings_of_mbd_run(tmp_path, scene, settings, quantities):
    simulation = simulation_of(load_scene(scene, settings))
    judging = Judging(*built_alone(tmp_path, simulation))
    simulation.reset()
    envelope, steps = Envelope(simulation), simulation.scene.steps
    every = envelope.every(simulation.h_ns) or steps
    while simulation.k < steps:
        simulation.advance(min(every - simulation.k % every, steps - simulation.k))
        if simulation.k % every == 0 or simulation.k == steps:
            envelope.look(simulation.snapshot())
    expected = [one for one in (*findings(simulation), *envelope.findings()) if one.quantity not in unchecked()]
    assert quantities is None or [one.quantity for one in expected] == quantities
    assert quantities is not None or expected
    for count in (1, 7, steps - 8):
        assert judging.step(judging.model, count) == OK
    assert judging.findings() == [said(BY_NAME[one.quantity], one) for one in expected]
    assert (judging.message(judging.model).decode() != '') == bool(expected)


def test_what_a_caller_commands_is_judged_by_what_the_vehicle_does(tmp_path):
    """A maneuver beyond the end stops is nobody's fault where nothing follows it; a steering wheel beyond them is told,
    whoever turned it."""
    settings = ['duration=2', 'vehicle.steering.lock=0.5', BEYOND, 'start.speed=5']
    simulation = simulation_of(load_scene(LIGHT, settings))
    judging = Judging(*built_alone(tmp_path, simulation))
    find = {judging.name(judging.model, v).decode(): v for v in range(judging.variables(judging.model))}
    for angle, quantities in ((0.3, []), (0.8, ['steering_end'])):
        judging.reset(judging.model)
        for name in simulation.channels.inputs:
            if not name.startswith('steering'):
                assert judging.set(judging.model, find[name], 0.0) == OK
        assert judging.set(judging.model, find['steering'], angle) == OK
        assert judging.step(judging.model, 1000) == OK
        told = judging.findings()
        assert [sentence.partition(' (')[2].partition(' ')[0] for sentence in told] == quantities
        assert not quantities or told[0].startswith('The steering wheel is turned beyond its end stops')


def test_steps_without_an_account_are_told(built):
    there, _, contents = built
    judging = Judging(there, contents['crank'])
    judging.audit(judging.model, 0)
    assert judging.step(judging.model, 10) == OK
    assert [sentence.partition(' (')[0] for sentence in judging.findings()] == [
        'Steps were advanced without an account'
    ]


def test_what_the_library_does_not_judge_is_named():
    """A twin, a look back across singular positions, a clock, and the ranges of levels."""
    assert unchecked() == ['numerical_error', 'branch_switches', 'real_time_factor_min', 'validity', 'envelope']
    assert {check.name for check in JUDGED} | {*unchecked()} == {check.name for check in CHECKS}
