"""docs/scene.md says what the code reads."""

from __future__ import annotations

import dataclasses
import importlib.util
import math
import re
import typing
from pathlib import Path

from solver.elements.laws import Law
from solver.elements.marker import Marker
from solver.files.scene import load_scene_text
from solver.files.schema import keys_of
from solver.files.vehicle import TEMPLATES
from solver.model.spec import ModelSpec
from solver.scene import Bound, Scene

ROOT = Path(__file__).resolve().parents[2]


def tables():
    spec = importlib.util.spec_from_file_location('tables', ROOT / 'docs' / 'tools' / 'tables.py')
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_document_agrees_with_the_code() -> None:
    module = tables()
    text = module.FILE.read_text(encoding='utf-8')
    assert module.render(text) == text, 'run `python docs/tools/tables.py`'


def test_every_field_that_a_file_may_hold_is_in_the_document() -> None:
    text = tables().FILE.read_text(encoding='utf-8')
    seen: set[type] = set()

    def visit(hint: object) -> None:
        for argument in typing.get_args(hint):
            visit(argument)
        # a text each, or described beside
        if not dataclasses.is_dataclass(hint) or hint in seen or hint in (Bound, Law, Marker):
            return
        seen.add(typing.cast(type, hint))
        for field in keys_of(hint):
            if hint is Scene and field.name in ('model', 'resolved'):
                continue
            for key in field.metadata.get('keys', [field.name]):  # a field of limits has a key for each
                assert key == 'name' or f'| `{key}`' in text, f'{hint}: {key}'
            visit(typing.get_type_hints(hint, include_extras=True)[field.name])

    visit(Scene)
    visit(ModelSpec)
    for data, _ in TEMPLATES.values():
        visit(data)
    assert len(seen) > 20


def minimal_example() -> str:
    found = re.search(r'```yaml\n# minimal scene.*?\n(.*?)```', tables().FILE.read_text(encoding='utf-8'), re.DOTALL)
    assert found
    return found[1]


def test_the_example_in_the_document_loads_and_runs() -> None:
    from solver.simulation import Simulation

    simulation = Simulation(load_scene_text(minimal_example()))
    snapshot = simulation.advance(simulation.scene.steps)
    assert snapshot.t_ns == 1_000_000_000
    # one metre, started at 1 rad/s from the lowest point: the amplitude of the pendulum bounds its angle
    J = 1.0 + 0.01
    assert 0.0 < abs(snapshot.joint_position[0]) < math.acos(1.0 - 0.5 * J / 9.81) + 1e-6
