"""The claims of analyses/all_cues.py, from small tables."""

import numpy as np
from analysis_scripts import load

all_cues = load("all_cues")


def test_no_cue_is_best_everywhere():
    table = all_cues.best(15)
    names = list(all_cues.MAPPED)
    assert np.all(table[names].min(axis=1) > 0)
    assert table["best"].nunique() == 3
    # Both forces and the moment are never worse than two of the three.
    pair, every = (table[name] for name in names[2:])
    assert np.all(every <= pair * (1 + 1e-9))


def test_only_the_cylinder_has_a_ridge():
    table = all_cues.ridge(400)
    spread = table.groupby("whisker")["radial_distance"].std()
    assert spread["cylinder"] > 5 * spread["tapered"]
    ridge = table[table["whisker"] == "cylinder"]
    # M ∝ θ/r along it: one moment, any distance.
    ratio = ridge["deflection_angle"] / ridge["radial_distance"]
    assert ratio.std() / ratio.mean() < 0.1
    assert ridge["radial_distance"].max() > 2 * ridge["radial_distance"].quantile(0.1)


def test_the_figures_are_drawn():
    assert len(all_cues.draw_best(all_cues.best(10)).axes) == 1
    assert len(all_cues.draw_ridge(all_cues.ridge(40)).axes) == 1
