"""A search for equilibrium ends where rounding does not let it come nearer."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from solver import simulation_of
from solver.analysis.kinematics_and_compliance import Rig
from solver.elements.road import RoadSpec
from solver.files.scene import load_scene, load_scene_text
from solver.start import equilibrium
from solver.start.equilibrium import EQUILIBRIUM_TOLERANCE, ROUNDING, STALLED


def test_wheels_that_rigid_links_guide_are_at_rest_after_a_few_iterations(monkeypatch: pytest.MonkeyPatch) -> None:
    """At the level kc they stand on springs of some 1e10 N/m: what rounding of a place leaves there is above the
    tolerance."""
    scene = simulation_of(load_scene('light_car_step_steer', ['fidelity=kc'])).scene
    iterations = 0
    solve = equilibrium.solve_saddle

    def counted(*arguments) -> None:
        nonlocal iterations
        iterations += 1
        solve(*arguments)

    monkeypatch.setattr(equilibrium, 'solve_saddle', counted)
    rig = Rig(dataclasses.replace(scene.model, road=RoadSpec()))
    u, weight = np.zeros(len(rig.inputs)), rig.start._weight()
    stalled = 0
    for travel in np.linspace(0.0, 0.01, 11):
        u[[rig.inputs.index(name) for name in rig.inputs if name.startswith('travel')]] = travel
        rig.start.assemble(rig.state, u)
        iterations = 0
        left = rig.start.equilibrium(rig.state, u)
        assert left < ROUNDING * EQUILIBRIUM_TOLERANCE * weight
        assert iterations <= 10 + STALLED
        stalled += left > EQUILIBRIUM_TOLERANCE * weight
    assert stalled > 0


@pytest.mark.parametrize('mass', [1.0, 1e-6, 1e-12])
def test_what_weighs_next_to_nothing_finds_its_rest(mass: float) -> None:
    """On a spring of 100 Hz; what remains of forces was compared with 1 N: 1e-11 kg began 0.6 % beside its rest, 1e-12
    kg where it was."""
    w = 200.0 * np.pi
    bodies = f'{{b: {{mass: {mass!r}, inertia: [{mass!r}, {mass!r}, {mass!r}]}}}}'
    text = (
        f'mechanism:\n  bodies: {bodies}\n  joints: {{g: {{kind: prismatic, i: world, j: b, at: [0, 0, 0], axis: '
        f'[0, 0, 1]}}}}\n'
    )
    text += f'  coordinate_forces: {{s: {{terms: [[g, 1]], spring: {mass * w**2!r}}}}}\nstart: {{kind: equilibrium}}\n'
    s = simulation_of(load_scene_text(text))
    assert s.state.q[0, 2] == pytest.approx(-9.81 / w**2, rel=1e-6)
