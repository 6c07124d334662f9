"""The claims of the charts of all cues, from small tables."""

import numpy as np

from weberwhisk import figures
from weberwhisk import surveys as all_cues


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


def test_charts_name_the_regions_where_methods_fail():
    """Every outcome of a table is written on its chart."""
    table = all_cues.curves(6, 2)
    lost = table[~table["outcome"].str.startswith("held")]
    names = {outcome.split(":")[0] for outcome in lost["outcome"]}
    assert {"one-sided", "flicked past"} <= names
    assert lost[["closed_form", "fisher", "posterior"]].isna().all(axis=None)
    works = figures.cue_jnds(table).axes[2]
    assert names <= {text.get_text() for text in works.texts}

    contacts = all_cues.best(30)
    beyond = set(contacts["beyond"])
    assert beyond == {"flicked past", "slipped off the tip"}
    chart = figures.best_cue(contacts, all_cues.MAPPED).axes[0]
    assert beyond <= {text.get_text() for text in chart.texts}

    ridge = figures.ridge(all_cues.ridge(40), (25e-3, 0.3)).axes[0]
    labels = {text.get_text() for text in ridge.get_legend().get_texts()}
    assert {"tapered: converged", "cylinder: unidentified"} <= labels
