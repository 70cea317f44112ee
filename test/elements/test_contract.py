"""The contract of elements can say no: elements that break one law each are refused by it."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest
from contract import Element, check_contract, kinematics

LAG = 0.2  # s


def rate(z: float) -> float:
    """dz/dt [1/s] of a lag that follows 0.7."""
    return (0.7 - z) / LAG


def element(solve: Callable[[float, float], float]) -> Element:
    """A state without a force, of which solve(zp, cz) is the stage solution."""

    def call(kin, zp, cz, u, tangents, f, Kq, Kv, z, out):
        z[0] = solve(zp[0], cz)
        out[0] = 0.0

    context = SimpleNamespace(n_bodies=1, n_states=1)
    return Element(call, context, n=1, outputs=('energy', 'dissipation'))  # type: ignore[arg-type]


def implicit(zp: float, cz: float) -> float:
    return (zp + cz / LAG * 0.7) / (1.0 + cz / LAG)


def clipped(zp: float, cz: float) -> float:
    """Dry friction: driven at 3/s, it slips at 0.5. The law is set-valued, and solved with its own rate."""
    return min(zp + 3.0 * cz, 0.5)


def explicit(zp: float, cz: float) -> float:
    return zp + cz * rate(zp)


def exponential(zp: float, cz: float) -> float:
    """Exact over a step of cz, so not of the form z = zp + cz g(z) that a stage has."""
    return 0.7 + (zp - 0.7) * float(np.exp(-cz / LAG))


def half_explicit(zp: float, cz: float) -> float:
    """The trapezoidal rule."""
    return (zp + 0.5 * cz * rate(zp) + 0.5 * cz / LAG * 0.7) / (1.0 + 0.5 * cz / LAG)


REST = kinematics([((0, 0, 0), (0, 0, 0))], np.zeros((1, 6)))


@pytest.mark.parametrize('solve', [implicit, clipped])
@pytest.mark.parametrize('zp', [0.1, 0.4999])
@pytest.mark.parametrize('cz', [1e-4, 0.01, 1.0])
def test_a_state_with_its_own_rate_passes(solve, zp: float, cz: float) -> None:
    check_contract(element(solve), REST, zp=[zp], cz=cz)


@pytest.mark.parametrize('solve', [explicit, exponential, half_explicit])
@pytest.mark.parametrize('cz', [1e-4, 0.01, 0.1])
def test_a_state_with_the_rate_of_the_beginning_is_refused(solve, cz: float) -> None:
    with pytest.raises(AssertionError, match='rate of the internal states'):
        check_contract(element(solve), REST, zp=[0.1], cz=cz)
