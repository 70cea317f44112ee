"""Other programs beside ours: a planar model as plain numbers, and Exudyn and MuJoCo run on it in processes of their
own.

MBD_EXUDYN_PYTHON and MBD_MUJOCO_PYTHON may name the Python that has them; otherwise it is the one that runs this (extra
`bench`).
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from solver.elements.marker import WORLD
from solver.errors import SpecError
from solver.simulation import Simulation

PYTHON = 'MBD_EXUDYN_PYTHON'
MUJOCO_PYTHON = 'MBD_MUJOCO_PYTHON'
PROGRAM = Path(__file__).with_name('exudyn_mechanism.py')


def planar(simulation: Simulation, instants: np.ndarray, joint: str = '') -> dict[str, Any]:
    """A mechanism in the x-y plane, as exudyn_peer wants it: observed in the coordinate of a joint, or in all of every
    body.

    Bodies fixed to the world vanish. Raises SpecError for what has no planar counterpart here.
    """
    spec, state = simulation.scene.model, simulation.state
    fixed = {WORLD} | {j.j.body for j in spec.joints if j.kind == 'fixed' and j.i.body == WORLD}
    moving = [k for k, body in enumerate(spec.bodies) if body.name not in fixed]
    number = {spec.bodies[k].name: n for n, k in enumerate(moving)} | dict.fromkeys(fixed, -1)
    centre = {body.name: np.array(body.com) for body in spec.bodies}

    def point(marker: Any) -> list[float]:
        return [
            float(x)
            for x in (np.array(marker.position) - (centre[marker.body] if number[marker.body] >= 0 else 0.0))[:2]
        ]

    bodies = []
    for k in moving:
        q, v = state.q[k], state.v[k]
        phi = 2.0 * float(np.arctan2(q[5], q[6]))
        bodies.append(
            {
                'm': spec.bodies[k].mass,
                'I': spec.bodies[k].inertia[2],
                'x': q[0],
                'y': q[1],
                'phi': phi,
                'vx': v[0],
                'vy': v[1],
                'w': v[5],
            }
        )
    model: dict[str, Any] = {
        'bodies': [{key: float(value) for key, value in body.items()} for body in bodies],
        'revolutes': [],
        'sliders': [],
        'springs': [],
        'torques': [],
        'gravity': float(spec.gravity[1]),
        'instants': [float(t) for t in instants],
        'observe': [] if joint else [[n, coordinate] for n in range(len(moving)) for coordinate in range(3)],
    }
    for j in spec.joints:
        if j.kind == 'revolute':
            model['revolutes'].append([number[j.i.body], point(j.i), number[j.j.body], point(j.j)])
        elif j.kind == 'prismatic':
            model['sliders'].append(number[j.j.body])
        elif not (j.kind == 'fixed' and j.j.body in fixed):
            raise SpecError(f'joint {j.name!r}: kind = {j.kind!r}: has no planar counterpart')
        if j.name == joint:
            model['observe'] = [[number[j.j.body], 0 if j.kind == 'prismatic' else 2]]
    rate = lambda law: 0.0 if law is None else law.slope[0]  # noqa: E731
    for s in spec.spring_dampers:
        model['springs'].append(
            [number[s.i.body], point(s.i), number[s.j.body], point(s.j), s.free_length, rate(s.spring), rate(s.damper)]
        )
    for f in spec.coordinate_forces:
        name = next(n for n, _ in f.terms)
        model['torques'].append([number[next(j.j.body for j in spec.joints if j.name == name)], -f.preload])
    return model


def exudyn(
    model: dict[str, Any], runs: Sequence[Mapping[str, Any]], program: Path = PROGRAM
) -> tuple[str, list[dict[str, Any]]]:
    """(version, result of every run) of a model in the words of the program. Raises SpecError with one sentence if
    Exudyn is not there."""
    return _ask('Exudyn', PYTHON, program, model, runs)


def mujoco(model: dict[str, Any], runs: Sequence[Mapping[str, Any]], program: Path) -> tuple[str, list[dict[str, Any]]]:
    """The same of MuJoCo."""
    return _ask('MuJoCo', MUJOCO_PYTHON, program, model, runs)


def _ask(
    name: str, variable: str, program: Path, model: dict[str, Any], runs: Sequence[Mapping[str, Any]]
) -> tuple[str, list[dict[str, Any]]]:
    interpreter = os.environ.get(variable, sys.executable)
    try:
        done = subprocess.run(
            [interpreter, '-P', str(program)],
            input=json.dumps({**model, 'runs': [*runs]}),
            capture_output=True,
            text=True,
            check=True,
        )
    except (OSError, subprocess.CalledProcessError) as error:
        last = (getattr(error, 'stderr', None) or str(error)).strip().splitlines()[-1]
        raise SpecError(
            f"{name} is left out ({last}); install it with pip install 'mbd_sim_ros[bench]', or name a Python that has "
            f'it in {variable}'
        ) from None
    found = json.loads(done.stdout.strip().splitlines()[-1])
    return found['version'], found['results']
