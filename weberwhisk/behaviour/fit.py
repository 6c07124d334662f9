"""A Weber fraction from a table of choices."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from .._util import checks
from .._util.campaign import one_blas_thread
from .._util.output import to_json
from .._util.refusals import Refusal, argument, named
from .._util.sampling import ArvizData
from .._util.values import Array, pd
from . import causes, criticism, predictive, report
from .arviz_data import observer_data
from .effects import Effect
from .encodings import NOISES, Encoding
from .estimates import Estimates, by_session, tails
from .importance import ImportancePosterior, Target
from .likelihood import build_model
from .located import at_touches
from .posteriors import WeberPosterior
from .quadrature import QuadraturePosterior
from .sampled import sample
from .states import (
    STATE_PRIORS,
    StateModel,
    StatePosterior,
    StateTarget,
    check_states,
    engagement,
    with_states,
)
from .trials import Trials
from .verdict import FitStatus, verdict

__all__ = ["StateFit", "WeberFit", "fit_weber"]

METHODS = ("quadrature", "importance", "emcee")


class WeberFit(Estimates):
    """The fit of one observer; everything in it comes from one posterior.

    `weber_fraction` is the posterior median. `status` says what the data determine and travels
    with the numbers; `notes` are further sentences; `report()` puts all of it in plain words.

    Examples
    --------
    >>> from weberwhisk import fit_weber, simulate_trials
    >>> fit = fit_weber(simulate_trials(weber_fraction=0.1, seed=1))
    >>> fit.parameters
    ('weber_fraction', 'lapse_low', 'lapse_high', 'bias')
    >>> low, high = fit.interval(0.95)
    >>> low < fit.weber_fraction < high
    True
    >>> fit.threshold(standard=2.0, proportion=0.75).columns.tolist()[:5]
    ['standard', 'criterion', 'comparison', 'lower', 'upper']
    """

    @cached_property
    def _judged(self) -> tuple[FitStatus, tuple[str, ...]]:
        """Made when first used: the checks take some ten times as long as the fit."""
        return criticism.judged(self, *self._verdict)

    @cached_property
    def checked(self) -> pd.DataFrame:
        """What `weberwhisk.behaviour.predictive.checks` finds, a row a check."""
        return predictive.checks(self)

    @cached_property
    def search(self) -> causes.Search:
        """What may be behind a misfit, tried cause by cause; see `causes`."""
        return causes.search(self)

    @property
    def causes(self) -> pd.DataFrame:
        """Causes of a misfit that this table can show, the best first.

        Index `cause`; `log_evidence`; `log_bayes_factor` over this fit; `weber_fraction`, `lower`
        and `upper` with the cause; `change`, how far it moves the median of ln k, in sds of this
        fit; and `status` of the fit with it, empty where the evidence is not strong. Causes that
        explain the answers together are a row, `contraction + session_bias`.

        Examples
        --------
        >>> from weberwhisk import fit_weber, simulate_trials
        >>> from weberwhisk.behaviour.effects import History
        >>> trials = simulate_trials(effects=[(History(), 1.5)], trials_per_level=12, seed=1)
        >>> fit = fit_weber(trials)
        >>> fit.causes.index[0], bool(fit.causes["log_bayes_factor"].iloc[0] > 5)
        ('history', True)
        """
        return self.search.table

    @cached_property
    def unweighed(self) -> FitStatus:
        """The status once checked: a misfit by the check that sees it, whatever it does to k."""
        return criticism.unweighed(self, self._verdict[0])

    @cached_property
    def _verdict(self) -> tuple[FitStatus, tuple[str, ...]]:
        return verdict(self.model, self.posterior)

    @property
    def unchecked(self) -> FitStatus:
        """The status without the checks, at once."""
        return self._verdict[0]

    def session_biases(self, mass: float = 0.95) -> pd.DataFrame:
        """The bias of each session, of a fit with the effect `SessionBias`.

        Returns
        -------
        DataFrame
            `session`, `bias` (posterior mean), `lower`, `upper`; with a bias per standard, how far
            the session is from these.

        Raises
        ------
        ValueError
            Of a fit without the effect.
        """
        return by_session(self, mass)

    def report(self) -> str:
        """What the data say, what they cannot say, and what to collect next."""
        return report.report(self)

    def methods(self) -> str:
        """What was done, as a methods section says it: one paragraph without line breaks.

        Numbers are the fit's; priors are named as SciPy names its distributions.

        Examples
        --------
        >>> from weberwhisk import fit_weber, simulate_trials
        >>> fit = fit_weber(simulate_trials(trials_per_level=10, seed=1))
        >>> "lapse_low ~ beta(0.7, 20)" in fit.methods()
        True
        """
        return report.methods(self)

    def to_dict(self) -> dict[str, object]:
        """Everything a reader needs to use or repeat the fit, ready for JSON."""
        return report.as_dict(self)

    def to_json(self) -> str:
        """`to_dict()` as JSON; an unreachable threshold is null."""
        return to_json(self.to_dict(), escaped=True)

    def to_arviz(self) -> ArvizData:
        """ArviZ data (0.23 or 1.x): posterior, prior, posterior-predictive, likelihood, data.

        A `cell` is a pair of stimuli: `answers` counts the trials among its `n` that were answered
        so, and its log-likelihood is of all of them. So `arviz.loo` leaves out a pair at a time,
        and `weberwhisk.compare` a trial. `log_prior` serves `arviz.psense` (`psens` of 0.23):
        whether prior or data moves an estimate.

        Examples
        --------
        >>> from weberwhisk import fit_weber, simulate_trials
        >>> data = fit_weber(simulate_trials(weber_fraction=0.1, seed=1)).to_arviz()
        >>> list(data["log_prior"].data_vars), data["observed_data"]["answers"].dtype.kind
        (['weber_fraction', 'lapses', 'bias'], 'i')
        """
        return observer_data(self)


class StateFit(WeberFit):
    """The fit of an observer that is engaged part of the time; see `weberwhisk.behaviour.states`.

    The Weber fraction, lapses, bias and thresholds are those of the engaged state. Residuals and
    checks are of each answer given the answers before it.

    Examples
    --------
    >>> from weberwhisk import fit_weber, simulate_trials
    >>> from weberwhisk.behaviour import States
    >>> fit = fit_weber(simulate_trials(states=States(engaged=0.6), seed=1), states=3)
    >>> fit.parameters[-5:]
    ('engaged', 'switch', 'side', 'answer_low', 'answer_high')
    >>> share, low, high = fit.share_engaged()
    >>> low < share < high
    True
    """

    @cached_property
    def _engagement(self) -> tuple[Array, Array]:
        assert isinstance(self.model, StateModel)
        return engagement(self.model, self.posterior.draws().thinned(2000), seed=0)

    @cached_property
    def engagement(self) -> pd.DataFrame:
        """The table of trials with `engaged`, the probability that the animal was, given all of its
        answers; trials without an answer have one too."""
        return self.trials.frame.assign(engaged=self._engagement[0])

    @property
    def remarks(self) -> list[str]:
        """How much of the time the animal was engaged, in a sentence."""
        share, low, high = (100 * x for x in self.share_engaged())
        return [
            f"The animal was engaged on {share:.0f} % of these trials ({low:.0f} to {high:.0f} %), "
            "and the Weber fraction is that of these."
        ]

    def share_engaged(self, mass: float = 0.95) -> tuple[float, float, float]:
        """Share of these trials on which the animal was engaged: mean, and ends of an interval."""
        share = self._engagement[1]
        low, high = np.quantile(share, tails(mass))
        return float(share.mean()), float(low), float(high)


@one_blas_thread
def fit_weber(
    trials: Trials,
    *,
    encoding: Encoding | None = None,
    observer: Any = None,
    bias: str | None = None,
    noise: str = "weber",
    effects: Sequence[Effect | str] = (),
    states: int = 1,
    priors: Any = None,
    method: str | None = None,
    distances: Any = None,
    seed: int | np.random.SeedSequence | np.random.Generator = 1,
) -> WeberFit:
    """Fit the Weber fraction of one observer, with lapses and bias.

    Parameters
    ----------
    trials : Trials
        From `read_trials` or `simulate_trials`; one subject, any number of standards.
    encoding : Encoding, optional
        How a stimulus is encoded. By default the magnitude itself, or its logarithm
        where the table is on a log scale.
    observer : Observer, optional
        A whisker and a cue, where stimuli are radial distances: short for
        `encoding=CueEncoding(observer)`.
    bias : {"none", "shared", "per standard"}, optional
        "shared" by default; percent-correct tasks have none. Of yes/no, go/no-go and
        same–different tasks it is the criterion.
    noise : {"weber", "equal-variance", "constant"}
        Each interval has the sd of its own stimulus, or both have that of the standard (textbook),
        or all stimuli have the same, k times their geometric mean.
    effects : sequence of Effect, or str
        What else may move the answers, a parameter each, such as drift over sessions or history:
        see `weberwhisk.behaviour.effects`. Also formulas of columns of the table,
        `"k ~ condition"` or `"bias ~ block"`, a parameter a level after the first.
    states : {1, 2, 3}
        States of the animal, which last some trials each: engaged, and with 2 one in which its
        answers have nothing to do with the stimuli, with 3 two in which it answers nearly always
        one way, or the other. Needs a row a trial in their order; see `StateFit`, and
        `weberwhisk.behaviour.states` for the model and the priors.
    priors : Priors or mapping, optional
        Frozen SciPy distributions, or numbers for what is known, by parameter:
        `{"lapse_low": scipy.stats.beta(1, 9), "bias": 0.0}`; `{"weber_fraction": "levels"}` where
        the levels were chosen to bracket the animal's thresholds. See `Priors`.
    method : {"quadrature", "importance", "emcee"}, optional
        By default quadrature, and with effects or states importance sampling. emcee is an
        independent check: it shares the model alone.
    distances : DataFrame or path, optional
        Where the touches of each trial were located (`ww.locate`), in place of nominal distances,
        or the contacts to locate by the observer's whisker; see `with_distances`. Of an observer
        that does not know the deflection angle, it is then the median of those located.
    seed : int, SeedSequence or Generator
        Of draws from the posterior. Estimates, evidence and `status` depend on the data alone, but
        for emcee.

    Returns
    -------
    WeberFit
        Always read its `status`. A `StateFit` with states.

    Raises
    ------
    ValueError
        For several subjects at once, unknown names, stimuli that give no signal.

    Examples
    --------
    >>> from weberwhisk.behaviour import simulate_trials
    >>> fit = fit_weber(simulate_trials(weber_fraction=0.1, seed=1))
    >>> fit.status.name
    'DETERMINED'
    >>> low, high = fit.interval(0.95)
    >>> low < 0.1 < high
    True
    """
    checks.one_of("noise", noise, NOISES)
    if distances is not None:
        trials, encoding = at_touches(trials, distances, encoding, observer)
        observer = None
    further = STATE_PRIORS.get(check_states(states), {})
    model, encoded, chosen = build_model(
        trials, encoding, observer, bias, noise, priors, effects, further
    )
    by_itself = "importance" if model.effects or states > 1 else "quadrature"
    used = by_itself if method is None else method
    checks.one_of("method", used, METHODS)
    rng = checks.generator(seed)
    if states > 1:
        if used != "importance":
            raise Refusal(
                argument("states", states) + " is fitted by importance sampling alone",
                argument("method", method),
                "leave " + named("method") + " out",
            )
        chain = with_states(model, trials, encoded, states)
        of_states = StatePosterior.sampled(StateTarget(chain), int(rng.integers(2**63)))
        return StateFit(trials, chain, encoded, noise, chosen, used, of_states)
    if used == "quadrature" and model.effects:
        raise Refusal(
            "quadrature is for observers without effects",
            ", ".join(effect.name for effect in model.effects),
            "leave " + named("method") + " out",
        )
    merged = model.merged()
    posterior: WeberPosterior
    if used == "emcee":
        posterior = sample(merged, seed=rng)
    elif used == "importance":
        posterior = ImportancePosterior.sampled(Target(merged), int(rng.integers(2**63)))
    else:
        posterior = QuadraturePosterior.integrated(merged, int(rng.integers(2**63)))
    return WeberFit(trials, model, encoded, noise, chosen, used, posterior)
