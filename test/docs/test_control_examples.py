"""docs/examples of control and learning: each does what its page says of it."""

from __future__ import annotations

import importlib.util
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import solver

DOCS = Path(__file__).parents[2] / 'docs'
pytestmark = pytest.mark.slow


def example(name: str) -> Any:
    """An example as a module."""
    spec = importlib.util.spec_from_file_location(name, DOCS / 'examples' / f'{name}.py')
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize('page', ['control', 'learning'])
def test_the_code_of_a_page_runs(page: str) -> None:
    pytest.importorskip('control' if page == 'control' else 'gymnasium', reason='pip install .[test]')
    blocks = re.findall(r'```python\n(.*?)```', (DOCS / f'{page}.md').read_text(encoding='utf-8'), re.DOTALL)
    assert blocks
    for block in blocks:
        exec(compile(block, page, 'exec'), {})


def test_a_designed_lane_keeper_drives_the_whole_car_as_the_linear_model_says() -> None:
    """Within a tenth of the offset at the start: two states leave 5 % of the answer of the car, which the loop makes
    smaller for slow parts and up to twice as large near its own frequency."""
    pytest.importorskip('control', reason='pip install .[test]')
    lqr = example('lqr_lane_keeping')
    car = solver.simulation_of(solver.load_scene(lqr.SCENE, lqr.SETTINGS))
    made = lqr.design(car)
    assert made.fit < 0.1 and (np.linalg.eigvals(made.a).real < 0.0).all() and (made.gains > 0.0).all()
    driven, said = lqr.drive(car, made.gains, 3.0), lqr.expected(made, 3.0, car.h)
    assert driven[0] == said[0] == lqr.ASIDE
    assert np.abs(driven - said).max() < 0.1 * lqr.ASIDE
    assert abs(driven[-1]) < 0.02 * lqr.ASIDE


def test_branches_from_saved_states_are_the_future_to_the_bit() -> None:
    pytest.importorskip('gymnasium', reason='pip install .[test]')
    offsets, same = example('mpc_branches').drive(40)
    assert same and np.abs(offsets).max() < 0.5  # where the car may begin


def test_a_policy_that_is_learned_on_a_small_model_holds_the_full_car_in_its_lane() -> None:
    """The same seed learns the same policy, and one that has not learned leaves the lane."""
    pytest.importorskip('gymnasium', reason='pip install .[test]')
    lanes = example('learn_lane_keeping')
    W, returns = lanes.learn(12, seed=0)
    assert lanes.learn(1, seed=0)[1] == returns[:1]
    assert returns[-1] > returns[0] + 10.0  # of at most 10 s in the lane
    found = lanes.certify(W, starts=1)
    assert found.held and found.offset < lanes.FULL.width
    assert not lanes.certify(np.zeros_like(W), starts=1).held


@pytest.mark.parametrize(('name', 'extra', 'library'), [
    ('lqr_lane_keeping', 'control', 'control'), ('mpc_branches', 'learn', 'gymnasium'),
])  # fmt: skip
def test_an_example_whose_library_is_missing_names_the_extra(
    name: str, extra: str, library: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, library, None)  # an import of it fails
    for module in [module for module in sys.modules if module.startswith('mbd_sim_ros.learn')]:
        monkeypatch.delitem(sys.modules, module)
    with pytest.raises((SystemExit, ModuleNotFoundError)) as caught:
        example(name)
    assert f"pip install 'mbd_sim_ros[{extra}]'" in str(caught.value)
