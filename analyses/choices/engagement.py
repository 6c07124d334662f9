"""Weber fractions of animals that are engaged part of the time: with states, without, and known.

    python analyses/choices/engagement.py [folder] [--short] [--sets N]

Writes `engagement.csv` and `engagement.md` into this folder, or the one named. Every animal (k =
0.15, six levels, lapses and a bias of its own) is fitted three ways: by `states=3`; by one state;
and by one state on the trials on which it was engaged, which nobody knows of a real animal. The
states are those of the model (`reset`: left with one probability, then drawn anew), or not
(`rates`: either disengaged state is left at a rate of its own), or there are none (`stationary`).
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).parents[1]))
from command import markdown_table, options

from weberwhisk import fit_weber, simulate_trials
from weberwhisk.behaviour import States, Trials, WeberFit

K = 0.15
LEVELS = [-0.3, -0.2, -0.1, 0.1, 0.2, 0.3]
ENGAGED, LOW, HIGH = 0, 1, 2
KINDS = ("reset", "rates", "stationary")


def states_of(kind: str, n: int, rng: np.random.Generator) -> np.ndarray:
    """The state of each trial: a Markov chain with either matrix of transitions."""
    share = rng.uniform(0.5, 1.0)
    if kind == "stationary":
        return np.zeros(n, dtype=int)
    if kind == "reset":
        long_run = np.array([share, (1 - share) / 2, (1 - share) / 2])
        step = 0.94 * np.eye(3) + 0.06 * long_run
    else:
        back, side = np.array([0.05, 0.1]), rng.uniform(0.2, 0.8)
        ratio = np.array([side, 1 - side]) / back
        leave = (1 - share) / share / ratio.sum()
        step = np.array(
            [
                [1 - leave, leave * side, leave * (1 - side)],
                [back[0], 1 - back[0], 0],
                [back[1], 0, 1 - back[1]],
            ]
        )
        long_run = np.array([share, *share * leave * ratio])
    state = np.empty(n, dtype=int)
    state[0] = rng.choice(3, p=long_run / long_run.sum())
    for t in range(1, n):
        state[t] = rng.choice(3, p=step[state[t - 1]])
    return state


def animal(kind: str, n_trials: int, seed: int) -> tuple[Trials, np.ndarray]:
    """Trials of an animal, and its state on each."""
    rng = np.random.default_rng([seed, n_trials, KINDS.index(kind)])
    lapse, bias = rng.beta(2, 98), 0.2 * rng.standard_normal()
    trials = simulate_trials(
        weber_fraction=K,
        offsets=LEVELS,
        trials_per_level=n_trials // len(LEVELS),
        lapse_low=lapse,
        lapse_high=lapse,
        bias=bias,
        seed=rng,
    )
    state, away = states_of(kind, len(trials.frame), rng), States()
    second = np.array([np.nan, away.answer_low, away.answer_high])[state]
    answer = np.where(
        state == ENGAGED, trials.frame["count"], rng.random(state.size) < second
    ).astype(float)
    return replace(trials, frame=trials.frame.assign(count=answer)), state


def row(kind: str, n_trials: int, seed: int) -> dict[str, object]:
    """What the three fits of an animal find, and the seconds of CPU of fit and checks."""
    trials, state = animal(kind, n_trials, seed)
    begun = time.process_time()
    several = fit_weber(trials, states=3)
    fitted = time.process_time()
    one = fit_weber(trials)
    simple = time.process_time()
    name = one.status.name
    checked = time.process_time()
    known = replace(trials, frame=trials.frame[state == ENGAGED].reset_index(drop=True), rows=None)
    _, low, high = several.share_engaged()
    return {
        "kind": kind,
        "trials": n_trials,
        "seed": seed,
        **of("states", several),
        **of("one", one),
        **of("known", fit_weber(known)),
        "status": name,
        "share_held": low <= (state == ENGAGED).mean() <= high,
        "fit_s": fitted - begun,
        "check_s": checked - simple,
    }


def of(name: str, fit: WeberFit) -> dict[str, float]:
    """Median and interval of k."""
    low, high = fit.interval()
    return {name: fit.weber_fraction, f"{name}_lower": low, f"{name}_upper": high}


def summary(table: pd.DataFrame) -> list[list[str]]:
    """A line for each kind of animal and number of trials."""
    lines = []
    for (kind, n), group in table.groupby(["kind", "trials"], sort=False):
        held = {x: group[f"{x}_lower"].lt(K) & group[f"{x}_upper"].gt(K) for x in FITS}
        rmse = {x: float(np.sqrt((np.log(group[x] / K) ** 2).mean())) for x in FITS}
        sure = group["status"].eq("DETERMINED")
        lines.append(
            [
                str(kind),
                str(n),
                *(f"{100 * held[x].mean():.0f} %" for x in FITS),
                f"{rmse['states']:.3f}",
                f"{rmse['states'] / rmse['known']:.2f}",
                f"{100 * group['share_held'].mean():.0f} %",
                f"{100 * (sure & ~held['one']).mean():.0f} %",
                f"{100 * group['status'].str.startswith('MISFIT').mean():.0f} %",
                f"{group['fit_s'].max():.1f}",
                f"{group['check_s'].max():.1f}",
            ]
        )
    return lines


FITS = ("states", "one", "known")
HEADS = (
    "states", "trials", "3 states hold k", "one state holds k", "known states hold k",
    "RMSE of ln k, 3 states", "over that of known states", "share engaged held",
    "one state: determined, and misses", "one state: MISFIT", "3 states, most s", "checks, most s",
)  # fmt: skip


def main() -> None:
    asked = options(
        __file__, __doc__, folder=Path(__file__).parent, short="six animals each", sets=100
    )
    sets = 6 if asked.short else asked.sets
    asked.folder.mkdir(parents=True, exist_ok=True)
    table = pd.DataFrame(
        [row(kind, n, seed) for n in (1000, 300) for kind in KINDS for seed in range(sets)]
    )
    table.to_csv(asked.folder / "engagement.csv", index=False, float_format="%.6g")
    text = (
        "# Animals that are engaged part of the time\n\n"
        f"`python analyses/choices/engagement.py --sets {sets}`: {sets} animals a line, 95 % "
        "intervals, seconds of CPU.\n\n"
    )
    (asked.folder / "engagement.md").write_text(
        text + markdown_table(HEADS, summary(table)) + "\n", "utf-8"
    )
    print(text + markdown_table(HEADS, summary(table)))


if __name__ == "__main__":
    main()
