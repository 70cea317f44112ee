"""State files that are none, or were damaged, are refused in one sentence."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from solver.errors import SpecError
from solver.model.state import fitting, load_arrays

CONTENT = {
    'no zip': b'hello',
    'a zip that is cut off': b'PK\x03\x04' + bytes(40),
    'nothing': b'',
}


@pytest.mark.parametrize('name', CONTENT)
def test_a_file_that_is_no_state_is_refused(name: str, tmp_path: Path) -> None:
    pytest.importorskip('rclpy', reason='needs ROS: source Jazzy, or pip install .[ros]')
    from mbd_sim_ros.node.running import Running

    file = tmp_path / 'state.npz'
    file.write_bytes(CONTENT[name])
    node = cast(Any, SimpleNamespace(scene=SimpleNamespace(hash='x')))
    for path in (file, tmp_path / 'none', Path('/dev/zero')):
        with pytest.raises(SpecError, match='is not a state file') as caught:
            Running.restore(node, path)
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
