"""What to cite, and the versions that a result was made with."""

from __future__ import annotations

import platform
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from . import __version__

_PAPER = (
    "Solomon JH, Hartmann MJZ (2011) Radial distance determination in the rat vibrissal system and "
    "the effects of Weber's law. Phil. Trans. R. Soc. B 366:3049–3057. doi:10.1098/rstb.2011.0166"
)
_BIBTEX = """@software{{weberwhisk,
  title = {{weberwhisk: Bayesian inference and psychophysics of touch through rat whiskers}},
  author = {{{{the weberwhisk developers}}}},
  version = {{{version}}},
}}
@article{{solomon2011radial,
  title = {{Radial distance determination in the rat vibrissal system and the effects of
           {{Weber}}'s law}},
  author = {{Solomon, Joseph H. and Hartmann, Mitra J. Z.}},
  journal = {{Philosophical Transactions of the Royal Society B}},
  volume = {{366}},
  number = {{1581}},
  pages = {{3049--3057}},
  year = {{2011}},
  doi = {{10.1098/rstb.2011.0166}},
}}
"""


def cite(*, bibtex: bool = False) -> str:
    """What to cite: this package in its version, and the paper whose theory it carries out.

    Examples
    --------
    >>> print(cite().splitlines()[0][:17])
    weberwhisk, versi
    >>> cite(bibtex=True).count("@")
    2
    """
    if bibtex:
        return _BIBTEX.format(version=__version__)
    return (
        f"weberwhisk, version {__version__}: Bayesian inference and psychophysics of touch through "
        f"rat whiskers.\n{_PAPER}\n"
    )


def versions_in_words(*packages: str) -> str:
    """This package's version, Python's, and those of the packages, for a methods section."""
    known = versions(*packages)
    found = [f"{name} {known[name]}" for name in packages if known[name]]
    return ", ".join([f"weberwhisk {__version__}", f"Python {platform.python_version()}", *found])


def versions(*packages: str) -> dict[str, str | None]:
    """Of this package and others, None for those that are not installed."""
    found: dict[str, str | None] = {"weberwhisk": __version__, **dict.fromkeys(packages)}
    for name in packages:
        with suppress(PackageNotFoundError):
            found[name] = version(name)
    return found


def machine(*packages: str) -> str:
    """`versions_in_words` and the kind of processor, for the foot of a figure of times."""
    words = versions_in_words("numpy", "scipy", "emcee", *packages)
    return f"{words}; {_processor()}, one core, CPU time"


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if "model name" in line)
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()
