"""A fit as ArviZ data."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..posterior.arviz_io import to_arviz as convert

if TYPE_CHECKING:
    from .result import WeberFit


def to_arviz(fit: WeberFit) -> Any:
    """Posterior, log-likelihood by cell, and observed data, for ArviZ 0.23 or 1.x.

    A cell is a pair of stimuli: `n` trials of which `count` had the answer. Its log-likelihood is
    that of the sequence of answers, binomial coefficient left out.
    """
    draws, model, chains = fit.posterior.draws(), fit.model, fit.posterior.chains
    size = draws.weber_fraction.size // chains
    kept = slice(0, size * chains)

    def chained(values: np.ndarray) -> np.ndarray:
        return values[kept].reshape(chains, size, *values.shape[1:])

    posterior = {
        name: chained(getattr(draws, name)) for name in model.names if name not in model.group_names
    }
    dims = {"answers": ["cell"], "n": ["cell"]}
    coords: dict[str, Any] = {"cell": np.arange(model.cells.n.size)}
    if model.free_bias:
        many = fit.bias == "per standard"
        posterior["bias"] = chained(draws.bias if many else draws.bias[:, 0])
        if many:
            dims["bias"], coords["standard"] = ["standard"], fit.trials.standards
    by_cell = model.cell_log_likelihood(
        draws.weber_fraction, draws.lapse_low, draws.lapse_high, draws.bias
    )
    cells = model.cells
    dims |= {"stimulus_1": ["cell"], "stimulus_2": ["cell"]}
    return convert(
        posterior,
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
