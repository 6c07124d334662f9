"""Tables of contacts become distances, row by row and touch by touch."""

from __future__ import annotations

import ast
import json
import re
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from short_forms import slow_but

import weberwhisk as ww
from weberwhisk import recordings
from weberwhisk.cli import app, run_app
from weberwhisk.inference.observer import distance_prior
from weberwhisk.inference.one_distance import ReadingGroup, one_distance
from weberwhisk.recordings.columns import find_columns
from weberwhisk.recordings.mixture import SPANS

C2 = replace(ww.Whisker.from_identity("C2"), curvature=0.0)
KNOWN = replace(C2, youngs_modulus=3e9)
SOFT = ww.cues.UnknownStiffness(ww.cues.ForceMap())


def _readings(cue: ww.cues.Cue, k: float, n: int, seed: int) -> tuple[ww.Observer, np.ndarray]:
    rng = np.random.default_rng(seed)
    observer = ww.Observer(C2, cue, ww.receptors.Weber(k))
    r = rng.uniform(0.2, 0.9, n) * C2.length
    theta = rng.uniform(0.1, 0.8, n) * ww.flick_past(C2, r).deflection_angle
    values = {"radial_distance": r, "deflection_angle": theta, "stiffness": np.ones(n)}
    contact = np.stack([values[name] for name in observer.unknowns], axis=-1)
    return observer, observer.read(contact, rng)


@pytest.mark.parametrize(
    ("cue", "k"),
    [(ww.cues.ForceMap(), 0.1), (ww.cues.ForceMap(), 0.3), (ww.cues.Compliance(), 0.1),
     (SOFT, 0.1), (SOFT, 0.3)],
)  # fmt: skip
def test_rows_agree_with_quadrature(cue: ww.cues.Cue, k: float) -> None:
    observer, y = _readings(cue, k, 8, seed=2)
    table = pd.DataFrame(y, columns=list(observer.cue.signal_names))
    found = ww.locate(table, C2, cue=cue, noise=ww.receptors.Weber(k))
    p = ww.posterior(observer, y)
    off = (found["radial_distance_mm"] - 1e3 * p.mean) / (1e3 * p.sd)
    assert np.abs(off).max() < 0.02
    np.testing.assert_allclose(found["sd_mm"], 1e3 * p.sd, rtol=0.02)
    if len(observer.unknowns) < 3:  # quantiles of three take minutes
        ends = 1e3 * p.interval(0.95)
        np.testing.assert_allclose(found["lower_mm"], ends[:, 0], atol=0.08 * 1e3 * p.sd.max())
        np.testing.assert_allclose(found["upper_mm"], ends[:, 1], atol=0.08 * 1e3 * p.sd.max())


def test_measurement_errors_alone_are_the_likelihood() -> None:
    """Constant errors: the same as an observer whose receptors have that floor and no more."""
    b = ww.press(KNOWN, [10e-3, 20e-3], 0.3)
    sd = np.array([0.05 * b.moment.min(), 0.05 * b.axial_force.min()])
    table = pd.DataFrame({"moment": b.moment, "axial_force": b.axial_force,
                          "moment_sd": sd[0], "axial_force_sd": sd[1]})  # fmt: skip
    found = ww.locate(table, KNOWN)
    noise = ww.receptors.GeneralisedWeber(0.0, floor=sd)
    p = ww.posterior(ww.Observer(KNOWN, ww.cues.ForceMap(), noise), table.iloc[:, :2].to_numpy())
    np.testing.assert_allclose(found["radial_distance_mm"], 1e3 * p.mean, rtol=2e-3)
    np.testing.assert_allclose(found["sd_mm"], 1e3 * p.sd, rtol=0.02)
    both = ww.locate(table, KNOWN, noise=ww.receptors.Weber(0.1))
    assert (both["sd_mm"] > found["sd_mm"]).all()


def test_own_names_units_signs_and_index() -> None:
    b = ww.press(KNOWN, [10e-3, 20e-3, 25e-3], [0.2, 0.3, 0.2])
    plain = pd.DataFrame({"moment": b.moment, "axial_force": b.axial_force})
    wanted = ww.locate(plain, KNOWN, noise=0.1)
    index = pd.Index(["a", "b", "c"], name="frame")
    other = pd.DataFrame({"M": -1e6 * b.moment, "F (mN)": -1e3 * b.axial_force, "who": "x"}, index)
    named = {"moment": "M", "axial_force": "-F (mN)"}  # a minus turns a column's sign
    units = {"moment": "µN m"}
    found = ww.locate(other, KNOWN, columns=named, units=units, noise=0.1)
    assert found.index.equals(index)
    assert list(found.columns[:3]) == list(other.columns)
    np.testing.assert_allclose(found["radial_distance_mm"], wanted["radial_distance_mm"], rtol=1e-9)
    notes = " ".join(found.attrs["notes"])
    assert "mirrored" in notes
    assert "opposite sign" not in notes
    named["axial_force"] = "F (mN)"
    found = ww.locate(other, KNOWN, columns=named, units=units, noise=0.1)
    note = next(note for note in found.attrs["notes"] if "opposite sign" in note)
    named |= _columns_in(note)
    assert named["axial_force"] == "-F (mN)"
    found = ww.locate(other, KNOWN, columns=named, units=units, noise=0.1)
    np.testing.assert_allclose(found["radial_distance_mm"], wanted["radial_distance_mm"], rtol=1e-9)
    # A minus that does not fit is taken away.
    other["F (mN)"] *= -1
    found = ww.locate(other, KNOWN, columns=named, units=units, noise=0.1)
    note = next(note for note in found.attrs["notes"] if "opposite sign" in note)
    assert _columns_in(note) == {"axial_force": "F (mN)"}


def _columns_in(note: str) -> dict[str, str]:
    """What a note gives to write for `columns`."""
    return ast.literal_eval(re.search(r"columns=(\{.*?\})", note)[1])


#: Signals of a push, and what turns each into the table's own column and convention.
OPPOSITE = {
    "own name and unit": {"moment_uNm": ("moment", 1e6), "axial_force_m_N": ("axial_force", -1e3)},
    "in space": {"force_x_N": ("axial_force", 1.0), "moment_y_Nm": ("moment", 0.0),
                 "moment_z_Nm": ("moment", -1.0)},
    "two in space": {"force_x_mN": ("axial_force", 1e3), "force_y_uN": ("transverse_force", -1e6),
                     "force_z_uN": ("transverse_force", 0.0), "moment_y_Nm": ("moment", 0.0),
                     "moment_z_Nm": ("moment", 1.0)},
}  # fmt: skip


@pytest.mark.parametrize("table", slow_but(OPPOSITE.values(), (2,)), ids=OPPOSITE)
def test_the_note_on_signs_works_as_it_stands(
    table: dict, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    """In Python and on the command line, whatever the columns are called."""
    truth = np.array([15e-3, 20e-3, 30e-3, 40e-3])
    whisker = ww.Whisker(50e-3, 100e-6, 5e-6, youngs_modulus=3e9, curvature=0)
    bent = ww.press(whisker, truth, 0.15)
    columns = {name: size * getattr(bent, of) for name, (of, size) in table.items()}
    table = pd.DataFrame(columns)
    found = ww.locate(table, whisker, noise=0.03)
    note = next(note for note in found.attrs["notes"] if "opposite sign" in note)
    told = _columns_in(note)
    assert {column.removeprefix("-") for column in told.values()} <= {*table}
    found = ww.locate(table, whisker, noise=0.03, columns=told)
    assert not any("opposite sign" in note for note in found.attrs["notes"])
    np.testing.assert_allclose(found["radial_distance_mm"], 1e3 * truth, rtol=0.04)
    table.to_csv(tmp_path / "t.csv", index=False)
    words = ["locate", str(tmp_path / "t.csv"), "--length-mm", "50", "--base-radius-um", "100",
             "--tip-radius-um", "5", "--youngs-modulus-gpa", "3", "--curvature-per-m", "0",
             "--weber-fraction", "0.03"]  # fmt: skip
    assert run_app(app, words) in (0, None)
    said = re.search(r"has it otherwise, write (.*)\.", capsys.readouterr().out)[1]
    assert run_app(app, [*words, *shlex.split(said), "--json"]) in (0, None)
    answer = json.loads(capsys.readouterr().out)
    assert not any("opposite sign" in note for note in answer["notes"])
    located = [row["radial_distance_mm"] for row in answer["rows"]]
    np.testing.assert_allclose(located, found["radial_distance_mm"], rtol=1e-6)


@pytest.mark.parametrize("tip_um", slow_but([300.0, 290.0], (0,)))
@pytest.mark.slow
def test_a_cylinder_is_a_straight_wire_unless_said(
    tip_um: float, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    """Steel: no curvature as is usual of whiskers is mixed over, whose tables have no folds."""
    truth = np.array([40e-3, 60e-3, 80e-3, 100e-3, 120e-3, 140e-3])
    wire = ww.Whisker(0.15, 0.3e-3, tip_um * 1e-6, youngs_modulus=200e9)
    bent = ww.press(wire, truth, np.arctan(0.03))
    table = pd.DataFrame({"Mz": 1e3 * bent.moment, "Fy": 1e3 * bent.transverse_force})
    columns = {"moment": "Mz", "transverse_force": "Fy"}
    units = {"moment": "mN m", "transverse_force": "mN"}
    noise = ww.receptors.GeneralisedWeber(0.02, floor=[0, 1e-3 * bent.transverse_force.min()])
    found = ww.locate(table, wire, columns=columns, units=units, noise=noise)
    np.testing.assert_allclose(found["radial_distance_mm"], 1e3 * truth, rtol=0.02)
    assert "a wire and so taken as straight; if it is bent, write curvature=" in (
        " ".join(found.attrs["notes"])
    )
    straight = replace(wire, curvature=0.0)
    same = ww.locate(table, straight, columns=columns, units=units, noise=noise)
    assert same["sd_mm"].tolist() == found["sd_mm"].tolist()
    assert "straight." in " ".join(same.attrs["notes"])
    assert "a wire and so taken as straight." in recordings.methods_paragraph(found)
    curved = ww.locate(table, replace(wire, curvature=0.5), columns=columns, units=units,
                       noise=noise)  # fmt: skip
    assert "curved." in " ".join(curved.attrs["notes"])
    assert ww.Observer(wire, ww.cues.ForceMap(["moment", "transverse_force"])).note == ""
    if tip_um == 300:
        table.to_csv(tmp_path / "t.csv", index=False)
        words = ["locate", str(tmp_path / "t.csv"), "--length-mm", "150", "--base-radius-um", "300",
                 "--tip-radius-um", "300", "--youngs-modulus-gpa", "200", "--weber-fraction",
                 "0.02", "--column", "moment=Mz", "--unit", "moment=mN m", "--column",
                 "transverse_force=Fy", "--unit", "transverse_force=mN"]  # fmt: skip
        assert run_app(app, words) in (0, None)
        said = " ".join(capsys.readouterr().out.split())
        assert "taken as straight; if it is bent, write --curvature-per-m 5, say." in said
        assert run_app(app, ["locate", "--help"]) in (0, None)
        helped = " ".join(capsys.readouterr().out.replace("│", " ").split())
        assert "[default: unknown, as is usual of its kind; of a cylinder 0;" in helped


def test_six_signals_are_turned_into_the_plane_of_the_push() -> None:
    b = ww.press(KNOWN, [10e-3, 20e-3], 0.3)
    phi = 0.7
    six = pd.DataFrame({
        "force_x": -b.axial_force, "force_y": b.transverse_force * np.cos(phi),
        "force_z": b.transverse_force * np.sin(phi), "moment_x": 0 * b.moment,
        "moment_y": -b.moment * np.sin(phi), "moment_z": b.moment * np.cos(phi),
    })  # fmt: skip
    flat = pd.DataFrame({"moment": b.moment, "axial_force": b.axial_force,
                         "transverse_force": b.transverse_force})  # fmt: skip
    a, c = (ww.locate(t, KNOWN)["radial_distance_mm"] for t in (six, flat))
    np.testing.assert_allclose(a, c, rtol=1e-9)
    a, c = (ww.locate(t, KNOWN)["radial_distance_mm"] for t in (six.iloc[:, :3], flat.iloc[:, 1:]))
    np.testing.assert_allclose(a, c, rtol=1e-9)
    # Errors alike in all directions are those in the plane.
    for table, names in ((six, six.columns), (flat, flat.columns)):
        for name in list(names):
            table[f"{name}_sd"] = 3e-8 if "moment" in name else 2e-6
    a, c = (ww.locate(t, KNOWN)["sd_mm"] for t in (six, flat))
    np.testing.assert_allclose(a, c, rtol=1e-9)
    curved = ww.Whisker.from_identity("C2", curved=True, youngs_modulus=3e9)
    with pytest.raises(ValueError, match="how its curvature lies"):
        ww.locate(six, curved)


@pytest.mark.parametrize("angle", [False, True])
def test_signs_of_a_concave_whisker_are_its_own(angle: bool) -> None:
    """Light contacts pull it outwards: axial forces and angles below zero are no convention."""
    w = ww.Whisker.from_identity("C2", curved=True, youngs_modulus=3e9)
    w = replace(w, curvature=-w.curvature)
    r = np.array([12e-3, 15e-3, 20e-3, 18e-3, 15e-3])
    b = ww.press(w, r, ww.mechanics.rest_angle(w, r) + np.array([0.1, 0.08, 0.1, 0.1, 0.25]))
    assert (b.axial_force < 0).sum() == 4
    table = pd.DataFrame({"moment": b.moment, "axial_force": b.axial_force})
    noise, columns = ww.inference.default_noise(w, ww.cues.ForceMap()), {}
    if angle:  # informed by the rows: where the whisker is, and how it is bent, go together
        table = table.assign(axial_force=-b.axial_force, deflection_angle=b.deflection_angle)
        found = ww.locate(table, w)
        assert any("better with the axial force" in note for note in found.attrs["notes"])
        noise, columns = None, {"axial_force": "-axial_force"}
    found = ww.locate(table, w, noise=noise, columns=columns)
    np.testing.assert_allclose(found["radial_distance_mm"], 1e3 * r, atol=0.4)
    assert not any("opposite" in note for note in found.attrs["notes"])


def test_rows_that_tell_nothing_stay() -> None:
    b = ww.press(KNOWN, 20e-3, 0.3)
    table = pd.DataFrame({"moment": [b.moment, np.nan, 0.0, -b.moment],
                          "axial_force": [b.axial_force, 1e-5, 0.0, b.axial_force]})  # fmt: skip
    found = ww.locate(table, KNOWN)
    assert found["status"].tolist() == ["converged", "not_a_reading", "no_contact", "converged"]
    assert found["radial_distance_mm"].isna().tolist() == [False, True, True, False]
    assert found["message"].str.len().min() > 5


@pytest.mark.parametrize(("soft", "k"), slow_but([(False, 0.1), (False, 0.3), (True, 0.1)], (2,)))
def test_a_touch_is_the_product_over_a_shared_distance_and_stiffness(soft: bool, k: float) -> None:
    """Brute force on a plain grid of r, θ and E, with the angles' span as the touch has it."""
    rng = np.random.default_rng(4)
    observer = ww.Observer(C2, ww.cues.ForceMap(), ww.receptors.Weber(k))
    place = rng.uniform(0.3, 0.8) * C2.length
    theta = rng.uniform(0.02, 0.98, 8) * float(ww.flick_past(C2, place).deflection_angle)
    signals = observer.signals(np.stack([np.full(8, place), theta], axis=-1))[0]
    readings = observer.noise.sample(signals, rng)
    asked = ww.Observer(C2, SOFT, ww.receptors.Weber(k)) if soft else observer
    [found] = one_distance([ReadingGroup(asked, readings, None, np.zeros(8, dtype=int))], 1, SPANS)
    r = np.linspace(max(0.02 * C2.length, found.mean - 8 * found.sd),
                    min(0.9995 * C2.length, found.mean + 8 * found.sd), 121)  # fmt: skip
    share = (np.arange(600) + 0.5) / 600
    theta = np.asarray(ww.flick_past(C2, r).deflection_angle)[:, None] * share
    contact = np.stack(np.broadcast_arrays(r[:, None], theta), axis=-1)
    signals = observer.signals(contact)[0]
    z = np.linspace(-4, 4, 61) if soft else np.zeros(1)
    total = np.log(distance_prior(observer, r))[:, None, None] - 0.5 * z[:, None] ** 2
    spans = np.exp(-((share[:, None] / SPANS) ** 4))
    spans /= spans.sum(axis=0)
    for y in readings:
        log = np.stack([observer.noise.log_likelihood(y, signals * np.exp(0.42 * a)) for a in z], 1)
        top = log.max(axis=2)
        total = total + top[..., None] + np.log(np.exp(log - top[..., None]) @ spans + 1e-300)
    weight = np.exp(total - total.max()).sum(axis=(1, 2))
    weight /= weight.sum()
    mean = weight @ r
    sd = np.sqrt(weight @ (r - mean) ** 2)
    assert abs(found.mean - mean) < 0.03 * sd
    assert abs(found.sd / sd - 1) < 0.03


def test_touches_are_named_in_every_row() -> None:
    b = ww.press(KNOWN, 20e-3, np.linspace(0.1, 0.4, 6))
    table = pd.DataFrame({"moment": b.moment, "axial_force": b.axial_force,
                          "touch": [1, 1, 1, 1, 0, np.nan]})  # fmt: skip
    found = ww.locate(table, KNOWN, touch="touch", noise=0.1)
    one = found.iloc[:4]
    assert one["touch_radial_distance_mm"].nunique() == 1
    assert one["touch_sd_mm"].iloc[0] < 0.8 * one["sd_mm"].min()
    assert one["touch_lower_mm"].iloc[0] < 20 < one["touch_upper_mm"].iloc[0]
    # A touch may be numbered 0, unless rows of 0 stand between touches.
    assert found["touch_status"].tolist() == ["converged"] * 5 + ["no_touch"]
    table["touch"] = [0, 1, 1, 1, 0, np.nan]
    between = ww.locate(table, KNOWN, touch="touch", noise=0.1)
    assert between["touch_status"].tolist() == ["no_touch", *["converged"] * 3, *["no_touch"] * 2]
    table["touch"] = [1, 1, 1, 1, np.nan, np.nan]
    each = ww.locate(table, KNOWN, touch=["a", "b", None, "a", "c", None], noise=0.1)
    lonely = each.iloc[[1, 4]]
    for name in ("radial_distance_mm", "sd_mm", "lower_mm"):  # a touch of one row is that row
        assert lonely[f"touch_{name}"].tolist() == lonely[name].tolist()
    assert any("Rows of 1 of 3 touches, such as 'a', stand in" in n for n in each.attrs["notes"])
    flag = table.assign(touch=table["touch"].eq(1))
    with pytest.raises(ValueError, match="does not say which"):
        ww.locate(flag, KNOWN, touch="touch")
    t = flag["touch"]
    named = (t & ~t.shift(fill_value=False)).cumsum().where(t)
    again = ww.locate(flag, KNOWN, touch=named.tolist(), noise=0.1)
    assert again["touch_sd_mm"][:4].equals(found["touch_sd_mm"][:4])


@pytest.mark.slow
def test_a_touch_of_a_curved_whisker_has_one_answer_and_rows_of_noise_its_side() -> None:
    """Pushed from both sides, a whisker with hardly a curve gives what a straight one does."""
    b = ww.press(KNOWN, 16e-3, np.linspace(0.1, 0.4, 4))
    side = np.array([1, -1, 1, -1])
    table = pd.DataFrame({"moment": side * b.moment, "axial_force": b.axial_force, "touch": 1})
    straight, hardly = (
        ww.locate(table, w, touch="touch", known_stiffness=True)
        for w in (KNOWN, replace(KNOWN, curvature=1e-3))
    )
    assert hardly["touch_radial_distance_mm"].nunique() == 1
    for name in ("touch_radial_distance_mm", "touch_sd_mm", "touch_lower_mm"):
        np.testing.assert_allclose(hardly[name], straight[name], rtol=2e-3)
    curved = ww.Whisker.from_identity("C2", curved=True, youngs_modulus=3e9)
    b = ww.press(
        curved, 16e-3, ww.mechanics.rest_angle(curved, 16e-3) + np.repeat([0.002, 0.2], [6, 3])
    )
    sd, z = {"moment": 1e-7, "axial_force": 1e-5}, []
    for seed in (4,):
        rng = np.random.default_rng(seed)
        noisy = {n: getattr(b, n) + e * rng.standard_normal(9) for n, e in sd.items()}
        assert (noisy["moment"] < 0).any()
        table = pd.DataFrame(noisy).assign(touch=1, **{f"{n}_sd": e for n, e in sd.items()})
        found = ww.locate(table, curved, touch="touch")
        assert found["touch_radial_distance_mm"].nunique() == 1
        assert not any("mirrored" in note for note in found.attrs["notes"])
        z.append((found["touch_radial_distance_mm"][0] - 16) / found["touch_sd_mm"][0])
    assert np.abs(z).max() < 2.6


@pytest.mark.parametrize(
    ("table", "options", "sentence"),
    [
        ({"moment": [1e-6]}, {}, "the columns 'moment', of which moment is known: needed are two"),
        ({"a": [1], "b": [2]}, {}, "the columns 'a', 'b', of which none is known: needed are two"),
        ({"moment": [3e-6], "axial_force": [0.08]}, {}, "did you pass mN\\?.*'mN'"),
        ({"moment": [3.0], "axial_force": [8e-5]}, {}, "did you pass uN m\\?"),
        ({"moment_uNm": [3e-6], "axial_force": [8e-5]}, {}, "far below .* did you pass N m\\?"),
        ({"moment": [3e-6], "axial_force": [8e-5]}, {"cue": ww.cues.SpaceMap()}, "leave cue out"),
        ({"moment": ["a"], "axial_force": [1e-5]}, {}, "holds text"),
        ({"moment": [True], "axial_force": [1e-5]}, {}, "holds bool"),
        ({("a", "moment"): [1e-6], ("a", "axial_force"): [1e-5]}, {}, "several levels"),
        ({"moment": [1e-6], "axial_force": [1e-5], "sd_mm": [1]}, {}, "already"),
        ({"moment": [1e-6], "axial_force": [1e-5]}, {"units": {"moment": "mm"}}, "no unit"),
        ({"moment": [1e-6], "axial_force": [1e-5]}, {"columns": {"moment": "M"}}, "no column"),
        ({"moment": [1e-6], "axial_force": [1e-5]}, {"touch": "t"}, "no column"),
        ({"moment": [1e-6], "moment_uNm": [1.0], "axial_force": [1]}, {}, "Two columns"),
        ({"moment": [1e-6], "axial_force": [1e-5], "moment_sd": [1e-7]}, {}, "all or none"),
        ({"moment": [], "axial_force": []}, {}, "no rows"),
    ],
)
def test_refusals_are_one_sentence(table: dict, options: dict, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        ww.locate(pd.DataFrame(table), KNOWN, **options)


def test_the_command_writes_table_touches_and_figure(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    from weberwhisk.cli import run_app

    b = ww.press(KNOWN, 20e-3, np.linspace(0.1, 0.4, 4))
    path = tmp_path / "contacts.csv"
    pd.DataFrame({"t_s": [0, 1, 2, 3], "M": 1e6 * b.moment, "axial_force_uN": 1e6 * b.axial_force,
                  "n": [1, 1, 2, 2]}).to_csv(path, index=False)  # fmt: skip
    words = ["locate", str(path), "--identity", "C2", "--youngs-modulus-gpa", "3", "--column",
             "moment=M", "--unit", "moment=uNm", "--touch", "n", "--time", "t_s", "--out",
             str(tmp_path / "out"), "--curvature-per-m", "0"]  # fmt: skip
    assert run_app(app, words) in (0, None)
    assert "4 of 4 rows: converged." in capsys.readouterr().out
    made = {p.name for p in (tmp_path / "out").iterdir()}
    assert {"located.csv", "touches.csv", "located.png", "touches.png", "locate.run.json"} <= made
    assert len(pd.read_csv(tmp_path / "out" / "touches.csv")) == 2
    assert run_app(app, ["locate", str(path), "--identity", "C2"]) == 2
    assert "No distance follows" in capsys.readouterr().err


def test_what_a_tracker_wrote_is_told_what_it_lacks(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    """Measurements lack points, and points what `tracked_signals` makes of them."""
    from weberwhisk.cli import run_app

    file = Path(__file__).parents[1] / "data" / "tracking" / "test_5frames.measurements"
    measured = ww.read_tracking(file, pixels_per_mm=20, frame_rate=500, shortest_px=200)
    with pytest.raises(ValueError, match=r"points are what is missing: read Whisk's \.whiskers"):
        ww.locate(measured, C2)
    with pytest.raises(ValueError, match=r"test_5frames\.measurements is of a tracker; forces"):
        ww.locate(file, C2)
    points = tmp_path / "tracked_session.csv"
    rows = [f"{frame},{60 * i},{i}" for frame in range(12) for i in range(9)]
    points.write_text("\n".join(["frame,x,y", *rows]))
    remedy = (
        r"write ww\.tracked_signals\(ww\.read_tracking\(file, pixels_per_mm=20, frame_rate=500\)"
    )
    for table in (points, ww.read_tracking(points)):
        with pytest.raises(ValueError, match=remedy):
            ww.locate(table, C2)
    assert run_app(app, ["locate", str(points), "--identity", "C2"]) == 2
    assert (
        "write --pixels-per-mm 20 --frame-rate 500 with your video's numbers."
        in capsys.readouterr().err
    )
    given = ["locate", str(points), "--identity", "C2", "--pixels-per-mm", "20"]
    assert run_app(app, given) == 2
    assert "write --frame-rate 500" in capsys.readouterr().err


def test_semicolons_and_decimal_commas(tmp_path: Path) -> None:
    b = ww.press(KNOWN, [10e-3, 20e-3], 0.3)
    table = pd.DataFrame({"moment_uNm": 1e6 * b.moment, "axial_force": b.axial_force})
    table.to_csv(tmp_path / "contacts.csv", sep=";", decimal=",", index=False)
    found = ww.locate(tmp_path / "contacts.csv", KNOWN, noise=0.1)["radial_distance_mm"]
    plain = ww.locate(table, KNOWN, noise=0.1)["radial_distance_mm"]
    np.testing.assert_allclose(found, plain, rtol=1e-9)


@pytest.mark.parametrize("count", [6, pytest.param(300, marks=pytest.mark.slow)])
def test_damaged_tables_have_a_sentence_or_rows_that_say_why(tmp_path: Path, count: int) -> None:
    """Cut files, swapped columns, NaN and text, other units: refused, or every row has a status."""
    rng = np.random.default_rng(18)
    theta = np.linspace(0.1, 0.4, 6)
    b = ww.press(KNOWN, 20e-3, theta)
    good = pd.DataFrame({"time": np.arange(6.0), "moment_uNm": 1e6 * b.moment,
                         "axial_force_uN": 1e6 * b.axial_force})  # fmt: skip
    refused = 0
    path = tmp_path / "contacts.csv"
    for i in range(count):
        table = good.astype(object)
        kind = i % 6
        if kind == 0:  # the forces' columns swapped: some 30 times off, or told by the rows
            table.columns = ["time", "axial_force_uN", "moment_uNm"]
        elif kind == 1:
            for _ in range(5):
                cell = rng.choice(np.array(["", "NaN", "x", "inf", "-", "1,5"], dtype=object))
                table.iat[rng.integers(6), rng.integers(1, 3)] = cell
        elif kind == 2:
            table[rng.choice(table.columns[1:])] *= 10.0 ** rng.choice([-9, -6, 3, 6, 9])
        elif kind == 3:
            table = table.drop(columns=rng.choice(table.columns[1:]))
        elif kind == 4:
            table = table.iloc[: rng.integers(0, 2)]
        text = table.to_csv(index=False)
        if kind == 5:
            text = text[: rng.integers(0, len(text))]
        path.write_text(text)
        try:
            found = ww.locate(path, KNOWN)
        except ValueError as error:
            refused += 1
            sentence = str(error)
        else:
            sentence = "."
            known = found["radial_distance_mm"].notna()
            assert (found["message"].str.len() > 5).all()
            assert found.loc[known, ["sd_mm", "lower_mm", "upper_mm"]].notna().all(axis=None)
            empty = found.loc[~known, "status"]
            assert empty.isin(["not_a_reading", "no_contact"]).all()
        assert "\n" not in sentence
        assert sentence.endswith(".")
    assert count / 3 < refused < count
    assert [p.name for p in tmp_path.iterdir()] == ["contacts.csv"]


def test_units_of_many_words_and_of_errors() -> None:
    def factor(header: list[str], name: str, **options: dict) -> float:
        mapped, units = options.get("columns"), options.get("units")
        return find_columns(header, mapped, units)[name][1]

    assert factor(["moment_rate_uN_m_per_s"], "moment_rate") == 1e-6
    assert factor(["moment_milli_newton_metre"], "moment") == 1e-3
    assert factor(["M_uN_m_per_s"], "moment_rate", columns={"moment_rate": "M_uN_m_per_s"}) == 1e-6
    assert factor(["m_Nm"], "moment", columns={"moment": "m_Nm"}) == 1.0
    assert factor(["m_N_m"], "moment", columns={"moment": "m_N_m"}) == 1.0
    assert factor(["moment", "moment_sd"], "moment_sd", units={"moment": "uN m"}) == 1e-6
    assert factor(["moment_uNm", "moment_uNm_sd"], "moment_sd") == 1e-6
    assert factor(["moment_uNm", "moment_sd_nNm"], "moment_sd") == 1e-9


FORCES = ["moment", "axial_force", "transverse_force"]


def test_a_row_at_odds_with_its_own_redundancy_says_so() -> None:
    b = ww.press(KNOWN, np.linspace(10e-3, 25e-3, 16), 0.3)
    rng = np.random.default_rng(2)
    table = pd.DataFrame({n: getattr(b, n) * (1 + 0.02 * rng.standard_normal(16)) for n in FORCES})
    table.loc[5, "axial_force"] *= 3
    found = ww.locate(table, KNOWN, noise=0.05)
    assert found["status"].eq("improbable_reading").to_numpy().nonzero()[0].tolist() == [5]
    assert found["misfit_sd"].idxmax() == 5


def test_one_row_a_contact_leaves_the_noise_as_believed() -> None:
    b = ww.press(KNOWN, np.linspace(10e-3, 25e-3, 6), 0.3)
    table = pd.DataFrame({"moment": b.moment, "axial_force": b.axial_force})
    found = ww.locate(table, KNOWN)
    assert any("follows from nothing in this table" in note for note in found.attrs["notes"])
    alone = ww.locate(table.iloc[[2]], KNOWN)
    for name in ("radial_distance_mm", "lower_mm", "upper_mm"):
        assert found.loc[2, name] == pytest.approx(alone.loc[2, name], rel=1e-6)


def test_a_shape_at_rest_that_nobody_gave_is_mixed_over() -> None:
    """Beside posteriors of whiskers of many curvatures, weighed by prior and evidence."""
    unsaid = ww.Whisker(C2.length, C2.base_radius, C2.tip_radius, youngs_modulus=3e9)
    b = ww.press(replace(unsaid, curvature=6.0), 18e-3, 0.25)
    y = np.array([b.moment, b.axial_force])
    found = ww.locate(pd.DataFrame([y], columns=FORCES[:2]), unsaid, noise=0.2)
    bow = ww.whisker.usual_turn() / unsaid.length
    score = np.linspace(-2.0, 2.0, 5)
    each = []
    for z in score:
        own = replace(unsaid, curvature=z * bow)
        noise = ww.inference.default_noise(own, ww.cues.ForceMap(), 0.2)
        each.append(ww.posterior(ww.Observer(own, ww.cues.ForceMap(), noise), y))
    log = np.array([float(p.log_evidence) for p in each]) - score**2 / 2
    weight = np.exp(log - log.max())
    weight /= weight.sum()
    mean, sd = (1e3 * np.array([float(np.ravel(getattr(p, n))[0]) for p in each]) for n in
                ("mean", "sd"))  # fmt: skip
    middle = weight @ mean
    assert found["radial_distance_mm"][0] == pytest.approx(middle, abs=0.1)
    spread = np.sqrt(weight @ (sd**2 + (mean - middle) ** 2))
    assert found["sd_mm"][0] == pytest.approx(spread, rel=0.05)
    straight = ww.locate(pd.DataFrame([y], columns=FORCES[:2]), KNOWN, noise=0.2)
    assert found["sd_mm"][0] > straight["sd_mm"][0]
    assert any("write curvature=0" in note for note in found.attrs["notes"])


def test_stiffness_is_mixed_over_as_the_engine_sums_over_it() -> None:
    """Two noises, nearly alike: the values of stiffness beside layers of the engine."""
    from weberwhisk.recordings.mixture import Done, Readings, Spread, cases_of, rows_of

    y = _readings(SOFT, 0.2, 4, seed=5)[1]
    readings = Readings(y, np.ones(4))
    noises = [lambda *_: ww.receptors.Weber(0.2), lambda *_: ww.receptors.Weber(0.2001)]
    cases = cases_of(C2, SOFT, None, noises, None)
    ends, values = rows_of(cases, readings, Spread(), Done())
    p = ww.posterior(ww.Observer(C2, SOFT, ww.receptors.Weber(0.2)), y)
    np.testing.assert_allclose(values[:, 0], p.mean, atol=0.05 * p.sd.min())
    np.testing.assert_allclose(values[:, 1], p.sd, rtol=0.05)
    np.testing.assert_allclose(ends, p.interval(0.95), atol=0.12 * p.sd.max())
    # Readings over the stiffness and whiskers of each are one and the same; the latter serve noise
    # with a floor of its own, here of next to nothing.
    floored = [ww.receptors.GeneralisedWeber(k, floor=1e-15) for k in (0.2, 0.2001)]
    whiskers = cases_of(C2, SOFT, None, floored, None)
    assert (len(cases.observers), len(whiskers.observers)) == (1, 5)
    stiff = rows_of(whiskers, readings, Spread(), Done())
    np.testing.assert_allclose(stiff.ends, ends, rtol=1e-4)
    np.testing.assert_allclose(stiff.values[:, :2], values[:, :2], rtol=1e-5)


def _film(rows: int) -> pd.DataFrame:
    """Touches of four rows, on both sides of a whisker."""
    rng = np.random.default_rng(7)
    r = np.repeat(rng.uniform(10e-3, 25e-3, rows // 4), 4)
    bent = ww.press(C2, r, np.tile([0.1, 0.2, 0.25, 0.3], rows // 4))
    side = np.where(np.arange(rows) < rows // 2, 1, -1)
    noisy = {
        name: signal * (1 + 0.1 * rng.standard_normal(rows))
        for name, signal in (("moment", bent.moment * side), ("axial_force", bent.axial_force))
    }
    return pd.DataFrame({**noisy, "touch": np.arange(rows) // 4})


@pytest.mark.parametrize("noise", slow_but([None, 0.1], (1,)))
def test_workers_give_the_same_bits(monkeypatch: pytest.MonkeyPatch, noise: float | None) -> None:
    """By lattices, which may want cells of the observer, and by cells alone."""
    from weberwhisk.recordings import mixture

    monkeypatch.setattr(mixture, "BLOCK", 4)
    film, done = _film(8), []
    given: dict[str, Any] = {"touch": "touch", "noise": noise}
    here = ww.locate(film, KNOWN, **given, progress=lambda *at: done.append(at))
    assert done == sorted(done)
    there = ww.locate(film, KNOWN, **given, workers=2)
    pd.testing.assert_frame_equal(here, there, check_exact=True)
    if noise is None:
        assert done[-1] == (16, 16)
        there = ww.locate(film, KNOWN, **given, workers=1)
        pd.testing.assert_frame_equal(here, there, check_exact=True)
    with pytest.raises(ValueError, match="workers"):
        ww.locate(film, C2, workers=0)


@pytest.mark.parametrize("curvature", [-15.0, 0.0, 10.0])
@pytest.mark.parametrize("k", slow_but([0.06, 0.2], (1,)))
def test_lattices_agree_with_cells(curvature: float, k: float) -> None:
    """Moments, quantiles and evidence, where the lattice claims them; it claims most of them."""
    from weberwhisk.inference import default_noise
    from weberwhisk.inference.quadrature import sums_of
    from weberwhisk.recordings.lattice import ALONE, Lattice, step_of

    whisker, cue = replace(C2, curvature=curvature), ww.cues.ForceMap()
    observer = ww.Observer(whisker, cue, default_noise(whisker, cue, k))
    y = _film(40)[["moment", "axial_force"]].abs().to_numpy()
    cells = sums_of(observer, y)
    densities = Lattice(observer, step_of(observer.noise, 2)).under(observer.noise, ALONE)
    sums = densities.sums(y)
    good = (sums.error < 2e-3) & (cells.error < 2e-3)
    assert good.mean() > 0.9
    off = (sums.mean - cells.mean)[good] / cells.sd[good]
    np.testing.assert_allclose(off, 0, atol=5e-3)
    np.testing.assert_allclose(sums.sd[good], cells.sd[good], rtol=5e-3)
    np.testing.assert_allclose(sums.log_evidence[good], cells.log_evidence[good], atol=5e-3)
    p = np.array([0.025, 0.5, 0.975])
    off = densities.quantiles(sums.layers, p)[good] - cells.quantiles(p, 0)[good]
    np.testing.assert_allclose(off / cells.sd[good, :1], 0, atol=0.02)


@pytest.mark.parametrize(
    "noise", slow_but([0.1, ww.receptors.GeneralisedWeber(0.1, floor=[0, 2e-6]), None], (0,))
)
@pytest.mark.slow
def test_a_touch_does_not_depend_on_touches_of_the_other_side(noise: object) -> None:
    whisker = replace(C2, curvature=-15.0)
    film = _film(8)
    every = ww.locate(film, whisker, touch="touch", noise=noise)
    assert (every["touch_status"] == "converged").all()
    if noise is None:  # learnt from all touches
        return
    alone = ww.locate(film.iloc[4:], whisker, touch="touch", noise=noise)
    numbers = [name for name in alone if name.startswith("touch_r") or name == "touch_sd_mm"]
    pd.testing.assert_frame_equal(every.iloc[4:][numbers], alone[numbers], rtol=1e-6)


def test_what_long_tables_take_is_said_with_what_spares_it() -> None:
    from functools import partial

    from weberwhisk.inference import default_noise
    from weberwhisk.recordings.mixture import cases_of

    laws = [partial(default_noise, weber_fraction=k) for k in (0.1, 0.2)]
    cases = cases_of(ww.Whisker(50e-3, 100e-6, 5e-6, curvature=0), SOFT, None, laws, None)
    assert cases.cost(False, 1000, 1) == ""
    said = cases.cost(False, 100_000, 1)
    assert said.startswith("Locating 100000 rows takes about 2 min by 10 combinations of shape, ")
    assert "about 1 min" in cases.cost(False, 100_000, 2)
    assert "about 50 min" in cases.cost(True, 100_000, 1)
