"""A first look at a recording: see relations.py for how it is known what is told."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from mbd_sim_ros.analysis.look import car
from mbd_sim_ros.analysis.look.grid import Column, Grid
from mbd_sim_ros.analysis.look.relations import CHANNELS, Looking
from mbd_sim_ros.analysis.look.roles import role_of
from mbd_sim_ros.analysis.runs import units
from mbd_sim_ros.bags.reader import Run


@dataclass(frozen=True)
class Look:
    """The first look at a recording. mapping: ours -> column. side: how it is known which side is positive ('' where it
    is assumed)."""

    columns: tuple[Column, ...]
    mapping: Mapping[str, Column]
    side: str
    notes: tuple[str, ...]


def look(run: Run) -> Look:
    """Look at all columns of a recording."""
    unit_of = units(run)
    columns = []
    for name in (name for one in run.series.values() for name in one.columns):
        role = role_of(name)
        stated = run.stated.get(name, '') or (unit_of(name) if role.what else '')
        columns.append(Column(name, role, stated=stated))
    candidates = [c for c in columns if c.role.what]
    grid = Grid(run, candidates)
    found = Looking(grid, candidates)
    found.units()
    car.wheels(found)
    car.steering(found)
    car.sides(found, bool(run.metadata.get('resolved_scene')))
    mapping: dict[str, Column] = {}
    for c in candidates:
        ours = CHANNELS.get(
            c.role.what, f'joint_states/wheel_{c.role.corner}/velocity' if c.role.what == 'wheel' else ''
        )
        if c.role.what == 'wheel' and c.unit not in ('rad/s', 'rpm'):
            ours = ''
        if c.told and ours and c.name in found.chosen:
            if ours in mapping:
                c.why.append(f'{mapping[ours].name} fits it too and is taken')
            else:
                mapping[ours] = c
    return Look(tuple(columns), mapping, found.side, tuple(found.notes))
