"""Fixtures of all tests."""

from __future__ import annotations

import gc
import os
import zlib
from collections.abc import Generator
from pathlib import Path

os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')  # as `mbd` has it; before numpy is imported

import numpy as np
import pytest

collect_ignore = ['data']  # files of recipes, tested in a copy of the program


BOUND_TO_THE_CLOCK = 'mark.realtime'  # what a file says that has such tests


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Garbage is not looked for while tests are imported, which took a quarter of that time, nor later among what stays
    of it."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Where only tests bound to the clock are wanted, the files that have none are not imported: that takes seconds of
    every process."""
    if not config.option.markexpr.startswith('realtime') or not collection_path.match('test_*.py'):
        return None
    return BOUND_TO_THE_CLOCK not in collection_path.read_text(encoding='utf-8') or None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Raises UsageError for a test that would be left out by that, where all of them are collected."""
    for path in {item.path for item in items if item.get_closest_marker('realtime')}:
        if BOUND_TO_THE_CLOCK not in path.read_text(encoding='utf-8'):
            raise pytest.UsageError(f'{path}: has tests bound to the clock without saying {BOUND_TO_THE_CLOCK!r}')


@pytest.fixture
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    """Random numbers that depend on the name of the test only, so a failure repeats and tests do not disturb each
    other."""
    return np.random.default_rng(zlib.crc32(request.node.name.encode()))
