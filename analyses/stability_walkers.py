"""The part of `stability.py` that starts emcee's walkers badly.

A user cannot place walkers: here the engine's own start is replaced by one ball, as small and as
far off as the search likes, for all ensembles, so that they agree with each other. Whatever they
say they have converged on is compared with the same sums as any posterior.

Of several peaks walkers find those in whose reach the ensembles start. With one unknown the engine
compares them with quadrature where the mass lies apart; with more nothing it can measure says that
there is a higher peak, and it is not tried.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

import numpy as np
import stability_posteriors as posteriors
from fault_search import Axis, Domain, Fate, Judged

from weberwhisk.inference import approximate

Array = np.ndarray
Case = dict[str, Array]

#: Where the sd of a sample is wrong in most runs unless they are judged.
NEAR_TIP = posteriors.AXES | {
    "distance": Axis(0.7, 1.0, special=(0.9, 0.95)),
    "k": Axis(0.3, 0.6, log=True),
}
#: The ball in the coordinates of the walkers, in which the whisker is some eight long.
BAD_START = {
    "start": Axis(-3.5, 4.0, special=(0.0,)),
    "start_2": Axis(-3.5, 4.0, special=(0.0,)),
    "width": Axis(1e-6, 3.0, log=True),
}


@contextmanager
def started_at(place: Array | None, width: float) -> Iterator[None]:
    """The engine with walkers in a ball, if one is given."""
    own = approximate._start

    def ball(observer, reading, density, rng):
        start, mode = own(observer, reading, density, rng)
        return place[: mode.shape[1]] + width * rng.standard_normal(start.shape), mode

    try:
        approximate._start = own if place is None else ball
        yield
    finally:
        approximate._start = own


def judge(case: Case, name: str) -> Judged:
    """Each case by itself, as each has a start of its own."""
    judged = []
    for i in range(case["k"].size):
        one = {key: value[i : i + 1] for key, value in case.items()}
        start = np.array([one["start"][0], one["start_2"][0]]) if "start" in case else None
        with started_at(start, float(one.get("width", [0.0])[0])):
            try:
                judged.append(posteriors.judge(one, name, "emcee"))
            except ValueError as error:
                # Walkers outside the support, or all in one place, are refused in a sentence.
                if "walker" not in str(error):
                    raise
                judged.append(Judged(np.array([Fate.REFUSED]), np.array([-np.inf]), {}))
    names = dict.fromkeys(key for j in judged for key in j.seen)
    seen = {key: np.array([j.seen.get(key, [np.nan])[0] for j in judged]) for key in names}
    return Judged(*(np.concatenate([getattr(j, f) for j in judged]) for f in ("fate", "excess")),
                  seen)  # fmt: skip


DOMAINS = [
    Domain("emcee, k ≥ 0.3 near the tip", NEAR_TIP, partial(judge, name="compliance")),
    *(
        Domain(
            f"emcee started badly, {name}", posteriors.AXES | BAD_START, partial(judge, name=name)
        )
        for name in ("compliance", "vibration, phase", "force map")
    ),
]
