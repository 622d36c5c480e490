"""What measurement noises do to the columns of a rigid body's flights, for total least squares and its kin.

The noise of a rotor's speed comes into a column through the map of its thrust, as 2 n times itself where
thrust goes with n^2, and into thrust, torques and offsets alike; that of the rates into dampings, couplings
and increments. So columns share noise with each other and with the response. What it adds up to is read
off a *surrogate*: the flight with so much more of every noise that is declared, whose columns differ from its
own by noise of the covariance that its own have.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from eivor.flights.prepared import PreparedFlight
from eivor.motions.rates.axes import AXES
from eivor.motions.rigid_body.parameters import ALONG
from eivor.signals.families import family_members

#: Of the surrogate's noises: a flight has the same estimate every time.
SEED = 0


def noises_known(flight: PreparedFlight) -> bool:
    """Whether noises are declared of all that is measured, and in every equation: speeds, rates and forces.

    Commands of rotors and references are exact; velocity and attitude are taken to be, where nothing is
    declared of them.
    """
    channels = flight.signals.channels
    speeds = family_members(flight.input.name, channels) if flight.input.measured else ()
    forces = {f"specific_force_body_{along}" for along in ALONG} & set(channels)
    return {*speeds, *(axis.rate for axis in AXES), *forces} <= set(flight.signals.noise)


def noisier(flight: PreparedFlight) -> PreparedFlight:
    """The flight with so much more of every noise that is declared."""
    signals, rng = flight.signals, np.random.default_rng(SEED)
    more = {
        name: values + signals.noise[name].sample(signals.sample_count, rng)
        for name, values in signals.channels.items()
        if name in signals.noise
    }
    return replace(flight, signals=replace(signals, channels={**signals.channels, **more}))
