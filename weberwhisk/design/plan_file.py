"""A plan on file: as JSON and back, every number to its last bit."""

from __future__ import annotations

import json
import os
import re
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats
from scipy.stats.distributions import rv_frozen

from .. import __version__
from .._util import checks
from ..array import ArrayObserver, WhiskerArray
from ..behaviour.encodings import (
    ConstantNoise,
    CueEncoding,
    IdentityEncoding,
    LogAxisEncoding,
    LogEncoding,
    PlaceEncoding,
    PooledEncoding,
)
from ..behaviour.priors import Priors
from ..cues import (
    Compliance,
    ForceMap,
    Friction,
    Fused,
    SpaceMap,
    UnknownCurvature,
    UnknownHinge,
    UnknownRoll,
    UnknownStiffness,
)
from ..inference.observer import Observer
from ..mechanics.model_choice import Chosen
from ..receptors import GeneralisedWeber, Joint, Weber
from ..whisker import Whisker
from .hypotheses import Goal, Hypothesis, SubjectPopulation
from .plan import Plan
from .scheme import Constraints, Scheme

# What each is made of: the names of its arguments, and after a colon what they may be where that is
# not one finite number.
NOUNS: dict[type, str] = {
    Whisker: "length base_radius tip_radius youngs_modulus curvature density "
    "hinge_stiffness:number|null identity:list|null",
    Compliance: "tap_angle angular_velocity velocity_spread",
    ForceMap: "signal_names:texts deflection_angle:number|null",
    Fused: "cues:list",
    Friction: "cue:cue angle:number|null coefficient",
    SpaceMap: "signal_names:texts roll",
    UnknownCurvature: "cue:cue spread",
    UnknownHinge: "cue:cue spread",
    UnknownRoll: "cue:cue spread",
    UnknownStiffness: "cue:cue spread soft_signals:texts",
    WhiskerArray: "species:text sides:text curved:flag identities:texts protraction",
    Weber: "weber_fraction:numbers correlation:numbers",
    GeneralisedWeber: "weber_fraction:numbers floor:numbers ceiling:limits correlation:numbers",
    Joint: "noises:list sizes:numbers",
    Observer: "whisker:Whisker cue:cue noise:Weber|GeneralisedWeber|Joint model:text|null",
    ArrayObserver: "array:WhiskerArray cue:Compliance|ForceMap|Friction|null "
    "noise:Weber|GeneralisedWeber|null angle_sd missed",
    CueEncoding: "observer:Observer deflection_angle:number|null unit",
    PooledEncoding: "looks:list offsets:numbers",
    PlaceEncoding: "observer:ArrayObserver start:numbers direction_deg length unit weber_fraction "
    "sideways_known:flag",
    IdentityEncoding: "",
    LogEncoding: "log_unit",
    LogAxisEncoding: "log_unit",
    ConstantNoise: "base:encoding typical",
    Priors: "weber_fraction:prior lapse_low:prior lapse_high:prior bias:prior lapse_correlation",
    Hypothesis: "name:text encoding:encoding priors:Priors bias:text noise:text task:text",
    Scheme: "standards:numbers offsets:numbers trials:numbers animals",
    Constraints: "nearest farthest:limits step easy_share easy_proportion",
    Goal: "bayes_factor:number|null half_width:number|null share",
    SubjectPopulation: "weber_fraction spread lapse bias_spread lapses_vary:flag",
}
#: Parts of a noun that are one of several nouns, or a number or distribution.
KINDS = {
    "cue": "Compliance|ForceMap|Friction|Fused|SpaceMap|UnknownCurvature|UnknownHinge|UnknownRoll|"
    "UnknownStiffness",
    "encoding": "CueEncoding|PooledEncoding|PlaceEncoding|IdentityEncoding|LogEncoding|"
    "LogAxisEncoding|ConstantNoise",
    "prior": "number|distribution",
}
KIND = "is"  # the key that says which noun a mapping is


def encode(value: Any) -> Any:
    """A noun, and whatever it is made of, in what JSON has.

    A cue or a receptor of one's own has no such form, and is refused.
    """
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if value is None or isinstance(value, bool | int | str):
        return None if isinstance(value, Chosen) else value  # a model is chosen again
    if isinstance(value, float):
        return value if np.isfinite(value) else str(value)
    if isinstance(value, list | tuple):
        return [encode(item) for item in value]
    if isinstance(value, dict):
        return {str(key): encode(item) for key, item in value.items()}
    if hasattr(value, "dist") and hasattr(value, "kwds"):
        return {KIND: value.dist.name, "args": encode(value.args), "kwds": encode(value.kwds)}
    if type(value) not in NOUNS:
        known = ", ".join(noun.__name__ for noun in NOUNS)
        raise ValueError(f"{value!r} cannot be written to a plan; make it of {known}.")
    parts = {name: encode(getattr(value, name)) for name in _parts(type(value))}
    made = {KIND: type(value).__name__, **parts}
    if isinstance(value, Observer) and decode(made) != value:
        raise ValueError(
            f"{value!r} has a prior or a tolerance of its own, which a plan does not keep; leave "
            "it out."
        )
    return made


def decode(value: Any) -> Any:
    """What `encode` has written.

    Refused are an unknown noun, parts that are missing, too many or of the wrong kind, and values
    that the noun refuses.
    """
    if isinstance(value, list):
        return [decode(item) for item in value]
    if not isinstance(value, dict):
        return value
    parts = {name: decode(v) for name, v in value.items() if name != KIND}
    if KIND not in value:
        return parts
    name = value[KIND]
    noun = next((noun for noun in NOUNS if noun.__name__ == name), None)
    if noun is None:
        return _frozen(value[KIND], parts)
    try:
        own = checked(noun.__name__, parts, _parts(noun))
        if noun is Fused:
            return Fused(*own["cues"])
        whose = own.pop("identity") if noun is Whisker else None
        made = noun(**own)
        if whose is not None:
            made._named(*whose[:2])
        return made
    except (TypeError, OverflowError) as error:
        raise ValueError(f"{noun.__name__} cannot be made of these ({error})") from None


def checked(what: str, parts: dict[Any, Any], kinds: dict[Any, str]) -> dict[Any, Any]:
    """Parts of the kinds that they must be, infinite numbers no longer text; none less or more."""
    for strange in parts.keys() ^ kinds.keys():
        words = "lacks" if strange in kinds else "has nothing called"
        raise ValueError(f"{what} {words} {strange!r}")
    for name, kind in kinds.items():
        if not any(_is(parts[name], one) for one in KINDS.get(kind, kind).split("|")):
            wanted = kind.replace("|", " or ")
            raise ValueError(f"{name} of {what} must be {wanted}, got {checks.shown(parts[name])}")
    return {
        name: _floats(parts[name]) if kind.startswith("limit") else parts[name]
        for name, kind in kinds.items()
    }


def _floats(value: Any) -> Any:
    if isinstance(value, list):
        return [_floats(item) for item in value]
    return float(value) if isinstance(value, str) else value


def _is(value: Any, kind: str, most: float = 1e30) -> bool:
    """Whether a value is of a kind; no number of a plan is beyond `most`."""
    match kind:
        case "null":
            return value is None
        case "flag":
            return isinstance(value, bool)
        case "text":
            return isinstance(value, str)
        case "number" | "limit":
            if isinstance(value, str | bool):
                return kind == "limit" and value in ("inf", "-inf", "nan")
            return isinstance(value, int | float) and abs(value) < most
        case "texts" | "numbers" | "limits":
            many = isinstance(value, list)
            return all(_is(item, kind) for item in value) if many else _is(value, kind[:-1])
        case "distribution":
            return isinstance(value, rv_frozen)
        case _:
            return type(value).__name__ == kind


def _frozen(name: Any, parts: dict[str, Any]) -> Any:
    """A SciPy distribution that has quantiles."""
    distribution = getattr(stats, name, None) if isinstance(name, str) else None
    if not isinstance(distribution, stats.rv_continuous):
        raise ValueError(f"{name!r} is nothing that this version knows.")
    checked(name, parts, {"args": "list", "kwds": "dict"})
    args, kwds = parts["args"], parts["kwds"]
    named = dict(enumerate(args)) | kwds
    checked(name, named, dict.fromkeys(named, "number"))
    try:
        made = distribution(*map(float, args), **{key: float(v) for key, v in kwds.items()})
        with np.errstate(all="ignore"):
            found = made.ppf([0.02, 0.5, 0.98])
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} cannot be made of {args} and {kwds} ({error})") from None
    if not (np.isfinite(found).all() and np.all(np.diff(found) > 0)):
        raise ValueError(f"{name} has no quantiles with {args} and {kwds}")
    return made


def _parts(noun: type) -> dict[str, str]:
    """Arguments of a noun, which its attributes are called by too, and their kinds."""
    found = re.findall(r"(\w+)(?::(\S+))?", NOUNS[noun])
    return {name: kind or "number" for name, kind in found}


FORMAT, VERSION = "weberwhisk plan", 1
#: What a file has, what the plan in it is made of, and what its table of power needs.
FILE = {
    "format": "text", "version": "number", "made_with": "dict", "trials_sha256": "text",
    "plan": "dict", "power": "dict|null",
}  # fmt: skip
PARTS = {
    "scheme": "Scheme", "hypotheses": "list", "goal": "Goal", "animals": "SubjectPopulation",
    "constraints": "Constraints", "trials_per_session": "number", "longest_run": "number",
    "together": "flag", "seed": "number", "title": "text",
}  # fmt: skip
COLUMNS = "truth", "trials", "animals", "power", "lower", "upper"
AGAIN = "write the plan again with `weberwhisk design`"


def plan_json(plan: Plan) -> str:
    """All that it takes to have a plan again, with the SHA-256 of its trial lists.

    Raises
    ------
    ValueError
        For a plan whose hypotheses have no such form: a cue of one's own, say.
    """
    checks.kind("plan", plan, "a Plan", "scheme", "write plan_experiment(...), say")
    own = {f.name: getattr(plan, f.name) for f in fields(plan)}
    power = own.pop("power")
    record = {
        "format": FORMAT,
        "version": VERSION,
        "made_with": {"weberwhisk": __version__, "numpy": np.__version__},
        "trials_sha256": plan.fingerprint,
        "plan": encode(own),
        "power": None if power is None else encode(power.to_dict("list")),
    }
    return json.dumps(record, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


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
    >>> from weberwhisk.design import Goal, Scheme, taper
    >>> hypotheses = taper(Whisker(50e-3, 100e-6, 5e-6))
    >>> plan = Plan(Scheme([15e-3, 40e-3], [-2e-3, 2e-3]), hypotheses, Goal(bayes_factor=10))
    >>> with TemporaryDirectory() as folder:
    ...     written = Path(folder, "plan.json").write_text(plan_json(plan), "utf-8")
    ...     again = read_plan(f"{folder}/plan.json")
    >>> again.fingerprint == plan.fingerprint
    True
    """
    if not isinstance(path, str | os.PathLike):
        raise ValueError(f"path must name a file, got {checks.shown(path)}; write plan.json.")
    return plan_of(Path(path).read_bytes(), os.fspath(path))


def plan_of(content: str | bytes, source: str = "plan.json") -> Plan:
    """A plan from the text of its JSON; see `read_plan`."""
    try:
        record = json.loads(content)
    except (ValueError, RecursionError) as error:  # also bytes that are no text
        raise ValueError(
            f"{source} is no whole plan: its JSON cannot be read ({error}); {AGAIN}."
        ) from None
    if not isinstance(record, dict) or record.get("format") != FORMAT:
        raise ValueError(
            f"{source} is not a plan; name the plan.json that `weberwhisk design` wrote."
        )
    version, versions = record.get("version"), record.get("made_with")
    made_with = "unknown"
    if isinstance(versions, dict):
        made_with = ", ".join(f"{name} {value}" for name, value in versions.items())
    if version != VERSION:
        raise ValueError(
            f"{source} has version {version!r} of the plan's format, and this weberwhisk "
            f"({__version__}) reads version {VERSION}; {AGAIN}, or use the version that made it "
            f"({made_with})."
        )
    try:
        checked("the file", record, FILE)
        own = checked("a plan", decode(record["plan"]), PARTS)
        if not own["hypotheses"] or {type(h) for h in own["hypotheses"]} != {Hypothesis}:
            raise ValueError("hypotheses of a plan must be a list of Hypothesis")
        plan = Plan(**own, power=_table(record["power"]))
        now = plan.fingerprint  # lays out the lists, which may be impossible
        for hypothesis in plan.hypotheses:
            with np.errstate(all="ignore"):
                seen = hypothesis.model(plan.scheme).encoded(np.ones(1))
            if not all(np.isfinite(part).all() for part in seen):
                raise ValueError(f"{hypothesis.name!r} gives no finite signals at these levels")
    except RecursionError:
        raise ValueError(f"{source} is damaged: its parts are nested too deep; {AGAIN}.") from None
    except ValueError as error:
        words = str(error).rstrip(".")
        raise ValueError(f"{source} does not hold a plan that can be run: {words}.") from None
    fingerprint = record["trials_sha256"]
    if now != fingerprint:
        raise ValueError(
            f"{source} gives other trial lists than when it was made (SHA-256 "
            f"{now[:8]}…, not {str(fingerprint)[:8]}…): it was changed since, or made "
            f"with other versions ({made_with}); {AGAIN}."
        )
    return plan


def _table(columns: Any) -> pd.DataFrame | None:
    if columns is None:
        return None
    checked("power", columns, dict.fromkeys([*COLUMNS, *columns], "list"))
    if len({len(column) for column in columns.values()}) != 1:
        raise ValueError("columns of power must be equally long")
    found = {}
    for name, values in columns.items():
        cells, kind = dict(enumerate(values)), "text" if name == "truth" else "limit"
        found[name] = list(checked(name, cells, dict.fromkeys(cells, kind)).values())
    return pd.DataFrame(found)
