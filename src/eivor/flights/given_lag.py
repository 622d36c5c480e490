"""The actuators' lag as information: what is given of it, and what a flight alone says."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from eivor.errors import UsageError
from eivor.flights.quantity import Unjudged
from eivor.flights.told_lag import ToldLag
from eivor.inference.diagnostics.diagnostic import BEYOND_DOUBT, SIGNIFICANT, told
from eivor.inference.quantiles import chi_square_tail
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY
from eivor.models.separable import Bounds, Nuisance, Prior, SeparableProblem, Values
from eivor.shapes import Float

#: Neither lag nor delay.
NO_LAG = Bounds(0.0, 0.0)
#: Lags that are tried between bounds, at most so far apart [s], and at most so many.
TRIED_EVERY_S, MOST_TRIED = 0.005, 13
#: Standard deviation of what may lie anywhere between two ends, as a share of half their distance.
EVEN_STD = 3.0**-0.5


@dataclass(frozen=True)
class GivenLag:
    """A lag that is known beside the flight, and the flight's own.

    Parameters
    ----------
    known : Prior or Bounds
        Of the effective lag, actuator lag plus delay [s].
    alone : Unjudged
        The effective lag that the flight tells without it [s].
    slack_s : float
        What the flight's command may be late or early by throughout, and its lag by as much [s].
    by : ToldLag or None
        What told it, when it was not a user.
    """

    known: Prior | Bounds
    alone: Unjudged
    slack_s: float = 0.0
    by: ToldLag | None = None

    @property
    def for_the_log(self) -> Prior | Bounds:
        """What is known of the lag that makes up for the command's lateness, too."""
        known, slack = self.known, self.slack_s
        if not slack or known == NO_LAG:
            return known
        if isinstance(known, Prior):
            return replace(known, std=float(np.hypot(known.std, slack * EVEN_STD)))
        return Bounds(max(known.low - slack, 0.0), known.high + slack)

    @property
    def p_value(self) -> float:
        """Of the test that both are of one lag: how far they are apart, over the standard error of that.

        A lag of the flight between the bounds that were given is not apart from them.
        """
        known, alone = self.known, self.alone
        if isinstance(known, Prior):
            apart, variance = alone.value - known.mean, alone.std_error**2 + known.std**2
        else:
            apart = alone.value - min(max(alone.value, known.low), known.high)
            variance = alone.std_error**2
        variance += (self.slack_s * EVEN_STD) ** 2
        return chi_square_tail(apart**2 / variance, 1) if apart else 1.0

    @property
    def contradicted(self) -> bool:
        """Beyond doubt."""
        return self.p_value <= BEYOND_DOUBT

    @property
    def agrees(self) -> bool:
        """Without a doubt."""
        return self.p_value >= SIGNIFICANT

    @property
    def closer_alone(self) -> bool:
        """Whether the flight tells the lag within less than bounds that it agrees with."""
        known, (low, high) = self.known, self.alone.interval
        return isinstance(known, Bounds) and known.low < low and high < known.high

    @property
    def outcome(self) -> str:
        """Whether they agree, in a word or two."""
        return told(self.p_value, ("agree", "may contradict each other", "contradict each other"))

    @property
    def given(self) -> str:
        """What was given, in words."""
        if self.by is not None:
            return self.by.sentence
        if isinstance(self.known, Prior):
            return f"{1e3 * self.known.mean:.3g} ± {1e3 * self.known.std:.2g} ms (one standard deviation)"
        if self.known == NO_LAG:
            return "neither lag nor delay"
        if self.known.low == self.known.high:
            return f"{1e3 * self.known.low:.3g} ms exactly"
        return f"{1e3 * self.known.low:.3g} to {1e3 * self.known.high:.3g} ms"

    @property
    def sentence(self) -> str:
        """What was given, what the flight says, and whether they agree."""
        low, high = self.alone.interval
        low, high = (1e3 * max(end, 0.0) for end in (low - self.slack_s, high + self.slack_s))
        closer = ", and the flight alone is closer: leave out the bounds for shorter intervals"
        who = "given" if self.by is None else f"{self.by.who} says"
        return (
            f"{who} {self.given}; "
            f"the flight alone says {1e3 * self.alone.value:.3g} [{low:.3g}, {high:.3g}] ms: "
            f"they {self.outcome}{closer if self.closer_alone else ''}"
        )


def with_given_lag(problem: SeparableProblem, known: Prior | Bounds, alone: Values) -> SeparableProblem:
    """Return the problem with what is known of the sum of lag and delay.

    Parameters
    ----------
    problem : SeparableProblem
        With a lag to search.
    known : Prior or Bounds
        Of the sum [s].
    alone : mapping of str to float
        Lag and delay of the flight without it: between bounds that sum is one of those that are tried, and a
        delay that is no choice of a few stays as it is.
    """
    if known == NO_LAG:
        return problem.with_nuisances(
            tuple(
                one.known_at(0.0) if one.name in (ACTUATOR_LAG.name, DELAY.name) else one
                for one in problem.nuisances
            )
        )
    return problem.with_nuisances(tuple(_with_known(one, known, alone) for one in problem.nuisances))


def _with_known(one: Nuisance, known: Prior | Bounds, alone: Values) -> Nuisance:
    if one.name == DELAY.name and one.refined and isinstance(known, Bounds):
        return one.known_at(alone[one.name])
    if one.name != ACTUATOR_LAG.name:
        return one
    lag = replace(one, known_with=(DELAY.name,))
    if isinstance(known, Prior):
        return replace(lag, prior=known)
    return replace(lag, bounds=known, discrete=True, grid=_between(known, lag.with_others(alone)))


def _between(bounds: Bounds, own: float) -> Float[np.ndarray, " lags"]:
    """Lags to try: evenly between the bounds, both included, and the flight's own if it is between."""
    count = min(int(np.ceil((bounds.high - bounds.low) / TRIED_EVERY_S)) + 1, MOST_TRIED)
    tried = np.linspace(bounds.low, bounds.high, count)
    return np.unique([*tried, own]) if bounds.low < own < bounds.high else np.unique(tried)


def lag_searched(problem: SeparableProblem) -> bool:
    """Whether the problem has an actuators' lag to search."""
    return any(one.name == ACTUATOR_LAG.name and one.refined for one in problem.nuisances)


def check_lag_searched(problem: SeparableProblem) -> None:
    """Refuse what is known of a lag that is not searched for.

    Raises
    ------
    UsageError
        When the problem has no lag to search.
    """
    if not lag_searched(problem):
        raise UsageError(
            "a flight whose actuators' lag is searched for",
            "one whose actuators' state was measured, or a motion without a lag",
            "Leave out what is known of the lag, or name the command with --input.",
        )
