"""One tire on a bench: a wheel in a given motion, and what the tire element says about it; and the law alone."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
from contract import ContractContext, Element, Result, forcing, kinematics
from interpreted import interpreted
from scipy.spatial.transform import Rotation

from solver.compiled.kernel import kernel
from solver.elements.magic_formula import camber_variable, load_increment, magic_formula, slip_stiffness
from solver.elements.marker import Marker
from solver.elements.point_pair import Kinematics
from solver.elements.road import FrictionPatch, HeightGrid, RoadSpec
from solver.elements.tire_data import TireData
from solver.elements.tire_pacejka import OUTPUTS, TireSpec, compile_tires, tire_forces
from solver.files.tir import read_tir

H = 1e-3  # s, step of what takes its time
ROOT = Path(__file__).resolve().parents[2]
CAR = read_tir(ROOT / 'config' / 'tires' / '205_55R16.tir')
EXAMPLE = read_tir(ROOT / 'test' / 'data' / 'externdata_225_50R17.tir')
SEDAN = read_tir(ROOT / 'test' / 'data' / 'chrono_245_40R18.tir')
FLAT = RoadSpec()
WAVES = tuple(tuple(0.02 * np.sin(1.3 * i + 0.7 * j) for j in range(6)) for i in range(7))
HILLY = RoadSpec(
    point=(0.0, 0.0, 0.01),
    normal=(0.1, -0.08, 1.0),
    friction=0.8,
    grids=(HeightGrid(origin=(-1.0, -1.0), step=(0.4, 0.5), height=WAVES),),
    patches=(FrictionPatch(center=(0.0, 0.0), size=(1.0, 0.8), factor=0.5, blend=0.6),),
)


class Tire(Element):
    """A tire whose tread has not given, where nothing else is said: zp may end before the last internal state."""

    def states(self, zp) -> tuple[float, ...]:
        """All internal states."""
        return (*zp, 0.0) if len(zp) == self.context.n_states - 1 else tuple(zp)

    def evaluate(self, kin: Kinematics, *, zp=(), **arguments) -> Result:
        """As Element.evaluate()."""
        return super().evaluate(kin, zp=self.states(zp), **arguments)


def tire(data: TireData = CAR, road: RoadSpec = FLAT, *, turn_slip: bool | None = False, **spec) -> Tire:
    """One tire on body b0, whose centre of mass lies off the wheel centre."""
    context = ContractContext(bodies=1, com=[(0.02, -0.01, 0.03)], road=road)
    table = compile_tires(
        [TireSpec(name='tire', marker=Marker(body='b0'), data=data, turn_slip=turn_slip, **spec)], context
    )
    return Tire(forcing(tire_forces, table, context.laws()), context, n=1, outputs=OUTPUTS)


@functools.cache
def _turned(yaw: float, camber: float, pitch: float) -> np.ndarray:
    """The rotation matrix; kept, for scipy takes longer than a tire."""
    return Rotation.from_euler('ZXY', [yaw, camber, pitch]).as_matrix()


def wheel(
    *,
    position=(0.0, 0.0, 0.3),
    velocity=(0.0, 0.0, 0.0),
    spin=0.0,
    yaw=0.0,
    camber=0.0,
    pitch=0.0,
    rates=(0.0, 0.0, 0.0),
) -> Kinematics:
    """A wheel by the position and velocity of its centre [m, m/s, in W], spin and other rates in the wheel's axes
    [rad/s]."""
    R = _turned(yaw, camber, pitch)
    x, y, z = w = np.array(rates) + [0.0, spin, 0.0]
    com = np.array([0.02, -0.01, 0.03])
    turning = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])  # np.cross takes five times as long
    return kinematics([(np.array(position) + R @ com, R)], [(*(np.array(velocity) + R @ (turning @ com)), *w)])


def value(element: Element, result: Result, name: str) -> float:
    return float(element.output(result, name)[0])


def settled(element: Element, kin: Kinematics) -> Result:
    """The steady state: an implicit step so long that the contact deflections have relaxed."""
    return element.evaluate(kin, zp=(0.0, 0.0), cz=1e6)


def march(element: Element, kin: Kinematics, steps: int, z=(0.0, 0.0), h: float = H) -> list[Result]:
    """Internal states by implicit Euler along a frozen motion."""
    results = []
    for _ in range(steps):
        results.append(element.evaluate(kin, zp=z, cz=h))
        z = tuple(results[-1].z)
    return results


def drop(
    element: Element,
    *,
    mass: float,
    gravity,
    seconds: float,
    velocity=(0.0, 0.0, 0.0),
    height: float = 0.297,
    h: float = H,
):
    """A wheel that cannot rotate, free to translate, by linearly implicit Euler; returns positions, velocities, outputs
    over time."""
    x, v, z = np.array([0.0, 0.0, height]), np.array(velocity, float), (0.0, 0.0)
    trace = []
    for _ in range(int(seconds / h)):
        r = element.evaluate(wheel(position=x, velocity=v), zp=z, cz=h, tangents=True)
        K, D = r.Kq[:3, :3], r.Kv[:3, :3]
        v = v + np.linalg.solve(
            mass * np.eye(3) - h * D - h * h * K, h * (r.f[0, :3] + mass * np.array(gravity) + h * K @ v)
        )
        x = x + h * v
        end = element.evaluate(wheel(position=x, velocity=v), zp=z, cz=h)
        z = tuple(end.z)
        trace.append((x.copy(), v.copy(), end))
    return trace


def load_at(element: Element, z: float, rise: float = 0.0) -> float:
    """Load [N] of an upright wheel with its centre at height z [m] that rises at `rise` [m/s]."""
    return value(element, element.evaluate(wheel(position=(0, 0, z), velocity=(0, 0, rise)), zp=(0, 0)), 'fz')


@kernel
def evaluate(c, kappa, tan_alpha, gamma, Fz, mu, V, forward, twist):
    dfz = load_increment(c, Fz)
    g = camber_variable(c, np.sin(gamma), np.cos(gamma))
    Kx, Ky = slip_stiffness(c, g, Fz, dfz)
    return magic_formula(c, kappa, tan_alpha, g, Fz, dfz, mu, V, Kx, Ky, forward, 1.0, twist)


def forces(
    c: np.ndarray, *, kappa=0.0, tan_alpha=0.0, gamma=0.0, Fz=4000.0, mu=1.0, V=16.7, forward=1.0, twist=0.0
) -> dict[str, float]:
    """Forces and moments by name, in the axes of the file; twist: R0 phi_t. Of complex numbers by the source of the
    law."""
    given = (kappa, tan_alpha, gamma, Fz, mu, V, forward, twist)
    law = interpreted(evaluate) if any(map(np.iscomplexobj, given)) else evaluate
    return dict(zip(('fx', 'fy', 'mx', 'my', 'mz'), law(c, *given), strict=True))
