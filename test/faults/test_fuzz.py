"""A few cases of each kind of the fuzzer, in children of this process; `python test/faults/fuzz.py` makes thousands."""

from __future__ import annotations

from pathlib import Path

import pytest
from faults import COUNT, SEED
from fuzz_cases import KINDS, Material, make_material
from fuzzing import run_case
from mutations import damage_bag, damage_text, damage_yaml, numbers_of

from solver.files.scene import config_directories

pytestmark = [pytest.mark.realtime, pytest.mark.slow]  # alone: a child of a process with threads of others may hang


@pytest.fixture(scope='module')
def material(tmp_path_factory: pytest.TempPathFactory) -> Material:
    return make_material(tmp_path_factory.mktemp('material'), ('slider_crank', 'light_car_lane_change'))


@pytest.mark.parametrize('kind', KINDS)
def test_damaged_input_ends_in_success_or_one_sentence(kind: str, material: Material, tmp_path: Path) -> None:
    for case in range(COUNT or 3):
        verdict = run_case(kind, SEED, case, tmp_path / str(case), material)
        assert not verdict.fault, f'{tmp_path / str(case)}: {verdict}'


def test_the_same_seed_gives_the_same_damage(material: Material) -> None:
    vehicle = (config_directories()[0] / 'vehicles' / 'light_car.yaml').read_text()
    for damage, source in ((damage_yaml, vehicle), (damage_text, vehicle), (damage_bag, material.crank / 'crank_0.mcap')):
        first, again, other = (damage(numbers_of('x', 1, case), source) for case in (5, 5, 6))  # type: ignore[operator]
        assert first == again != other
