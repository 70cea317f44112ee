"""Checks of vehicles: of road, tires and steering, and of what no vehicle can do whatever the equations say
(solver.analysis.impossible).

*Road.* A tire touches the road at one point. A wheel makes of a hollow that is rounder than itself, an edge above all,
a profile no rounder than itself (Pacejka 2012, 10.1.5); without that the point of contact jumps, and loads are many
times too large.
*Tires.* A tire cannot be pressed in by more than what is between its tread and the rim, without rim data than its
radius. Its spring and the rim go on beyond that, along straight lines that nobody has measured.
*Steering.* A steering ends at its stops, before its tie rods pass their dead centres (solver.vehicle.end_stops); there
it is held.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from solver.checks.check import Check, Evidence, Measured
from solver.elements.footprint import footprint
from solver.elements.road import RandomRoad, edge, envelops, too_large
from solver.inputs.maneuver import ManeuverSource

# rad: from there on tires lose their friction (docs/tire.md), and no car comes back onto its wheels
LEANING = math.radians(60.0)
# of the angle of the end stops; with ten times as much beyond them rods of many cars pass their dead centre
PRESSED = 1.05
BEFORE = 'No vehicle can do that: results are valid only before this time'


def steering_end(e: Evidence) -> Iterator[Measured]:
    """The angle of the steering wheel that a maneuver asks for beyond the end stops [rad]."""
    found = e.source.beyond_end(e.k) if isinstance(e.source, ManeuverSource) else None
    if found is not None:
        assert e.model.spec.lock is not None
        yield Measured(
            value=found[0], limit=e.model.spec.lock, time=found[1],
            reason='the maneuver asks for a steering wheel angle beyond the end stops of the steering, where it is '
            'held',
            remedy='Steer less, or give the vehicle its steering.lock',
        )  # fmt: skip


STEERING_END = Check(
    name='steering_end',
    unit='rad',
    rule='`steering.lock` of the vehicle, or where its tie rods come within 20 degrees of their dead centre: a '
    f'maneuver that asks for more is held there; of a motion, {PRESSED:g} times that',
    measure=steering_end,
    reason='the steering wheel is turned beyond its end stops, where no steering goes',
    remedy=BEFORE,
)


def road_curvature(e: Evidence) -> Iterator[Measured]:
    """The curvature of the roundest hollow that tires touch at one point [1/m]."""
    if not e.model.spec.tires:
        return
    base = footprint([tire.data for tire in e.model.spec.tires])
    assert base is not None
    road, worst, place, remedy = e.model.spec.road, 0.0, '', ''
    for k, (grid, enveloped) in enumerate(zip(road.grids, envelops(road, base), strict=True)):
        if enveloped or isinstance(grid, RandomRoad):
            continue  # the spectrum of a random road ends where the tire envelops
        found = edge(grid)
        if found.curvature > worst:
            worst, (i, j), (x, y) = found.curvature, found.node, found.place
            place = f'road.grids[{k}].height[{i}][{j}] at x = {x:.4g} m, y = {y:.4g} m'
            large = too_large(grid, base) if road.contact == 'auto' else ''
            remedy = (
                f'Take a part of the road ({large}), or give the profile that the wheel makes of the obstacle'
                if large
                else ''
            )
    yield Measured(value=worst, limit=1.0 / base.radius, where=place, remedy=remedy)


ROAD_CURVATURE = Check(
    name='road_curvature',
    unit='1/m',
    rule='1 over the radius of the wheels, of hollows in a grid of heights that tires touch at one point '
    '(`road.contact`)',
    measure=road_curvature,
    reason='a hollow of the road is rounder than the wheels',
    remedy='Take road.contact: enveloping, or give the profile that the wheel makes of the obstacle',
    plan='scene',
)


def tire_deflection(e: Evidence) -> Iterator[Measured]:
    """Largest deflection of a tire [m], of the tire that came furthest beyond its rim."""
    tires = e.model.spec.tires
    if e.state is None or not tires:
        return
    peaks = e.account.peak  # of tires alone
    walls = [tire.data.values['UNLOADED_RADIUS'] - tire.data.values.get('RIM_RADIUS', 0.0) for tire in tires]
    worst = int(np.argmax(peaks[:, 0] - np.array(walls)))
    value, time = peaks[worst].tolist()
    yield Measured(value=value, limit=walls[worst], time=time, where=tires[worst].name)


TIRE_DEFLECTION = Check(
    name='tire_deflection',
    unit='m',
    rule='radius of a tire less that of its rim (its whole radius where the file has no RIM_RADIUS), in every step: '
    'beyond that spring and rim go on along straight lines that mean nothing',
    measure=tire_deflection,
    reason='tire {where!r} is pressed in beyond its rim',
    remedy='The load of a tire means nothing there: load the tire less, or take one for such loads',
    plan='scene',
)
TIRE_LOAD = Check(
    name='tire_load',
    unit='N',
    rule="FZMAX of the tire's file, of the mean load of a second: friction and stiffness are held there; an edge or a "
    'landing may load it more for an instant',
    measure=None,
    reason='tire {where!r} carries more than its data cover, in the mean of a second',
    remedy='Its friction and stiffness are held at FZMAX: load the vehicle less, or take a tire for such loads',
    plan='scene',
)
ROLLOVER = Check(
    name='rollover',
    unit='rad',
    limit=LEANING,
    rule='how far the chassis of a vehicle leans from the normal of the road, in the instants '
    'that are looked at; nothing but tires touches the road',
    measure=None,
    reason='the vehicle rolls over: {where!r} leans to its side',
    remedy='Only tires touch the road in this model, and the body falls through it: results are valid only before that '
    'time',
    plan='scene',
)
ARTICULATION = Check(
    name='articulation',
    unit='rad',
    rule='a right angle between a trailer and its car, or less where its first wheels or its drawbar come between the '
    'wheels of the car',
    measure=None,
    reason='the trailer is folded into the car',
    remedy=BEFORE,
)
UNDER_ROAD = Check(
    name='under_road',
    unit='m',
    limit=0.0,
    rule='how far the centre of a wheel is below the road at its contact',
    measure=None,
    reason='the centre of wheel {where!r} is below the road',
    remedy=BEFORE,
)
SUSPENSION = Check(
    name='suspension',
    unit='m',
    rule='the unloaded radius of a wheel: how far its centre is from where it stands in its chassis by design',
    measure=None,
    reason='wheel {where!r} is further than its own radius from where it stands in its suspension',
    remedy=BEFORE,
)
WHEEL_AXIS = Check(
    name='wheel_axis',
    unit='rad',
    limit=0.5 * math.pi,
    rule='angle between the axis of a wheel and that of the vehicle',
    measure=None,
    reason='wheel {where!r} has turned inside out',
    remedy=BEFORE,
)
CROSSED = Check(
    name='crossed',
    unit='m',
    limit=0.0,
    rule='how far the left wheel of an axle is to the left of the right one',
    measure=None,
    reason='the left wheel {where!r} of an axle is to the right of the right one',
    remedy=BEFORE,
)
