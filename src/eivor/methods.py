"""Public door `eivor.methods`: every estimation method, that of regularisation included."""

from __future__ import annotations

from eivor.estimation import methods
from eivor.estimation.methods import *  # noqa: F403 - its `__all__` is the list of names
from eivor.lab.regularised import regularised

__all__ = ["regularised"]
__all__ += methods.__all__


def __dir__() -> list[str]:
    return __all__
