"""What a public GLM-HMM, dynamax, says of a kept sequence of answers.

    python analyses/choices/glm_hmm_reference.py [file]

Needs `pip install dynamax`; the package itself does not. Writes `tests/data/glm_hmm.json`: drives
and answers of two sessions, and for some parameters the log-likelihood and the probability of the
engaged state of each trial. The engaged state has the drive as its one input, the disengaged ones
answer whatever the drive; transitions are those of `weberwhisk.behaviour.states`.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from dynamax.hidden_markov_model import LogisticRegressionHMM
from scipy.special import logit, ndtr

jax.config.update("jax_enable_x64", True)

#: k, bias, lapses, engaged, switch, side, answer_low, answer_high.
POINTS = (
    (0.15, 0.1, 0.02, 0.7, 0.06, 0.5, 0.05, 0.95),
    (0.1, -0.2, 0.01, 0.9, 0.3, 0.2, 0.2, 0.7),
    (0.3, 0.0, 0.05, 0.3, 0.01, 0.8, 0.01, 0.99),
)
LEVELS = np.array([0.7, 0.8, 0.9, 1.1, 1.2, 1.3])


def sequences(seed: int = 1, sessions: int = 2, trials: int = 120) -> list[dict[str, Any]]:
    """Levels and answers of an animal that loses its engagement now and then."""
    rng = np.random.default_rng(seed)
    out = []
    for _ in range(sessions):
        level = rng.choice(LEVELS, trials)
        p = ndtr((level - 1) / (0.15 * np.hypot(1, level)))
        p[trials // 2 : trials * 3 // 4] = 0.05
        out.append({"level": level.tolist(), "answer": (rng.random(trials) < p).astype(int)})
    return [one | {"answer": one["answer"].tolist()} for one in out]


def expected(point: tuple[float, ...], data: list[dict[str, Any]]) -> dict[str, Any]:
    """dynamax's log-likelihood and P(engaged) of every trial."""
    k, bias, lapse, engaged, switch, side, low, high = point
    share = np.array([engaged, (1 - engaged) * (1 - side), (1 - engaged) * side])
    model = LogisticRegressionHMM(3, 1)
    params, _ = model.initialize(
        initial_probs=jnp.array(share),
        transition_matrix=jnp.array((1 - switch) * np.eye(3) + switch * share),
        emission_weights=jnp.array([[1.0], [0.0], [0.0]]),
        emission_biases=jnp.array([0.0, logit(low), logit(high)]),
        method="prior",
    )
    total, states = 0.0, []
    for one in data:
        level = np.array(one["level"])
        p = lapse + (1 - 2 * lapse) * ndtr((level - 1) / (k * np.hypot(1, level)) + bias)
        inputs, answers = jnp.array(logit(p))[:, None], jnp.array(one["answer"], dtype=float)
        total += float(model.marginal_log_prob(params, answers, inputs))
        smoothed = model.smoother(params, answers, inputs).smoothed_probs
        states.append(np.asarray(smoothed)[:, 0].round(10).tolist())
    return {"point": point, "log_likelihood": total, "engaged": states}


def main(path: Path) -> None:
    """Everything."""
    data = sequences()
    kept = {"sessions": data, "expected": [expected(point, data) for point in POINTS]}
    path.write_text(json.dumps(kept) + "\n", encoding="utf-8")


if __name__ == "__main__":
    default = Path(__file__).parents[2] / "tests" / "data" / "glm_hmm.json"
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else default)
