"""Plot the road that a tire makes of obstacles: python docs/tools/enveloping_plots.py TIRE.tir
docs/pictures/enveloping.png"""

from __future__ import annotations

import sys

import matplotlib

matplotlib.use('Agg')
import matplotlib.pyplot as plt
import numpy as np

from solver.elements.enveloping import Heights, effective
from solver.elements.footprint import footprint
from solver.files.tir import read_tir

OBSTACLES = {'strip, 50 mm': (0.05, 0.0, 0.05), 'pothole, 60 mm': (-0.06, 0.0, 0.5), 'kerb, 100 mm': (0.1, 0.0, 9.0)}


def main(source: str, target: str) -> None:
    """For each obstacle the road, the basic curve (a base without length) and the effective road, and below it its
    slope."""
    tire = footprint([read_tir(source)])
    assert tire is not None
    figure, axes = plt.subplots(2, 3, figsize=(13, 5.5), layout='constrained', sharex='col', height_ratios=(3, 2))
    x = np.arange(-0.8, 1.3, 0.002)
    for (name, (height, begin, end)), (above, below) in zip(OBSTACLES.items(), axes.T, strict=True):
        road = np.where((x > begin - 1e-9) & (x < end + 1e-9), height, 0.0)
        grid = Heights((float(x[0]), 0.0), (0.002, 4.0), 0.0, np.repeat(road[:, None], 2, 1))
        above.fill_between(x, 1e3 * road, -70.0, color='0.85')
        for label, footing in (('basic curve of a cam', tire._replace(length=0.004)), ('effective road', tire)):
            found = effective(grid, footing, name)
            at = found.origin[0] + found.step[0] * np.arange(found.height.shape[0])
            above.plot(at, 1e3 * found.height[:, 0], label=label)
        below.plot(at, np.gradient(found.height[:, 0], found.step[0]), color='C1')
        above.set(title=name, ylabel='height [mm]', ylim=(-70.0, 115.0))
        below.set(ylabel='effective slope', xlabel='x [m]', xlim=(-0.6, 0.9), ylim=(-0.8, 0.8))
        below.grid(alpha=0.3)
    axes[0, 0].legend(loc='upper left', fontsize=8)
    figure.savefig(target, dpi=80)


if __name__ == '__main__':
    main(*sys.argv[1:])
