"""The observers that an experiment is to distinguish, each with its priors and its fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from .._util import checks
from .._util.refusals import Refusal, argument
from .._util.values import Array, Fields
from ..behaviour.encodings import (
    OF_DISTANCE,
    ConstantNoise,
    CueEncoding,
    Encoding,
    LogEncoding,
    checked_encoding,
    refuse_out_of_reach,
    unit_encodings,
)
from ..behaviour.fit import WeberFit, fit_weber
from ..behaviour.likelihood import BIASES, WeberModel, observer_model
from ..behaviour.priors import DEFAULTS, Priors, of_task, usual_bias
from ..behaviour.simulate import draw_animals
from ..behaviour.tasks import Task, task_named
from ..behaviour.trials import STIMULI, Cells, Trials
from ..cues import Compliance, ForceMap
from ..inference.observer import Observer
from ..whisker import Whisker
from .magnitude import Magnitude
from .scheme import Scheme

__all__ = ["Hypothesis", "SubjectPopulation", "cues", "noises", "taper", "with_priors"]

#: What those who answer are called, one and several.
SUBJECTS = {"animal": "animals", "person": "people", "subject": "subjects"}
TWO_STIMULI, ONE_STIMULUS = ("2AFC", "2IFC"), ("yes/no", "go/no-go")


@dataclass(frozen=True, eq=False, repr=False)
class Hypothesis(Fields):
    """An observer as it will be fitted: how it encodes stimuli, and its priors.

    Parameters
    ----------
    name : str
    encoding : Encoding
        How a stimulus is encoded: any cue, whisker and receptor noise, through `CueEncoding`.
    priors : Priors
        Of the Weber fraction, the lapses, and the bias (PSE) of every standard: those of the fit.
    bias : {"none", "shared", "per standard"}
        A bias that differs between standards would pass for a difference between JND curves: here
        each standard has its own, where a fit by itself shares one.
    noise : {"weber", "equal-variance", "constant"}
    task : str
        As for `read_trials`.

    Examples
    --------
    >>> from weberwhisk.behaviour import IdentityEncoding
    >>> scheme = Scheme([1.0, 2.0], [-0.2, 0.2])
    >>> Hypothesis("Weber", IdentityEncoding()).model(scheme).names
    ('weber_fraction', 'lapse_low', 'lapse_high', 'bias[1]', 'bias[2]')
    """

    name: str
    encoding: Encoding
    priors: Priors = DEFAULTS
    bias: str = "per standard"
    noise: str = "weber"
    task: str = "2AFC"

    def __post_init__(self) -> None:
        checked_encoding(self.encoding)
        checks.kind(
            "priors", self.priors, "Priors", "is_fixed",
            "give ww.behaviour.Priors(...), or leave it",
        )  # fmt: skip
        checks.one_of("bias", self.bias, BIASES)
        if self.bias != "none" and not task_named(self.task).has_bias:
            raise Refusal(
                f"{self.task} has no response bias to fit",
                argument("bias", self.bias),
                "write " + argument("bias", "none"),
            )
        object.__setattr__(self, "priors", of_task(self.priors, self.asked))

    @property
    def asked(self) -> Task:
        """The task."""
        return task_named(self.task)

    @property
    def weber_fraction(self) -> float:
        """The median of what is believed of k: the expected animal."""
        return float(self.priors.value("weber_fraction", 0.0))

    @property
    def usual_bias(self) -> float:
        """That of its priors; 0 where it has none."""
        return 0.0 if self.bias == "none" else usual_bias(self.asked, self.priors)

    def model(self, scheme: Scheme | Cells) -> WeberModel:
        """The likelihood that the trials of a scheme will have, no answers filled in yet.

        The same model that `fit_weber` builds from the trials.

        Raises
        ------
        ValueError
            For stimuli that cannot be encoded.
        """
        cells = scheme.cells() if isinstance(scheme, Scheme) else scheme
        for what, at in (("standard", cells.standard), ("comparison", cells.stimulus_2)):
            refuse_out_of_reach(self.encoding, at, what)
        encoded = unit_encodings(
            self.encoding, cells.stimulus_1, cells.stimulus_2, cells.standard, self.noise
        )
        return observer_model(self.asked, encoded, cells, self.priors, self.bias)

    def fit(self, trials: Trials) -> WeberFit:
        """Fitted to a table as the planned analysis fits it, by quadrature for its evidence."""
        return fit_weber(trials, method="quadrature", **options_of(self))

    def expected_counts(self, scheme: Scheme, weber_fraction: float, lapse: float) -> Array:
        """Answers of such an animal on average, (C,): without bias, and not whole."""
        model = self.model(scheme)
        k, lost = np.array([weber_fraction]), np.array([lapse])
        p, _ = model.probability(k, lost, lost, np.full((1, model.n_groups), self.usual_bias))
        return np.asarray((p * model.cells.n)[0])

    def expected_trials(self, scheme: Scheme, weber_fraction: float, lapse: float) -> Trials:
        """The answers that one such animal gives on average: n·P of every level.

        Examples
        --------
        >>> from weberwhisk.behaviour import IdentityEncoding
        >>> weber, scheme = Hypothesis("Weber", IdentityEncoding()), Scheme([1.0], [-0.2, 0.2], 50)
        >>> weber.expected_trials(scheme, 0.1, 0.02).frame["count"].round(1).tolist()
        [3.8, 44.2]
        """
        cells = scheme.cells()
        frame = pd.DataFrame({name: getattr(cells, name) for name in STIMULI})
        count = self.expected_counts(scheme, weber_fraction, lapse)
        frame = frame.assign(n=cells.n.astype(np.int64), count=count)
        log_unit = self.encoding.log_unit if isinstance(self.encoding, LogEncoding) else None
        scale = "linear" if log_unit is None else "log"
        return Trials(frame, self.asked, scale, log_unit, source="expected answers")


def options_of(hypothesis: Hypothesis) -> dict[str, Any]:
    """What `fit_weber` and `fit_population` take from a hypothesis."""
    return {name: getattr(hypothesis, name) for name in ("encoding", "priors", "bias", "noise")}


def taper(whisker: Whisker, *, unit: float = 1.0, **options: Any) -> tuple[Hypothesis, Hypothesis]:
    """The paper's prediction: distance encoded through a tapered whisker, or through a cylinder.

    Both by the compliance cue with Weber noise: the JND is k r (1 − r/A) or k r, equations (3.5)
    and (3.6).

    Parameters
    ----------
    whisker : Whisker
        Tapered; the cylinder has its length and base radius.
    unit : float
        Metres in one unit of the stimuli.
    **options
        Of both hypotheses: `priors`, `bias`, `task`.

    Examples
    --------
    >>> [h.name for h in taper(Whisker(50e-3, 100e-6, 5e-6))]
    ['tapered', 'cylindrical']
    """
    _check_whisker(whisker)
    if whisker.tip_radius >= whisker.base_radius:
        raise Refusal(
            f"the whisker has no taper to test, its tip ({whisker.tip_radius:g} m) being as "
            f"thick as its base ({whisker.base_radius:g} m)",
            remedy="give one whose tip is thinner",
        )
    tapered, cylinder = (
        CueEncoding(Observer(w, Compliance()), unit=unit) for w in (whisker, whisker.cylinder())
    )
    return Hypothesis("tapered", tapered, **options), Hypothesis("cylindrical", cylinder, **options)


def cues(
    whisker: Whisker, deflection_angle: float, *, unit: float = 1.0, **options: Any
) -> tuple[Hypothesis, Hypothesis]:
    """The compliance cue (§2e) against the moment–axial-force map (§2f).

    Parameters
    ----------
    whisker : Whisker
        Tapered: the map of a cylinder leaves distance open.
    deflection_angle : float
        rad, of every contact.
    unit : float
        Metres in one unit of the stimuli.
    **options
        Of both hypotheses.

    Examples
    --------
    >>> [h.name for h in cues(Whisker(50e-3, 100e-6, 5e-6), 0.1)]
    ['compliance', 'moment–axial-force map']
    """
    _check_whisker(whisker)
    compliance = CueEncoding(Observer(whisker, Compliance()), unit=unit)
    force_map = CueEncoding(Observer(whisker, ForceMap()), deflection_angle, unit)
    return (
        Hypothesis("compliance", compliance, **options),
        Hypothesis("moment–axial-force map", force_map, **options),
    )


def _check_whisker(whisker: Whisker) -> None:
    hint = "write ww.Whisker.from_identity('C2'), say"
    checks.kind("whisker", whisker, "a Whisker", "tip_radius", hint)


def noises(
    encoding: Encoding, standards: ArrayLike, **options: Any
) -> tuple[Hypothesis, Hypothesis]:
    """Weber noise against noise that is the same at every stimulus.

    Parameters
    ----------
    encoding : Encoding
    standards : array_like
        The constant sd is k × the geometric mean of the encoding's sds there, so that both models
        mean the same by k.
    **options
        Of both hypotheses.

    Examples
    --------
    >>> from weberwhisk.behaviour import IdentityEncoding
    >>> constant = noises(IdentityEncoding(), [1.0, 4.0])[1]
    >>> constant.encoding.typical
    2.0
    """
    checked_encoding(encoding)
    at = np.atleast_1d(checks.finite("standards", standards, "give two or more"))
    refuse_out_of_reach(encoding, at, "standard")
    sd = encoding.sd_per_weber_fraction(at)
    if sd.size < 2:
        raise Refusal("standards must be two or more", sd.size, "give some far apart")
    if np.ptp(sd) <= 1e-9 * sd.max():
        raise Refusal(
            f"the encoding has the same noise, {sd.max():g}, at all {sd.size} standards, so "
            "the two kinds of noise are one",
            remedy="give standards far apart",
        )
    typical = float(np.exp(np.mean(np.log(sd))))
    return (
        Hypothesis("Weber noise", encoding, **options),
        Hypothesis("constant noise", ConstantNoise(encoding, typical), **options),
    )


def check_distinct(hypotheses: Sequence[Hypothesis]) -> tuple[Hypothesis, ...]:
    """Hypotheses that can be compared: names differ, and the task is one."""
    given = tuple(checks.several("hypotheses", hypotheses, "write ww.design.taper(whisker), say"))
    for h in given:
        checks.kind(
            "a hypothesis", h, "a Hypothesis", "encoding", "write ww.design.taper(whisker), say"
        )
    names = [h.name for h in given]
    if not given:
        raise Refusal("a design needs a hypothesis", "none", "write ww.design.taper(whisker), say")
    if len(set(names)) < len(names):
        raise Refusal("hypotheses need names of their own", names, "rename one")
    if len({h.task for h in given}) > 1:
        raise Refusal(
            "hypotheses are about one experiment",
            f"tasks {[h.task for h in given]}",
            "give all the same",
        )
    return given


def check_magnitude(hypotheses: Sequence[Hypothesis], magnitude: Magnitude) -> None:
    """Refuses encodings of another magnitude than the scheme's, or of distances in another unit
    where tables have mm for metres."""
    for h in hypotheses:
        base = getattr(h.encoding, "base", h.encoding)
        if isinstance(base, OF_DISTANCE) != magnitude.is_distance:
            raise Refusal(
                f"the scheme is of {magnitude.name}, and {h.name!r} encodes another magnitude",
                remedy="give the scheme magnitude=ww.design.Magnitude(...), or a whisker",
            )
        log_unit = getattr(base, "log_unit", None)
        if not magnitude.is_distance and log_unit != magnitude.log_unit:
            raise Refusal(
                f"the scheme's stimuli have log_unit={magnitude.log_unit}, and {h.name!r} encodes "
                f"log_unit={log_unit}",
                remedy="give it the encoding of the scheme's magnitude",
            )
        unit = getattr(base, "unit", 1.0)
        if unit != 1.0:
            raise Refusal(
                "a plan has distances in metres",
                f"{h.name!r} with an encoding in units of {unit:g} m",
                "leave its unit= out, and give standards and offsets in metres",
            )


def with_priors(hypotheses: Sequence[Hypothesis], **changes: Any) -> tuple[Hypothesis, ...]:
    """The same hypotheses with other priors, by parameter: `lapse_low=scipy.stats.beta(1, 19)`."""
    return tuple(
        replace(h, priors=replace(h.priors, **changes)) for h in check_distinct(hypotheses)
    )


@dataclass(frozen=True, repr=False)
class SubjectPopulation(Fields):
    """What the animals, or people, are expected to be like.

    Parameters
    ----------
    weber_fraction : float
        Median k of the animals.
    spread : float
        Standard deviation of ln k between animals.
    lapse : float
        Share of trials lost on either side; its mean, where `lapses_vary`.
    bias_spread : float
        Standard deviation of the animals' biases, in sds of the difference between the two signals.
    lapses_vary : bool
        Whether each animal has lapses of its own, from Beta(2, 2/lapse − 2), or all have the same.
    subject : {"animal", "person", "subject"}
        What they are called.
    """

    weber_fraction: float = 0.1
    spread: float = 0.3
    lapse: float = 0.03
    bias_spread: float = 0.2
    lapses_vary: bool = True
    subject: str = "animal"

    def __post_init__(self) -> None:
        checks.one_of("subject", self.subject, SUBJECTS)
        checks.positive_number("weber_fraction", self.weber_fraction, "write for example 0.1")
        for name in ("spread", "bias_spread"):
            checks.non_negative_number(name, getattr(self, name), "write for example 0.03")
        checks.between("lapse", self.lapse, "write for example 0.03", high=0.5, ends="[)")

    @property
    def subjects(self) -> str:
        """What several are called."""
        return SUBJECTS[self.subject]

    def counted(self, number: int) -> str:
        """So many of them, in words."""
        return f"{number} {self.subject if number == 1 else self.subjects}"

    def draw(self, number: int, seed: np.random.SeedSequence | int) -> pd.DataFrame:
        """So many of them, a row each: the truth that `simulate_responses` takes."""
        drawn = draw_animals(
            number, weber_fraction=self.weber_fraction, spread=self.spread, lapse_low=self.lapse,
            lapse_high=self.lapse, bias_spread=self.bias_spread, seed=seed,
        )  # fmt: skip
        if not self.lapses_vary:
            drawn[["lapse_low", "lapse_high"]] = self.lapse
        return drawn


def refuse_given_k(hypotheses: Sequence[Hypothesis], what: str) -> None:
    """Refuses to wait for the interval of a Weber fraction that is given."""
    for h in hypotheses:
        if h.priors.is_fixed("weber_fraction"):
            raise Refusal(
                f"{what}, and {h.name!r} is given its Weber fraction, {h.weber_fraction:g}, "
                "which no trials make surer",
                remedy="leave weber_fraction out of its priors, or ask for a Bayes factor",
            )


def check_task(task: str) -> None:
    """Refuses what no trial list is made for."""
    if task not in (*TWO_STIMULI, *ONE_STIMULUS):
        raise Refusal(
            "Trial lists are made for one or two stimuli a trial",
            f"the task {task!r}",
            "write 2AFC, 2IFC, yes/no or go/no-go",
        )


def check_answers(
    trials: Trials, task: str, animals: int, expected: SubjectPopulation | None = None
) -> None:
    """Refuses trials of another question than was planned, and several animals without names."""
    trials_task = trials.task.name
    if trials_task != task and not any(
        {trials_task, task} <= {*tasks} for tasks in (TWO_STIMULI, ONE_STIMULUS)
    ):
        raise Refusal(
            f"{trials.source}: the plan is of {task}",
            f"trials of {trials_task}",
            f"write ww.read_trials(table, task={task!r})",
        )
    if animals > 1 and not trials.subjects:
        raise Refusal(
            f"{trials.source}: the plan is of {(expected or SubjectPopulation()).counted(animals)}",
            "no column 'subject'",
            "write in it whose trial each row is",
        )
