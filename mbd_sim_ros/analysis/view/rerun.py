"""Recordings in the viewer of Rerun (extra `rerun`): its decoders read the bag itself, with the links of /tf and
robot_description."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from mbd_sim_ros.bags.files import find_file
from solver.errors import BagError

APPLICATION = 'mbd_sim_ros'


def open_viewer(bags: Sequence[Path]) -> None:
    """Start the viewer with the recordings; it goes on when this process ends. Raises BagError where it cannot
    start."""
    _need_rerun()
    files = [str(find_file(bag)) for bag in bags]
    if sys.platform == 'linux' and not (os.environ.get('DISPLAY') or os.environ.get('WAYLAND_DISPLAY')):
        raise BagError('--rerun: there is no display for its viewer; write a file for it with --out FILE.rrd')
    subprocess.Popen([sys.executable, '-m', 'rerun', *files], start_new_session=True)


def write_rrd(bags: Sequence[Path], file: Path) -> None:
    """Write the recordings as one file of Rerun, which its viewer opens anywhere. Raises BagError."""
    _need_rerun()
    import rerun

    files = [find_file(bag) for bag in bags]
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()
    except OSError as error:
        raise BagError(f'cannot write {file}: {error.strerror}; choose another place') from None
    recording = rerun.RecordingStream(APPLICATION)
    recording.save(str(file))
    for one in files:
        recording.log_file_from_path(one)
    recording.flush()
    recording.disconnect()


def _need_rerun() -> None:
    if find_spec('rerun') is None:
        raise BagError("Rerun is not installed: pip install 'mbd_sim_ros[rerun]'")
