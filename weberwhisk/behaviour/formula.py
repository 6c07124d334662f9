"""Effects written as formulas: `k ~ condition`, `bias ~ block + session`, for any columns.

The right side is read by formulaic (Wilkinson notation): categories of any number of levels count
from their first, numbers are scaled, `*` has interactions. Each of its columns is an effect with a
parameter of its own, so that a formula may stand beside any other effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from scipy import stats
from scipy.stats.distributions import rv_frozen

from .._util import checks
from .._util.refusals import Refusal
from .._util.values import Array, Fields, pd
from .effects import Effect
from .encodings import Encoding, Signals
from .trials import Trials

__all__ = ["Term", "expanded"]

#: What may stand on the left, and the parameter that it means.
LEFT = {"k": "k", "weber_fraction": "k", "bias": "bias", "criterion": "bias"}
PRIOR = stats.norm(0.0, 0.5)  # one object: the table of its quantiles is made once


@dataclass(frozen=True, eq=False, repr=False)
class Term(Effect, Fields):
    """One column of a formula: a change of ln k, or of the bias in sds of the difference.

    `term` is the name that formulaic gives it. A column of two values counts as 0 and 1, others
    are centred and divided by their sd, over the whole table by which the formula was read.
    """

    formula: str
    on: str
    term: str
    spec: Any
    centre: float = 0.0
    scale: float = 1.0
    prior: rv_frozen | float = PRIOR
    is_scale_free: ClassVar[bool] = True

    @property
    def name(self) -> str:  # type: ignore[override]
        return f"{self.on}:{self.term.replace('[T.', '[')}"

    @property
    def typed(self) -> str:
        return repr(self.formula)

    @property
    def by_name(self) -> str:
        return self.formula

    def column(self, trials: Trials, encoding: Encoding) -> Array:
        matrix, _ = _matrix(self.spec, trials, self.formula)
        return (matrix[self.term].to_numpy(float) - self.centre) / self.scale

    def apply(self, signals: Signals, value: Array, column: Array | float) -> Signals:
        if self.on == "bias":
            return signals._replace(shift=signals.shift + value * column)
        factor = np.exp(value * column)
        return signals._replace(sd_1=signals.sd_1 * factor, sd_2=signals.sd_2 * factor)


def expanded(effects: Sequence[Effect | str], trials: Trials) -> tuple[Effect, ...]:
    """The effects with the terms of each formula in its place, read by all rows of a table.

    Raises
    ------
    ValueError
        For a left side that is neither k nor the bias, columns that are not there or are empty in
        a trial with an answer, and formulas that say nothing.

    Examples
    --------
    >>> from weberwhisk import simulate_trials
    >>> trials = simulate_trials(sessions=3, seed=1)
    >>> [effect.name for effect in expanded(["k ~ session", "bias ~ C(session)"], trials)]
    ['k:session', 'bias:C(session)[2]', 'bias:C(session)[3]']
    """
    out: list[Effect] = []
    for effect in effects:
        out += _terms(effect, trials) if isinstance(effect, str) else [effect]
    return tuple(out)


def _terms(formula: str, trials: Trials) -> list[Term]:
    left, _, right = (part.strip() for part in formula.partition("~"))
    on = LEFT[checks.one_of("the left side of a formula", left, LEFT)]
    if on == "bias" and not trials.task.has_bias:
        raise Refusal(
            f"{trials.task.name} has no response bias for {formula!r} to move",
            remedy=f"write 'k ~ {right}'",
        )
    matrix, spec = _matrix(right, trials, formula)
    if "Intercept" not in matrix:
        raise Refusal(
            f"the formula {formula!r} has no intercept",
            remedy=f"write '{left} ~ condition', say: {left} itself is that of the first level",
        )
    made = []
    for term in matrix.columns.drop("Intercept"):
        values = matrix[term].to_numpy(float)[trials.answered]
        levels = np.unique(values)
        if levels.size < 2:
            raise Refusal(
                f"{trials.source}: {term!r} of {formula!r} is the same in all trials with an "
                "answer",
                remedy="leave it out",
            )
        if levels.size == 2:
            centre, scale = levels[0], levels[1] - levels[0]
        else:
            centre, scale = values.mean(), values.std()
        made.append(Term(formula, on, str(term), spec, float(centre), float(scale)))
    if not made:
        raise Refusal(
            f"the formula {formula!r} has no column that differs between trials",
            remedy=f"name one of {checks.listed(list(map(str, trials.frame.columns)), 12)}",
        )
    return made


def _matrix(right: Any, trials: Trials, formula: str) -> tuple[pd.DataFrame, Any]:
    """The columns of the right side of a formula, or of what was read of it, a row a row of the
    table, 0 in rows without an answer that lack a value; and what was read of it."""
    try:
        import formulaic
        from formulaic.errors import FormulaicError
    except ImportError:  # in a browser
        raise Refusal("formulas are read by formulaic", "none", "pip install formulaic") from None
    frame = trials.frame
    try:
        read = formulaic.Formula(right) if isinstance(right, str) else right
        columns = sorted(map(str, read.required_variables))
        for column in columns:
            checks.one_of(f"a column of {formula!r}", column, map(str, frame.columns))
        lacking = frame[columns].isna()
        if (lost := lacking[trials.answered].any()).any():
            raise Refusal(
                f"{trials.source}, column {lost.idxmax()!r}: empty in a trial with an answer",
                remedy="fill it, or remove the trial",
            )
        matrix = formulaic.model_matrix(
            read, frame[~lacking.any(axis=1)], context={"np": np}, na_action="ignore"
        )
    except (FormulaicError, SyntaxError, TypeError) as error:
        said = str(error).splitlines()[0]
        raise Refusal(
            f"the formula {formula!r} cannot be read ({said})", remedy="write 'k ~ condition', say"
        ) from None
    return pd.DataFrame(matrix).reindex(frame.index, fill_value=0.0), matrix.model_spec
