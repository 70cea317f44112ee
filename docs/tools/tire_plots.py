"""Plot the steady-state characteristics of a tire: python docs/tools/tire_plots.py config/tires/205_55R16.tir
tire.png"""

from __future__ import annotations

import sys

import matplotlib

matplotlib.use('Agg')
import matplotlib.pyplot as plt
import numpy as np

from solver.elements.magic_formula import (
    camber_variable,
    load_increment,
    magic_formula,
    relaxation_lengths,
    slip_stiffness,
)
from solver.elements.tire_data import I, pack
from solver.files.tir import read_tir


def main(source: str, target: str) -> None:
    """Six panels over slip, slip angle and load, in the signs of docs/conventions.md."""
    data = read_tir(source)
    c = pack(data.values, data.version)
    F0 = c[I.FNOMIN]

    def law(kappa: float, alpha: float, Fz: float, gamma: float = 0.0) -> tuple[float, ...]:
        dfz, g = load_increment(c, Fz), camber_variable(c, np.sin(gamma), np.cos(gamma))
        K = slip_stiffness(c, g, Fz, dfz)
        return magic_formula(c, kappa, -np.tan(alpha), g, Fz, dfz, 1.0, c[I.LONGVL], *K, 1.0, 1.0)

    kappa, alpha, loads = (
        np.linspace(-0.5, 0.5, 201),
        np.radians(np.linspace(-15, 15, 201)),
        F0 * np.array([0.5, 1.0, 1.5]),
    )
    figure, axes = plt.subplots(2, 3, figsize=(15, 8), layout='constrained')
    for Fz in loads:
        label = f'Fz = {Fz:.0f} N'
        axes[0, 0].plot(kappa, [law(k, 0.0, Fz)[0] for k in kappa], label=label)
        axes[0, 1].plot(np.degrees(alpha), [law(0.0, a, Fz)[1] for a in alpha], label=label)
        axes[0, 2].plot(np.degrees(alpha), [law(0.0, a, Fz)[4] for a in alpha], label=label)
    for degrees in (0, 2, 4, 8):
        points = np.array([law(k, np.radians(degrees), F0)[:2] for k in np.linspace(-1, 1, 401)])
        axes[1, 0].plot(*points.T, label=f'alpha = {degrees} deg')
    for degrees in (-4, 0, 4):
        axes[1, 1].plot(
            np.degrees(alpha), [law(0.0, a, F0, np.radians(degrees))[1] for a in alpha], label=f'gamma = {degrees} deg'
        )
    Fz = np.linspace(0.05, 2.0, 100) * F0
    stiffness = [slip_stiffness(c, 0.0, F, load_increment(c, F)) for F in Fz]
    sigma = np.array(
        [relaxation_lengths(c, 0.0, F, load_increment(c, F), *K) for F, K in zip(Fz, stiffness, strict=True)]
    )
    axes[1, 2].plot(Fz, sigma[:, 0], label='sigma kappa [m]')
    axes[1, 2].plot(Fz, sigma[:, 1], label='sigma alpha [m]')
    titles = [('kappa [-]', 'Fx [N]'), ('alpha [deg]', 'Fy [N]'), ('alpha [deg]', 'Mz [N m]')]
    titles += [('Fx [N]', 'Fy [N]'), ('alpha [deg]', 'Fy [N]'), ('Fz [N]', 'relaxation length [m]')]
    for axis, (x, y) in zip(axes.flat, titles, strict=True):
        axis.set(xlabel=x, ylabel=y)
        axis.grid(alpha=0.3)
        axis.legend()
    figure.suptitle(data.name)
    figure.savefig(target, dpi=120)


if __name__ == '__main__':
    main(*sys.argv[1:3])
