"""Public door `eivor.methods`: every estimation method, that of regularisation included."""

from __future__ import annotations

from eivor.estimation.methods import (
    TABLE,
    TwoStage,
    TwoStepRobust,
    Unweighted,
    bias_compensated_least_squares,
    bias_eliminating_least_squares,
    by_name,
    extended_iv,
    extended_iv_tls,
    frisch_scheme,
    fuller,
    generalized_fuller,
    generalized_iv,
    generalized_iv_tls,
    generalized_iv_unknown_noise,
    generalized_liml,
    least_squares,
    liml,
    reference_iv,
    spectral_giv,
    spectral_giv_combined,
    total_least_squares,
    whitened_least_squares,
    whittle_ml,
)
from eivor.lab.regularised import regularised

__all__ = [
    "TABLE",
    "TwoStage",
    "TwoStepRobust",
    "Unweighted",
    "bias_compensated_least_squares",
    "bias_eliminating_least_squares",
    "by_name",
    "extended_iv",
    "extended_iv_tls",
    "frisch_scheme",
    "fuller",
    "generalized_fuller",
    "generalized_iv",
    "generalized_iv_tls",
    "generalized_iv_unknown_noise",
    "generalized_liml",
    "least_squares",
    "liml",
    "reference_iv",
    "regularised",
    "spectral_giv",
    "spectral_giv_combined",
    "total_least_squares",
    "whitened_least_squares",
    "whittle_ml",
]


def __dir__() -> list[str]:
    """Names that the module offers."""
    return __all__
