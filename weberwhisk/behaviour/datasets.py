"""Real choices to run on, shipped with the package."""

from __future__ import annotations

from collections.abc import Iterable
from importlib.resources import as_file, files

from .reading import read_trials
from .trials import Trials


def load_rat_auditory(sessions: int | Iterable[int] | None = None) -> Trials:
    """One rat comparing two sounds: which was louder?

    Rat W053 of the delayed-comparison task of Akrami, Kopec, Diamond & Brody (2018, Nature
    554:368), the first 40 sessions of its training: 11 489 trials. The stimuli are normalised
    logarithms of the sound level; one unit is an unknown number of natural-log units, so a Weber
    fraction is counted per unit. Neighbouring levels are compared, at several standards. The animal
    is learning: lapses, bias and drift are real.

    Sample data of the psytrack package (github.com/nicholas-roy/psytrack), MIT licence, copyright
    of its author; see `weberwhisk/data/README.md`.

    Parameters
    ----------
    sessions : int or iterable of int, optional
        1 to 40; all by default.

    Examples
    --------
    >>> load_rat_auditory(sessions=range(31, 41)).n_trials
    3101
    """
    with as_file(files("weberwhisk") / "data" / "rat_auditory_2ifc.csv.gz") as path:
        trials = read_trials(
            path,
            columns={"stimulus_1": "s1_z", "stimulus_2": "s2_z"},
            choice_labels={"right": "first", "left": "second"},
            scale="log",
            task="2IFC",
        )
    return trials if sessions is None else trials.select(session=sessions)


def load_numerosity(subject: str | None = None) -> Trials:
    """Two people, each 250 trials: which of two clouds has more dots?

    `stimulus_2` over `stimulus_1` is given by its natural logarithm; a choice of "second" is the
    first colour of the original table.

    Data of the TEfits package (github.com/akcochrane/TEfits), MIT licence; Cochrane, Cui, Hubbard &
    Green (2019); see `weberwhisk/data/README.md`.

    Parameters
    ----------
    subject : {"s1", "s2"}, optional
        Both by default.

    Examples
    --------
    >>> load_numerosity("s1").n_trials
    250
    """
    with as_file(files("weberwhisk") / "data" / "numerosity_2afc.csv") as path:
        trials = read_trials(path, columns={"choice": "response"})
    return trials if subject is None else trials.select(subject=subject)
