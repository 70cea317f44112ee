"""When steps are made: the settings of pacing, which parameters may change at any time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Mode = Literal['realtime', 'fast', 'lockstep']
MODES = ('realtime', 'fast', 'lockstep')


@dataclass(kw_only=True)
class Pace:
    """Pace that loop, commands and publishing share.

    rate_factor: simulated per elapsed time in real time. command_timeout: age [s] from which a command that drives
    counts as zero; 0: never. In lockstep an answer is a command at each of the places lockstep_commands, or a stamped
    one; it makes lockstep_every steps.
    """

    mode: Mode = 'realtime'
    rate_factor: float = 1.0
    command_timeout: float = 0.0
    lockstep_commands: tuple[int, ...] = (0, 1, 2)
    lockstep_every: int = 1

    @property
    def lockstep(self) -> bool:
        """True where steps wait for commands."""
        return self.mode == 'lockstep'
