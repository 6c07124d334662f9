"""Designs of experiments: where a trial tells most, and how power grows."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes

from .style import COLOURS, LINES, MARKERS, axes_or_new, drawable, figure_of, legend_above, styled

if TYPE_CHECKING:
    import pandas as pd

    from ..design.power_analysis import Power

#: What the columns of `information` are about.
ABOUT = {"weber_fraction": "k", "jnd": "the JND", "hypothesis": "the hypothesis"}


@styled
def information(
    table: pd.DataFrame, ax: Axes | None = None, *, about: str = "weber_fraction"
) -> Axes:
    """Information of one trial over standard and offset, millibits; a ring where it is greatest.

    Parameters
    ----------
    table : DataFrame
        From `weberwhisk.design.information`.
    ax : Axes, optional
    about : {"weber_fraction", "jnd", "hypothesis"}

    Examples
    --------
    >>> from weberwhisk.behaviour import IdentityPercept
    >>> from weberwhisk.design import Hypothesis, information as bits
    >>> table = bits([Hypothesis("Weber", IdentityPercept())], [1e-3, 2e-3], [-1e-4, 0.0, 1e-4])
    >>> information(table).get_xlabel()
    'Standard (mm)'
    """
    ax = axes_or_new(ax)
    shape = table["standard"].nunique(), -1
    standard, offset, value = (
        scale * table[name].to_numpy(float).reshape(shape)
        for name, scale in (("standard", 1e3), ("offset", 1e3), (about, 1e3))
    )
    mesh = ax.pcolormesh(
        standard, offset, np.ma.masked_invalid(value), shading="nearest", cmap="cividis", vmin=0.0
    )
    figure_of(ax).colorbar(mesh, ax=ax, label=f"About {ABOUT[about]} (millibit)")
    best = np.unravel_index(np.nanargmax(value), value.shape)
    ax.plot(standard[best], offset[best], "o", markerfacecolor="none", color="w", markersize=7)
    ax.axhline(0.0, color="w", linewidth=0.5)
    ax.set_xlabel("Standard (mm)")
    ax.set_ylabel("Offset (mm)")
    return ax


@styled
def power_curve(power: Power, ax: Axes | None = None) -> Axes:
    """Share of experiments that reach the goal against their size, with Monte Carlo intervals.

    Against the number of animals where that alone varies, else against trials.

    Examples
    --------
    >>> from weberwhisk import Whisker, power
    >>> from weberwhisk.design import Scheme, taper
    >>> hypotheses = taper(Whisker(50e-3, 100e-6, 5e-6))
    >>> scheme = Scheme.spaced(hypotheses[0].percept, [15e-3, 45e-3])
    >>> found = power(scheme, hypotheses, trials=[5, 10], truths=["tapered"], runs=16, seed=1)
    >>> power_curve(found).get_ylabel()
    'Power'
    """
    ax = axes_or_new(ax)
    table = power.table
    by = "animals" if table["trials"].nunique() == 1 < table["animals"].nunique() else "trials"
    others = [name for name in ("truth", "lapse", "trials", "animals")
              if name != by and (name == "truth" or table[name].nunique() > 1)]  # fmt: skip
    for i, (key, own) in enumerate(table.groupby(others, sort=False)):
        own = own.sort_values(by)
        words = [drawable(key[0])] + [
            f"{n} {v:g}" for n, v in zip(others[1:], key[1:], strict=True)
        ]
        y = own["power"].to_numpy(float)
        ax.errorbar(
            own[by],
            y,
            [y - own["lower"].to_numpy(float), own["upper"].to_numpy(float) - y],
            color=COLOURS[i % len(COLOURS)],
            marker=MARKERS[i % len(MARKERS)],
            linestyle=LINES[i % len(LINES)],
            elinewidth=1,
            label=", ".join(words),
        )
    ax.axhline(power.goal.share, color="0.6", linewidth=0.8, linestyle=":")
    ax.set_xscale("log")
    sizes = np.unique(table[by])
    ax.set_xticks(sizes, [f"{size:g}" for size in sizes])
    ax.minorticks_off()
    ax.set_ylim(0.0, 1.0)
    ax.set_xlabel("Animals" if by == "animals" else "Trials of each comparison")
    ax.set_ylabel("Assurance" if power.assurance else "Power")
    legend_above(ax)
    return ax
