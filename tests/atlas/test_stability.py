"""Nothing is wrong in silence: a short search of each domain, and of what is wrong on purpose."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from analysis_scripts import load

from weberwhisk import Whisker

fault_search = load("fault_search")
stability = load("stability")
W = Whisker(50e-3, 100e-6, 5e-6, 3e9)
DOMAINS = {d.name: d for d, *_ in stability.domains()}
#: Cases of each kind and generations bred from the worst: half a second each on a quiet core. New
#: ones in the slow form; `analyses/stability.py` searches for hours.
SIZES = {
    "closed form": (4, 0),
    "elastica": (4, 0),
    "profile": (2, 0),
    "rod, in the plane": (2, 1),
    "rod, out of the plane": (3, 0),
    "JND by propagation": (2, 0),
    "fit of choices": (1, 1),
    "quadrature, vibration, phase": (6, 1),
    "quadrature, floor and ceiling": (6, 1),
    "quadrature, force map": (1, 0),
    "quadrature, two taps fused": (3, 1),
    "quadrature, tap and map fused": (1, 1),
    "quadrature, map, stiffness unknown": (1, 1),
    "quadrature, log-normal map, stiffness unknown": (1, 1),
    "quadrature, angle-side-angle, side unknown": (1, 1),
    "laplace, vibration": (6, 1),
    "laplace, velocity felt": (3, 1),
    "emcee, compliance": (3, 1),
    "quadrature, vibration, phase, odd readings": (6, 1),
    "contacts outside": (20, 1),
    "fusions of any whisker": (1, 0),
    "real whiskers": (1, 0),
    "curvature or hinge uncertain": (1, 0),
    "curved whiskers in space": (1, 0),
    "friction unknown": (1, 0),
    "posteriors outside": (6, 0),
}


#: Left to the slow form: a cheaper search covers the same engine, or other tests compare it with
#: brute force (out of the plane, `test_three_unknowns`, `test_fit`, `test_emcee_hard_cases`).
LONG = {
    "elastica", "quadrature, floor and ceiling", "quadrature, vibration, phase, odd readings",
    "rod, in the plane", "rod, out of the plane", "fit of choices", "quadrature, tap and map fused",
    "quadrature, log-normal map, stiffness unknown", "quadrature, map, stiffness unknown",
    "quadrature, angle-side-angle, side unknown", "emcee, compliance", "fusions of any whisker",
    "real whiskers", "curvature or hinge uncertain", "curved whiskers in space",
    "friction unknown", "quadrature, two taps fused", "laplace, velocity felt",
    "quadrature, vibration, phase",
}  # fmt: skip


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] * (n in LONG)) for n in SIZES]
)
def test_a_search_finds_nothing_wrong_in_silence(name: str, search_seed: int) -> None:
    """The seed is new in the slow form; WEBERWHISK_SEARCH_SEED replays one."""
    for seed in range(search_seed, search_seed + 10):  # a few cases may all be beyond the reference
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of the references, past the ends of what exists
            cases = fault_search.search(DOMAINS[name], *SIZES[name], seed)
        wrong = fault_search.silent(cases)
        assert wrong.empty, (
            f"WEBERWHISK_SEARCH_SEED={seed} replays these of {name}:\n{wrong.to_string()}"
        )
        if (cases["fate"] != fault_search.Fate.UNJUDGED).any():
            return
    pytest.fail(f"Ten searches from seed {search_seed} on had nothing that could be judged.")


@pytest.mark.slow
def test_a_long_search_of_fusions_finds_nothing_wrong_in_silence(search_seed: int) -> None:
    """150 fusions, which missed modes in silence once: some ten minutes of a core."""
    cases = fault_search.search(DOMAINS["fusions of any whisker"], 30, 3, search_seed)
    wrong = fault_search.silent(cases)
    assert wrong.empty, f"WEBERWHISK_SEARCH_SEED={search_seed} replays these:\n{wrong.to_string()}"
    assert (cases["fate"] == fault_search.Fate.RIGHT).mean() > 0.3


def test_the_search_can_find() -> None:
    """A wrong answer is found: signals of a whisker taken for 1 % stiffer."""
    rungs = stability.stability_rungs
    press = rungs._press

    def stiffer(whisker, *others):
        made = Whisker(
            whisker.length, whisker.base_radius, whisker.tip_radius, 1.01 * rungs.MODULUS
        )
        return press(made, *others)

    rungs._press = stiffer
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            cases = fault_search.search(DOMAINS["elastica"], 8, 0, 1)
    finally:
        rungs._press = press
    assert (cases["fate"] == fault_search.Fate.SILENT).sum() >= 4
    assert (cases["fate"] == fault_search.Fate.RIGHT).sum() == 0


@pytest.mark.slow  # in the plane: the test before
def test_the_search_can_find_out_of_the_plane() -> None:
    """Whiskers that twist by 4 % less than the referee's, which are right where nothing twists."""
    space = load("stability_space")
    press = space.rod.press
    case = {
        "distance": [0.4, 0.7, 0.5, 0.7], "push": [0.8, 0.5, 0.6, 0.5],
        "tip": [0.05, 0.05, 1.0, 0.05], "curvature": [0.8, -1.2, 1.0, -1.2],
        "friction": [0.0, 0.3, -0.3, 0.3], "bearing": [1.2, 0.7, 2.0, 0.0],
        "roll": [0.3, 0.0, 2.5, 0.0],
    }  # fmt: skip
    given = {name: np.array(values) for name, values in case.items()}
    assert set(space.judge(given).fate.tolist()) == {fault_search.Fate.RIGHT}
    space.rod.press = lambda *a, **k: press(*a, **k, poisson_ratio=0.32)
    try:
        fate = space.judge(given).fate
    finally:
        space.rod.press = press
    assert fate.tolist() == [fault_search.Fate.SILENT] * 3 + [fault_search.Fate.RIGHT]


@pytest.mark.slow  # each against the package: the searches
def test_the_two_referees_agree_in_the_plane() -> None:
    """One follows the whisker from the contact in its plane, the other from the base in space."""
    beam, rod_ = load("reference_beam"), load("reference_rod")
    one, curvature = np.ones(4), np.array([0.0, 20.0, -25.0, 10.0])
    friction = np.array([0.4, 0.0, -0.6, 0.3])
    beams = beam.Beams(50e-3 * one, 1e-4 * one, 1e-5 * one, 3e9 * one, curvature, friction)
    r, push = np.array([20e-3, 35e-3, 30e-3, 49e-3]), np.array([0.5, 0.2, 0.3, 0.9])
    rods = rod_.Rods.pushed(beams, r, 0 * r, 0 * r)
    ways = rods.walk(2 * one), beams.walk(r, beams.at_rest(r)[1] + push)
    np.testing.assert_array_equal(ways[0]["end"], [1, 1, 1, 2])
    np.testing.assert_array_equal(ways[1]["end"], [0, 0, 0, 2])
    force, arc, _ = rods.at(ways[0]["trail"], push)
    # At the tip a walk's last step, of 1e-4 at most, is not made.
    tip = ways[1]["angle"][3] - ways[1]["rest"][3]
    np.testing.assert_allclose(ways[0]["angle"][3], tip, atol=3e-5)
    space = rods.polish(push, force, arc)["force"]
    plane = beams.polish(r, beams.at_rest(r)[1] + push, ways[1]["arc"], ways[1]["force"])
    np.testing.assert_allclose(-space[0, :3], plane["axial_force"][:3], rtol=1e-9)
    np.testing.assert_allclose(space[1, :3], plane["transverse_force"][:3], rtol=1e-9)
    np.testing.assert_array_equal(space[2, :3], 0)


def test_the_maps_are_drawn() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        cases = fault_search.search(DOMAINS["quadrature, log-normal"], 6, 0, 1)
    cases = cases.assign(panel="quadrature, one unknown", across=cases["distance"], up=cases["k"])
    assert len(stability.draw(cases).axes) == 4
    counts = stability.summary(cases)
    assert counts[["right", "warned", "refused", "silent", "unjudged"]].to_numpy().sum() == 12
