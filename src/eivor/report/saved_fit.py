"""Saved results: reading, prediction and draws."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from eivor import checks
from eivor.errors import EstimationError, InputError, NotIdentifiedError, UsageError
from eivor.exports.fitted import Exported, Fitted, Supplied, accepted_verdicts, known_number
from eivor.exports.models import StateSpace, state_space
from eivor.exports.simulators import RANDOMISATIONS, target_by_name
from eivor.flights.motion import Motion
from eivor.flights.quantity import Quantity
from eivor.inference.covariance import CovariancePart, JointCovariance, JointEstimate, joint_draws
from eivor.inference.distributions import normal_quantile
from eivor.inference.verdict import Reason, Status
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY
from eivor.motions.machine import Machine
from eivor.motions.rigid_body.vehicle import KnownNumber, load_vehicle, vehicle_from_record
from eivor.motions.table import motion_of_model, name_of_model
from eivor.report import json_document
from eivor.signals.channels import CurveSide
from eivor.tools import Float, html_table

if TYPE_CHECKING:
    import polars as pl


#: More draws at once would fill the memory.
MOST_DRAWS = 10_000_000


@dataclass(frozen=True)
class SavedFit:
    """What a document of schema ``eivor.identify/1`` or ``/2`` says of a motion."""

    quantities: Mapping[str, Quantity]  # Parameters and derived quantities
    estimated: JointEstimate | None  # Joint vector and covariance; None without an estimate
    document: json_document.FitDocument = field(repr=False)  # The whole document
    #: For each flight of a pool its quantities, those that are its own among them; empty otherwise.
    by_flight: Mapping[str, Mapping[str, Quantity]] = field(default_factory=dict)

    @property
    def verdict(self) -> Status:
        """Verdict of the whole."""
        return self.document.verdict

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the verdict is not better."""
        return tuple(self.document.reasons)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joint vector; empty without an estimate."""
        return () if self.document.covariance is None else tuple(self.document.covariance.names)

    @property
    def parameters(self) -> dict[str, float]:
        """Value of every quantity."""
        return {name: quantity.value for name, quantity in self.quantities.items()}

    @property
    def refused(self) -> frozenset[str]:
        """Names of the quantities that are refused."""
        return frozenset(name for name, q in self.quantities.items() if q.verdict is Status.REFUSED)

    @property
    def covariance(self) -> Float[np.ndarray, "n n"]:
        """Covariance of the joint vector, in the order of `names`.

        Raises
        ------
        EstimationError
            When nothing was estimated.
        """
        return self.joint.covariance.matrix

    @property
    def joint(self) -> JointEstimate:
        """Joint vector with its covariance; an `EstimationError` when nothing was estimated."""
        if self.estimated is None:
            expected = "a document of a flight with an estimate"
            raise EstimationError(expected, f"one without: {' '.join(self.reasons)}", "See its verdict.")
        return self.estimated

    def interval(self, name: str, level: float = 0.95) -> tuple[float, float]:
        """Confidence interval of a quantity.

        Raises
        ------
        UsageError
            For an unknown name, a level that is none, or another than .95 for a derived quantity or for a
            parameter whose interval is that of a set.
        """
        checks.level(level)
        if name in self.quantities and level == 0.95:
            return self.quantities[name].interval
        if name not in self.names:
            known = ", ".join(self.names) or "none"
            raise UsageError(
                f"a quantity out of {', '.join(self.quantities)} at level .95, or of the joint vector "
                f"({known})",
                f"'{name}' at level {level}",
                "Name one of them.",
            )
        quantity = self.quantities[name]
        if not math.isclose(quantity.interval[1], quantity.widened(self._wald(name, 0.95))[1], rel_tol=1e-9):
            expected = f"level .95 for {name}, whose interval is that of a set for weak instruments or a pool"
            remedy = "Identify the flight again and ask its result: fit.interval(name, level)."
            raise UsageError(expected, f"level {level}", remedy)
        return quantity.widened(self._wald(name, level))

    def sample(self, n: int, seed: int = 0) -> dict[str, Float[np.ndarray, " n"]]:
        """Draw joint sets of the parameters.

        Each is drawn by the law that its interval is read from, Student's t with the degrees of freedom of
        the covariance, and they are correlated as the covariance says. What its printed interval has beyond
        that, such as systematic parts, is drawn independently. What cannot be below a bound is put there, as
        its interval is cut; of a delay the lag makes up for it.

        Parameters
        ----------
        n : int
            How many.
        seed : int
            Of the random numbers: the same seed gives the same draws.

        Returns
        -------
        dict of str to ndarray, shape (n,)
            One array for each name of `names`, refused ones too: see `refused`.

        Raises
        ------
        EstimationError
            When nothing was estimated, or the covariance has no finite variance.
        UsageError
            When `n` is no number of draws, or the seed is below zero.
        """
        checks.whole("n", n)
        checks.whole("seed", seed)
        if not 1 <= n <= MOST_DRAWS or seed < 0:
            expected = f"1 to {MOST_DRAWS:,} draws, and a seed that is not below zero"
            raise UsageError(expected, f"{n:,} draws with seed {seed}", "Ask for a number within these.")
        rng, known = np.random.default_rng(seed), self.document.parameters
        bounds = ((known[name].lowest if name in known else None) for name in self.names)
        lowest = [_number(bound, -math.inf) for bound in bounds]
        drawn = joint_draws(self.joint.values, self.joint.covariance, n, rng)
        below, above = np.array([self._beyond_covariance(name) for name in self.names]).T
        normal = rng.standard_normal(drawn.shape)
        drawn += np.where(normal < 0.0, below, above) * normal
        draws = dict(zip(self.names, drawn.T, strict=True))
        if {ACTUATOR_LAG.name, DELAY.name} <= draws.keys():
            both = draws[ACTUATOR_LAG.name] + draws[DELAY.name]
            draws[DELAY.name] = np.clip(draws[DELAY.name], 0.0, np.maximum(both, 0.0))
            draws[ACTUATOR_LAG.name] = both - draws[DELAY.name]
        return {name: np.maximum(draws[name], low) for name, low in zip(self.names, lowest, strict=True)}

    def to_statespace(self, speed_m_s: float = 0.0) -> StateSpace:
        """Arrays of the motion about hover or rest, and ``.to_control()`` for python-control.

        Parameters
        ----------
        speed_m_s : float
            Of a rigid body, about steady flight along x at this speed.

        Returns
        -------
        StateSpace
            ``A``, ``B``, ``C``, ``D``, names of ``states``, ``inputs`` and ``outputs``, and ``delay_s``.

        Raises
        ------
        NotIdentifiedError
            When a quantity that they are made of is not identified.
        UsageError
            When the result is of another motion.
        """
        checks.number("speed_m_s", speed_m_s)
        return state_space(self.fitted, Supplied(), speed_m_s)

    def export(
        self,
        to: str,
        *,
        mass: tuple[float, float] | None = None,
        priors: Mapping[str, tuple[float, float]] | None = None,
        vehicle: str | Path | None = None,
        draws: int | None = None,
        seed: int = 0,
        accept: str = "identified",
    ) -> str | bytes:
        """Content of a file for an autopilot, a controller or a simulator, as ``eivor export`` writes it.

        Parameters
        ----------
        to : str
            A target by its word in ``eivor export --help``, such as "px4", "statespace" or "rotorpy".
        mass : tuple of float, optional
            Of the vehicle and its standard deviation [kg], for targets that need it.
        priors : mapping of str to tuple of float, optional
            Value and standard deviation of quantities that are not identified.
        vehicle : str or path, optional
            A vehicle's file, or the name of a shipped one, for simulators: where its rotors are. Without it
            that of the result, when it has one.
        draws : int, optional
            For "rotorpy", "mujoco" and "isaaclab": in place of one vehicle as many joint draws of it.
        seed : int
            Of the draws.
        accept : str
            "weak" writes weak numbers as well, "provisional" these and provisional ones, each with its
            verdict beside it.

        Returns
        -------
        str, or bytes of "matlab"
            All of it. What is not identified is a comment there, with the reason.

        Raises
        ------
        NotIdentifiedError
            When the target cannot do without a quantity that is not identified, and none was given.
        UsageError
            When the target is unknown, or the result is not of the kind that it takes.
        InputError
            When the vehicle's file cannot be read.
        """
        supplied = Supplied(
            None if mass is None else _known_pair("mass", mass),
            {name: _known_pair(name, prior) for name, prior in (priors or {}).items()},
            None if vehicle is None else load_vehicle(vehicle),
        )
        return self.exported(to, supplied, draws, seed, accept).text

    def exported(
        self, to: str, supplied: Supplied, draws: int | None, seed: int, accept: str = "identified"
    ) -> Exported:
        """What `export` returns, with what is left out of it."""
        fitted = replace(self.fitted, accepted=accepted_verdicts(accept))
        if draws is None:
            return target_by_name(to).export(fitted, supplied)
        checks.index_of("draws", to, RANDOMISATIONS, "Name one of them, or none for a table.")
        return RANDOMISATIONS[to](fitted, supplied, self.sample(draws, seed), seed)

    @property
    def motion(self) -> Motion[Any]:
        """Motion that was identified, of its vehicle or declaration; its channels are known from then on."""
        prediction = self.document.prediction
        return motion_of_model(self.document.model.name, None if prediction is None else prediction.vehicle)

    @property
    def fitted(self) -> Fitted:
        """What exports take of it."""
        document, model = self.document, self.document.model
        vehicle: Any = document.prediction and document.prediction.vehicle
        machine = self.motion if isinstance(vehicle, dict) and "machine" in vehicle else None
        side, in_force, logged = (model.autopilot_curve.get(name) for name in ("side", "in_force", "logged"))
        return Fitted(
            model=model.name,
            quantities=self.quantities,
            input=model.input,
            map_name=model.input_map,
            curve_side=next((item for item in CurveSide if item.value == side), CurveSide.UNKNOWN),
            curve_in_force=in_force if isinstance(in_force, dict) else {},
            logged=logged if isinstance(logged, dict) else {},
            input_measured=model.input_measured,
            formats=tuple(log.format for log in document.logs),
            logs=tuple((str(log.get("name")), log.get("sha256") or "") for log in document.provenance.logs),
            version=document.provenance.version,
            vehicle=None if machine or vehicle is None else vehicle_from_record(vehicle),
            machine=machine if isinstance(machine, Machine) else None,
            names=self.names,
            joint=self.estimated,
        )

    def _beyond_covariance(self, name: str) -> tuple[float, float]:
        """Standard deviations, below and above, of what the printed interval has beyond the covariance's."""
        if name not in self.quantities or name == DELAY.name:  # what shifts both is drawn with the lag
            return 0.0, 0.0
        quantity = self.quantities[name]
        ends = zip(quantity.interval, self._wald(name, 0.95), strict=True)
        squares = ((printed - quantity.value) ** 2 - (end - quantity.value) ** 2 for printed, end in ends)
        below, above = (math.sqrt(max(square, 0.0)) / normal_quantile(0.95) for square in squares)
        return (below if math.isfinite(below) else 0.0), (above if math.isfinite(above) else 0.0)

    def _wald(self, name: str, level: float) -> tuple[float, float]:
        index = self.names.index(name)
        direction = np.eye(len(self.names))[index]
        value, half = float(self.joint.values[index]), self.joint.covariance.half_width(direction, level)
        return value - half, value + half

    def _repr_html_(self) -> str:
        rows = [
            (name, f"{q.value:.4g}", f"[{q.interval[0]:.4g}, {q.interval[1]:.4g}]", q.unit, q.verdict.value)
            for name, q in self.quantities.items()
        ]
        columns = ("quantity", "value", "95 % interval", "unit", "verdict")
        return html_table(f"saved fit: {self.verdict.value}", columns, rows, " ".join(self.reasons))


def _known_pair(name: str, pair: tuple[float, ...]) -> KnownNumber:
    checks.items(name, pair, (int, float), "a value and a standard deviation", "Give (1.53, 0.02).")
    if len(pair) != 2:
        raise UsageError(f"a value and a standard deviation for {name}", f"{pair}", "Give (1.53, 0.02).")
    return known_number(float(pair[0]), float(pair[1]))


#: Larger files are no result.
LARGEST_BYTES = 100_000_000


def load_fit(file: str | Path, model: str = "") -> SavedFit:
    """Read back a result that ``eivor identify --json FILE``, ``fit.to_json()`` or a log's result wrote.

    Parameters
    ----------
    file : str or Path
        A document of schema ``eivor.identify/1`` or ``/2``.
    model : str, optional
        The motion that is wanted, such as "vertical"; needed where the document has several.

    Returns
    -------
    SavedFit
        Quantities with intervals and verdicts, the joint covariance, and what is needed to predict.

    Raises
    ------
    InputError
        When the file cannot be read, or is no such document.
    UsageError
        When the document does not have the motion, or has several and none is named.
    """
    return fit_among(load_fits(file), model)


def fit_among(fits: Mapping[str, SavedFit], model: str = "", preferred: Sequence[str] = ()) -> SavedFit:
    """The fit of a motion that is named or preferred, or the only one with an estimate."""
    checks.text("model", model)
    if model:
        checks.index_of("a motion of the result", model, fits, "Name one of them, or identify it.")
    fitted = [name for name, fit in fits.items() if fit.estimated is not None] or list(fits)
    matching = sorted((name for name in preferred if name in fits), key=lambda name: name not in fitted)
    candidates = [model] if model else matching[:1] or fitted
    if len(candidates) > 1 and not preferred:
        remedy = f"Name one: --model {candidates[0]}, in Python model='{candidates[0]}'."
        raise UsageError("the motion that is meant", f"a result of several: {', '.join(candidates)}", remedy)
    return fits[candidates[0]]


def load_fits(file: str | Path) -> dict[str, SavedFit]:
    """Read back the fit of every motion of a document, by the motion's name: see `load_fit`."""
    checks.kind("file", file, (str, Path), "the path of a JSON file", 'Such as ev.load_fit("fit.json").')
    path = Path(file)
    try:
        if path.stat().st_size > LARGEST_BYTES:
            raise _no_document(path, f"a file of {path.stat().st_size} bytes")
        document = json.loads(path.read_text(encoding="utf-8"))  # names may hold lone surrogates
    except OSError as error:
        received = f"'{path}': {error.strerror or error}"
        raise InputError("a result that can be read", received, "Check the path.") from error
    except (ValueError, RecursionError) as error:
        raise _no_document(path, "content that is not JSON") from error
    schema = document.get("schema") if isinstance(document, dict) else None
    try:
        if schema == json_document.MOTION_SCHEMA:
            fit = fit_of(document)
            return {name_of_model(fit.document.model.name): fit}
        if schema != json_document.LOG_SCHEMA:
            raise _no_document(path, "another document")
        parsed = msgspec.convert(document, json_document.LogDocument)
        return {name: fit_of(motion, parsed.provenance) for name, motion in parsed.motions.items()}
    except (msgspec.ValidationError, ValueError) as error:
        raise _no_document(path, f"one that lacks parts ({error})") from error


def _no_document(path: Path, received: str) -> InputError:
    return InputError(
        f"a document of schema {json_document.MOTION_SCHEMA} or {json_document.LOG_SCHEMA} in {path.name}",
        received,
        "Write one with: eivor identify LOG --json FILE.",
    )


def fit_of(document: Mapping[str, Any], provenance: json_document.JsonProvenance | None = None) -> SavedFit:
    """Return the fit of a motion's document, with the provenance of the log's where it has none."""
    parsed = msgspec.convert(document, json_document.FitDocument)
    if provenance is not None:
        parsed = msgspec.structs.replace(parsed, provenance=provenance)
    quantities = _read_quantities(parsed)
    return SavedFit(
        quantities=quantities,
        estimated=None if parsed.covariance is None else _joint(parsed.covariance, quantities),
        document=parsed,
        by_flight={str(row.log): _read_quantities(row) for row in parsed.by_flight or ()},
    )


def _read_quantities(row: json_document.FitDocument | json_document.JsonRow) -> dict[str, Quantity]:
    return {
        name: Quantity(
            value=_number(item.value, math.nan),
            unit=item.unit,
            std_error=_number(item.std_error, math.nan),
            interval=(_number(item.interval[0], -math.inf), _number(item.interval[1], math.inf)),
            verdict=item.verdict,
            by_run=tuple(_number(value, math.nan) for value in item.by_segment or ()),
            reasons=tuple(Reason(item.verdict, sentence) for sentence in item.reasons),
            systematic_uncertainties=tuple(item.systematic),
        )
        for name, item in {**row.parameters, **row.derived}.items()
    }


def _joint(block: json_document.JsonCovariance, quantities: Mapping[str, Quantity]) -> JointEstimate:
    """Joint vector of a document; of several delays where it fits best."""
    best = [item for item in block.candidates or () if item.best]
    joint = best[0] if best else block
    if len(best) > 1 or not joint.parts or not set(block.names) <= set(quantities):
        raise ValueError("a covariance of its quantities, and which candidate is the best")
    if len(joint.values) != len(block.names):
        raise ValueError("a value for each name of the covariance")
    values = np.array(joint.values, dtype=np.float64)  # NaN for None
    parts = []
    for part in joint.parts:
        matrix = np.array(part.matrix, dtype=np.float64).reshape(values.size, values.size)
        parts.append(CovariancePart(part.name, matrix, _number(part.degrees, math.inf), part.share))
    return JointEstimate(values, JointCovariance(tuple(parts)))


def _number(value: float | None, default: float) -> float:
    return default if value is None else value


def draws_table(
    fit: SavedFit, n: int, seed: int = 0, mass: KnownNumber | None = None, accept: str = "identified"
) -> pl.DataFrame:
    """Table of joint draws."""
    import polars as pl

    draws, fitted = fit.sample(n, seed), replace(fit.fitted, accepted=accepted_verdicts(accept))
    selected = [name for name in fit.quantities if fitted.is_identified(name)]
    columns = {name: column for name, column in draws.items() if name in selected}
    if not columns:
        expected = "a parameter that is identified, to draw from"
        remedy = "Fly again as the report says."
        raise NotIdentifiedError(expected, f"a result without. {' '.join(fit.reasons)}".rstrip("."), remedy)
    prediction = fit.document.prediction
    for name, value in (prediction.at if prediction else {}).items():
        if name in selected and name not in columns and value is not None:
            columns[name] = np.full(n, float(value))
    if mass is not None:
        random = np.random.default_rng([seed, 1])  # a stream of its own, which leaves the other draws alone
        columns["mass"] = np.maximum(mass.value + mass.std * random.standard_normal(n), 0.0)
    return pl.DataFrame(columns)
