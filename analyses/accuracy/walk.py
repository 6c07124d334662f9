"""One reading's walk down the tree of cells, drawn at three levels.

    python analyses/accuracy/walk.py [figure]

A force map's reading, k = 0.1: the coarse cells, those kept halfway, and the lattice that is summed
(`docs/theory/engines.md`). Writes `analyses/figures/walk.png` where no other file is named.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import PolyCollection

import weberwhisk as ww
from weberwhisk import plots
from weberwhisk.inference.descent import cell_sums
from weberwhisk.inference.tree import DROP, TOLERANCE, tree_of

FIGURE = Path(__file__).parent.parent / "figures" / "walk.png"
CORNERS = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])


@plots.styled
def main() -> None:
    """Draw the walk."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("figure", type=Path, nargs="?", default=FIGURE)
    given = parser.parse_args()
    observer = ww.Observer(ww.Whisker(50e-3, 100e-6, 5e-6), ww.cues.ForceMap())
    reading = observer.read([30e-3, 0.2], seed=1)
    tree = tree_of(observer, TOLERANCE)
    cell_sums(tree, reading[None])
    # With one reading, the cells of a level are the halves of those kept one level up.
    levels = [tree.start]
    while levels[-1].children:
        levels.append(next(iter(levels[-1].children.values()))[0])
    figure, axes = plt.subplots(1, 3, figsize=(9, 3.2), sharex=True, sharey=True)
    chosen = (0, len(levels) // 2, len(levels) - 1)
    names = ("coarse cells, all readings", "cells halfway", "the lattice that is summed")
    for ax, depth, name in zip(axes, chosen, names, strict=True):
        level = levels[depth]
        place = level.cells.place[:, : level.count].T
        log, _ = observer.log_density_and_contact((place + 0.5) * level.step, reading)
        if depth == chosen[-1]:
            place, log = place[log > log.max() - DROP], log[log > log.max() - DROP]
        contact, _ = observer.space.constrain((place[:, None] + CORNERS) * level.step)
        cells = PolyCollection(contact * [1e3, 180 / np.pi], edgecolor="0.45", linewidth=0.3)
        cells.set(array=np.exp(log - log.max()), cmap="Blues", clim=(0, 1.2))
        ax.add_collection(cells)
        ax.set(title=f"{name}: {len(place)}", xlabel="distance, mm", xlim=(0, 50), ylim=(0, 70))
    axes[0].set_ylabel("deflection angle, °")
    figure.savefig(given.figure, dpi=90)


if __name__ == "__main__":
    main()
