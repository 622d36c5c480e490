"""How much instruments say: conditional first-stage strength, and over-identification.

Notation: Q orthonormal basis of the instruments, G Jacobian, e residual.
"""

from __future__ import annotations

import numpy as np

from eivor.inference.quantiles import chi_square_tail
from eivor.shapes import Float

#: Directions of the unit-length instruments with smaller singular values are noise and are dropped.
SMALLEST_DIRECTION = 1e-4


def orthonormal_basis(instruments: Float[np.ndarray, "rows p"]) -> Float[np.ndarray, "rows q"]:
    """Orthonormal basis of the space of the instruments, each scaled to unit length first.

    Zero columns, and directions with singular values below 1e-4, are left out.
    """
    lengths = np.sqrt(np.einsum("ij,ij->j", instruments, instruments))
    moving = lengths > 0.0
    if not moving.any():
        return np.empty((instruments.shape[0], 0))
    U, singular, _ = np.linalg.svd(instruments[:, moving] / lengths[moving], full_matrices=False)
    basis: Float[np.ndarray, "rows q"] = U[:, singular >= SMALLEST_DIRECTION]
    return basis


def conditional_first_stage(
    basis: Float[np.ndarray, "rows p"], jacobian: Float[np.ndarray, "rows n"]
) -> Float[np.ndarray, " n"]:
    """F statistic of each column of G given the others (Sanderson and Windmeijer 2016, for whitened rows).

    delta = least squares of Q'G_j on Q'G_-j; r = G_j - G_-j delta;
    F_j = (|Q'r|^2 / (p - n + 1)) / (|r - QQ'r|^2 / (rows - p)). Zero without enough instruments.
    """
    rows, rank = basis.shape
    count = jacobian.shape[1]
    degrees = rank - (count - 1)
    if degrees < 1 or rows <= rank:
        return np.zeros(count)
    projected = basis.T @ jacobian
    strengths = np.zeros(count)
    for j in range(count):
        others = [i for i in range(count) if i != j]
        delta = np.linalg.lstsq(projected[:, others], projected[:, j], rcond=None)[0]
        r = jacobian[:, j] - jacobian[:, others] @ delta
        explained = basis.T @ r
        unexplained = float(r @ r - explained @ explained)
        if unexplained > 0.0:
            strengths[j] = float(explained @ explained) / degrees / (unexplained / (rows - rank))
        else:
            strengths[j] = np.inf
    return strengths


def first_stage_of_products(
    instruments: Float[np.ndarray, "p p"],
    cross: Float[np.ndarray, "p n"],
    regressors: Float[np.ndarray, "n n"],
    rows: int | float,
    shared: Float[np.ndarray, "p n"] | None = None,
) -> Float[np.ndarray, " n"]:
    """Conditional first-stage F from mean(psi psi'), mean(psi phi') and mean(phi phi').

    Of compensated equations `shared` is C, what the measurement noises add to mean(psi phi'). Noise that
    instruments and regressors share moves both and would pass for strength: what is explained is that
    by mean(psi phi') - C, and the rest is the variance of phi less that.

    The same statistic as `conditional_first_stage`, from moments alone: rounding limits it to about
    half the digits, which is enough to compare it with ten. Zero when the instruments are collinear.
    """
    available, count = cross.shape
    degrees = available - (count - 1)
    scale = np.sqrt(np.diag(instruments))
    if degrees < 1 or rows <= available or not scale.all():
        return np.zeros(count)
    eigenvalues, vectors = np.linalg.eigh(instruments / np.outer(scale, scale))
    kept = eigenvalues > SMALLEST_DIRECTION**2
    to_basis = (vectors[:, kept] / np.sqrt(eigenvalues[kept])).T / scale
    noise_products = to_basis @ (np.zeros(cross.shape) if shared is None else shared)
    basis_products = to_basis @ cross - noise_products
    projected = basis_products.T @ basis_products
    strengths = np.zeros(count)
    for j in range(count):
        others = [i for i in range(count) if i != j]
        delta = np.linalg.lstsq(projected[np.ix_(others, others)], projected[others, j], rcond=None)[0]
        direction = np.zeros(count)
        direction[j], direction[others] = 1.0, -delta
        explained = float(direction @ projected @ direction)
        total = float(direction @ regressors @ direction)
        unexplained = (
            total - explained - 2.0 * float((basis_products @ direction) @ (noise_products @ direction))
        )
        negligible = unexplained <= 1e-12 * float(regressors[j, j])
        strengths[j] = np.inf if negligible else explained / degrees / (unexplained / (rows - available))
    return strengths


def over_identification(
    basis: Float[np.ndarray, "rows p"], residual: Float[np.ndarray, " rows"], variance: float, unknowns: int
) -> tuple[float, float]:
    """J = e'QQ'e / s^2 and its p-value on p - n degrees of freedom (1 when exactly identified)."""
    moments = basis.T @ residual
    J = float(moments @ moments) / variance if variance > 0.0 else 0.0
    degrees = basis.shape[1] - unknowns
    return J, chi_square_tail(J, degrees) if degrees > 0 else 1.0
