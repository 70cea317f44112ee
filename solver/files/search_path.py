"""Directories in which names and includes are looked up."""

from __future__ import annotations

import os
import sys
from pathlib import Path

PACKAGE = 'mbd_sim_ros'  # folder of an installed share directory
CHECKOUT = Path(__file__).resolve().parents[2] / 'config'  # of the source; an installation has its files below share/


def config_directories() -> list[Path]:
    """Directories in which names of scenes and included files are looked up, the first one first.

    They are the current directory, the config/ of this checkout, and the installed share directories.
    """
    prefixes = [*filter(None, os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)), sys.prefix]
    candidates = [
        Path.cwd() / 'config',
        Path.cwd(),
        CHECKOUT,
        *(Path(prefix) / 'share' / PACKAGE / 'config' for prefix in prefixes),
    ]
    return [directory for directory in dict.fromkeys(candidates) if directory.is_dir()]
