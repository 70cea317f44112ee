"""Rolling out: how a car without drive and brakes slows down, between two speeds."""

from __future__ import annotations

from dataclasses import dataclass

from mbd_sim_ros.analysis.evaluation.figures import Chart, Curve, Figure, Result
from mbd_sim_ros.analysis.evaluation.kinds import Drive, Evaluation
from mbd_sim_ros.analysis.evaluation.measures import crossing
from mbd_sim_ros.analysis.evaluation.signals import Signals


@dataclass(frozen=True, kw_only=True)
class Coasting:
    """above, below: speeds between which it is measured [m/s]. most: deceleration that is allowed [m/s^2]."""

    above: float = 20.0
    below: float = 15.0
    most: float = 0.5


def judge(s: Signals, p: Coasting) -> Result:
    """Mean deceleration. Raises BagError."""
    if s['speed'].max() < p.above or s['speed'].min() > p.below:
        raise s.refuse(f'does not roll out from {p.above:g} to {p.below:g} m/s')
    begin, end = (crossing(s.t, -s['speed'], -v) for v in (p.above, p.below))
    found = (p.above - p.below) / (end - begin)
    limit = f'<= {p.most:g} m/s^2'
    return Result(
        evaluation='coasting', title='Rolling out', norm='our own',
        figures=(Figure('deceleration', 'mean deceleration', found, 'm/s^2', limit, found <= p.most),),
        charts=(Chart(title='speed', x=('time', 's'), y=('speed', 'm/s'), curves=(Curve('speed', s.t, s['speed']),)),),
        notes=tuple(s.notes), source=s.place,
    )  # fmt: skip


COASTING = Evaluation(
    name='coasting',
    title='rolling out: mean deceleration',
    norm='our own',
    needs=('speed',),
    parameters=Coasting,
    judge=judge,
    drive=Drive(maneuver='straight_ahead', speed=22.0, duration=40.0),
)
