"""Accounts of the messages of a topic: times that go back, the same time twice, and the sum of all of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

# ns by which messages on their way overtake each other at most: more is a clock that was set back
SET_BACK = 1_000_000_000
LEAST_BACK = 3  # steps back in time: so many are no clock that was set back; 30 would miss that in short recordings
# messages per step back at most where a file is in no order; 30 would take a clock that is set back often for that
SHUFFLED = 3
Clock = Literal['log time', 'publish time', 'header stamp']
CLOCKS: tuple[Clock, ...] = ('log time', 'publish time', 'header stamp')
# rows of a table of stamps: three clocks [ns], and which set of columns a message has
LOG, PUBLISH, HEADER, NAMES = range(4)


@dataclass(frozen=True)
class Account:
    """Account of the messages of a topic: messages = rows + equal + beside.

    equal: left out, because a later message has the same time and the same columns; twice: of these, those with the
    same values too, so that nothing is lost. beside: in the row of another message, of other columns. disordered:
    recorded behind one with a later time, and put in order. holes: column -> values that are no number. clock: which
    time counts. misaligned: see cdr.decode_first. span: first and last of it [ns]; log: first and last log time [ns].
    """

    messages: int
    rows: int
    equal: int
    twice: int
    beside: int
    disordered: int
    holes: dict[str, int]
    clock: Clock
    misaligned: bool
    span: tuple[int, int]
    log: tuple[int, int]

    def joined(self, other: Account, rows: int) -> Account:
        """That of both, whose messages share a table of so many rows."""
        return Account(
            messages=self.messages + other.messages,
            rows=rows,
            equal=self.equal + other.equal,
            twice=self.twice + other.twice,
            beside=self.messages + other.messages - self.equal - other.equal - rows,
            disordered=self.disordered + other.disordered,
            holes=self.holes | other.holes,
            clock=self.clock,
            misaligned=self.misaligned or other.misaligned,
            span=(min(self.span[0], other.span[0]), max(self.span[1], other.span[1])),
            log=(min(self.log[0], other.log[0]), max(self.log[1], other.log[1])),
        )

    def doubts(self, holes: str = 'values that are no number') -> list[str]:
        """Sentences on messages that were left out, or put in another order than they were recorded. holes: what values
        are called that are no number."""
        found = []
        if self.misaligned:
            found.append('its messages are aligned from the start of the buffer, against CDR, and are read so')
        if self.equal > self.twice:
            found.append(
                f'{self.equal} of {self.messages} messages are left out, because a later one has the same {self.clock}'
                + (f' ({self.twice} of them the same values too); ' if self.twice else '; ')
                + (
                    'its clock is too coarse, or has several publishers'
                    if self.clock != 'log time'
                    else 'they were recorded in bursts'
                )
            )
        if self.disordered:
            late = f'{self.disordered} of {self.messages} messages were'
            found.append(f'{late} recorded behind one with a later {self.clock}, and are put in order')
        if self.holes:
            shown = [f'{column} ({count})' for column, count in self.holes.items()]
            more = f' and {len(shown) - 3} more columns' if len(shown) > 3 else ''
            found.append(f'{holes}: {", ".join(shown[:3])}{more}')
        return found

    def remarks(self) -> list[str]:
        """Sentences on messages that were left out or put in another order without a loss."""
        if not self.twice or self.twice < self.equal:
            return []
        return [
            f'{self.twice} of {self.messages} messages are left out, which were recorded twice: the same {self.clock}, '
            'the same values'
        ]


def shuffled(log_times: np.ndarray) -> bool:
    """True where messages do not lie in the file as they were recorded: reversed, or in no order.

    A clock that is set back, or begins anew, goes back once now and then; these go back all the time.
    """
    back = int(np.count_nonzero(log_times[1:] < log_times[:-1]))
    return back >= LEAST_BACK and SHUFFLED * back >= log_times.size


def went_back(came: np.ndarray, clock: Clock, log_times: np.ndarray) -> str:
    """Why times that go back by more than SET_BACK are not taken, and what to do."""
    back = int(np.max(np.maximum.accumulate(came) - came))
    often = int(np.count_nonzero(came[:-1] - came[1:] > SET_BACK))
    steady = clock != 'log time' and int(np.max(np.maximum.accumulate(log_times) - log_times)) <= SET_BACK
    if often >= LEAST_BACK and steady:
        why = f'{often} times and by up to {back * 1e-9:.6g} s, as of publishers with clocks of their own'
        return f'its times go back {why}; take the log times (--log-times)'
    why = f'by {back * 1e-9:.6g} s, as of a clock that was set back or began anew'
    more = '' if not steady else ', or take the log times (--log-times)'
    return f'its times go back {why}; cut the recording there{more}'


def alike(left: np.ndarray, stay: np.ndarray, left_at: np.ndarray, stay_at: np.ndarray) -> int:
    """Number of messages that are left out and have the values and times (columns of tables) of those that stay; one
    NaN is like another."""
    same = (left == stay) | (np.isnan(left) & np.isnan(stay))
    return int(np.count_nonzero(np.all(same, axis=0) & np.all(left_at == stay_at, axis=0)))
