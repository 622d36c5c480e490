"""What a motion is: everything that is true of one kind of motion only, behind one interface.

The recipe, the reports and the command line know this interface and no parameter of any motion. How to
write one is told in docs/motions.md.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import ClassVar, Generic, TypeVar

import numpy as np

from eivor.errors import UsageError
from eivor.estimation.estimate import Estimate
from eivor.estimation.method import Method
from eivor.flights.across import AcrossFlights
from eivor.flights.agreement import SensorAgreement
from eivor.flights.ahead import Ahead
from eivor.flights.airborne import Active, airborne_by_log
from eivor.flights.allowance import Allowance
from eivor.flights.circumstances import Circumstances, Strength
from eivor.flights.companion import Companion
from eivor.flights.drawn import Drawn
from eivor.flights.grid import MEMORY_S, Grid
from eivor.flights.implied import Implications
from eivor.flights.options import FlightOptions
from eivor.flights.predicted import Predicted, SimpleModel
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import Quantity, Unjudged, Wording
from eivor.flights.references import ReferenceSource
from eivor.flights.selection import InputFamily, Selection
from eivor.flights.shown import Panel, Trace
from eivor.flights.tracked import Followed
from eivor.flights.words import CardSection, Words
from eivor.inference.verdict import Reason
from eivor.models.instruments import InstrumentRule
from eivor.models.separable import SeparableProblem, Values
from eivor.shapes import Float
from eivor.signals.canonical import CanonicalChannel
from eivor.signals.recording import Finding, Recording
from eivor.signals.signals import Signals

P = TypeVar("P", bound=SeparableProblem)


class Motion(ABC, Generic[P]):
    """One kind of motion: its equation, its quantities, their verdicts and their words."""

    name: ClassVar[str]
    """The command line's word."""
    model_name: ClassVar[str]
    """The name in JSON documents."""
    equation: ClassVar[tuple[str, str]]
    """The equation in one line, and what its symbols are."""
    wording: ClassVar[Mapping[str, Wording]]
    """Every quantity, in the order of results; each joint parameter of the estimate is among them."""
    shown: ClassVar[tuple[str, ...]]
    """The same names in the order of reports."""
    headline: ClassVar[tuple[str, ...]]
    """Quantities whose grounds make the overall verdict."""
    rows: ClassVar[tuple[str, ...]]
    """Quantities that a table of flights or of methods shows."""
    words: ClassVar[Words]
    """How reports speak of it."""
    inputs: ClassVar[tuple[InputFamily, ...]]
    """What may drive the vehicle, in order of preference."""
    telemetry: ClassVar[tuple[str, ...]] = ()
    """Channels that are measured states of what drives it: beside commands they tell the actuators' lag."""
    lag_from: ClassVar[tuple[str, ...]] = ()
    """Names of other motions that the same actuators make: where they tell the lag, it is taken from them."""
    companions: ClassVar[tuple[Companion, ...]] = ()
    """Quantities that other motions tell, with the lag that this one tells."""
    across: ClassVar[tuple[AcrossFlights, ...]] = ()
    """Quantities that reports of fleets pool; the headline as it is where nothing is said."""
    needed: ClassVar[tuple[str, ...]]
    """Channels without which nothing can be identified, beside an input."""
    references: ClassVar[tuple[ReferenceSource, ...]]
    """Channels that may be instruments."""
    channels: ClassVar[tuple[CanonicalChannel, ...]] = ()
    """Channels that it adds to the canonical ones."""
    of_flight: ClassVar[tuple[str, ...]] = ()
    """Linear parameters that belong to the flight (wind, load) and not to the vehicle: flights of a pool have
    each their own. Names out of the problem's parameters; what belongs to a run is none of them."""
    terms: ClassVar[Mapping[str, str]] = {}
    """Terms that its equation may have beside the others: the word of each, and what it is."""
    direct: ClassVar[str] = "least_squares"
    """Method that serves when no instrument is at hand."""
    memory_s: ClassVar[float] = MEMORY_S
    """Time before a sample that decides the state of what drives the vehicle [s]: 25 of the longest lags."""
    logged_parameters: ClassVar[tuple[str, ...]] = ()
    """Parameters of an autopilot that are worth showing."""
    vehicle_parameters: ClassVar[tuple[str, ...]] = ()
    """Parameters of an autopilot that stand for the vehicle: flights in which they differ make no pool."""

    # -- from a log to a problem --------------------------------------------------------------------------

    def check(self, options: FlightOptions) -> None:
        """Refuse options that this motion does not have, before any log is looked at.

        Raises
        ------
        UsageError
            With what there is.
        """

    def weighted(self, method: Method, /) -> Method:
        """Return a method with the weights of rows that it needs for this motion; by default its own."""
        return method

    def for_flights(self, _flights: tuple[PreparedFlight, ...], _options: FlightOptions, /) -> Motion[P]:
        """Return the same motion with the terms that were asked for, and what all flights say together.

        Raises
        ------
        EivorError
            When a log lacks what a term needs, with what it is.
        """
        return self

    @property
    def written(self) -> tuple[str, str]:
        """The equation with the terms that were asked for, and what its symbols are."""
        return self.equation

    def of_vehicle(self, vehicle: str) -> Motion[P]:
        """Return the same motion of a vehicle that a user describes, by a name or a file.

        Raises
        ------
        UsageError
            When the motion has no use for one.
        """
        raise UsageError(
            "a motion that asks what flies", f"'{self.name}', which does not", f"Leave out {vehicle!r}."
        )

    @abstractmethod
    def select(self, log: Recording, options: FlightOptions) -> Selection:
        """Return the channels by role, and which samples count.

        Raises
        ------
        MissingChannelError
            When the log lacks one that is needed.
        """

    def active(self, log: Recording, grid: Grid, input_level: Float[np.ndarray, " n"]) -> Active:
        """Samples during which the motion holds; for what flies: while it is in the air.

        Parameters
        ----------
        log : Recording
            Z up.
        grid : Grid
            Samples to judge.
        input_level : ndarray, shape (n,)
            Mean of the actuators' commands on the grid.
        """
        return airborne_by_log(log, grid, input_level)

    @abstractmethod
    def problem(self, flights: tuple[PreparedFlight, ...], rule: InstrumentRule) -> P:
        """Return the problem of flights that all have runs.

        Raises
        ------
        EivorError
            When they make none.
        """

    def signals(self, flight: PreparedFlight, _lag_s: float, _delay_s: float, /) -> Signals:
        """Return a flight's signals for work in Python, what drives the vehicle as its equation has it.

        Parameters
        ----------
        flight : PreparedFlight
            Whose.
        lag_s, delay_s : float
            Of its actuators [s].
        """
        return flight.signals

    def settled(
        self, problem: P, estimated: Callable[[P], Estimate], _options: FlightOptions, /
    ) -> tuple[P, Estimate]:
        """Problem and its estimate, when all that the motion finds out by estimates is found out.

        Parameters
        ----------
        problem : SeparableProblem
            To begin with.
        estimated : callable
            From a problem to its estimate.
        """
        return problem, estimated(problem)

    def as_settled(self, flights: tuple[PreparedFlight, ...], _problem: P, /) -> tuple[PreparedFlight, ...]:
        """Flights as a result tells of them, with what was found out of them."""
        return flights

    def input_level(self, flight: PreparedFlight) -> float:
        """Size of a flight's input over the samples used, by which inputs of other scales are told."""
        return float(np.abs(flight.used_input).mean())

    # -- from an estimate to a result ---------------------------------------------------------------------

    @abstractmethod
    def quantities(self, problem: P, estimate: Estimate) -> Mapping[str, Unjudged]:
        """Return every quantity of `wording`."""

    @abstractmethod
    def grounds(
        self, quantities: Mapping[str, Unjudged], strength: Strength, at: Circumstances
    ) -> Mapping[str, tuple[Reason, ...]]:
        """Grounds against each quantity of `wording`."""

    def known(self, _flights: tuple[PreparedFlight, ...], /) -> Mapping[str, float]:
        """Values of quantities that flights with runs tell without an estimate."""
        return {}

    def excitation(self, _flights: tuple[PreparedFlight, ...], /) -> str:
        """Say how much the flights moved, in a sentence; empty for nothing."""
        return ""

    def allowances(
        self,
        _problem: P,
        _estimate: Estimate,
        _flights: tuple[PreparedFlight, ...],
        _quantities: Mapping[str, Unjudged],
        _at: Circumstances,
        /,
    ) -> Mapping[str, tuple[Allowance, ...]]:
        """Systematic parts by quantity: what the scatter within these flights, all with runs, cannot show."""
        return {}

    # -- sensors that tell the same -----------------------------------------------------------------------

    def sensors(self, _problem: P, _flights: tuple[PreparedFlight, ...], /) -> SensorAgreement | None:
        """Whether two measurements of one response agree; None where the flights have but one."""
        return None

    def sensors_told(self, _sensors: SensorAgreement, /) -> str:
        """What is told of them, in a line."""
        return ""

    def aligned(
        self, flights: tuple[PreparedFlight, ...], _sensors: SensorAgreement, /
    ) -> tuple[PreparedFlight, ...]:
        """Flights with those differences taken out that can be."""
        return flights

    def following(self, _quantities: Mapping[str, Unjudged], /) -> Mapping[str, Unjudged]:
        """Quantities that follow from a headline whose interval is another than that of `quantities`."""
        return {}

    def diagnostics(
        self, _problem: P, _estimate: Estimate, _flights: tuple[PreparedFlight, ...], /
    ) -> Mapping[str, float]:
        """Numbers behind the verdict that this motion alone has."""
        return {}

    def checks(self, _numbers: Mapping[str, float], /) -> tuple[tuple[str, str], ...]:
        """What they say: a title and a sentence each, for those that reports show."""
        return ()

    def followed(
        self, _problem: P, _quantities: Mapping[str, Quantity], _options: FlightOptions, /
    ) -> Followed | None:
        """What can be followed over a flight, and what is known beside it; by default nothing can."""
        return None

    def implications(self, _estimate: Estimate, /) -> Implications:
        """What follows from an estimate and from what a user supplied; by default nothing."""
        return Implications()

    def findings(
        self, _flights: tuple[PreparedFlight, ...], _quantities: Mapping[str, Quantity], /
    ) -> tuple[Finding, ...]:
        """What this motion alone notices in the logs, beside the result."""
        return ()

    # -- for replicates of a pool, see `bootstrap_flights` -------------------------------------------------

    def flight_sums(self, _problem: P, _at: Values, /) -> Mapping[str, Float[np.ndarray, " flights"]]:
        """Sums over the samples of each flight, at values of the nuisances, that `resampled` needs by name.

        Flights are numbered as in the problem's rows.
        """
        return {}

    def resampled(self, problem: P, drawn: Drawn) -> Mapping[str, float]:
        """Quantities of a draw of flights, in the order of results; each is a parameter or in `wording`.

        By default the linear parameters, and the nuisances that were searched for.
        """
        searched = [nuisance.name for nuisance in problem.nuisances if nuisance.searched]
        return {**drawn.parameters, **{name: drawn.at[name] for name in searched}}

    # -- predictions of another flight, see `eivor.report.validation` ---------------------------------------

    def simple_models(self, _problem: P, _estimate: Estimate, /) -> Mapping[str, SimpleModel]:
        """Models that an estimate is held against in another flight, by name; none without predictions."""
        return {}

    def predictions(self, _problem: P, _values: Values, /) -> tuple[Predicted, ...]:
        """What parameters and nuisances, by name, say of flights; the farthest horizon comes last.

        By default nothing: the motion cannot be validated.
        """
        return ()

    def ahead(
        self,
        _flights: tuple[PreparedFlight, ...],
        _models: Mapping[str, SimpleModel],
        _refused: frozenset[str],
        /,
    ) -> Ahead | None:
        """Predictions some tenths of a second ahead, from many starts of flights that all have runs.

        By default nothing. The models are those of `simple_models`, the fit itself before them; quantities
        that the fit refuses have no say.
        """
        return None

    def told_vehicle(self) -> Mapping[str, object] | None:
        """What a result says of the vehicle it was made for, for JSON; nothing for a motion that asks not."""
        return None

    def of_told_vehicle(self, _told: object, /) -> Motion[P]:
        """Return the same motion of the vehicle that a result tells of, see `told_vehicle`.

        Raises
        ------
        InputError
            When the motion asks what flies, and is not told.
        """
        return self

    # -- for planning ---------------------------------------------------------------------------------------

    def flown(
        self, _problem: P, _estimate: Estimate, _flights: tuple[PreparedFlight, ...], /
    ) -> Mapping[str, object]:
        """How the flights were flown: what simulating another one needs, for JSON; by default nothing."""
        return {}

    # -- for reports --------------------------------------------------------------------------------------

    @abstractmethod
    def symbols(self, flight: PreparedFlight) -> str:
        """What the symbols of the equation are in this flight, one line."""

    @abstractmethod
    def traces(self, problem: P, estimate: Estimate) -> tuple[Trace, ...]:
        """Measured and predicted, for each axis."""

    @abstractmethod
    def overview(self, flight: PreparedFlight) -> tuple[Panel, ...]:
        """Series to look at beside the input when nothing could be estimated."""

    @abstractmethod
    def advice(self, log_format: str) -> tuple[CardSection, ...]:
        """What to fly and to log."""
