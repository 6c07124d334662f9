"""What a fit is worth: the members are the messages."""

from enum import Enum


class FitStatus(Enum):
    """The outcome of a fit, worst first; it travels with the numbers.

    Examples
    --------
    >>> FitStatus.REVERSED.ok, FitStatus.ONE_SIDED.message[:24]
    (False, 'all answers are the same')
    """

    NO_TRIALS = "there are no trials with an answer: the posterior is the prior"
    REVERSED = (
        "the answers run against the stimuli: the labels of the answers, or the two stimuli, look "
        "exchanged, and the Weber fraction below means nothing until that is settled"
    )
    ONE_SIDED = (
        "all answers are the same: they tell of a preference, not of what was felt, and the Weber "
        "fraction below means nothing"
    )
    NOT_CONVERGED = "the posterior was not computed to the accuracy asked for"
    UNINFORMED = "the data say next to nothing about the Weber fraction: the posterior is the prior"
    UPPER_BOUND = (
        "the data only bound the Weber fraction from above: the lower end of the interval is the "
        "prior's"
    )
    LOWER_BOUND = (
        "the data only bound the Weber fraction from below: the upper end of the interval is the "
        "prior's"
    )
    DETERMINED = "the data determine the Weber fraction: both ends of the interval are theirs"

    @property
    def ok(self) -> bool:
        """Whether the interval is the data's own."""
        return self is FitStatus.DETERMINED

    @property
    def message(self) -> str:
        """The same as the value, for reading."""
        return self.value
