"""Footprints of the tires of a model, which envelop its road."""

from __future__ import annotations

import math
from collections.abc import Sequence

from solver.elements.enveloping import Footprint
from solver.elements.tire_data import DEFAULT_WIDTH, TireData


def footprint(tires: Sequence[TireData]) -> Footprint | None:
    """The base and the cams of the smallest of the tires, whose obstacles are the hardest; None where there is no tire.

    Half length and width of the base at nominal load from the contact patch [Besselink2010], the length scaled by
    ELLIPS_SHIFT.
    """
    if not tires:
        return None
    tire = min(tires, key=lambda data: data['UNLOADED_RADIUS'])
    R0 = tire['UNLOADED_RADIUS']
    pressed = tire['FNOMIN'] / (tire['VERTICAL_STIFFNESS'] * R0)
    length = R0 * (tire['Q_RA1'] * math.sqrt(pressed) + tire['Q_RA2'] * pressed)
    width = tire['WIDTH'] if tire['WIDTH'] > 0.0 else DEFAULT_WIDTH * R0
    half_width = width * (tire['Q_RB1'] * pressed ** (1.0 / 3.0) + tire['Q_RB2'] * pressed)
    return Footprint(
        radius=R0,
        length=max(2.0 * tire['ELLIPS_SHIFT'] * length, 0.05 * R0),
        width=min(max(2.0 * half_width, 0.2 * width), width),
        cam_length=tire['ELLIPS_LENGTH'] * R0,
        cam_height=tire['ELLIPS_HEIGHT'] * R0,
        order=tire['ELLIPS_ORDER'],
    )
