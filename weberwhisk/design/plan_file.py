"""A plan as JSON, and back: what was asked, and a fingerprint of what came out."""

from __future__ import annotations

import json
import os
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from .. import __version__, _checks
from .coding import checked, decode, encode
from .hypotheses import Hypothesis
from .plan import Plan

FORMAT = "weberwhisk plan"
VERSION = 1  # of the format
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
    _checks.kind("plan", plan, "a Plan", "scheme", "write plan_experiment(...), say")
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
        raise ValueError(f"path must name a file, got {_checks.shown(path)}; write plan.json, say.")
    return plan_of(Path(path).read_bytes(), os.fspath(path))


def plan_of(content: str | bytes, source: str = "plan.json") -> Plan:
    """A plan from the text of its JSON; see `read_plan`."""
    try:
        record = json.loads(content, parse_constant=_not_json)
    except (ValueError, RecursionError) as error:  # also bytes that are no text
        raise ValueError(
            f"{source} is no whole plan: its JSON cannot be read ({error}); {AGAIN}."
        ) from None
    if not isinstance(record, dict) or record.get("format") != FORMAT:
        raise ValueError(
            f"{source} is not a plan; name the plan.json that `weberwhisk design` wrote."
        )
    version = record.get("version")
    if version != VERSION:
        raise ValueError(
            f"{source} has version {version!r} of the plan's format, and this weberwhisk "
            f"({__version__}) reads version {VERSION}; {AGAIN}, or use the version that made it "
            f"({_made_with(record)})."
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
                raise ValueError(f"{hypothesis.name!r} feels nothing finite of these levels")
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
            f"with other versions ({_made_with(record)}); {AGAIN}."
        )
    return plan


def _not_json(name: str) -> None:
    raise ValueError(f"{name} is no number of JSON")


def _table(columns: Any) -> pd.DataFrame | None:
    if columns is None:
        return None
    checked("power", columns, dict.fromkeys([*COLUMNS, *columns], "list"))
    if len({len(column) for column in columns.values()}) != 1:
        raise ValueError("columns of power must be equally long")
    return pd.DataFrame({name: _column(name, column) for name, column in columns.items()})


def _column(name: str, values: list[Any]) -> list[Any]:
    kinds = dict.fromkeys(range(len(values)), "text" if name == "truth" else "limit")
    return list(checked(name, dict(enumerate(values)), kinds).values())


def _made_with(record: dict[str, Any]) -> str:
    versions = record.get("made_with")
    if not isinstance(versions, dict):
        return "unknown"
    return ", ".join(f"{name} {value}" for name, value in versions.items())
