"""The tire of Pacejka's book against values that two other implementations computed for it.

Scheme: [Pacejka2006], table A3.1 (205/60 R15 91V, 2.2 bar, ISO axes). docs/tire.md says
where they and the values were found. The law is that of the 3rd edition.
"""

from __future__ import annotations

import numpy as np
import pytest
from tire_bench import forces

from solver.elements.tire_data import pack

R0, F0, V0 = 0.313, 4000.0, 16.67
BOOK = {
    **{'FNOMIN': F0, 'UNLOADED_RADIUS': R0, 'LONGVL': V0, 'VERTICAL_STIFFNESS': 13.37 * F0 / R0},
    **{
        'PCX1': 1.685,
        'PDX1': 1.210,
        'PDX2': -0.037,
        'PEX1': 0.344,
        'PEX2': 0.095,
        'PEX3': -0.020,
        'PKX1': 21.51,
        'PKX2': -0.163,
    },
    **{'PKX3': 0.245, 'PHX1': -0.002, 'PHX2': 0.002, 'RBX1': 12.35, 'RBX2': -10.77, 'RCX1': 1.092, 'RHX1': 0.007},
    **{
        'PCY1': 1.193,
        'PDY1': -0.990,
        'PDY2': 0.145,
        'PDY3': -11.23,
        'PEY1': -1.003,
        'PEY2': -0.537,
        'PEY3': -0.083,
        'PEY4': -4.787,
    },
    **{
        'PKY1': -14.95,
        'PKY2': 2.130,
        'PKY3': -0.028,
        'PKY4': 2.0,
        'PKY6': -0.92,
        'PKY7': -0.24,
        'PHY1': 0.003,
        'PHY2': -0.001,
    },
    **{
        'PVY1': 0.045,
        'PVY2': -0.024,
        'PVY3': -0.532,
        'PVY4': 0.039,
        'RBY1': 6.461,
        'RBY2': 4.196,
        'RBY3': -0.015,
        'RCY1': 1.081,
    },
    **{'RHY1': 0.009, 'RVY1': 0.053, 'RVY2': -0.073, 'RVY3': 0.517, 'RVY4': 35.44, 'RVY5': 1.9, 'RVY6': -10.71},
    **{
        'QBZ1': 8.964,
        'QBZ2': -1.106,
        'QBZ3': -0.842,
        'QBZ5': -0.227,
        'QBZ9': 18.47,
        'QCZ1': 1.180,
        'QDZ1': 0.100,
        'QDZ2': -0.001,
    },
    **{
        'QDZ3': 0.007,
        'QDZ4': 13.05,
        'QDZ6': -0.008,
        'QDZ8': -0.296,
        'QDZ9': -0.009,
        'QEZ1': -1.609,
        'QEZ2': -0.359,
        'QEZ4': 0.174,
    },
    **{
        'QEZ5': -0.896,
        'QHZ1': 0.007,
        'QHZ2': -0.002,
        'QHZ3': 0.147,
        'QHZ4': 0.004,
        'SSZ1': 0.043,
        'SSZ2': 0.001,
        'SSZ3': 0.731,
    },
    **{'SSZ4': -0.238, 'QSY1': 0.01},
}

# kappa, alpha [deg], Fz [N], Fx, Fy [N], Mz [N m] upright; a C++ and a Python program that agree to 1e-9 (MiniEngine)
UPRIGHT = (
    (-0.5, 0.0, 2000, -1986.1194085661953, -88.25461910604399, -27.07868352989113),
    (0.02, 0.0, 2000, 635.4227365044682, 94.75549551368744, 3.8556858457999166),
    (0.3, 0.0, 2000, 2277.7768724961525, 134.56732921005928, 30.07576110672682),
    (0.0, -6.0, 2000, -65.8087042868421, 1969.3428055291329, -19.819270731012516),
    (0.0, 0.0, 4000, -172.00946110146887, 41.99718332234983, -13.573589310153654),
    (0.0, -2.0, 4000, -161.5405652204195, 1608.3945254373825, -58.29878463331622),
    (0.0, 6.0, 4000, -88.61698738891505, -3346.4349571737075, 39.682185638630685),
    (0.0, 15.0, 6000, -24.438901043871496, -5306.947264719752, -8.62405016796792),
    (0.1, 0.0, 6000, 7020.21664117894, 136.06054195674923, 91.46498105208536),
    (0.05, 2.0, 4000, 3026.296411329449, -1291.3060220469745, 57.64499334529745),
    (-0.1, 4.0, 4000, -3799.446092908455, -2385.4748885373065, -46.947824740532766),
    (-0.3, -8.0, 4000, -3852.5413913017182, 1712.9103114386708, -44.10867792328077),
    (0.2, -12.0, 4000, 2970.4907661809034, 2684.4585867385267, 49.3506641569585),
)

# alpha [rad], gamma [deg], Fz, Fx, Fy at kappa = 0 (magic-formula-tyre-library, whose side force is a function of
# alpha, not tan alpha)
CAMBERED = (
    (-0.21, -4, 2000, -30.04203835, 2423.536528),
    (0.042, -4, 2000, -95.30455754, -901.6651685),
    (-0.063, 4, 2000, -90.77777272, 1389.698003),
    (0.126, 4, 2000, -50.06390136, -2083.982376),
    (-0.063, -4, 4000, -136.3325318, 2963.291537),
    (0.126, -4, 4000, -75.18733076, -3457.84983),
    (-0.21, 4, 4000, -45.11795152, 4145.014126),
    (0.042, 4, 4000, -143.1309805, -2072.303624),
    (-0.21, -4, 6000, -38.11377939, 6185.619763),
    (0.042, -4, 6000, -120.9111325, -1807.776921),
    (-0.063, 4, 6000, -115.1680842, 2949.562446),
    (0.126, 4, 6000, -63.51514732, -5398.535475),
)


@pytest.fixture(scope='module')
def c() -> np.ndarray:
    return pack(BOOK, 61)


@pytest.mark.parametrize('row', UPRIGHT)
def test_upright_tire_at_combined_slip(c: np.ndarray, row: tuple[float, ...]) -> None:
    """Forces to the small numbers that the other program adds to denominators, the moment to its cos(alpha) = Vx/(V +
    0.1 m/s)."""
    kappa, alpha, Fz, fx, fy, mz = row
    r = forces(c, kappa=kappa, tan_alpha=np.tan(np.radians(alpha)), Fz=float(Fz), V=V0)
    assert r['fx'] == pytest.approx(fx, rel=1e-8)
    assert r['fy'] == pytest.approx(fy, rel=1e-8)
    arm = R0 * (BOOK['SSZ1'] + BOOK['SSZ2'] * fy / F0) * fx
    V = V0 / np.cos(np.radians(alpha))
    assert (r['mz'] - arm) * V / (V + 0.1) + arm == pytest.approx(mz, rel=1e-6)


@pytest.mark.parametrize('row', CAMBERED)
def test_cambered_tire_at_side_slip(c: np.ndarray, row: tuple[float, ...]) -> None:
    """To 1e-4 of the load."""
    alpha, gamma, Fz, fx, fy = row
    at = dict(gamma=np.radians(gamma), Fz=float(Fz), V=V0)
    assert forces(c, tan_alpha=np.tan(alpha), **at)['fx'] == pytest.approx(fx, rel=1e-8)
    assert forces(c, tan_alpha=alpha, **at)['fy'] == pytest.approx(fy, abs=1e-4 * Fz)
