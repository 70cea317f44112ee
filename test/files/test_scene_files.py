"""The mechanism files that the package promises are there, and the documents' own scenes run."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from mbd_sim_ros.commands.main import main
from solver import simulation_of
from solver.elements.contact import KINDS as CONTACTS
from solver.elements.joint import KINDS as JOINTS
from solver.files.scene import load_scene_text

ROOT = Path(__file__).parents[2]
# name: bodies, constraint rows, degrees of freedom, redundant constraints at the start
PROMISED = {
    'slider_crank': (4, 26, 1, 3),
    'pendulum': (1, 5, 1, 0),
    'double_pendulum': (2, 10, 2, 0),
    'four_bar': (3, 21, 0, 3),  # its crank is driven
    'four_bar_n': (81, 605, 1, 120),
    'andrews': (7, 50, 1, 9),
    'bricard': (5, 30, 1, 1),
    'flyball_governor': (4, 20, 4, 0),
    'spinning_top': (1, 3, 3, 0),
    'rolling_disc': (1, 3, 3, 0),
    'knife_edge': (1, 4, 2, 0),
    'chaplygin_sleigh': (1, 4, 2, 0),
}


@pytest.mark.slow
@pytest.mark.parametrize('name', PROMISED)
def test_info_counts_every_promised_mechanism(name, capsys):
    assert (ROOT / 'config' / 'mechanisms' / f'{name}.yaml').is_file()
    assert main(['info', name, '--json']) == 0
    data = json.loads(capsys.readouterr().out)
    counts = (data['bodies'], data['constraint_rows'], data['dof'], data['redundant_constraints'])
    assert counts == PROMISED[name]


def blocks() -> list[str]:
    """The scenes in docs/scene.md."""
    return [
        text
        for text in re.findall(r'```yaml\n(.*?)```', (ROOT / 'docs' / 'scene.md').read_text(), re.DOTALL)
        if 'mechanism:' in text
    ]


def test_scenes_in_the_document_run():
    assert len(blocks()) >= 2
    for text in blocks():
        simulation = simulation_of(load_scene_text(text))
        simulation.advance(100)
        assert simulation.totals()['energy_error_max'] < 1e-3


def test_rolling_wheel_of_the_document_goes_straight_at_its_speed():
    simulation = simulation_of(load_scene_text(next(text for text in blocks() if 'rolling' in text)))
    np.testing.assert_allclose(simulation.advance(1000).pose[0, :3], [1.0, 0.0, 0.5], atol=1e-9)


def test_document_explains_every_kind_of_joint_and_contact():
    text = (ROOT / 'docs' / 'scene.md').read_text()
    for section, kinds in (('joints', JOINTS), ('contacts', CONTACTS)):
        part = text.partition(f'### {section}\n')[2].partition('\n### ')[0]
        missing = [kind for kind in kinds if not re.search(rf"(^|[ '\n]){kind}'?:", part)]
        assert not missing, f'{section}: {missing}'
