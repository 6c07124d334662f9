"""A plan in writing: what it assumes, its preregistration, and its JSON, which brings it back."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from functools import cache
from itertools import chain
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Any, get_args, get_type_hints

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy import stats

from .. import __version__, cues, receptors
from .._util import checks
from .._util.refusals import Refusal
from .._util.values import Array, counted, paragraphs, plain_number
from ..behaviour import encodings
from ..behaviour.priors import Priors
from ..behaviour.tasks import task_named
from ..inference.observer import Observer
from ..mechanics.model_choice import Chosen
from ..whisker import Whisker
from .goals import Contrast, Evidence, Goal, Precision
from .hypotheses import ONE_STIMULUS, Hypothesis, SubjectPopulation
from .magnitude import Magnitude
from .plan import Plan, sha256_of
from .rivals import FlooredNoise, PowerNoise
from .scheme import Constraints, Scheme
from .session import KEYS, PLACES

if TYPE_CHECKING:
    from cattrs import Converter

__all__ = [
    "assumptions", "columns_in_words", "offsets_in_words", "plan_json", "plan_of",
    "preregistration", "read_plan",
]  # fmt: skip

#: What may stand where a field is annotated with a protocol.
CHOICES: dict[type, tuple[type, ...]] = {
    cues.Cue: (
        cues.Compliance, cues.ForceMap, cues.Friction, cues.Fused, cues.SpaceMap,
        cues.UnknownCurvature, cues.UnknownHinge, cues.UnknownRoll, cues.UnknownStiffness,
    ),
    encodings.Encoding: (
        encodings.CueEncoding, encodings.PooledEncoding,
        encodings.IdentityEncoding, encodings.LogEncoding, encodings.LogAxisEncoding,
        encodings.ConstantNoise, PowerNoise, FlooredNoise,
    ),
    receptors.ReceptorNoise: (receptors.Weber, receptors.GeneralisedWeber, receptors.Joint),
    Goal: (Contrast, Evidence, Precision),
}  # fmt: skip
CLASSES: dict[str, type] = {
    kind.__name__: kind
    for kind in chain(
        (Whisker, Observer, Priors, Hypothesis, Scheme, Constraints, Magnitude),
        (SubjectPopulation, Plan),
        *CHOICES.values(),
    )
}
#: Fields that are not kept: an observer's prior and tolerance, which must be the default ones, and
#: what is written elsewhere or worked out again.
SKIPPED = {"prior", "tolerance", "_filled", "power"}
FORMAT, VERSION = "weberwhisk plan", 3
#: Fields that a plan of version 2 lacks: it was of animals, and of radial distances.
SINCE_3 = {"magnitude", "subject", "conditions"}
AGAIN = "write the plan again with `weberwhisk design`"


def plan_json(plan: Plan) -> str:
    """All that it takes to have a plan again, with the SHA-256 of its trial lists.

    Raises
    ------
    ValueError
        For a plan that is made of something else than this package has: a cue of one's own, say.
    """
    checks.kind("plan", plan, "a Plan", "scheme", "write ww.plan_experiment(...), say")
    record = {
        "format": FORMAT,
        "version": VERSION,
        "made_with": {"weberwhisk": __version__, "numpy": np.__version__},
        "trials_sha256": plan.fingerprint,
        "plan": plain(plan),
        "power": None if plan.power is None else plain(plan.power.to_dict("list")),
    }
    return json.dumps(record, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def plain(value: Any) -> Any:
    """In what JSON has: an object as a mapping of its fields, with its class under "is"."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if value is None or isinstance(value, bool | int | str):
        return None if isinstance(value, Chosen) else value  # a model is chosen again
    if isinstance(value, float):
        return value if np.isfinite(value) else str(value)
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if hasattr(value, "dist") and hasattr(value, "kwds"):
        return {"is": value.dist.name, "args": plain(value.args), "kwds": plain(value.kwds)}
    kind = type(value)
    if CLASSES.get(kind.__name__) is not kind:
        raise Refusal(
            f"{value!r} cannot be written to a plan", remedy=f"make it of {', '.join(CLASSES)}"
        )
    fields = {name: getattr(value, name) for name in _kept(kind)}
    if kind is Observer and value != replace(value, prior={}, tolerance=0.1):
        raise Refusal(
            f"{value!r} has a prior or a tolerance of its own, which a plan does not keep",
            remedy="leave it out",
        )
    return {"is": kind.__name__} | {name: plain(part) for name, part in fields.items()}


def _kept(kind: type) -> list[str]:
    """The fields that make an object again."""
    return [f.name for f in fields(kind) if f.init and f.name not in SKIPPED]


@cache
def _reader() -> Converter:
    """Makes objects of what `plain` wrote, every field of the kind that its class declares."""
    from cattrs import Converter  # a browser, which only writes plans, lacks it

    reader = Converter()

    def exact(value: Any, kind: type) -> Any:
        if type(value) is not kind:
            raise Refusal(f"{checks.shown(value)} is no {kind.__name__}")
        return value

    def number(value: Any, _: type, most: float = 1e30) -> float:
        if value in ("inf", "-inf"):
            return float(value)
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < most:
            raise Refusal(f"{checks.shown(value)} is no number")
        return value

    def array(value: Any, _: type) -> Any:
        if isinstance(value, list):
            return np.array([array(item, float) for item in value])
        return None if value is None else np.array(number(value, float))

    def prior(value: Any, _: type) -> Any:
        return _frozen(value) if isinstance(value, dict) else number(value, float)

    def thing(value: Any, kind: type) -> Any:
        if value is None and type(None) in get_args(kind):
            return None
        kind = next((one for one in get_args(kind) if one in CHOICES), kind)
        value = _goal_of_0_2(value) if kind is Goal else value
        made = CLASSES.get(str(value.get("is"))) if isinstance(value, dict) else None
        if made is None or made not in CHOICES.get(kind, (kind,)):
            raise Refusal(f"{checks.shown(value)} is no {kind.__name__}")
        fields = {name: part for name, part in value.items() if name != "is"}
        for strange in (fields.keys() ^ set(_kept(made))) - (SINCE_3 - fields.keys()):
            words = "has nothing called" if strange in fields else "lacks"
            raise Refusal(f"{made.__name__} {words} {strange!r}")
        types = get_type_hints(made, localns=CLASSES)
        arguments = {}
        for name, part in fields.items():
            try:
                arguments[name] = reader.structure(part, types[name])
            except Exception as error:
                raise Refusal(f"{name} of {made.__name__}: {_in_words(error)}") from None
        try:
            return cues.Fused(*arguments["cues"]) if made is cues.Fused else made(**arguments)
        except (TypeError, OverflowError) as error:
            raise Refusal(f"{made.__name__} cannot be made of these ({error})") from None

    def identity(value: Any, kind: type) -> Any:
        types = get_type_hints(kind).values()
        pairs = zip(value, types, strict=True)
        return kind(*(reader.structure(part, component_type) for part, component_type in pairs))

    for kind in (int, str, bool):
        reader.register_structure_hook(kind, exact)
    reader.register_structure_hook(float, number)
    reader.register_structure_hook_func(lambda kind: hasattr(kind, "_fields"), identity)
    reader.register_structure_hook_func(lambda kind: kind is Any, prior)
    reader.register_structure_hook_func(lambda kind: kind in (Array, ArrayLike | None), array)

    def is_thing(kind: Any) -> bool:
        optional = isinstance(kind, UnionType) and any(one in CHOICES for one in get_args(kind))
        return kind in CHOICES or kind in CLASSES.values() or optional

    reader.register_structure_hook_func(is_thing, thing)
    return reader


def _goal_of_0_2(value: Any) -> Any:
    """A goal of either kind for one that weberwhisk 0.2 wrote, which had a field for each."""
    if not isinstance(value, dict) or value.get("is") != "Goal":
        return value
    kinds = {"bayes_factor": "Evidence", "half_width": "Precision"}
    given = {name: part for name, part in value.items() if name != "is" and part is not None}
    kind = next((kinds[name] for name in given if name in kinds), "Goal")
    return {"is": kind} | given


def _in_words(error: BaseException) -> str:
    """The first thing that cattrs found wrong."""
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    return str(error)


def _frozen(value: dict[str, Any]) -> Any:
    """A SciPy distribution that has quantiles."""
    name, args, kwds = value.get("is"), value.get("args"), value.get("kwds")
    distribution = getattr(stats, name, None) if isinstance(name, str) else None
    if not isinstance(distribution, stats.rv_continuous) or len(value) != 3:
        raise Refusal(f"{checks.shown(value)} is nothing that this version knows")
    numbers = _reader().structure(args, list[float])
    named = _reader().structure(kwds, dict[str, float])
    try:
        made = distribution(*numbers, **named)
        with np.errstate(all="ignore"):
            quantiles = made.ppf([0.02, 0.5, 0.98])
    except (TypeError, ValueError) as error:
        raise Refusal(f"{name} cannot be made of {args} and {kwds} ({error})") from None
    if not (np.isfinite(quantiles).all() and np.all(np.diff(quantiles) > 0)):
        raise Refusal(f"{name} has no quantiles with {args} and {kwds}")
    return made


def read_plan(path: str | os.PathLike[str]) -> Plan:
    """A plan from its JSON, with the same trial lists to the byte.

    Raises
    ------
    ValueError
        For a file that is no plan, is damaged, is of another version of the format, or whose trial
        lists come out differently here.
    FileNotFoundError
        Where there is no such file.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from weberwhisk import Whisker
    >>> from weberwhisk.design import Evidence, Scheme, taper
    >>> hypotheses = taper(Whisker(50e-3, 100e-6, 5e-6))
    >>> plan = Plan(Scheme([15e-3, 40e-3], [-2e-3, 2e-3]), hypotheses, Evidence(10))
    >>> with TemporaryDirectory() as folder:
    ...     written = Path(folder, "plan.json").write_text(plan_json(plan), "utf-8")
    ...     again = read_plan(f"{folder}/plan.json")
    >>> again.fingerprint == plan.fingerprint
    True
    """
    if not isinstance(path, str | os.PathLike):
        raise Refusal("path must name a file", checks.shown(path), "write plan.json")
    return plan_of(Path(path).read_bytes(), os.fspath(path))


def plan_of(content: str | bytes, source: str = "plan.json") -> Plan:
    """A plan from the text of its JSON; see `read_plan`."""
    try:
        record = json.loads(content)
    except (ValueError, RecursionError) as error:  # also bytes that are no text
        raise Refusal(
            f"{source} is no whole plan: its JSON cannot be read ({error})", remedy=AGAIN
        ) from None
    if not isinstance(record, dict) or record.get("format") != FORMAT:
        raise Refusal(
            f"{source} is not a plan", remedy="name the plan.json that `weberwhisk design` wrote"
        )
    version, versions = record.get("version"), record.get("made_with")
    made_with = "unknown"
    if isinstance(versions, dict):
        made_with = ", ".join(f"{name} {value}" for name, value in versions.items())
    if version not in (2, VERSION):
        raise Refusal(
            f"{source} has version {version!r} of the plan's format, and this weberwhisk "
            f"({__version__}) reads versions 2 and {VERSION}",
            remedy=f"{AGAIN}, or use the version that made it ({made_with})",
        )
    try:
        plan: Plan = _reader().structure(record.get("plan"), Plan)
        object.__setattr__(plan, "power", _table(record.get("power")))
        # Lays out the lists, which may be impossible; those of version 2 had no `standard_is`.
        now = plan.fingerprint if version == VERSION else sha256_of(plan.trials)
        for hypothesis in plan.hypotheses:
            with np.errstate(all="ignore"):
                seen = hypothesis.model(plan.scheme).encoded(np.ones(1))
            if not all(np.isfinite(part).all() for part in seen):
                raise Refusal(f"{hypothesis.name!r} gives no finite signals at these levels")
    except RecursionError:
        raise Refusal(f"{source} is damaged: its parts are nested too deep", remedy=AGAIN) from None
    except (ValueError, TypeError, BaseExceptionGroup) as error:  # None for a list, say
        words = _in_words(error).rstrip(".")
        raise Refusal(f"{source} does not hold a plan that can be run: {words}.") from None
    fingerprint = record.get("trials_sha256")
    if now != fingerprint:
        raise Refusal(
            f"{source} gives other trial lists than when it was made (SHA-256 {now[:8]}…, not "
            f"{str(fingerprint)[:8]}…): it was changed since, or made with other versions "
            f"({made_with})",
            remedy=AGAIN,
        )
    return plan


def _table(columns: Any) -> pd.DataFrame | None:
    """What is known of the power."""
    if columns is None:
        return None
    needed = {"truth", "trials", "animals", "power", "lower", "upper"}
    if not isinstance(columns, dict) or needed - columns.keys():
        raise Refusal("power must have columns truth, trials, animals, power, lower and upper")
    power: dict[str, list[Any]] = {
        name: _reader().structure(values, list[str] if name == "truth" else list[float])
        for name, values in columns.items()
    }
    if len({len(column) for column in power.values()}) != 1:
        raise Refusal("columns of power must be equally long")
    return pd.DataFrame(power)


# -- in words --------------------------------------------------------------------------------------


def assumptions(plan: Plan) -> list[str]:
    """What the expected numbers hang on, a sentence each."""
    animals, first = plan.animals, plan.hypotheses[0]
    unmeasured = " None has been measured for whisker force or moment."
    return [
        f"Weber fraction of the {animals.subjects}: median {animals.weber_fraction:g}, ln k with "
        f"an sd of {animals.spread:g} between {animals.subjects}."
        + unmeasured
        * plan.magnitude.is_distance,
        f"Lapses: {100 * animals.lapse:g} % on either side on average. Biases: sd "
        f"{animals.bias_spread:g} between {animals.subjects}, in sds of the difference of the two "
        "signals.",
        f"{_capital(plan.magnitude.encoded(first.encoding))}.",
        *notes_of(plan.hypotheses),
        "Noise is independent from trial to trial, k is the same in all sessions, and the two "
        "stimuli are encoded alike.",
    ]


def notes_of(hypotheses: Sequence[Hypothesis]) -> list[str]:
    """What observers of the hypotheses leave out, a sentence each: a whisker's shape at rest."""
    looks = (look for h in hypotheses for look in getattr(h.encoding, "looks", (h.encoding,)))
    said = (getattr(getattr(look, "observer", None), "note", "") for look in looks)
    return [words + "." for words in dict.fromkeys(said) if words]


def offsets_in_words(offsets: Sequence[float], magnitude: Magnitude) -> str:
    """Offsets in the magnitude's unit, those that come with either sign once."""
    shown = [float(f"{magnitude.per_unit * o:.4g}") for o in offsets]
    if sorted(shown) == sorted(-o for o in shown):
        return ", ".join(f"±{plain_number(o)}" for o in sorted(shown) if o > 0)
    return ", ".join(f"{'+' * (o > 0)}{plain_number(o)}" for o in shown)


def _capital(words: str) -> str:
    return words[0].upper() + words[1:]


def columns_in_words(plan: Plan) -> str:
    """What the columns of the trial lists hold: which stimulus is first, or left."""
    task, of = plan.hypotheses[0].task, plan.magnitude
    first, second = of.column("stimulus_1"), of.column("stimulus_2")
    if task in ONE_STIMULUS:
        no, yes = KEYS[task]
        answer = task_named(task).answer
        return (
            f"In the lists {second} is the stimulus that is put and {first} the standard held in "
            f"mind; greater is 2 where the right answer is {answer}, and "
            f"1 else (correct_answer: {yes} and {no})."
        )
    before, after = PLACES[task]
    return (
        f"In the lists {first} is the {before} stimulus and {second} the {after} one, standard_is "
        f"says which of them is the standard, and greater is 1 where the {before} one is the "
        f"{of.greater}, 2 where the {after} one is."
    )


def preregistration(plan: Plan) -> str:
    """The plan as a preregistration asks for it: question, design, size, analysis, inference.

    Every number is the plan's. What only the experimenter knows stands in square brackets.
    """
    scheme, goal, given, animals = plan.scheme, plan.goal, plan.hypotheses, plan.animals
    task, number = given[0].task, plan.scheme.animals
    of = plan.magnitude
    encoded = "; ".join(f"({i}) {h.name}: {of.encoded(h.encoding)}" for i, h in enumerate(given, 1))
    levels = "; ".join(
        f"{of.said(s, 5)} against {of.listed(row, 5)}"
        for s, row in zip(scheme.standards, scheme.comparisons, strict=True)
    )
    counts = sorted({n for row in scheme.trials for n in row})
    times = " to ".join(map(str, dict.fromkeys([counts[0], counts[-1]])))
    opening = "Which of these observers makes the choices"
    if len(given) == 1:
        opening = "How large is the Weber fraction k of this observer"
    question, unit, order = (
        of.question,
        "pair",
        f"The standard is the {PLACES.get(task, PLACES['2AFC'])[0]} stimulus in half of the trials "
        "of every pair, so that either answer is right equally often; within a session the right "
        "answer repeats as often as it changes, and not more than "
        f"{plan.longest_run} times running. ",
    )
    if task in ONE_STIMULUS:
        question = of.one_question
        unit, order = "level", ""
    size = f"The aim is {goal}. " + ("" if plan.power is None else f"{plan.power_in_words()} ")
    fitted = {h.name: _as_fitted(h, plan) for h in given}
    analysis = " ".join(f"{name}: {text}" for name, text in fitted.items())
    if len({*fitted.values()}) == 1:
        analysis = fitted[given[0].name]
    in_each = ""
    if scheme.conditions:
        first, second = scheme.conditions
        opening = f"Is the Weber fraction k in {second} another than in {first}"
        in_each = f" in each of the conditions {first} and {second}, which alternate by session"
        analysis += (
            f" So it is in either condition. The ratio of the two k is the same for all "
            f"{animals.subjects}; each has a k, biases and lapses of its own, which are integrated "
            "over (Plan.analyse)."
        )
    over = "" if plan.together or number == 1 else f", multiplied over {animals.subjects}"
    sections = {
        "Question and hypotheses": f"{opening}? {encoded}. Each compares two noisy signals, whose "
        "sds go with k.",
        "Design": f"Task: {task}, {question}. Method of constant stimuli. Standards and "
        f"comparisons: {levels}. Every pair is shown {times} times to each {animals.subject}"
        f"{in_each}: "
        f"{animals.counted(number)}, {scheme.n_trials} trials each, in "
        f"{counted(plan.sessions, 'session')} of at most {plan.trials_per_session}.",
        "Order of trials": f"Trials are randomised within blocks that hold every {unit} equally "
        f"often (within one). {order}Lists are drawn beforehand from seed {plan.seed}, a "
        f"different one for each {animals.subject} and session. {columns_in_words(plan)}",
        "Sample size": f"{size}It assumes {animals.subjects} with a median Weber fraction of "
        f"{animals.weber_fraction:g} (sd of ln k {animals.spread:g}) and lapses of "
        f"{100 * animals.lapse:g} % a side. Each {animals.subject} is run to the end of its "
        "lists, and no "
        "data are looked at to decide when to stop.",
        "Analysis": f"{analysis} The Weber fraction is reported as the posterior median with its "
        "equal-tailed 95 % interval.",
        "Inference": goal.inference(over),
        "Exclusion": "No trials are left out but those without an answer. "
        f"{_capital(_a(animals.subject))} whose fit has the status REVERSED or ONE_SIDED is "
        "reported and left out of the conclusion. "
        + (
            "[Criteria of training and health.]"
            if animals.subject == "animal"
            else "[Criteria of inclusion.]"
        ),
        "Files": f"weberwhisk {__version__}; plan.json makes these lists again (SHA-256 "
        f"{plan.fingerprint[:16]}…), and `weberwhisk rehearse plan.json` simulates the whole.",
    }
    text = paragraphs({heading: [said] for heading, said in sections.items()}, 92)
    return f"{plan.title}\n\n{text}"


def _a(thing: str) -> str:
    return f"{'an' if thing[0] in 'aeiou' else 'a'} {thing}"


def _as_fitted(h: Hypothesis, plan: Plan) -> str:
    # A fit by itself shares one bias between the standards; one that differs would pass for a
    # difference between JND curves, so hypotheses leave it free, and the call says so.
    options = [f'bias="{h.bias}"', *([f'noise="{h.noise}"'] if h.noise != "weber" else [])]
    call = f"with {', '.join(options)}; on the command line --bias '{h.bias}'"
    fitted = (
        f"All {plan.animals.subjects} are fitted together (weberwhisk.fit_population {call}), "
        "which learns how their Weber fractions spread"
        if plan.together
        else f"Each {plan.animals.subject} is fitted by itself by quadrature "
        f"(weberwhisk.fit_weber {call})"
    )
    noise = "of its own stimulus" if h.noise == "weber" else "of the standard"
    noise = "of all stimuli alike" if isinstance(h.encoding, encodings.ConstantNoise) else noise
    if isinstance(h.encoding, PowerNoise | FlooredNoise):
        noise = f"of {h.encoding.noise_in_words}"
    bias = {"none": "no response bias", "shared": "one response bias b",
            "per standard": "a response bias b for each standard"}[h.bias]  # fmt: skip
    greater = plan.magnitude.greater
    chance = f"P(second {greater}) = λ_lo + (1 − λ_lo − λ_hi) Φ((I2 − I1)/√(σ1² + σ2²) + b)"
    if h.task in ONE_STIMULUS:  # b is the criterion c there, and I1 the standard's signal
        chance = f"P({h.asked.answer}) = λ_lo + (1 − λ_lo − λ_hi) Φ((I2 − I1 − c σ1)/σ2)"
        bias = bias.replace("response bias", "criterion").replace(" b", " c")
    priors = ", ".join(
        f"{name.replace('_', ' ')} ~ {h.priors.words(name)}"
        for name in ("weber_fraction", *h.asked.lapses, "bias")
        if name != "bias" or h.bias != "none"
    )
    if not any(h.priors.is_fixed(name) for name in h.asked.lapses):
        rho = h.priors.lapse_correlation
        priors += f"; normal scores of the two lapse rates correlate by {rho:g}"
    return (
        f"{fitted}: {chance}, each signal with the sd {noise}, σ in proportion to k, two lapse "
        f"rates and {bias}. Priors (SciPy): {priors}."
    )
