"""Two real data sets fitted and criticised: a rat that is learning, and people who count dots.

    python analyses/real_data.py [--short] [folder]

Writes `real_data.md` (the report) and `figures/real_data.png` into this folder, or the one named.
`--short` fits the last ten sessions of the rat only, as the slow tests do.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from command import ANALYSES, markdown_table, options

from weberwhisk import compare, fit_weber, plots
from weberwhisk.behaviour import (
    Comparison,
    StateFit,
    Trials,
    WeberFit,
    checks,
    load_numerosity,
    load_rat_auditory,
    quantile_residuals,
    residuals_by,
)
from weberwhisk.behaviour.effects import Contraction, Drift, History

BLOCK = 5  # sessions fitted together


def markdown(table: pd.DataFrame, index: bool = True) -> str:
    """A table in Markdown, numbers to three digits."""
    shown = table.reset_index() if index else table

    def cell(value: object) -> str:
        return f"{value:.3g}" if isinstance(value, float) else str(value)

    rows = [[cell(value) for value in row] for row in shown.to_numpy(object).tolist()]
    return markdown_table([str(name) for name in shown.columns], rows)


def by_block(trials: Trials) -> pd.DataFrame:
    """The rat fitted in blocks of sessions, during which it changes less."""
    rows = []
    sessions = trials.sessions
    for start in range(0, len(sessions), BLOCK):
        block = sessions[start : start + BLOCK]
        fit = fit_weber(trials.select(session=block))
        low, high = fit.interval()
        median = fit.summary()["median"]
        rows.append(
            {
                "sessions": f"{block[0]}–{block[-1]}",
                "middle": (block[0] + block[-1]) / 2,
                "n": fit.trials.n_trials,
                "weber_fraction": fit.weber_fraction,
                "lower": low,
                "upper": high,
                "lapse_low": median["lapse_low"],
                "lapse_high": median["lapse_high"],
                "bias": median["bias"],
                "misfit_p": fit.misfit,
                "status": fit.status.name,
            }
        )
    return pd.DataFrame(rows)


def observers(trials: Trials) -> Comparison:
    """What else moves the rat: contraction to the mean of all sounds, its last answer."""
    return compare(
        {
            "sounds alone": fit_weber(trials),
            "a bias per standard": fit_weber(trials, bias="per standard"),
            "contraction": fit_weber(trials, effects=[Contraction()]),
            "history": fit_weber(trials, effects=[History()]),
        }
    )


def by_standard(trials: Trials, shared: WeberFit) -> str:
    """What the report says of the whole course with one bias, and what a bias per standard does."""
    own = fit_weber(trials, bias="per standard")
    low, high = own.interval()
    notes = " ".join(note for note in shared.notes if "kinds" in note)
    return (
        f"The status is {shared.status.name}, and the report adds: “{notes}” The animal moreover "
        f"prefers another answer at each standard (misfit p = {shared.misfit:.2g}). With a bias "
        f"per standard the status is {own.status.name}, at {own.weber_fraction:.3g} per unit "
        f"({low:.3g} to {high:.3g}, misfit p = {own.misfit:.2g}): as the biases differ and the "
        "lapses do not, the answers separate them."
    )


def with_states(trials: Trials) -> pd.DataFrame:
    """Blocks of the rat with one, two and three states, and the last session of each held out.

    The log score of trials held out is the difference of two log evidences: of all trials, and of
    those before. It is the sum over trials of the log-probability of the next answer.
    """
    rows = []
    for start in range(0, len(trials.sessions), BLOCK):
        block = trials.sessions[start : start + BLOCK]
        whole, before = trials.select(session=block), trials.select(session=block[:-1])
        held_out = whole.n_trials - before.n_trials
        row: dict[str, object] = {"sessions": f"{block[0]}–{block[-1]}", "held out": held_out}
        scores = {}
        for states in (1, 2, 3):
            fit, fewer = (fit_weber(t, bias="per standard", states=states) for t in (whole, before))
            assert fit.log_evidence is not None
            assert fewer.log_evidence is not None
            scores[states] = fit.log_evidence - fewer.log_evidence
            low, high = fit.interval()
            row[f"k, {states}"] = f"{fit.weber_fraction:.2g} ({low:.2g} to {high:.2g})"
            if isinstance(fit, StateFit):
                row[f"engaged, {states}"] = f"{100 * fit.share_engaged()[0]:.0f} %"
                row[f"gain, {states}"] = scores[states] - scores[1]
            row[f"status, {states}"] = fit.status.name
        rows.append(row)
    return pd.DataFrame(rows)


def of_states(table: pd.DataFrame) -> str:
    """What the held-out sessions say of states, in a sentence."""
    words = []
    for states in (2, 3):
        gain = table[f"gain, {states}"]
        words.append(
            f"{states} states predict the sessions held out better than one by {gain.sum():+.0f} "
            f"nats in all, in {(gain > 0).sum()} of {len(gain)} blocks"
        )
    return f"{'; '.join(words)} ({table['held out'].sum()} trials held out)."


def rat(trials: Trials, lines: list[str]) -> tuple[pd.DataFrame, WeberFit]:
    """The rat's part of the report."""
    whole = fit_weber(trials)
    blocks = by_block(trials)
    known = {"bias": 0.0}
    drift = compare(
        {
            "stationary": fit_weber(trials, priors=known),
            "drifting": fit_weber(trials, priors=known, effects=[Drift()]),
        }
    )
    late = trials.select(session=trials.sessions[-10:])
    which = observers(late)
    states = with_states(trials)
    columns = ["log_bayes_factor", "elpd_difference", "difference_se", "bad_k"]
    lines += [
        "## The rat: which of two sounds was louder?",
        "",
        f"{trials.n_trials} trials in {len(trials.sessions)} sessions. The stimuli are normalised "
        "log levels of unknown unit, so Weber fractions are counted per unit of that scale. All "
        "steps between neighbours are alike: there are two proportions, one up and one down, "
        "for a Weber fraction, a bias and two lapses, so that what is believed of lapses decides: "
        f"the default, {whole.model.priors.words('lapse_low')} at either end.",
        "",
        f"One observer for all: {whole.weber_fraction:.3g} per unit, with 95 % between "
        f"{whole.interval()[0]:.3g} and {whole.interval()[1]:.3g}. It must not be believed: the "
        "checks, set beside data that this observer would give, say",
        "",
        markdown(checks(whole)),
        "",
        by_standard(trials, whole),
        "",
        f"The same in blocks of {BLOCK} sessions, where the animal changes less:",
        "",
        markdown(blocks.drop(columns="middle"), index=False),
        "",
        f"Stationary or drifting? {drift.report()}",
        "",
        markdown(drift.table[columns]),
        "",
        "What moves the answers besides the two sounds, in the last ten sessions? "
        f"{which.report()}",
        "",
        markdown(which.table[columns]),
        "",
        "Is the animal engaged all the time? Blocks with a bias per standard and 1, 2 or 3 states; "
        "the last session of each is predicted from those before (gain of the log score over one "
        f"state, nats). {of_states(states)}",
        "",
        markdown(states, index=False),
        "",
        "Checks of the last ten sessions under the best of these:",
        "",
        markdown(checks(which.fits[str(which.table.index[0])])),
        "",
    ]
    return blocks, whole


def people(trials: Trials, lines: list[str]) -> list[WeberFit]:
    """The people's part of the report."""
    fits = [fit_weber(trials.select(subject=s)) for s in trials.subjects]
    rows = []
    for subject, fit in zip(trials.subjects, fits, strict=True):
        low, high = fit.interval()
        p = checks(fit)["p"]
        rows.append(
            {
                "subject": subject,
                "n": fit.trials.n_trials,
                "weber_fraction": fit.weber_fraction,
                "lower": low,
                "upper": high,
                "bias": fit.summary().loc["bias", "median"],
                "p levels": p["levels"],
                "p trend": p["trend"],
                "p repetition": p["repetition"],
                "status": fit.status.name,
            }
        )
    lines += [
        "## Two people: which cloud has more dots?",
        "",
        "250 trials each; the Weber fraction is a pure ratio. The p are those of the checks.",
        "",
        markdown(pd.DataFrame(rows), index=False),
        "",
    ]
    return fits


def draw(blocks: pd.DataFrame, whole: WeberFit, fits: list[WeberFit], path: Path) -> None:
    """The figure: the rat's course, its residuals by session, and the people's curves."""
    figure = plots.new_figure(plots.DOUBLE, 5.2)
    ((course, off), (one, two)) = figure.subplots(2, 2)
    middle, low, high = (blocks[c].to_numpy(float) for c in ("weber_fraction", "lower", "upper"))
    course.errorbar(
        blocks["middle"], middle, [(middle - low).tolist(), (high - middle).tolist()], fmt="o-",
        color=plots.COLOURS[0], capsize=2, markersize=4,
    )  # fmt: skip
    course.set_ylim(bottom=0)
    course.set_xlabel("session")
    course.set_ylabel("Weber fraction per unit")
    course.text(0.78, 0.9, "the rat", transform=course.transAxes)
    plots.residuals(residuals_by(whole, "session"), off)
    off.text(0.04, 0.9, "the rat", transform=off.transAxes)
    for ax, fit in zip((one, two), fits, strict=True):
        plots.psychometrics(fit, ax, unit="log ratio")
        ax.set_ylabel("P(second reported greater)")
        ax.text(0.04, 0.9, f"person {fit.trials.subjects[0]}", transform=ax.transAxes)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)


def main(folder: Path, short: bool = False) -> Path:
    """Everything; returns the report."""
    lines = ["# Real data, fitted and criticised", "", "Made by `real_data.py`.", ""]
    trials = load_rat_auditory(sessions=range(31, 41) if short else None)
    blocks, whole = rat(trials, lines)
    fits = people(load_numerosity(), lines)
    z = np.concatenate([quantile_residuals(fit)["z"] for fit in fits])
    lines += [
        f"Their {z.size} randomised quantile residuals have mean {z.mean():+.2f} and sd "
        f"{z.std():.2f}, 0 and 1 being those of a model that holds.",
        "",
        "![The rat's course, its residuals, and the people's choices](figures/real_data.png)",
    ]
    draw(blocks, whole, fits, folder / "figures" / "real_data.png")
    report = folder / "real_data.md"
    report.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return report


if __name__ == "__main__":
    given = options(__file__, __doc__, folder=ANALYSES, short="ten sessions of the rat")
    main(given.folder, given.short)
