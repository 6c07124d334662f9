"""The claims of the charts of all cues, from small tables."""

import numpy as np
import pytest

from weberwhisk import Whisker, WhiskerArray, figures
from weberwhisk import surveys as all_cues
from weberwhisk.commands import figure


def test_no_cue_is_best_everywhere():
    table = all_cues.best(15)
    names = [f"{name}_mm" for name in all_cues.MAPPED]
    assert np.all(table[names].min(axis=1) > 0)
    assert table["best"].nunique() == 3
    # Both forces and the moment are never worse than two of the three.
    pair, every = (table[name] for name in names[2:])
    assert np.all(every <= pair * (1 + 1e-9))


def test_only_the_cylinder_has_a_ridge():
    table = all_cues.ridge(400)
    spread = table.groupby("whisker")["radial_distance_mm"].std()
    assert spread["cylinder"] > 5 * spread["tapered"]
    ridge = table[table["whisker"] == "cylinder"]
    # M ∝ θ/r along it: one moment, any distance.
    ratio = ridge["deflection_angle_deg"] / ridge["radial_distance_mm"]
    assert ratio.std() / ratio.mean() < 0.1
    assert ridge["radial_distance_mm"].max() > 2 * ridge["radial_distance_mm"].quantile(0.1)


def words(text, names):
    """The names in a text that lists several, or the text."""
    return text.split(", ") if set(text.split(", ")) <= names else [text]


def test_charts_name_the_regions_where_methods_fail():
    """Every outcome of a table is written on its chart."""
    table = all_cues.curves(6, 2)
    lost = table[~table["outcome"].str.startswith("held")]
    names = {outcome.split(":")[0] for outcome in lost["outcome"]}
    assert {"one-sided", "flicked past"} <= names
    assert lost[["closed_form_mm", "fisher_mm", "posterior_mm"]].isna().all(axis=None)
    works = figures.cue_jnds(table).axes[:4]
    written = [text.get_text() for ax in works for text in ax.texts]
    assert names | set(table["cue"]) == {word for text in written for word in words(text, names)}
    for ax in works:  # a colour is one cue's
        colours = [line.get_color() for line in ax.lines if line.get_marker() not in (None, "None")]
        assert len(set(colours)) == len(colours) > 1

    contacts = all_cues.best(30)
    beyond = set(contacts["beyond"])
    assert beyond == {"flicked past", "slipped off the tip"}
    chart = figures.best_cue(contacts, all_cues.MAPPED).axes[0]
    assert beyond <= {text.get_text() for text in chart.texts}

    ridge = figures.ridge(all_cues.ridge(40), (25e-3, 0.3)).axes[0]
    labels = {text.get_text() for text in ridge.get_legend().get_texts()}
    assert {"tapered: converged", "cylinder: unidentified"} <= labels


def test_every_way_to_fail_is_an_outcome_on_a_chart():
    """By chance, as a tip that is not touched, or altogether, as modes that damping merges."""
    table = all_cues.outcomes(30, 60, seed=3)
    total = table.groupby(["cue", "radial_distance_mm"])["share"].sum()
    assert np.allclose(total, 1.0)
    names = {cue: set(rows["outcome"]) for cue, rows in table.groupby("cue")}
    assert {"no touch", "tip not touched"} <= names["whisker length (a)"]
    assert "no touch" in names["which of three whiskers touch (b)"]
    assert {"one-sided", "out of reach"} <= names["angle-side-angle (c)"]
    assert "flicked past" in names["contact and detachment (c)"]
    assert "slipped off the tip" in names["moment and axial force (f)"]
    assert "flicked past" in names["balance of moments (h)"]
    # Modes that are one peak tell nothing, wherever the impact is.
    damped = table[table["cue"] == "vibration, 6 damped modes (d)"]
    on_whisker = damped[damped["place"] <= 1.0]
    assert np.all(on_whisker.loc[on_whisker["outcome"] == "unresolved", "share"] == 1.0)
    assert "held" not in names["vibration, 6 damped modes (d)"]
    # The tip is touched less and less often towards the base, and nothing further and further out.
    length = table[table["cue"] == "whisker length (a)"]
    none = length[length["outcome"] == "no touch"].sort_values("place")["share"].to_numpy()
    assert none[0] == 0.0
    assert none[-1] > 0.5

    chart = figures.cue_outcomes(table)
    shown = {text.get_text() for text in chart.legends[0].get_texts()}
    assert shown == set(table["outcome"]) - {"held"} | {"distance found"}
    titles = {ax.get_title() for ax in chart.axes} - {""}
    assert titles == set(table["cue"])
    # Both columns have ticks below, and a colour means one outcome, whichever else are shown.
    count = len(titles)
    for ax in chart.axes[count - 2 : count]:
        assert ax.xaxis.get_tick_params()["labelbottom"]
    few = figures.cue_outcomes(table[table["cue"] == "moment and axial force (f)"])
    whole, part = (
        dict(zip((text.get_text() for text in box.get_texts()), box.legend_handles, strict=True))
        for box in (chart.legends[0], few.legends[0])
    )
    for name, patch in part.items():
        assert patch.get_facecolor() == whole[name].get_facecolor()


def test_neighbours_are_those_of_the_identity(monkeypatch):
    """E4 (17.9 mm) stood between whiskers of 40 and 30 mm."""
    array = all_cues.neighbours(identity="E4")
    known = [Whisker.from_identity(name).length for name in ("E5", "E3")]
    np.testing.assert_allclose(array.lengths, known)
    assert np.sign(array.bases[:, 1]).tolist() == [1, -1]
    assert np.all((np.abs(array.bases[:, 1]) > 0.5e-3) & (np.abs(array.bases[:, 1]) < 3e-3))
    # C2's base by hand, from Belli et al. 2018: azimuth -8.4°, elevation 2.51°, 6.743 mm out.
    base = 1e3 * WhiskerArray("rat", "right").whiskers["C2"].base
    np.testing.assert_allclose(base, 6.7432 * np.array([0.98832, -0.14594, 0.04379]), rtol=1e-3)
    asked = []
    monkeypatch.setattr(all_cues, "curves", lambda *a, **how: asked.append(how) or 1 / 0)
    with pytest.raises(ZeroDivisionError):
        figure.CHARTS["cues"](figure.Asked(Whisker.from_identity("E4"), True, identity="E4"))
    assert asked[0]["identity"] == "E4"
    table = all_cues.outcomes(4, 4, whisker=Whisker.from_identity("E4"), identity="E4")
    other = all_cues.outcomes(4, 4, whisker=Whisker.from_identity("E4"))
    assert not table[table["cue"] == all_cues.ARRAY].equals(other[other["cue"] == all_cues.ARRAY])
