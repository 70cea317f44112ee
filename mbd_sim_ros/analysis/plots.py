"""Pictures of comparisons, drawn without a display."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from mbd_sim_ros.analysis.comparison import Comparison
from solver.errors import BagError

SHOWN = 6
FIRST, SECOND = '#d95f02', '#1b6ca8'  # run, reference; apart for colour-blind eyes too
GREY = '#555555'
STYLE: dict = {
    'font.size': 9,
    'axes.grid': True,
    'grid.color': '#e4e4e4',
    'axes.spines.top': False,
    'axes.spines.right': False,
}


def plot_comparison(comparison: Comparison, file: Path, *, names: tuple[str, str] = ('run', 'reference')) -> None:
    """Draw the worst channels: both curves on the left, their difference on the right.

    Raises BagError when the file cannot be written.
    """
    shown = comparison.differences[:SHOWN]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11.0, 0.7 + 1.9 * len(shown)), layout='constrained')
        FigureCanvasAgg(figure)
        axes = figure.subplots(len(shown), 2, squeeze=False, sharex=True, width_ratios=(3, 2))
        for (left, right), d in zip(axes, shown, strict=True):
            c = comparison.curves(d.channel)
            if c.half is not None:
                left.fill_between(c.time, c.reference - c.half, c.reference + c.half, color=SECOND, alpha=0.25, lw=0)
            left.plot(c.time, c.reference, color=SECOND, lw=1.6, label=names[1])
            left.plot(c.time, c.run, color=FIRST, lw=1.0, ls=(0, (5, 3)), label=names[0])
            left.set_title(d.channel + (f' [{d.unit}]' if d.unit not in ('', '1') else ''), loc='left', fontsize=9)
            right.plot(c.time, c.difference, color=GREY, lw=0.9)
            right.set_title(
                f'difference: max {d.max:.3g} at {d.time:g} s, RMS {d.rms:.3g}' + ('' if d.ok else '  OUTSIDE'),
                loc='left',
                fontsize=9,
            )
            for ax in (left, right):
                ax.margins(x=0.01)
                ax.ticklabel_format(axis='y', useOffset=False, scilimits=(-3, 4))
        for ax in axes[-1]:
            ax.set_xlabel('time [s]')
        axes[0][0].legend(loc='upper right', fontsize=8, ncols=2, frameon=False, bbox_to_anchor=(1.0, 1.25))
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            figure.savefig(file, dpi=110, format=file.suffix[1:] or 'png')  # else a name without ending gets one
        except (OSError, ValueError) as error:
            raise BagError(f'cannot write the picture {file}: {getattr(error, "strerror", None) or error}') from None
