"""Parameters along a record, of rows that may tell some of them at times only, with what is known beforehand.

A two-stage estimate of faded products, A'A its information over the instruments that vary, joined with what
is known of the parameters: (k A'A + P) theta = k A'b + P theta_0 with P the precisions and k the information
of a row, which is that of errors with memory, from the robust covariance of the scores. A parameter that the
rows do not tell keeps what was known of it, and the interval says so.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from eivor.estimation.recursive.change_detector import ChangeDetector, Watch
from eivor.estimation.recursive.faded_covariance import faded_covariance
from eivor.estimation.recursive.faded_products import FadedProducts, nothing_yet
from eivor.estimation.recursive.forgetting import BLOCKS_PER_LOOK, Forgetting
from eivor.estimation.recursive.looks import References, newest_look
from eivor.estimation.recursive.timed_rows import TimedRows
from eivor.inference.covariances.covariance import JointCovariance, unit_scale
from eivor.models.separable import Prior
from eivor.shapes import Float

#: Share of the largest variance of the scaled instruments below which a direction of them does not vary.
CONSTANT = 1e-9
#: Share of the largest information below which there is none.
LOST = 1e-12
#: Times that the information of a row is renewed at the estimate.
PASSES = 3
#: Rows without any error tell everything; in numbers, so much.
MOST_INFORMATION = 1e200


@dataclass(frozen=True, slots=True)
class TrackedPoint:
    """What is known after a look.

    Parameters
    ----------
    sample : int
        Samples of the record so far.
    value, half_width : float
        Of the parameter that is followed, 95 %; infinite where nothing was told of late.
    share : float
        Weights of the rows that counted over those of a memory without gaps.
    change : int
        1 where it was told to have grown, -1 to have fallen, 0 for neither.
    """

    sample: int
    value: float
    half_width: float
    share: float
    change: int = 0


@dataclass(frozen=True, slots=True)
class Posterior:
    """Estimate of faded products and of what was known beforehand.

    Parameters
    ----------
    theta : ndarray, shape (n,)
        The estimate.
    mapped : ndarray, shape (n, p)
        What a change of the mean scores changes it by.
    known : ndarray, shape (n, n)
        Part of its covariance that comes of what was known.
    """

    theta: Float[np.ndarray, " n"]
    mapped: Float[np.ndarray, "n p"]
    known: Float[np.ndarray, "n n"]


@dataclass(frozen=True, slots=True)
class Follower:
    """What follows one parameter of several.

    Parameters
    ----------
    place : int
        Which of them.
    priors : tuple of Prior or None
        What is known of each beforehand; None for nothing.
    start : ndarray, shape (n,)
        Values near which they are.
    """

    place: int
    priors: tuple[Prior | None, ...]
    start: Float[np.ndarray, " n"]

    def points(
        self, rows: TimedRows, forgetting: Forgetting, detector: ChangeDetector
    ) -> Iterator[TrackedPoint]:
        """What is known after each look of a record."""
        faded, watching = nothing_yet(rows, forgetting, whole=True), Watch()
        for stretch in rows.stretches(0, forgetting.look):
            faded = faded.then(stretch)
            if stretch.count < forgetting.look:
                return
            watching = watching.after(newest_look(faded), detector)
            told = watching.told(detector)
            change = 0
            if told:
                change = 1 if told[0][1] else -1
                faded, watching = faded.last(detector.kept_looks * BLOCKS_PER_LOOK), watching.reset()
            found = self.posterior(faded)
            watching = watching.expecting(self._reference(faded, found), detector)
            yield self._point(faded, found, change)

    def _reference(self, faded: FadedProducts, found: Posterior | None) -> References | None:
        """What later looks are held against: what rows alone say of a change; None where they say nothing."""
        if found is None:
            return None
        mapped = found.mapped[[self.place]]
        share = float(mapped[0] @ faded.moments.equations[:, self.place])
        watched = slice(self.place, self.place + 1)
        return References(found.theta[None, :], mapped[None] / share, watched) if share > 0.0 else None

    def _point(self, faded: FadedProducts, found: Posterior | None, change: int) -> TrackedPoint:
        share = faded.total.products.count / faded.forgetting.memory
        if found is None:
            return TrackedPoint(faded.samples, math.nan, math.inf, share, change)
        covariance = faded_covariance(faded, found.theta, found.mapped)
        direction = np.eye(found.theta.size)[self.place]
        half = covariance.half_width(direction, 0.95, float(found.known[self.place, self.place]))
        return TrackedPoint(faded.samples, float(found.theta[self.place]), half, share, change)

    def posterior(self, faded: FadedProducts) -> Posterior | None:
        """Estimate of the rows so far; None where they tell nothing of what is not known beforehand."""
        if not faded.effective_rows > self.start.size:
            return None
        moments = faded.moments
        basis = _basis(moments.products.instruments.sum(axis=0) / moments.rows)
        A, b = np.hsplit(basis.T @ moments.equations, [-1])
        own, seen = A.T @ A, A.T @ b[:, 0]
        precision = np.diag([0.0 if prior is None else prior.std**-2 for prior in self.priors])
        mean = np.array([0.0 if prior is None else prior.mean for prior in self.priors])
        if not own[self.place, self.place] > 0.0:
            return None
        theta = self.start
        for _ in range(PASSES):
            row = _row_information(faded_covariance(faded, theta, A.T @ basis.T), np.diag(own))
            row = min(row, MOST_INFORMATION / max(float(np.abs(seen).max()), float(np.abs(own).max())))
            inverse = _inverse(row * own + precision)
            theta = inverse @ (row * seen + precision @ mean)
        return Posterior(theta, row * inverse @ A.T @ basis.T, inverse @ precision @ inverse)


def _row_information(scores: JointCovariance, powers: Float[np.ndarray, " n"]) -> float:
    """Information of the rows: one over the variance of their scores, each over its power, the largest."""
    told = powers > 0.0
    variances = [float(np.mean(np.diag(part.matrix)[told] / powers[told])) for part in scores.parts]
    return 1.0 / max(*variances, np.finfo(np.float64).tiny)


def _inverse(normal: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "n n"]:
    """Inverse of a sum of information, without the directions that nothing tells."""
    scale = unit_scale(np.diag(normal))
    inverse = np.linalg.pinv(normal * np.outer(scale, scale), rcond=LOST, hermitian=True)
    scaled: Float[np.ndarray, "n n"] = np.outer(scale, scale) * inverse
    return scaled


def _basis(products: Float[np.ndarray, "p p"]) -> Float[np.ndarray, "p q"]:
    """Combinations of the instruments that vary, with the identity as their products."""
    scale = unit_scale(np.diag(products))
    values, vectors = np.linalg.eigh(products * np.outer(scale, scale))
    kept = values > CONSTANT * max(values[-1], 0.0)
    basis: Float[np.ndarray, "p q"] = scale[:, None] * vectors[:, kept] / np.sqrt(values[kept])
    return basis
