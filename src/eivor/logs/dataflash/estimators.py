"""Which estimator, and which of its cores, flies.

EKF3 logs XKF1 and EKF2 NKF1, with a core in the column C since 4.0; before that the second core is in XKF6 or
NKF6. XKFS.PI, XKF4.PI and NKF4.PI are the core in use; ATT.AEKF, and the parameter AHRS_EKF_TYPE, tell the
estimator in use.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from eivor.logs.dataflash.messages import Messages
from eivor.logs.dataflash.sources import ESTIMATORS
from eivor.signals.recording import Finding

#: ATT.AEKF and AHRS_EKF_TYPE of each estimator.
_TYPES = {3: "XKF1", 2: "NKF1", 1: "EKF1"}
#: Where the core in use is logged, by estimator.
_PRIMARY = {"XKF1": ("XKFS", "XKF4"), "NKF1": ("NKF4",), "EKF1": ()}


def choose_estimator(
    tables: dict[str, Messages], parameters: Mapping[str, float], findings: list[Finding]
) -> None:
    """Leave of all estimates the one that flies, under the name of its first core.

    Parameters
    ----------
    tables : dict of str to Messages
        By name; changed.
    parameters : mapping of str to float
        Of the log.
    findings : list of Finding
        To which is added when the core in use changed.
    """
    logged = [name for name in ESTIMATORS if name in tables]
    if not logged:
        return
    told = _most(tables.get("ATT"), "AEKF") or int(parameters.get("AHRS_EKF_TYPE", 0.0))
    chosen = _TYPES.get(told, logged[0])
    chosen = chosen if chosen in logged else logged[0]
    for name in logged:
        if name != chosen:
            del tables[name]
    core = _core(tables, chosen, findings)
    table = tables[chosen]
    if table.has("C"):
        cores = table.stored("C")
        kept = core if np.any(cores == core) else int(cores.min())
        tables[chosen] = table.where(cores == kept)
    elif core == 1:
        tables[chosen] = tables.get(f"{chosen[:3]}6", table)


def _core(tables: Mapping[str, Messages], chosen: str, findings: list[Finding]) -> int:
    """Number of the core that was in use for most of the log; 0 where it is not told."""
    for name in _PRIMARY[chosen]:
        table = tables.get(name)
        if table is None or not table.has("PI"):
            continue
        told, counts = np.unique(table.stored("PI"), return_counts=True)
        core = int(told[np.argmax(counts)])
        if told.size > 1:
            share = 1.0 - float(counts.max()) / float(counts.sum())
            findings.append(
                Finding(
                    "estimator_core",
                    f"The estimator changed its core ({name}.PI): velocity and position are those of core "
                    f"{core}, which was not in use for {share:.0%} of the log.",
                )
            )
        return max(core, 0)
    return 0


def _most(table: Messages | None, column: str) -> int:
    """Value that a column has most often; 0 where there is none."""
    if table is None or not table.has(column) or not table.count:
        return 0
    told, counts = np.unique(table.stored(column), return_counts=True)
    return int(told[np.argmax(counts)])
