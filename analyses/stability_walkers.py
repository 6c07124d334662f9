"""The part of `stability.py` that starts emcee's walkers badly, and takes its mixture away.

A user cannot place walkers: here the engine's own start is replaced by one ball, as small and as
far off as the hunt likes, for all ensembles, so that they agree with each other. Plain emcee is the
engine without the mixture's proposals, by stretch and differential evolution alone. Whatever they
say they have converged on is held against the same sums as any posterior.

Of several peaks plain emcee knows the one in whose reach all its ensembles start, and nothing it
can measure says that there is a higher one: that is what the mixture is for, with which it is
tried, and plain emcee is not.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import stability_posteriors as posteriors
from hunting import Axis, Domain, Fate, Judged

from weberwhisk.inference import emcee
from weberwhisk.inference.moves import default_moves, recommended_walkers

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

#: Steps that plain emcee is given: one unknown, and more. It seldom needs more, and seconds if so.
PLAIN_STEPS = (3000, 2000)


@contextmanager
def changed(start: Array | None, width: float, *, plain: bool) -> Iterator[None]:
    """The engine with another start, and without its mixture where it is plain."""
    own = emcee._start, emcee._moves, emcee.MOST_STEPS, emcee.STAGES

    def ball(density, mixture, mode, rng):
        count, dim = mode.shape
        shape = (count, 4, recommended_walkers(dim), dim)
        return start[:dim] + width * rng.standard_normal(shape)

    try:
        if start is not None:
            emcee._start = ball
        if plain:
            emcee._moves = lambda mixture, dim, share: default_moves(dim)
            emcee.MOST_STEPS, emcee.STAGES = PLAIN_STEPS, ()
        yield
    finally:
        emcee._start, emcee._moves, emcee.MOST_STEPS, emcee.STAGES = own


def judge(case: Case, name: str, *, plain: bool) -> Judged:
    """Each case by itself, as each has a start of its own."""
    judged = []
    for i in range(case["k"].size):
        one = {key: value[i : i + 1] for key, value in case.items()}
        start = np.array([one["start"][0], one["start_2"][0]]) if "start" in case else None
        with changed(start, float(one.get("width", [0.0])[0]), plain=plain):
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


def _judge(name: str, *, plain: bool) -> Callable[[Case], Judged]:
    return lambda case: judge(case, name, plain=plain)


DOMAINS = [
    Domain("emcee, k ≥ 0.3 near the tip", NEAR_TIP, _judge("compliance", plain=False)),
    Domain("plain emcee, k ≥ 0.3 near the tip", NEAR_TIP, _judge("compliance", plain=True)),
    *(
        Domain(
            f"{'plain ' * plain}emcee started badly, {name}",
            posteriors.AXES | BAD_START,
            _judge(name, plain=plain),
        )
        for plain in (False, True)
        for name in ("compliance", "vibration, phase", "force map")
        if not plain or name != "vibration, phase"
    ),
]
