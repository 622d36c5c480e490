"""Density of the air, which a DataFlash log does not have: that of dry air at the barometer's readings.

The barometer's own temperature is above that of the air, by some ten degrees where the board is warm: then
the density is too small by 3 %, alike in all flights of a vehicle.
"""

from __future__ import annotations

import numpy as np

from eivor.logs.dataflash.reading import Reading
from eivor.shapes import Float

#: Gas constant of dry air [J/(kg K)], and zero degrees Celsius [K].
DRY_AIR, ZERO_CELSIUS = 287.05, 273.15


def add_air_density(reading: Reading) -> None:
    """Add it, where pressure [Pa] and temperature [degrees Celsius] are logged."""
    table = reading.tables.get("BARO")
    if table is None or not table.has("Press", "Temp") or not table.clock:
        return
    if "air_temperature" not in reading.channels:
        return

    def values() -> Float[np.ndarray, " n"]:
        return table.values("Press") / (DRY_AIR * (table.values("Temp") + ZERO_CELSIUS))

    reading.add_made("air_density", table, values, "BARO.Press and .Temp")
