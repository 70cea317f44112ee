"""State files that are none, or were damaged, are refused in one sentence."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from synthetic import Synthetic, scene

from mbd_sim_ros.node.state_files import restore, save
from solver.errors import SpecError
from solver.model.state import fitting, load_arrays

CONTENT = {
    'no zip': b'hello',
    'a zip that is cut off': b'PK\x03\x04' + bytes(40),
    'nothing': b'',
}


@pytest.mark.parametrize('name', CONTENT)
def test_a_file_that_is_no_state_is_refused(name: str, tmp_path: Path) -> None:
    file = tmp_path / 'state.npz'
    file.write_bytes(CONTENT[name])
    with pytest.raises(SpecError, match='no file is there'):
        restore(tmp_path / 'none', SimpleNamespace(hash='x'), Synthetic(), {})
    for path in (file, tmp_path / 'none', Path('/dev/zero')):
        with pytest.raises(SpecError, match='is not a state file') as caught:
            restore(path, SimpleNamespace(hash='x'), Synthetic(), {})
        assert '\n' not in str(caught.value)


def test_arrays_that_claim_more_than_a_state_has_are_not_unpacked(tmp_path: Path) -> None:
    file = tmp_path / 'bomb.npz'
    np.savez_compressed(file, k=np.zeros(10_000_000))
    assert file.stat().st_size < 1_000_000
    with pytest.raises(SpecError, match=r'claims to hold 8000\d\d\d\d bytes'):
        load_arrays(file.read_bytes())
    for saved in (None, np.zeros(3), np.zeros(2, np.float32)):
        with pytest.raises(SpecError, match='of another model'):
            fitting('inputs', saved, np.zeros(2))


def test_a_file_holds_the_commands_and_one_of_an_older_version_has_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    simulation, parts = Synthetic(), {'steering': SimpleNamespace(state=np.array([0.1, 0.2, 0.3]))}
    simulation.advance(5)
    path = save(scene(), simulation, parts, {'steering': 0.4, 'brake_torque': 30.0})
    began, found = Synthetic(), {'steering': SimpleNamespace(state=np.zeros(3))}
    assert restore(path, scene(), began, found) == {'steering': 0.4, 'brake_torque': 30.0}
    assert began.k == 5
    np.testing.assert_array_equal(found['steering'].state, [0.1, 0.2, 0.3])
    content = load_arrays(path.read_bytes())
    older = tmp_path / 'older.npz'
    np.savez(older, **{name: value for name, value in content.items() if name not in ('commands', 'latched')})
    assert restore(older, scene(), Synthetic(), found) == {}
    for wrong, says in ((np.zeros(3), 'latched has shape'), (np.array([0.4, np.nan]), 'holds commands that are no numbers')):
        np.savez(older, **{**content, 'latched': wrong})
        with pytest.raises(SpecError, match=says):
            restore(older, scene(), Synthetic(), found)
