"""One table of choices, several observers: which of them made it?

Two answers side by side. The evidence, integrated exactly, weighs each model with its priors; the
leave-one-out density (LOO) asks how well it would predict one more trial, whatever the priors. For
the paper's question, whether a whisker's taper is noticed, and its relatives there are functions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from scipy.special import logsumexp

from .. import _checks
from .._values import Array, Index, Shown, renamed_arguments
from ..cues import Compliance, ForceMap
from ..inference.arviz_io import pointwise_loo
from ..inference.observer import Observer
from ..whisker import Whisker
from .criticism import _Rows, check_fit
from .effects import Drift, Effect, Floor, check_effects
from .encodings import ConstantNoise, CueEncoding, Encoding, chosen_encoding, encoding_for
from .fit import WeberFit, fit_weber
from .located import at_touches
from .trials import SDS, Trials, check_trials
from .verdict import strength


@dataclass(frozen=True, repr=False)
class Comparison(Shown):
    """Fits of several observers to the same trials, best evidence first in `table`.

    Columns of `table`: `log_evidence`; `log_bayes_factor` against the best (natural log);
    `probability` if all were equally likely before; `elpd`, the expected log predictive density of
    a trial left out, summed over the trials; `elpd_difference` from the highest, with its standard
    error `difference_se`; `bad_k`, trials whose Pareto k is above 0.7, where LOO is not to be
    relied on; `weber_fraction`, and the `status` of the fit.

    Examples
    --------
    >>> from weberwhisk import fit_weber, simulate_trials
    >>> trials = simulate_trials(weber_fraction=0.1, seed=1)
    >>> known = {"lapse_low": 0.0, "lapse_high": 0.0}
    >>> both = compare({"lapses": fit_weber(trials), "none": fit_weber(trials, priors=known)})
    >>> both.table["log_bayes_factor"].iloc[0], both.report().startswith("none against lapses")
    (np.float64(0.0), True)
    """

    _figure: ClassVar[str] = "comparison"
    table: pd.DataFrame
    fits: Mapping[str, WeberFit] = field(repr=False)

    def _line(self) -> str:
        return self.report().split("; ")[0].rstrip(".")

    def report(self) -> str:
        """The verdict in words."""
        if len(self.table) < 2 or not np.isfinite(self.table["log_evidence"]).all():
            return "There is nothing to compare by evidence."
        best, second = self.table.index[:2]
        lead = -float(self.table["log_bayes_factor"].iloc[1])
        row = self.table.loc[second]
        return (
            f"{best} against {second}: log Bayes factor {lead:+.2f}, {strength(lead)}; {second} "
            f"predicts a trial left out by {row['elpd_difference']:.1f} ± "
            f"{row['difference_se']:.1f} nats in all, from the best predictor."
        )


def compare(fits: Mapping[str, WeberFit]) -> Comparison:
    """Compare fits of the same trials.

    Parameters
    ----------
    fits : mapping of name to WeberFit

    Returns
    -------
    Comparison

    Raises
    ------
    ValueError
        For fewer than two fits, or fits of different trials.

    Examples
    --------
    >>> from weberwhisk import fit_weber, simulate_trials
    >>> trials = simulate_trials(standards=[1.0, 2.0], weber_fraction=0.1, seed=1)
    >>> both = compare({"free": fit_weber(trials), "wrong": fit_weber(
    ...     trials, priors={"weber_fraction": 0.3})})
    >>> both.table.index.tolist()
    ['free', 'wrong']
    """
    if not isinstance(fits, Mapping):
        raise ValueError(
            f"fits must be a mapping of names to fits, got {_checks.shown(fits)}; write "
            "compare({'one': fit, 'two': other})."
        )
    for name, fit in fits.items():
        check_fit(fit, f"the fit {name!r}")
    if len(fits) < 2:
        raise ValueError(f"two fits or more can be compared, got {len(fits)}; give another.")
    rows = {name: _Rows.of(fit) for name, fit in fits.items()}
    first, *others = rows.values()
    for name, other in zip(list(fits)[1:], others, strict=True):
        same = other.n.shape == first.n.shape and all(
            np.array_equal(getattr(first, a), getattr(other, a)) for a in ("n", "count")
        )
        if not (same and _same_stimuli(first.frame, other.frame)):
            raise ValueError(
                f"{name!r} was fitted to other trials than {next(iter(fits))!r}; fit both to the "
                "same ones."
            )
    evidence = np.array(
        [np.nan if f.log_evidence is None else f.log_evidence for f in fits.values()]
    )
    loos = [_by_answer(fit, rows[name].cell) for name, fit in fits.items()]
    # Trials by row and answer; a row of counts stands for several.
    weight = np.stack([first.count, first.n - first.count])
    elpd = np.array([(weight * values).sum() for values, _ in loos])
    best = int(np.argmax(elpd))
    total, errors = weight.sum(), []
    for values, _ in loos:
        off = values - loos[best][0]
        mean = (weight * off).sum() / total
        errors.append(np.sqrt((weight * (off - mean) ** 2).sum() * total / max(total - 1, 1)))
    table = pd.DataFrame(
        {
            "log_evidence": evidence,
            "log_bayes_factor": evidence - np.nanmax(evidence, initial=-np.inf),
            "probability": np.exp(evidence - logsumexp(evidence)),
            "elpd": elpd,
            "elpd_difference": elpd - elpd[best],
            "difference_se": errors,
            "bad_k": [int((weight * (k > 0.7)).sum()) for _, k in loos],
            "weber_fraction": [fit.weber_fraction for fit in fits.values()],
            "status": [fit.status.name for fit in fits.values()],
        },
        index=pd.Index(fits, name="model"),
    )
    order = ["log_evidence", "elpd"] if np.isfinite(evidence).all() else ["elpd"]
    return Comparison(table.sort_values(order, ascending=False), dict(fits))


def _same_stimuli(one: pd.DataFrame, other: pd.DataFrame) -> bool:
    """Whether the stimuli are the same but for their unit, or were measured, or are logarithms."""
    shown = [frame[["stimulus_1", "stimulus_2"]].to_numpy(float) for frame in (one, other)]
    if any(SDS[0] in f for f in (one, other)) or any((s <= 0).any() for s in shown):
        return True
    a, b = (s / s.max(initial=0.0) for s in shown)
    return bool(np.allclose(a, b))


def _by_answer(fit: WeberFit, cell: Index) -> tuple[Array, Array]:
    """LOO density and Pareto k of one trial of each row, answered one way or the other, (2, R)."""
    model = fit.model
    if model.dispersed is not None:
        raise ValueError(
            "trials of an overdispersed observer are not independent, so none can be left out "
            "alone; compare fits without the effect Overdispersion."
        )
    chains = fit.posterior.chains
    draws = fit.posterior.draws()
    size = len(draws) // chains
    p, q = model.probability(*draws.values)
    both = np.log(np.stack([p, q], axis=1))[: size * chains]  # (D, 2, C)
    both = both.reshape(chains, size, -1)
    used = np.stack([model.cells.count, model.cells.n - model.cells.count]).ravel() > 0
    elpd, pareto_k = np.zeros(used.size), np.zeros(used.size)
    elpd[used], pareto_k[used] = pointwise_loo(both[..., used])
    shape = 2, model.cells.n.size
    return elpd.reshape(shape)[:, cell], pareto_k.reshape(shape)[:, cell]


@renamed_arguments(percept="encoding")
def compare_noise(
    trials: Trials,
    *,
    encoding: Encoding | None = None,
    effects: Sequence[Effect] = (),
    **options: Any,
) -> Comparison:
    """Weber noise, generalised Weber noise (with a floor), and constant noise.

    Parameters
    ----------
    trials : Trials
        At several standards: at one alone the three can hardly be distinguished.
    encoding : Encoding, optional
    effects : sequence of Effect, optional
        Of all three.
    **options
        As for `fit_weber`.

    Raises
    ------
    ValueError
        On a log scale of unknown unit, where all noise is constant.

    Examples
    --------
    >>> from weberwhisk import simulate_trials
    >>> trials = simulate_trials(standards=[1.0, 4.0], weber_fraction=0.15, seed=2)
    >>> compare_noise(trials).table.index[-1]
    'constant noise'
    """
    check_trials(trials)
    check_effects(effects)
    observer, distances = (options.pop(name, None) for name in ("observer", "distances"))
    if distances is not None:
        trials, encoded = at_touches(trials, distances, encoding, observer)
    else:
        given = chosen_encoding(encoding, observer)
        encoded = given or encoding_for(trials.scale, trials.log_unit, "weber")
    cells = trials.cells()
    noisiness = encoded.sd_per_weber_fraction(np.concatenate([cells.stimulus_1, cells.stimulus_2]))
    if noisiness.size and np.ptp(noisiness) <= 1e-9 * noisiness.max():
        raise ValueError(
            f"{trials.source}: on this scale noise is constant as it stands; give magnitudes, or "
            "log_unit= when the table is read."
        )
    typical = float(np.exp(np.mean(np.log(noisiness)))) if noisiness.size else 1.0
    models: dict[str, tuple[Encoding, list[Effect]]] = {
        "Weber noise": (encoded, []),
        "generalised Weber noise": (encoded, [Floor()]),
        "constant noise": (ConstantNoise(encoded, typical), []),
    }
    return compare(
        {
            name: fit_weber(trials, encoding=of_it, effects=[*effects, *own], **options)
            for name, (of_it, own) in models.items()
        }
    )


def compare_drift(trials: Trials, *, effects: Sequence[Effect] = (), **options: Any) -> Comparison:
    """A stationary observer, and one whose Weber fraction drifts over the sessions.

    The drift of ln k is linear in the number of the session, or in its logarithm (fast first).
    `effects` are those of all three; `options` go to `fit_weber`.

    Examples
    --------
    >>> from weberwhisk import simulate_trials
    >>> trials = simulate_trials(weber_fraction=0.15, drift=-1.5, sessions=6, seed=3)
    >>> compare_drift(trials, bias="none").table.index[-1]
    'stationary'
    """
    check_effects(effects)
    courses = {
        "stationary": [],
        "drifting": [Drift()],
        "drifting, fast first": [Drift(of_log=True)],
    }
    return compare(
        {
            name: fit_weber(trials, effects=[*effects, *own], **options)
            for name, own in courses.items()
        }
    )


def compare_taper(
    trials: Trials, whisker: Whisker, *, unit: float = 1.0, **options: Any
) -> Comparison:
    """The paper's prediction: radial distance encoded through a tapered whisker, or a cylinder.

    Both by the compliance cue with Weber noise: the JND is k r (1 − r/A) or k r, equations (3.5)
    and (3.6).

    Parameters
    ----------
    trials : Trials
        Of radial distances, with standards near the base and near the tip.
    whisker : Whisker
        Tapered; the cylinder has its length and base radius.
    unit : float
        Metres in one unit of the stimuli.
    **options
        As for `fit_weber`.

    Examples
    --------
    >>> from weberwhisk import Observer, cues, simulate_trials
    >>> whisker = Whisker(50e-3, 100e-6, 5e-6)
    >>> trials = simulate_trials(observer=Observer(whisker, cues.Compliance()),
    ...     standards=[15e-3, 42e-3], offsets=[-0.1, -0.05, 0.05, 0.1], seed=4)
    >>> compare_taper(trials, whisker).table.index[0]
    'tapered'
    """
    encoded = taper_encodings(whisker, unit)
    return compare({name: fit_weber(trials, encoding=p, **options) for name, p in encoded.items()})


def taper_encodings(whisker: Whisker, unit: float = 1.0) -> dict[str, CueEncoding]:
    """Distance as (3.5) has it for a tapered whisker, and (3.6) for its cylinder, by name."""
    _check_whisker(whisker)
    if whisker.tip_radius >= whisker.base_radius:
        raise ValueError(
            f"the whisker has no taper to test, its tip ({whisker.tip_radius:g} m) being as thick "
            f"as its base ({whisker.base_radius:g} m); give one whose tip is thinner."
        )
    return {
        name: CueEncoding(Observer(w, Compliance()), unit=unit)
        for name, w in (("tapered", whisker), ("cylindrical", whisker.cylinder()))
    }


def cue_encodings(
    whisker: Whisker, deflection_angle: float, unit: float = 1.0
) -> dict[str, CueEncoding]:
    """Distance by compliance, and by the map of forces at that angle (rad), by name."""
    _check_whisker(whisker)
    compliance, force_map = (Observer(whisker, cue) for cue in (Compliance(), ForceMap()))
    return {
        "compliance": CueEncoding(compliance, unit=unit),
        "moment–axial-force map": CueEncoding(force_map, deflection_angle, unit),
    }


def _check_whisker(whisker: Whisker) -> None:
    hint = "write Whisker.from_identity('C2'), say"
    _checks.kind("whisker", whisker, "a Whisker", "tip_radius", hint)


def compare_cues(
    trials: Trials,
    whisker: Whisker,
    *,
    deflection_angle: float,
    unit: float = 1.0,
    **options: Any,
) -> Comparison:
    """Radial distance by the compliance cue (§2e), or by the map of moment and axial force (§2f).

    Parameters
    ----------
    trials : Trials
        Of radial distances.
    whisker : Whisker
        Tapered: the map of a cylinder leaves distance open.
    deflection_angle : float
        rad, of every contact.
    unit : float
        Metres in one unit of the stimuli.
    **options
        As for `fit_weber`.

    Examples
    --------
    >>> from weberwhisk import Observer, cues, simulate_trials
    >>> whisker = Whisker(50e-3, 100e-6, 5e-6)
    >>> trials = simulate_trials(observer=Observer(whisker, cues.Compliance()),
    ...     standards=[10e-3, 25e-3, 40e-3], offsets=[-0.2, -0.1, 0.1, 0.2], seed=5)
    >>> compare_cues(trials, whisker, deflection_angle=0.1).table.index[0]
    'compliance'
    """
    encoded = cue_encodings(whisker, deflection_angle, unit)
    return compare({name: fit_weber(trials, encoding=p, **options) for name, p in encoded.items()})
