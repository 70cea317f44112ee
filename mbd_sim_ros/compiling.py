"""Bar while kernels compile: how many of about how many. It is drawn on a terminal only, and goes when the compiler
rests."""

from __future__ import annotations

import os
import sys
from importlib.util import find_spec
from typing import Any

from numba.core import event
from tqdm import tqdm

from solver.engine import ahead
from solver.model.spec import ModelSpec

# Kernels that the first run of a new version compiles, about: of a scene without tires and of a car with all its
# elements, as `MBD_CACHE_DIR=$(mktemp -d) mbd run slider_crank --no-record` and car_step_steer count them (a test
# does). They are the length of the bar and nothing else: where more is compiled the bar grows, where less is, it ends
# early.
OF_MECHANISM, OF_CAR = 193, 401
FORMAT = '{desc}: {n_fmt} of about {total_fmt} kernels |{bar:30}| {elapsed}'


class Bar(event.Listener):
    """Count of the kernels of the solver that numba has compiled, those too that were compiled for others, or in
    another process for this one. total: about how many there will be. shown: draw it."""

    def __init__(self, *, shown: bool) -> None:
        self.total, self.here, self.shown = OF_CAR, 0, shown
        self._process, self._before = os.getpid(), ahead.elsewhere
        self._depth = 0
        self._drawn: tqdm | None = None

    @property
    def count(self) -> int:
        """Kernels that were compiled."""
        return self.here + ahead.elsewhere - self._before

    def on_start(self, event: Any) -> None:
        """A kernel begins to be compiled, or this process waits for one that is compiled elsewhere."""
        if event.kind == ahead.WAITING:
            self._draw()
        elif _is_ours(event):
            self._depth += 1
            self._draw()

    def on_end(self, event: Any) -> None:
        """It is compiled, or waiting has ended."""
        if event.kind != ahead.WAITING:
            if not _is_ours(event):
                return
            self._depth -= 1
            self.here += 1
            self._draw()
        if self._drawn is not None and self._depth == 0:
            self._drawn.clear()

    def _draw(self) -> None:
        if not self.shown or os.getpid() != self._process:
            return
        if self._drawn is None:
            self._drawn = tqdm(
                total=self.total, desc='compiling, once for a version', leave=False, file=sys.stderr, bar_format=FORMAT
            )
        self._drawn.total = max(self.total, self.count)
        self._drawn.n = self.count
        self._drawn.refresh()


def _is_ours(event: Any) -> bool:
    return event.data['dispatcher'].py_func.__module__.startswith('solver.')


_bar: Bar | None = None


def tell(shown: bool, model: ModelSpec) -> None:
    """Draw a bar whenever this process compiles kernels from now on, if shown and if the standard error is a terminal.
    model: what is compiled next."""
    global _bar
    if not shown or not sys.stderr.isatty():
        return
    if _bar is None:
        _bar = Bar(shown=True)
        event.register('numba:compile', _bar)
        event.register(ahead.WAITING, _bar)
    _bar.total = _bar.count + (OF_CAR if model.tires else OF_MECHANISM)


def without_blas() -> None:
    """Have numba begin without a look for BLAS, which no kernel calls: the import of scipy.linalg takes 0.17 s of CPU
    time. Whoever compiles a product of matrices later finds it."""
    if 'scipy.linalg' in sys.modules or 'numba.np.arraymath' in sys.modules:
        return
    modules: dict[str, Any] = sys.modules
    modules['scipy.linalg'] = None
    try:
        from numba.np import arraymath
    finally:
        del modules['scipy.linalg']
    arraymath._HAVE_BLAS = find_spec('scipy') is not None


without_blas()  # commands import this module before they load or compile a kernel
