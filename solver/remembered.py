"""Results of functions of one object, remembered while the same object comes again: a sweep, a twin and a plan ask for
the same vehicle many times."""

from __future__ import annotations

import copy
import functools
import threading
from collections import deque
from collections.abc import Callable
from typing import Any, TypeVar

Result = TypeVar('Result')
MOST = 4  # results that each function keeps, with what they are of; ten times as many hold 50 MB of cars

_all: list[deque[Any]] = []


def forget() -> None:
    """Forget all results: for who changes what they depend on besides their arguments."""
    for kept in _all:
        kept.clear()


def of_same(function: Callable[..., Result]) -> Callable[..., Result]:
    """The function, whose last results come back for the same first argument and other arguments that are equal.

    The first argument is known by the object itself, which nobody may change; nor may anybody change a result. The
    other arguments are copied, so a caller may change them; they compare to True or False, which arrays do not.
    Refusals are not kept.
    """
    kept: deque[tuple[Any, tuple, dict[str, Any], Result]] = deque(maxlen=MOST)
    lock = threading.Lock()
    _all.append(kept)

    @functools.wraps(function)
    def remembering(first: Any, *rest: Any, **named: Any) -> Result:
        with lock:
            for one, others, names, result in kept:
                if one is first and others == rest and names == named:
                    return result
        asked = copy.deepcopy((rest, named))  # as they are now
        result = function(first, *rest, **named)
        with lock:
            kept.append((first, *asked, result))
        return result

    return remembering
