#!/usr/bin/env bash
# PsychoPy 2026.2.5: two adaptive handlers do not use what they are given: `PsiHandler` not the
# intensity that was shown, `QuestPlusHandler` not the priors of two parameters as named.
#
# Behaviour: `PsiHandler.addResponse(answer, intensity=shown)` writes `shown` into `intensities`,
# from which files are saved, and updates its posterior as if the recommended intensity had been
# shown; the handlers of QUEST and QUEST+ use the intensity that is given.
# `QuestPlusHandler(prior=...)` with a prior for each of its four parameters gives that of the
# lapse rate to the lower asymptote, and the reverse, where both have as many values; nothing is
# raised. With a prior for three of them or fewer each goes where it belongs.
# Why: `addResponse` calls `self._psi.update(result)`, without the intensity
# (psychopy/data/staircase.py). The other lists its priors as threshold, slope, lapse rate, lower
# asymptote; questplus 2023.1 takes a full set by place and not by name (questplus/qp.py,
# `_gen_prior`), and its third place is the lower asymptote.
# Why it matters: the argument is there for rigs that cannot show just what was recommended, as a
# motor with steps. The threshold then belongs to other stimuli than those in the data beside it,
# which are right: fit them anew.
# Output seen: 20 right answers, all shown at 10: location 1.3 by Psi as if at 6 … 2, 4.3 by its
#              records
#              QUEST+ threshold 1.1 if at what it recommended, 4.3 if at 10
#              priors: lapse rate 0, lower asymptote 0.2; QUEST+ has lapse rate 0.2,
#              lower asymptote 0.0
# Fails if the handlers use what they are given, or another version is installed. Installs PsychoPy
# without what its windows need, some 500 MB.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
export HOME="$work" # PsychoPy writes preferences there
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q "questplus==2023.1" "numpy==2.3.5" "scipy==1.16.3" \
    "pandas==2.3.3" six
"$work/venv/bin/pip" install -q --no-deps "psychopy==2026.2.5" "i18next==0.0.3" \
    2>"$work/missing" || { cat "$work/missing" >&2; exit 1; } # else a list of what windows need
"$work/venv/bin/python" - <<'PYTHON'
from importlib.metadata import version

import numpy as np
from psychopy import logging
from psychopy.data import PsiHandler, QuestPlusHandler
from scipy.stats import norm

assert version("psychopy") == "2026.2.5", version("psychopy")
assert version("questplus") == "2023.1", version("questplus")
logging.console.setLevel(60)  # QuestPlusHandler says each time that it may change
locations, sds, levels = np.arange(1, 10.5, 0.5), np.arange(0.5, 3.5, 0.5), np.arange(1.0, 11.0)


def answer(handler, shown=None):
    """The handler after 20 right answers, at `shown` or at what it recommended."""
    for _ in handler:
        handler.addResponse(1, intensity=shown)
    return handler


def psi():
    return PsiHandler(
        20, [1, 10], [1, 10], [0.5, 3], 1, 0.5, 0.5, delta=0.04, expectedMin=0.5, stepType="lin"
    )


def quest(shown=None, asymptotes=(0.5,), lapses=(0.02,), prior=None):
    handler = QuestPlusHandler(
        20, levels, locations, [3.5], asymptotes, lapses, responseVals=[1, 0], prior=prior,
        stimScale="linear",
    )
    return handler if prior else answer(handler, shown).paramEstimate["threshold"]


recommended, at_10 = answer(psi()), answer(psi(), 10.0)
by_psi = float(at_10.estimateLambda()[0])
p = 0.02 + 0.96 * (0.5 + 0.5 * norm.cdf(10.0, locations[:, None], sds))  # as Psi has it
mass = (p**20).sum(axis=1)
by_records = float((mass * locations).sum() / mass.sum())
first, last = recommended.intensities[0], recommended.intensities[-1]
print(f"20 right answers, all shown at 10: location {by_psi:.1f} by Psi ", end="")
print(f"as if at {first:.0f} … {last:.0f}, {by_records:.1f} by its records")
print(f"QUEST+ threshold {quest():.1f} if at what it recommended, {quest(10.0):.1f} if at 10")

rates, one = np.array([0.0, 0.1, 0.2]), np.ones(1)
priors = {
    "threshold": np.ones(len(locations)), "slope": one,
    "lowerAsymptote": np.array([0.0, 0.0, 1.0]), "lapseRate": np.array([1.0, 0.0, 0.0]),
}
full = quest(None, rates, rates, priors).paramEstimate
print("priors: lapse rate 0, lower asymptote 0.2; QUEST+ has lapse rate", end=" ")
print(f"{full['lapseRate']:.1f}, lower asymptote {full['lowerAsymptote']:.1f}")

assert at_10.intensities == [10.0] * 20 != recommended.intensities
assert at_10.estimateLambda() == recommended.estimateLambda(), "Psi uses what was shown now"
assert by_records - by_psi > 2
assert quest(10.0) - quest() > 2, "QUEST+ does not use what was shown"
assert round(full["lapseRate"], 6) == 0.2, "priors go where they belong now"
assert round(full["lowerAsymptote"], 6) == 0
del priors["slope"]
three = quest(None, rates, rates, priors).paramEstimate
assert round(three["lapseRate"], 6) == 0 and round(three["lowerAsymptote"], 6) == 0.2
PYTHON
