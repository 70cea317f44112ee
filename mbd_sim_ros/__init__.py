"""The ROS edge of the simulator: messages, recordings, node. Only `node` needs rclpy.

The public interface, documented in docs/api.md: a run as fast as it goes, and recordings as columns or data frames.
Nothing heavy is imported before it is asked for.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mbd_sim_ros.analysis.dataframes import load
    from mbd_sim_ros.bags.reader import Run, read
    from mbd_sim_ros.batch import simulate

__all__ = ['Run', 'load', 'read', 'simulate']
_HOMES = {  # public name -> module it is imported from when it is asked for
    'Run': 'mbd_sim_ros.bags.reader',
    'load': 'mbd_sim_ros.analysis.dataframes',
    'read': 'mbd_sim_ros.bags.reader',
    'simulate': 'mbd_sim_ros.batch',
}


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f'module {__name__!r} has no attribute {name!r}')


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
