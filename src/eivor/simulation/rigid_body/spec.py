"""Specifications of flights of a whole vehicle."""

from __future__ import annotations

from dataclasses import dataclass, field

from eivor.errors import ParameterError
from eivor.motions.rigid_body.parameter_ranges import within
from eivor.motions.rigid_body.vehicle import Vehicle
from eivor.signals.noise import WhiteNoise
from eivor.simulation.flights.trajectories import TrajectoryKind
from eivor.simulation.rigid_body.controller import FlightController
from eivor.simulation.rigid_body.integrators import Integrator, RungeKutta4
from eivor.simulation.rigid_body.sensors import Sensor
from eivor.simulation.sources.disturbance import Disturbance
from eivor.simulation.sources.excitation import Excitation


def _noisy(std: float) -> Sensor:
    return Sensor(noise=WhiteNoise(std))


@dataclass(frozen=True, slots=True)
class AxisExcitations:
    """A series about each axis of the body, or none.

    Parameters
    ----------
    roll, pitch, yaw : Excitation or None
        About the axes that point forward, left and up.
    """

    roll: Excitation | None = None
    pitch: Excitation | None = None
    yaw: Excitation | None = None


@dataclass(frozen=True, slots=True)
class TorqueDisturbance:
    """Torques from outside, as the angular acceleration that each would give by itself.

    Parameters
    ----------
    roll, pitch, yaw : Disturbance or None
        About the axes that point forward, left and up [rad/s^2].
    """

    roll: Disturbance | None = None
    pitch: Disturbance | None = None
    yaw: Disturbance | None = None


@dataclass(frozen=True, slots=True)
class Wind:
    """Velocity of the air in the world.

    Parameters
    ----------
    steady : tuple of float
        What does not change, on three axes [m/s].
    x, y, z : Disturbance or None
        Gusts along each axis of the world [m/s].

    Raises
    ------
    ParameterError
        When the steady wind is no triple of speeds up to 50 m/s.
    """

    steady: tuple[float, ...] = (0.0, 0.0, 0.0)
    x: Disturbance | None = None
    y: Disturbance | None = None
    z: Disturbance | None = None

    def __post_init__(self) -> None:
        if len(self.steady) != 3 or not all(abs(speed) <= 50.0 for speed in self.steady):
            raise ParameterError(
                "a steady wind of three speeds up to 50 m/s", f"{self.steady}", "Correct the wind."
            )


@dataclass(frozen=True, slots=True)
class Sensors:
    """What the vehicle measures; a sensor that is described has the noise of its description, else none.

    Parameters
    ----------
    angular_rate : Sensor
        Body rates [rad/s], which the rate loop gets; of .02 rad/s of white noise when left out.
    specific_force : Sensor
        Accelerometer in the centre of mass [m/s^2]; of .5 m/s^2.
    velocity, position : Sensor
        In the world [m/s, m]; of .05 m/s and .02 m.
    attitude : Sensor
        Its errors are small rotations about the body's axes [rad]; of .002 rad. It has no filter.
    rotor_speed : Sensor or None
        [rad/s]; not logged when left out.

    Raises
    ------
    ParameterError
        When the attitude has a filter, or is averaged.
    """

    angular_rate: Sensor = field(default_factory=lambda: _noisy(0.02))
    specific_force: Sensor = field(default_factory=lambda: _noisy(0.5))
    velocity: Sensor = field(default_factory=lambda: _noisy(0.05))
    position: Sensor = field(default_factory=lambda: _noisy(0.02))
    attitude: Sensor = field(default_factory=lambda: _noisy(0.002))
    rotor_speed: Sensor | None = None

    def __post_init__(self) -> None:
        for name in ("cutoff_hz", "averaged_s"):
            if getattr(self.attitude, name):
                raise ParameterError(
                    "an attitude without a filter",
                    f"{name}={getattr(self.attitude, name):g}",
                    "Leave it out: quaternions are not averaged part by part.",
                )

    @classmethod
    def exact(cls) -> Sensors:
        """Sensors without errors, rotor speeds included."""
        return cls(Sensor(), Sensor(), Sensor(), Sensor(), Sensor(), Sensor())


@dataclass(frozen=True, slots=True)
class Logged:
    """How often what is no measurement is logged; at every step of the simulation where zero.

    Parameters
    ----------
    rotor_command_hz : float
        Commands of the rotors [Hz].
    setpoint_hz : float
        Setpoints of thrust, torques and rates, and injected torques [Hz]: the values of that moment.
    reference_hz : float
        References of height and attitude [Hz].
    left_out : tuple of str
        Channels that are not logged, `rotor_command_*` for those of all rotors.

    Raises
    ------
    ParameterError
        When a rate is out of its range.
    """

    rotor_command_hz: float = 0.0
    setpoint_hz: float = 0.0
    reference_hz: float = 0.0
    left_out: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("rotor_command_hz", "setpoint_hz", "reference_hz"):
            if not 0.0 <= getattr(self, name) <= 1e5:
                raise ParameterError(f"{name} between 0 and 1e5", f"{getattr(self, name)}", "Correct it.")


@dataclass(frozen=True, slots=True)
class RigidBodyFlightSpec:
    """Everything that a flight is a function of.

    Parameters
    ----------
    vehicle : Vehicle
        What flies.
    rate_hz : float
        Steps of the simulation per second [Hz], over which commands, wind and torques from outside are held.
    duration : float
        Of the flight [s].
    trajectory : TrajectoryKind
        The height reference.
    vigour : float
        Share of the speed and acceleration that an excitation of the height may reach.
    attitude : AxisExcitations
        Roll, pitch and yaw that are asked for [rad], yaw first.
    injection : AxisExcitations
        What is added to the normalised torque setpoints.
    controller : FlightController
        Its loops.
    wind : Wind
        Of the air.
    torque_disturbance : TorqueDisturbance
        From outside.
    sensors : Sensors
        What is measured, and how.
    logged : Logged
        How often the rest is logged.
    integrator : Integrator
        Of the motion.
    seed : int
        Of the random streams.

    Raises
    ------
    ParameterError
        When a value is out of its range, or the loops' rates or a delay of the rotors do not fit the steps.
    """

    vehicle: Vehicle
    rate_hz: float = 500.0
    duration: float = 30.0
    trajectory: TrajectoryKind = TrajectoryKind.MULTISINE
    vigour: float = 1.0
    attitude: AxisExcitations = field(default_factory=AxisExcitations)
    injection: AxisExcitations = field(default_factory=AxisExcitations)
    controller: FlightController = field(default_factory=FlightController)
    wind: Wind = field(default_factory=Wind)
    torque_disturbance: TorqueDisturbance = field(default_factory=TorqueDisturbance)
    sensors: Sensors = field(default_factory=Sensors)
    logged: Logged = field(default_factory=Logged)
    integrator: Integrator = field(default_factory=RungeKutta4)
    seed: int = 0

    def __post_init__(self) -> None:
        within(self, RANGES, "Correct the flight's description.")
        for name in ("rate_hz", "attitude_hz", "height_hz"):
            self._whole(f"{name} of the controller", self.rate_hz / getattr(self.controller, name))
        self._whole("attitude_hz of the controller", self.controller.rate_hz / self.controller.attitude_hz)
        self._whole("height_hz of the controller", self.controller.rate_hz / self.controller.height_hz)
        steps = self.vehicle.rotors.delay * self.rate_hz
        if abs(steps - round(steps)) > 1e-6:
            raise ParameterError(
                f"a delay of the rotors that is a multiple of {self.step_s:g} s, a step of the simulation",
                f"{self.vehicle.rotors.delay}",
                "Correct it, or the simulation's rate_hz.",
            )

    def _whole(self, what: str, periods: float) -> None:
        if not (periods > 0.5 and abs(periods - round(periods)) < 1e-6):
            raise ParameterError(
                f"{what} that is the rate of the simulation, and of its rate loop, over a whole number",
                f"{periods:g} periods of these in one of its own",
                f"The simulation has {self.rate_hz:g} Hz, its rate loop {self.controller.rate_hz:g} Hz.",
            )

    @property
    def step_s(self) -> float:
        """Step of the simulation [s]."""
        return 1.0 / self.rate_hz

    @property
    def count(self) -> int:
        """Number of steps."""
        return round(self.duration * self.rate_hz)


#: What each number of a specification may be.
RANGES = {
    "rate_hz": (20.0, 1e4),
    "duration": (0.1, 3600.0),
    "vigour": (0.01, 2.0),
    "seed": (0, 2**63),
}
