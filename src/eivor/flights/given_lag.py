"""The actuators' lag as information: what is given of it, and what a flight alone says."""

from __future__ import annotations

from dataclasses import dataclass, replace

from eivor.errors import UsageError
from eivor.flights.quantity import Unjudged
from eivor.inference.diagnostics.diagnostic import BEYOND_DOUBT, told
from eivor.inference.quantiles import chi_square_tail
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY
from eivor.models.separable import Prior, SeparableProblem


@dataclass(frozen=True)
class GivenLag:
    """A lag that was given beside the flight, and the flight's own.

    Parameters
    ----------
    prior : Prior
        Of the effective lag, actuator lag plus delay [s].
    alone : Unjudged
        The effective lag that the flight tells without it [s].
    """

    prior: Prior
    alone: Unjudged

    @property
    def p_value(self) -> float:
        """Of the test that both are of one lag: their difference over its standard error."""
        apart = (self.alone.value - self.prior.mean) ** 2
        return chi_square_tail(apart / (self.alone.std_error**2 + self.prior.std**2), 1)

    @property
    def contradicted(self) -> bool:
        """Beyond doubt."""
        return self.p_value <= BEYOND_DOUBT

    @property
    def outcome(self) -> str:
        """Whether they agree, in a word or two."""
        return told(self.p_value, ("agree", "may contradict each other", "contradict each other"))

    @property
    def sentence(self) -> str:
        """What was given, what the flight says, and whether they agree."""
        low, high = (1e3 * max(end, 0.0) for end in self.alone.interval)
        return (
            f"given {1e3 * self.prior.mean:.3g} ± {1e3 * self.prior.std:.2g} ms (one standard deviation); "
            f"the flight alone says {1e3 * self.alone.value:.3g} [{low:.3g}, {high:.3g}] ms: "
            f"they {self.outcome}"
        )


def with_given_lag(problem: SeparableProblem, prior: Prior) -> SeparableProblem:
    """Return the problem with what is known of the sum of lag and delay.

    Raises
    ------
    UsageError
        When it has no lag to search.
    """
    if not any(one.name == ACTUATOR_LAG.name and one.refined for one in problem.nuisances):
        raise UsageError(
            "a flight whose actuators' lag is searched for",
            "one whose actuators' state was measured, or a motion without a lag",
            "Leave out what is known of the lag, or name the command with --input.",
        )
    return problem.with_nuisances(
        tuple(
            replace(one, prior=prior, prior_with=(DELAY.name,)) if one.name == ACTUATOR_LAG.name else one
            for one in problem.nuisances
        )
    )
