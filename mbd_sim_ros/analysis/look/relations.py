"""Roles of columns by their dependence on each other: the relations of the first look, and the units and signs that fit
all of them.

Names only propose (roles.py). A unit is told where the data confirm it: quantities of a car depend on each other, and
every relation

    ay = v r (steady cornering)          ax = dv/dt          r = d(yaw)/dt          v = |d(x, y)/dt|          beta =
                                         atan(vy / v)

has a factor that is 1 in SI units. The factor that is found allows some combinations of units only; a column is told
its unit where all combinations that fit every relation agree in it. Signs follow from the signs of the factors. To
which side the lateral ones are positive no relation among them tells, for all of them may be turned; wheel speeds left
and right do, and the wheel that is steered more (car.py).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from mbd_sim_ros.analysis.look.grid import LEAST, MOVING, SAMPLES, Column, Fit, Grid
from solver.units import UNITS

CHANNELS = {'yaw_rate': 'imu/wz', 'speed': 'odom/twist/vx', 'vy': 'odom/twist/vy', 'ax': 'imu/ax', 'ay': 'imu/ay',
'az': 'imu/az',
            'steering': 'cmd_applied/steering', 'x': 'odom/pose/x', 'y': 'odom/pose/y'}  # fmt: skip
SPEEDS, RATES, ACCELERATIONS, ANGLES = ('m/s', 'km/h', 'mph', 'kn'), ('rad/s', 'deg/s'), ('m/s^2', 'g'), ('rad', 'deg')
LENGTHS = ('m', 'mm', 'cm', 'ft', 'km')
OPTIONS = {'speed': SPEEDS, 'vy': SPEEDS, 'yaw_rate': RATES, 'ax': ACCELERATIONS, 'ay': ACCELERATIONS,
'az': ACCELERATIONS,
           'yaw': ANGLES, 'sideslip': ANGLES, 'steering': ANGLES, 'road_angle': ANGLES, 'x': LENGTHS, 'y': LENGTHS,
           'wheel': (*SPEEDS, 'rad/s', 'rpm')}  # fmt: skip
TEXTS = {'speed': 'speed along the car', 'vy': 'speed to the '
    'side', 'yaw_rate': 'yaw rate', 'ax': 'longitudinal acceleration',
         'ay': 'lateral acceleration', 'az': 'vertical acceleration', 'yaw': 'yaw angle', 'sideslip': 'sideslip angle',
         'steering': 'steering', 'road_angle': 'steering angle of a road wheel', 'x': 'place', 'y': 'place',
         'wheel': 'wheel speed'}  # fmt: skip
LEFT_POSITIVE = ('yaw_rate', 'ay', 'yaw', 'steering', 'road_angle', 'vy', 'sideslip')  # quantities with a side
CORRELATION = 0.8  # least one of a relation that counts; less than half of the variance is then something else
FIT = 0.25  # most of |ln(factor / expected)|; factors of units are apart by 0.48 and more, but mph and kn
SLOW = 0.4  # s, the same for ax = dv/dt, whose noise is that of the body
TURNING = 0.3  # part of the largest lateral acceleration above which ax holds what cornering adds to it
AMONG = 2  # candidates of a role whose combinations are tried, at most, beyond the first


class Relation(NamedTuple):
    """A relation between columns. powers: with which the units of the columns enter its factor."""

    text: str
    fit: Fit
    powers: Mapping[str, int]


class Looking:
    """The state of a look: columns by role, relations, what was found."""

    def __init__(self, grid: Grid, candidates: Sequence[Column]) -> None:
        self.grid = grid
        self.by_role: dict[str, list[Column]] = {}
        self.side = ''
        self.left = 1  # sign of the column of the yaw rate, positive to the left
        self.notes: list[str] = []
        self.chosen: set[str] = set()
        self.signs: dict[str, int] = {}  # lateral column -> its sign relative to that of the yaw rate as it is
        self.path: np.ndarray | None = None
        for c in candidates:
            if c.name not in grid:
                c.why.append(
                    f'{TEXTS[c.role.what]} by its name, but it holds fewer than {SAMPLES} numbers, or its times meet '
                    'no others'
                )
            elif not grid.changes(c.name):
                c.why.append(f'{TEXTS[c.role.what]} by its name, but it never changes')
            else:
                self.by_role.setdefault(c.role.what, []).append(c)
        for what, group in self.by_role.items():
            group.sort(key=lambda c: c.name != CHANNELS.get(what))  # of those that fit alike the one with our name

    def first(self, what: str) -> Column | None:
        """The column taken for a role."""
        return next((c for c in self.by_role.get(what, []) if c.name in self.chosen), None)

    def options(self, c: Column) -> tuple[str, ...]:
        """Units that a column may have: the one stated in the header, else the one in its name, else all of its
        role."""
        known = c.stated or c.role.unit
        if known:
            return (known,) if known in UNITS and UNITS[known][0] in {UNITS[u][0] for u in OPTIONS[c.role.what]} else ()
        wrapped = self.grid.wraps.get(c.name, '')
        return (wrapped,) if wrapped else OPTIONS[c.role.what]

    def units(self) -> None:
        """Choose one column for every role and find the units that fit all relations."""
        self._choose()
        relations = self._relations()
        names = {name for r in relations for name in r.powers}
        by_name = {c.name: c for group in self.by_role.values() for c in group}
        options = {name: self.options(by_name[name]) for name in names}
        for name in [name for name in names if not options[name]]:
            by_name[name].why.append(
                f'its header says {by_name[name].stated!r}, which is no unit of a {TEXTS[by_name[name].role.what]}'
            )
        good = []
        for r in relations:
            if abs(r.fit.correlation) >= CORRELATION and all(options[name] for name in r.powers):
                good.append(r)
                continue
            for name in r.powers:
                by_name[name].against.append(f'{r.text} does not hold ({r.fit.text})')
        fits = {'': _fitting(good, options)}
        if not fits['']:  # one of the columns is not what it is called, or what its header says; which one, may be open
            found = sorted({name for r in good for name in r.powers})
            fits = {
                name: one for name in found if (one := _fitting([r for r in good if name not in r.powers], options))
            }
        accepted = [r for r in good if '' in fits or not any(name in fits for name in r.powers)]
        for r in good:
            for name in r.powers:
                if r in accepted:
                    by_name[name].why.append(f'{r.text}: {r.fit.text}')
                else:
                    by_name[name].against.append(f'{r.text} holds in no unit, or others do not ({r.fit.text})')
        for name in {name for r in accepted for name in r.powers}:
            left = sorted({one[name] for assignments in fits.values() for one in assignments if name in one})
            everywhere = all(name in one for assignments in fits.values() for one in assignments)
            if len(left) == 1 and everywhere:
                by_name[name].unit = left[0]
            else:
                by_name[name].against.append(f'its unit is not told: {" or ".join(left)}')
        self._signs(accepted)

    def _choose(self) -> None:
        """Choose among several columns for a role those that fit best together."""
        g = self.grid
        best: tuple[float, tuple[Column, ...]] = (0.0, ())
        roles = [self.by_role.get(what, [])[: 1 + AMONG] for what in ('speed', 'yaw_rate', 'ay')]
        for v, r, ay in itertools.product(*roles):
            fit = g.fit(g.of(v.name) * g.of(r.name), g.of(ay.name))
            best = max(best, (round(abs(fit.correlation), 3), (v, r, ay)), key=lambda one: one[0])
        self.chosen = {c.name for c in best[1]}
        for what, group in self.by_role.items():
            if what in ('wheel', 'road_angle'):
                self.chosen |= {c.name for c in group}
            elif self.first(what) is None:
                self.chosen.add(group[0].name)

    def _relations(self) -> list[Relation]:
        g, found = self.grid, []
        v, r, ay, ax, yaw = (self.first(what) for what in ('speed', 'yaw_rate', 'ay', 'ax', 'yaw'))
        x, y, vy, beta = (self.first(what) for what in ('x', 'y', 'vy', 'sideslip'))
        ways = [(v.name, g.of(v.name), g.of(v.name, SLOW))] if v else []
        if x and y:
            self.path = np.hypot(g.rate(g.of(x.name)), g.rate(g.of(y.name)))
            ways.append((x.name, self.path, np.hypot(g.rate(g.of(x.name, SLOW)), g.rate(g.of(y.name, SLOW)))))
            if v:
                found.append(
                    Relation(
                        f'{v.name} = |d({x.name}, {y.name})/dt|',
                        g.ratio(self.path, np.abs(g.of(v.name))),
                        {x.name: 1, v.name: -1},
                    )
                )
        for name, speed, slow in ways:
            if r and ay:
                found.append(
                    Relation(
                        f'{ay.name} = {"speed along " if x and name == x.name else ""}{name} * {r.name}',
                        g.fit(speed * g.of(r.name), g.of(ay.name)),
                        {name: 1, r.name: 1, ay.name: -1},
                    )
                )
            if ax:
                text = f'{ax.name} = d({"speed along " if x and name == x.name else ""}{name})/dt'
                along = g.rate(slow)
                if r:
                    turn = np.abs(speed * g.of(r.name))
                    along = np.where(turn < TURNING * np.nanmax(turn), along, np.nan)
                found.append(Relation(text, g.fit(along, g.of(ax.name, SLOW)), {name: 1, ax.name: -1}))
        if yaw and r:
            found.append(
                Relation(
                    f'{r.name} = d({yaw.name})/dt',
                    g.fit(g.rate(g.of(yaw.name)), g.of(r.name)),
                    {yaw.name: 1, r.name: -1},
                )
            )
        if yaw and x and y and self.path is not None:
            self._course(yaw, x, y)
        if beta and v and vy:
            slip = np.arctan2(g.of(vy.name), g.of(v.name))
            found.append(
                Relation(f'{beta.name} = atan({vy.name} / {v.name})', g.fit(slip, g.of(beta.name)), {beta.name: -1})
            )
        for what, group in self.by_role.items():
            one = self.first(what)
            if what in ('wheel', 'road_angle', 'x', 'y', 'az', 'steering') or one is None:
                continue
            for c in group:
                if c is not one:
                    self.chosen.discard(c.name)
                    way = g.ratio if what == 'speed' else g.fit
                    found.append(
                        Relation(f'{c.name} = {one.name}', way(g.of(one.name), g.of(c.name)), {one.name: 1, c.name: -1})
                    )
        return found

    def _course(self, yaw: Column, x: Column, y: Column) -> None:
        """The unit of the yaw angle by the direction of travel, where the car goes along its own axis."""
        g = self.grid
        assert self.path is not None
        going = self.path > MOVING * np.nanmax(self.path)
        course = np.arctan2(g.rate(g.of(y.name)), g.rate(g.of(x.name)))[going]
        angle = g.of(yaw.name)[going]
        good = np.isfinite(course) & np.isfinite(angle)
        fits = []
        for unit in self.options(yaw):
            apart = np.exp(1j * (course[good] - UNITS[unit][1] * angle[good]))
            if good.sum() >= LEAST and abs(np.mean(apart)) > 0.95 and abs(np.angle(np.mean(apart))) < 0.2:
                fits.append(unit)
        if len(fits) == 1:
            self.grid.wraps[yaw.name] = fits[0]
            yaw.why.append(f'it is the direction of travel in ({x.name}, {y.name}) in {fits[0]}')

    def _signs(self, accepted: Sequence[Relation]) -> None:
        by_name = {c.name: c for group in self.by_role.values() for c in group}
        v, r = self.first('speed'), self.first('yaw_rate')
        if v and v.unit:
            values = self.grid.of(v.name)
            mostly = np.nanmedian(values[np.abs(values) > MOVING * np.nanmax(np.abs(values))])
            v.sign = 1 if mostly > 0.0 else -1
        forward = v.sign if v and v.sign else 1
        for c in (c for what in ('x', 'y') for c in self.by_role.get(what, [])):
            if self.first('x') and (unit := self.first('x').unit):  # type: ignore[union-attr]
                c.unit, c.sign = unit, 1
                if not c.why:
                    c.why.append(f'as {self.first("x").name}')  # type: ignore[union-attr]
        for rel in sorted(
            accepted, key=lambda rel: len({by_name[name].role.what for name in rel.powers}) == 1 < len(rel.powers)
        ):
            sign = 1 if rel.fit.correlation > 0.0 else -1
            names = list(rel.powers)
            whats = {by_name[name].role.what for name in names}
            target = by_name[next(name for name in names if rel.powers[name] < 0)]
            if target.role.what == 'ax':
                target.sign = sign * (forward if v and v.name in names else 1)
            elif target.role.what == 'ay':
                self.signs[target.name] = sign * (forward if v and v.name in names else 1)
                self.signs.setdefault(r.name, 1)  # type: ignore[union-attr]
            elif target.role.what == 'yaw_rate' and 'yaw' in whats:
                self.signs.setdefault(target.name, 1)
                self.signs[next(n for n in names if by_name[n].role.what == 'yaw')] = sign
            elif len(whats) == 1:
                other = next((name for name in names if name != target.name), target.name)
                if target.role.what in LEFT_POSITIVE and other in self.signs:
                    self.signs[target.name] = sign * self.signs[other]
                elif target.role.what == 'speed':
                    target.sign = sign * forward
        self._lateral_speed()

    def _lateral_speed(self) -> None:
        """vy by the part of ay that is dvy/dt, in the unit of the speed; the sideslip angle goes with it."""
        g = self.grid
        v, r, ay, vy, beta = (self.first(what) for what in ('speed', 'yaw_rate', 'ay', 'vy', 'sideslip'))
        if vy is None:
            return
        if not (v and r and ay and v.unit and r.unit and ay.unit and v.unit in self.options(vy)):
            vy.why.append('speed to the side by its name; nothing to check it against')
            return
        turn = UNITS[v.unit][1] * UNITS[r.unit][1] * g.of(v.name) * g.of(r.name)
        pushed = UNITS[ay.unit][1] * self.signs.get(ay.name, 1) * (v.sign or 1) * g.of(ay.name)
        more = UNITS[v.unit][1] * g.rate(g.of(vy.name))
        alone = abs(g.fit(turn, pushed).correlation)
        both = {s: abs(g.fit(turn + s * more, pushed).correlation) for s in (1, -1)}
        sign = max(both, key=lambda s: both[s])
        if 1.0 - both[sign] ** 2 < 0.7 * (1.0 - alone**2):
            vy.unit, self.signs[vy.name] = v.unit, sign
            vy.why.append(
                f'with its derivative {ay.name} is explained better: correlation {both[sign]:.4f} instead of '
                f'{alone:.4f}; its unit is taken as that of {v.name}'
            )
            if beta is not None and beta.unit:
                slip = g.fit(np.arctan2(g.of(vy.name), g.of(v.name)), g.of(beta.name))
                self.signs[beta.name] = sign * (1 if slip.correlation > 0 else -1)
        else:
            vy.why.append(
                f'speed to the side by its name; what it adds to {ay.name} is too little to tell unit and sign'
            )


def _fitting(relations: Sequence[Relation], options: Mapping[str, Sequence[str]]) -> list[dict[str, str]]:
    """The units of all columns, in every combination with which all relations hold."""
    feasible: list[dict[str, str]] = [{}]
    for r in sorted(relations, key=lambda r: -abs(r.fit.correlation)):
        fresh = [name for name in r.powers if name not in feasible[0]]
        chosen = [dict(zip(fresh, units)) for units in itertools.product(*(options[name] for name in fresh))]
        feasible = [whole for one in feasible for more in chosen if abs(_off(r, whole := {**one, **more})) <= FIT]
        if not feasible:
            break
    return feasible


def _off(r: Relation, chosen: Mapping[str, str]) -> float:
    """ln of the factor of a relation over the one that the units ask for."""
    expected = sum(power * math.log(UNITS[chosen[name]][1]) for name, power in r.powers.items())
    return math.log(abs(r.fit.factor)) - expected
