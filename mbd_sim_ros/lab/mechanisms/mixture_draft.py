"""A mechanism while it is drawn: bodies at random places, joints with both markers at one place of the world, text for
a scene."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from mbd_sim_ros.lab.mechanisms.maximal import Maximal
from solver.units import MODEL_GRAVITY

DURATION = 1.0  # s
# rad/s: what a spring makes of its body alone, at most, and in three of four; a thousand is a radian in a step of 1 ms
FASTEST, MOSTLY = 1000.0, 120.0


class Draft:
    """A mechanism while it is drawn. size [m], mass [kg], time [s]: its scales."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.size, self.mass, self.time = (
            10.0 ** rng.uniform(-3, 1),
            10.0 ** rng.uniform(-6, 3),
            10.0 ** rng.uniform(-0.6, 0.3),
        )
        # centre, axes, centre in the frame of the file
        self.places: dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}
        self.data: dict[str, Any] = {'gravity': self._gravity(), 'bodies': {}, 'joints': {}}
        self.maneuver: dict[str, Any] = {}
        self.parts: list[str] = []

    def _gravity(self) -> list[float]:
        if self.size > 0.2 and self.rng.random() < 0.5:
            return [0.0, 0.0, -MODEL_GRAVITY]  # as models have it
        return (self.direction() * self.size / self.time**2 * self.rng.uniform(0.0, 2.0)).tolist()

    def direction(self) -> np.ndarray:
        v = self.rng.normal(size=3)
        return v / np.linalg.norm(v)

    def across(self, v: np.ndarray) -> np.ndarray:
        """A random direction perpendicular to one."""
        u = np.cross(v, self.direction())
        return u / np.linalg.norm(u)

    def place(self) -> np.ndarray:
        return self.rng.uniform(-1, 1, 3) * self.size

    def body(self, centre: np.ndarray, axes: np.ndarray | None = None, half: Sequence[float] | None = None) -> str:
        """A body that is a solid ellipsoid with these half axes, about half the size of the mechanism where they are
        not given."""
        rng, name = self.rng, f'b{len(self.places)}'
        R = Rotation.random(random_state=rng.integers(2**31)).as_matrix() if axes is None else axes
        a, b, c = rng.uniform(0.05, 0.5, 3) * self.size if half is None else half
        mass = self.mass * 10.0 ** rng.uniform(-0.7, 0.7)
        own = Rotation.random(random_state=rng.integers(2**31)).as_matrix() if half is None else np.eye(3)
        inertia = own @ np.diag([b * b + c * c, a * a + c * c, a * a + b * b]) @ own.T * mass / 5.0
        com = rng.normal(size=3) * 0.2 * self.size if rng.random() < 0.7 else np.zeros(3)
        self.places[name] = centre, R, com
        self.data['bodies'][name] = {
            'mass': float(mass),
            'inertia': [float(inertia[k]) for k in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))],
            'com': com.tolist(),
            'position': (centre - R @ com).tolist(),
            'orientation': Rotation.from_matrix(R).as_quat().tolist(),
        }
        return name

    def joint(self, kind: str, i: str, j: str, at: np.ndarray, axis: np.ndarray | None = None) -> str:
        """A joint with both markers at one place; its axes are random where they are not given."""
        name = f'{kind}_{len(self.data["joints"])}'
        z = self.direction() if axis is None else axis
        self.data['joints'][name] = {
            'kind': kind, 'i': i, 'j': j, 'at': at.tolist(), 'axis': z.tolist(), 'x_axis': self.across(z).tolist(),
        }  # fmt: skip
        return name

    def add(self, section: str, element: dict[str, Any]) -> str:
        found = self.data.setdefault(section, {})
        name = f'{section}_{len(found)}'
        found[name] = element
        return name

    def rate(self, slowest: float, part: float = 1.0) -> float:
        """Angular frequency of a spring [rad/s], by ratio between the slowest, times 1 / time, and part of the
        fastest."""
        fastest = part * (FASTEST if self.rng.random() < 0.25 else MOSTLY)
        return float(10.0 ** self.rng.uniform(np.log10(slowest / self.time), np.log10(fastest)))

    def base(self) -> str:
        """The world, or a body that is there."""
        return str(self.rng.choice(['world', 'world', *self.places]))

    def two(self) -> tuple[str, str]:
        """Two of the bodies and the world."""
        i, j = self.rng.choice(['world', *self.places], 2, replace=False)
        return (str(j), str(i)) if j == 'world' else (str(i), str(j))

    def coordinates(self) -> list[tuple[str, bool]]:
        """Names of joint coordinates, and whether they are angles."""
        out = []
        for name, joint in self.data['joints'].items():
            if joint['kind'] in ('revolute', 'prismatic'):
                out.append((name, joint['kind'] == 'revolute'))
            elif joint['kind'] == 'cylindrical':
                out += [(f'{name}/angle', True), (f'{name}/slide', False)]
        return out

    def text(self) -> str:
        maneuver = {'maneuver': {'signals': self.maneuver}} if self.maneuver else {}
        return yaml.safe_dump({'mechanism': self.data, **maneuver, 'duration': DURATION}, sort_keys=False)

    def freedoms(self) -> tuple[int, int]:
        """Freedoms of velocity, and the rank of all rows."""
        maximal = Maximal(self.text())
        return maximal.freedoms, maximal.rank

    def keep(self, section: str, element: dict[str, Any], signal: dict[str, Any] | None = None) -> bool:
        """Add an element with rows where it takes a freedom and does not take the last one; a driver may take it."""
        _, before = self.freedoms()
        name = self.add(section, element)
        if signal is not None:
            self.maneuver[element['input']] = signal
        free, rank = self.freedoms()
        if rank > before and free >= (0 if signal else 1):
            return True
        del self.data[section][name]
        if not self.data[section]:
            del self.data[section]
        if signal is not None:
            del self.maneuver[element['input']]
        return False
