"""A fit as ArviZ data."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..posterior.arviz_io import to_arviz as convert
from .likelihood import Draws
from .predictive import prior_draws

if TYPE_CHECKING:
    from .result import WeberFit

Array = NDArray[np.float64]


def to_arviz(fit: WeberFit, seed: int = 0) -> Any:
    """Posterior, prior, posterior-predictive, log-likelihood and observed data, for ArviZ.

    A cell is a pair of stimuli: `n` trials of which `count` had the answer. Its log-likelihood is
    that of the sequence of answers, binomial coefficient left out. `seed` is that of the draws from
    the prior and of the replicated counts.
    """
    model, chains, cells = fit.model, fit.posterior.chains, fit.model.cells
    draws = fit.posterior.draws()
    rng = np.random.default_rng(seed)

    def chained(values: Array) -> Array:
        size = len(values) // chains
        return values[: size * chains].reshape(chains, size, *values.shape[1:])

    many = fit.bias == "per standard"

    def named(of: Draws) -> dict[str, Array]:
        columns = {
            name: chained(values)
            for name, values in of.named(model).items()
            if name not in model.group_names
        }
        if model.free_bias:
            columns["bias"] = chained(of.bias if many else of.bias[:, 0])
        return columns

    by_cell = model.cell_log_likelihood(
        draws.weber_fraction, draws.lapse_low, draws.lapse_high, draws.bias, draws.effects
    )
    dims = {name: ["cell"] for name in ("answers", "n", "stimulus_1", "stimulus_2")}
    coords: dict[str, Any] = {"cell": np.arange(cells.n.size)}
    if model.free_bias and many:
        dims["bias"], coords["standard"] = ["standard"], fit.trials.standards
    return convert(
        named(draws),
        prior=named(prior_draws(model, len(draws), rng)),
        posterior_predictive={"answers": chained(model.simulate(draws, rng))},
        log_likelihood={"answers": chained(by_cell)},
        observed_data={"answers": cells.count},
        constant_data={
            "n": cells.n,
            "stimulus_1": cells.stimulus_1,
            "stimulus_2": cells.stimulus_2,
        },
        coords=coords,
        dims=dims,
        attrs={"status": fit.status.message, "method": fit.method, "source": fit.trials.source},
    )
