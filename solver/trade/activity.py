"""Activity of the subsystems of a vehicle: the integral of |power| over a maneuver [Louca2010].

It orders what is tried first and decides nothing: it ignores the quantity that is asked for, and a stiff bushing with next to no
activity may decide compliance steer.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from solver import simulation_of
from solver.errors import MbdError
from solver.levels import derive
from solver.scene import Scene
from solver.trade.setting import Setting

STEP = 2e-3  # s


def of_elements(scene: Scene, until: float) -> dict[str, float]:
    """Element -> integral over time until [s] of |d(stored energy)/dt + dissipation| [J] in the full vehicle. Raises MbdError."""
    simulation = simulation_of(Setting(h=STEP, iterations=2).of(scene))
    names = [name.rpartition('/')[0] for name in simulation.channels.elements]
    energy, dissipation = (
        {
            element: k
            for k, (element, name) in enumerate(zip(names, simulation.channels.elements, strict=True))
            if name.endswith(f'/{column}')
        }
        for column in ('energy', 'dissipation')
    )
    columns = np.array([[energy[e], dissipation[e]] for e in energy], int).reshape(-1, 2)
    rows = [simulation.snapshot().elements[columns]]
    for _ in range(round(until / simulation.h)):
        rows.append(simulation.advance(1, audit=False).elements[columns])
    data = np.array(rows)
    power = np.diff(data[:, :, 0], axis=0) / simulation.h + 0.5 * (data[1:, :, 1] + data[:-1, :, 1])
    return dict(zip(energy, (np.abs(power).sum(axis=0) * simulation.h).tolist(), strict=True))


def of_subsystems(scene: Scene, until: float) -> dict[str, float]:
    """Subsystem that is on -> activity [J] of the elements that its switch removes; those that cannot be off are left out."""
    elements = of_elements(scene, until)
    found = {}
    there = [one.subsystem for one in derive(scene).report.switched if one.on]
    for subsystem in there:
        try:
            absent = derive(Setting(off=(subsystem,)).of(dataclasses.replace(scene, resolved=''))).report.absent
        except MbdError:
            continue
        removed = {name.partition(' ')[2] for name in absent}
        found[subsystem] = float(sum(elements.get(name, 0.0) for name in removed))
    return found
