"""Fixtures of all tests."""

from __future__ import annotations

import os
import zlib

os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')  # as `mbd` has it; before numpy is imported

import numpy as np
import pytest

collect_ignore = ['data']  # files of recipes, tested in a copy of the program


@pytest.fixture
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    """Random numbers that depend on the name of the test only, so a failure repeats and tests do not disturb each other."""
    return np.random.default_rng(zlib.crc32(request.node.name.encode()))
