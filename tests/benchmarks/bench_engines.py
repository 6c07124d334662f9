"""Speed of emcee on one core, beside a plain emcee loop measured in the same run.

``OMP_NUM_THREADS=1 python tests/benchmarks/bench_engines.py`` prints one line a figure. Rates are
posteriors per second of CPU time, everything included: density, diagnostics, summaries.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import emcee
import numpy as np
from numpy.typing import NDArray
from scipy import special

from weberwhisk._util.ensemble import sample_stacked
from weberwhisk.inference.emcee import WALKERS

Array = NDArray[np.float64]
K = 0.1


def timed(work: Callable[[], Any], repeats: int = 3) -> tuple[Any, float]:
    """The last result and the least CPU seconds of a few runs."""
    least = np.inf
    for _ in range(repeats):
        begun = time.process_time()
        result = work()
        least = min(least, time.process_time() - begun)
    return result, least


def distance_density(r0: Array) -> Callable[[Array, Array], Array]:
    """One moment read with Weber noise, r uniform on (0, 1), in x = logit(r); 1-D."""
    reading = (1 / r0 - 1)[:, None]

    def density(x: Array, index: Array) -> Array:
        with np.errstate(over="ignore"):
            moment = np.exp(-x[..., 0])
            return -0.5 * ((reading[index] / moment - 1) / K) ** 2 - 2 * np.log1p(moment)

    return density


def pair_density(cost: float) -> tuple[Callable[[Array, Array], Array], float]:
    """A correlated 2-D Gaussian made to cost about `cost` seconds a point; and what it costs."""

    def density(x: Array, index: Array, work: int = 0) -> Array:
        u, v = x[..., 0], x[..., 1]
        out = -0.5 * (u * u - 1.2 * u * v + v * v) / 0.64
        for _ in range(work):
            out = out + 0.0 * np.sin(u)  # stands for the cue's map
        return out

    def price(work: int) -> float:
        x = np.random.default_rng(1).normal(size=(500, 24, 2))
        _, seconds = timed(lambda: [density(x, np.arange(500), work) for _ in range(20)])
        return seconds / (20 * x.shape[0] * x.shape[1])

    work = round((cost - price(0)) / max((price(20) - price(0)) / 20, 1e-12))
    return lambda x, index: density(x, index, work), price(work)


def exact_sd(density: Callable[[Array, Array], Array], r0: Array) -> Array:
    x = np.linspace(-30, 30, 60_001)
    log = density(np.tile(x[:, None], (len(r0), 1, 1)), np.arange(len(r0)))
    weight = np.exp(log - log.max(axis=1, keepdims=True))
    weight /= weight.sum(axis=1, keepdims=True)
    mean = weight @ x
    return np.sqrt((weight * (x - mean[:, None]) ** 2).sum(axis=1))[:, None]


def bench_plain_emcee() -> None:
    """One posterior after the other, 32 walkers, vectorised, to 2 % in the sd."""
    r0 = np.linspace(0.2, 0.9, 4)
    density = distance_density(r0)

    def loop() -> list[float]:
        out = []
        for i, place in enumerate(special.logit(r0)):
            index = np.array([i])
            sampler = emcee.EnsembleSampler(
                32, 1, lambda x, index=index: density(x[None], index)[0], vectorize=True
            )
            start = place + K * np.random.default_rng(i).normal(size=(32, 1))
            # 2 % takes 1250 independent draws or more; the stretch move's time is 27 steps.
            sampler.run_mcmc(start, 1500)
            out.append(float(sampler.get_chain(discard=200, flat=True).std()))
        return out

    sds, seconds = timed(loop, repeats=1)
    error = np.abs(np.array(sds) / exact_sd(density, r0)[:, 0] - 1).max()
    print(
        f"1-D plain emcee loop, 1500 steps    {4 / seconds:10.1f} posteriors/s  worst {error:.3f}"
    )


def bench_stacked_1d(count: int = 1000) -> None:
    r0 = np.linspace(0.2, 0.9, count)
    density = distance_density(r0)
    scatter = K * np.random.default_rng(1).normal(size=(count, 4, WALKERS, 1))
    start = special.logit(r0)[:, None, None, None] + scatter
    fit, seconds = timed(lambda: sample_stacked(density, start, seed=1, indexed=True))
    error = np.sqrt(np.mean((fit.sd / exact_sd(density, r0) - 1) ** 2))
    print(
        f"1-D stacked emcee, 2 % in the sd    {count / seconds:10.1f} posteriors/s  "
        f"rms error of the sd {error:.4f}, converged {fit.converged.mean():.3f}"
    )


def bench_stacked_2d(count: int = 500) -> None:
    density, price = pair_density(0.6e-6)
    start = np.random.default_rng(2).normal(size=(count, 4, WALKERS, 2))
    fit, seconds = timed(
        lambda: sample_stacked(density, start, seed=1, precision=0.03, indexed=True), repeats=2
    )
    error = np.sqrt(np.mean((fit.sd - 1) ** 2))
    print(
        f"2-D stacked emcee, 3 % in the sd    {count / seconds:10.1f} posteriors/s  "
        f"rms error of the sd {error:.4f}, converged {fit.converged.mean():.3f}, "
        f"{price * 1e6:.2f} µs a point"
    )


if __name__ == "__main__":
    bench_plain_emcee()
    bench_stacked_1d()
    bench_stacked_2d()
