"""`weberwhisk quickstart`: an example from end to end, on a real whisker and a real rat."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Annotated, Any

import numpy as np

import weberwhisk as ww

from .._util.checks import positive
from .._util.output import Run, atomic_write, to_json
from .._util.values import pd
from . import as_options, command, describe, enough_draws, finish, progress, whisker_line
from .whiskers import curve_in_steps

__all__ = ["jnd_surface", "moment_dominated", "quickstart", "rat_choices"]


@command
def quickstart(
    identity: Annotated[str, "A rat's whisker by row and column."] = "C2",
    weber_fraction: Annotated[float, "Of the receptors."] = 0.1,
    draws: Annotated[int, "Noisy readings at each place of the JND curve."] = 100,
    seed: int = 1,
    out: Annotated[Path, "Folder for figures, tables and text.", {"metavar": "FOLDER"}] = Path(
        "quickstart"
    ),
    as_json: bool = False,
) -> None:
    """The paper's figures 4a and 4b for a real whisker, and the Weber fraction of a real rat.

    Takes under a minute, writes everything into one folder, and says in plain words what came out.
    """
    positive("--weber-fraction", weber_fraction, "write 0.1, say")
    enough_draws(draws)
    whisker = ww.Whisker.from_identity(identity)
    inputs = {"identity": identity, "weber_fraction": weber_fraction, "draws": draws}
    with Run(out, "quickstart", inputs, seed) as run:
        curve = curves(run, whisker, weber_fraction, draws, seed, as_json)
        surface = jnd_surface(run, whisker, weber_fraction)
        rat = rat_choices(run, seed, as_json)
        numbers = {
            "whisker": {"identity": identity, **describe(whisker)},
            "weber_fraction": weber_fraction, "jnd_curve": curve, "jnd_surface": surface,
            "rat": rat,
        }  # fmt: skip
        text = explanation(identity, whisker, weber_fraction, draws, numbers)
        atomic_write(run.path("rat_report.txt"), rat["report"])
        atomic_write(run.path("quickstart.txt"), text)
        atomic_write(run.path("quickstart.json"), to_json(numbers) + "\n")
    finish(run, as_json, numbers, text)


def curves(
    run: Run, whisker: ww.Whisker, k: float, draws: int, seed: int, as_json: bool
) -> dict[str, Any]:
    """Figure 4a: posteriors by emcee and closed forms, for a taper and a cylinder."""
    by_emcee, exact = (
        light_taps(whisker, k, method, draws, seed, as_json) for method in ("emcee", "quadrature")
    )
    checks = [curve["posterior"].to_numpy() for curve in exact.values()]
    tables = {name: curve.table for name, curve in by_emcee.items()}
    table = pd.concat(tables, names=["whisker"]).reset_index()
    run.table("jnd_curve", table.assign(posterior_by_quadrature_mm=np.concatenate(checks) * 1e3))
    run.figure("jnd_curve", ww.plots.jnd_lines(by_emcee, length=whisker.length, weber_fraction=k))
    return {name: _compared(curve, exact[name], whisker, k) for name, curve in by_emcee.items()}


def light_taps(
    whisker: ww.Whisker, k: float, method: str, draws: int, seed: int, as_json: bool = False
) -> dict[str, ww.sensitivity.JNDCurve]:
    """Posteriors of figure 4a for a whisker and a cylinder of its length, at ten places."""
    places, out = np.linspace(0.05, 0.95, 10) * whisker.length, {}
    for name, shape in (("tapered", whisker), ("cylinder", whisker.cylinder())):
        observer = ww.Observer(shape, ww.cues.Compliance(), ww.receptors.Weber(k))
        options = (np.array([]), method, "d'=1", draws, seed, as_json, f"{method}, {name}")
        out[name] = curve_in_steps(observer, places, *options)
    return out


def _compared(
    table: ww.sensitivity.JNDCurve, exact: ww.sensitivity.JNDCurve, whisker: ww.Whisker, k: float
) -> dict[str, Any]:
    """One whisker's posteriors compared with the closed form and with quadrature, JND/(kL)."""
    scale = whisker.length * k
    closed, sampled, error = (
        table[name].to_numpy(float) for name in ("closed_form", "posterior", "posterior_error")
    )
    return {
        "r_over_length": table["radial_distance"].to_numpy(float) / whisker.length,
        "closed_form": closed / scale, "posterior": sampled / scale,
        "posterior_95_percent": 1.96 * error / scale,
        "within_95_percent": int(np.sum(np.abs(sampled - closed) <= 1.96 * error)),
        "excess": sampled / closed - 1,
        "emcee_from_quadrature": float(np.max(np.abs(sampled / exact["posterior"].to_numpy() - 1))),
    }  # fmt: skip


def jnd_surface(run: Run, whisker: ww.Whisker, k: float) -> dict[str, Any]:
    """Figure 4b: the JND of the force map with noise only in the moment."""
    along = moment_dominated(whisker, k)
    table = ww.sensitivity.linear_surface(along)
    run.table("jnd_surface", table)
    shown = ww.plots.jnd_surface(table, length=whisker.length, weber_fraction=k)
    run.figure("jnd_surface", shown)
    scale = whisker.length * k

    def at(place: float, angle: float) -> float:
        contact = np.array([place * whisker.length, np.radians(angle)])
        return float(ww.sensitivity.weber_propagation(along, contact)) / scale

    limit = ww.flick_past(whisker, 0.5 * whisker.length).deflection_angle
    return {
        "flick_past_degrees_at_half_length": float(np.degrees(limit)),
        "at_10_degrees": {f"{p:g}": at(p, 10.0) for p in (0.3, 0.5, 0.7)},
        "at_0.7_length": {f"{a:g}": at(0.7, a) for a in (1.0, 10.0, 20.0)},
    }


def moment_dominated(whisker: ww.Whisker, k: float) -> ww.Observer:
    """The force map with noise in the moment, and negligible noise in the axial force."""
    return ww.Observer(whisker, ww.cues.ForceMap(), ww.receptors.Weber([k, k * 1e-9]))


def rat_choices(
    run: Run, seed: int, as_json: bool, sessions: tuple[int, int] = (31, 37)
) -> dict[str, Any]:
    """The Weber fraction of a real rat in the last sessions before its levels changed."""
    trials = ww.behaviour.load_rat_auditory(range(sessions[0], sessions[1] + 1))
    with progress("Weber fraction of the rat", 1, as_json=as_json) as advance:
        fit = ww.fit_weber(trials, bias="per standard", seed=seed)
        advance()
    run.table("rat_choices", fit.residuals())
    run.table("rat_fit", fit.summary().reset_index())
    run.figure("rat_psychometric", ww.plots.psychometrics(fit))
    said = {"holds": what_holds(fit), "report": as_options(fit.report())}
    return {"sessions": sessions, **said, **fit.to_dict()}


#: What each check asks of an observer.
REQUIRED = {
    "levels": "the curve at every pair",
    "overdispersion": "answers that scatter by chance alone",
    "exponent": "Weber's law",
    "contraction": "no pull of the first sound to the mean",
    "noise_by_order": "both sounds equally noisy",
    "standard_second": "the standard alike in either place",
    "sessions": "the same in every session",
    "drift": "a Weber fraction that stays",
    "trend": "no trend",
    "repetition": "no pull of the answer before",
    "outcome": "no pull of the side that was right before",
    "streaks": "engaged throughout",
}


def what_holds(fit: ww.behaviour.WeberFit) -> str:
    """What of an observer holds for these answers, what does not, and what that does to k."""
    from ..behaviour.predictive import threshold

    table = fit.checked
    fires = table["p"] < threshold(table)
    words = {
        which: ", ".join(REQUIRED.get(str(name), str(name)) for name in table.index[fires == which])
        for which in (False, True)
    }
    cause = f" {fit.search.sentence}" if fires.any() else ""
    return (
        f"What holds of this observer: {words[False] or 'nothing that was checked'}. What does "
        f"not: {words[True] or 'nothing that was checked'}.{cause}"
    )


# -- the text ------------------------------------------------------------------------------------


def explanation(
    identity: str, whisker: ww.Whisker, k: float, draws: int, numbers: dict[str, Any]
) -> str:
    """The results in plain words; every number comes from `numbers`."""
    rat = numbers["rat"]
    texts = [
        f"A mean {identity} whisker of rats (Belli et al. 2017). {whisker_line(whisker)} Receptor "
        f"noise follows Weber's law with k = {k:g}: the sd of a reading is {k:.3g} of the signal. "
        "All JNDs here are one sd (d' = 1), and are given over k times the whisker's length L.",
        _of_curve(numbers["jnd_curve"], draws),
        _of_surface(numbers["jnd_surface"]),
        f"3. A real rat (rat_psychometric.png). {rat['holds']} {rat['data']['n_trials']} choices "
        f"of one rat, sessions {rat['sessions'][0]} to {rat['sessions'][1]}: which of two sounds "
        "was louder, "
        f"around {len(rat['data']['standards'])} standards. The stimulus column is a normalised "
        "logarithm of sound level whose unit is not published with it, so its Weber fraction "
        "cannot be put beside another, nor beside the k of the whisker above, which is an "
        "assumption: no Weber fraction of whisker force or moment has been measured. What "
        "`weberwhisk fit` reports of such a table:",
    ]
    credit = (
        "Data: rat W053, first 40 sessions; sample data of the psytrack package "
        "(github.com/nicholas-roy/psytrack), MIT licence, copyright Nicholas A. Roy; task of "
        "Akrami, Kopec, Diamond & Brody 2018, Nature 554:368. Whisker: Belli, Yang, Bresee & "
        "Hartmann 2017, J Neurophysiol 117:1807."
    )
    filled = [textwrap.fill(part, 92) for part in texts]
    return "\n\n".join([*filled, rat["report"].rstrip(), textwrap.fill(credit, 92)]) + "\n"


def _of_curve(curve: dict[str, Any], draws: int) -> str:
    taper, cylinder = curve["tapered"], curve["cylinder"]
    places = taper["r_over_length"]
    middle, last = len(places) // 2, -1
    agree = max(w["emcee_from_quadrature"] for w in curve.values())
    return (
        "1. JND curve (jnd_curve.png; the paper's figure 4a). Lines are the closed forms of the "
        f"rotational compliance cue, points the mean sd of {draws} emcee posteriors each. Tapered: "
        f"the JND is {taper['closed_form'][middle]:.2f} kL at {places[middle]:.2f} L and "
        f"{taper['closed_form'][last]:.2f} kL at {places[last]:.2f} L, so resolution is better "
        f"towards the tip; posterior {taper['posterior'][middle]:.2f} and "
        f"{taper['posterior'][last]:.3f} ± {taper['posterior_95_percent'][last]:.3f}. Cylinder: it "
        f"grows all the way, {cylinder['closed_form'][middle]:.2f} and "
        f"{cylinder['closed_form'][last]:.2f} kL; posterior {cylinder['posterior'][middle]:.2f} "
        f"and {cylinder['posterior'][last]:.2f}, {cylinder['excess'][last]:+.0%} at the last "
        "place, where the observer also knows that the whisker ends. "
        f"{taper['within_95_percent']} of {len(places)} tapered points and "
        f"{cylinder['within_95_percent']} of {len(places)} cylindrical ones lie on the line within "
        f"95 %. emcee is within {agree:.1%} of quadrature everywhere."
    )


def _of_surface(surface: dict[str, Any]) -> str:
    distances = ", ".join(f"{v:.2f} at {p} L" for p, v in surface["at_10_degrees"].items())
    angles = ", ".join(
        f"{v:.2f} at {a}°" for a, v in surface["at_0.7_length"].items() if np.isfinite(v)
    )
    return (
        "2. JND surface (jnd_surface.png; the paper's figure 4b). Moment and axial force together "
        "give distance and angle; noise is in the moment alone. The JND over kL falls with "
        f"distance (at 10°: {distances}) and with deflection (at 0.7 L: {angles}), as the paper "
        "says. Past the black line the whisker flicks past the object, at "
        f"{surface['flick_past_degrees_at_half_length']:.1f}° for 0.5 L. This JND is the slope at "
        "one contact; a posterior averages over the contacts that a reading allows and ends where "
        "the whisker does. The orange line is a false zero: there the axial force stops changing "
        "with angle, so that the slope alone calls distance known exactly, which no posterior "
        "does. It lies beyond the contact angle of 90° (dashed), where the paper's figure ends."
    )
