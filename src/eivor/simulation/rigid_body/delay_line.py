"""Values that arrive some steps after they were sent, in one flight or in several side by side."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np

from eivor.motions.rigid_body.coefficients import Value
from eivor.shapes import Int


class DelayLine:
    """What is on its way.

    Parameters
    ----------
    late : int or ndarray of int, shape (flights,)
        Steps that it takes.
    before : sequence of components, optional
        What arrives first; the first values that are sent when it is left out.
    """

    def __init__(
        self, late: int | Int[np.ndarray, " flights"], before: Sequence[Value] | None = None
    ) -> None:
        steps = np.unique(late).tolist()
        self._longest = int(steps[-1])
        # For each delay, the flights that have it; none to choose among when all have the same.
        self._flights = [(step, np.flatnonzero(late == step)) for step in steps] if len(steps) > 1 else []
        self._past: deque[list[Value]] = deque(maxlen=self._longest + 1)
        if before is not None:
            self._past.extend([list(before)] * self._longest)

    def pass_on(self, values: list[Value]) -> list[Value]:
        """Send values, and return those that arrive in this step."""
        if self._longest == 0:
            return values
        past = self._past
        if not past:
            past.extend([values] * self._longest)
        past.append(values)
        if not self._flights:
            return past[0]
        arrived = [np.array(one) for one in values]
        for step, flights in self._flights:
            for one, sent in zip(arrived, past[self._longest - step], strict=True):
                one[..., flights] = np.asarray(sent)[..., flights]
        return list(arrived)
