"""The page of a report beside identifying its flight: the example, by one method and by all of them.

Target: a page takes no more than a second beyond `identify_flight`.
"""

from __future__ import annotations

from _shared import arguments, least_seconds, machine

from eivor.flights.options import FlightOptions
from eivor.logs.read import example_flight
from eivor.motions.identify import identify_flight
from eivor.report.flight_page import flight_page

#: Seconds that a page may take.
TARGET_S = 1.0


def main() -> None:
    small = arguments(__doc__).small
    print(machine())
    log = example_flight()
    for name, options in {"one method": FlightOptions(), "every method": FlightOptions(compare=True)}.items():
        result = identify_flight(log, options)
        page = flight_page(result)
        writing = least_seconds(lambda result=result: flight_page(result), 1 if small else 5)
        identifying = least_seconds(lambda options=options: identify_flight(log, options), 1 if small else 3)
        print(
            f"{name}: page {writing:.2f} s, {len(page) / 1e6:.2f} MB; identify {identifying:.2f} s; "
            f"ratio {writing / identifying:.2f}; of target {writing / TARGET_S:.2f}"
        )
        if small:
            break


if __name__ == "__main__":
    main()
