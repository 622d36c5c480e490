"""Every method that is solved by total least squares against its formula as it stands, with dense matrices.

Nothing of the product is used but the record: instruments, regressors and the covariances of their noises are
written out entry by entry, sigma is the least generalized eigenvalue of a pencil of SciPy's, and the paper's
augmented systems (27), (33) are solved with all their rows.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg

import eivor as ev
from eivor.estimation import methods
from eivor.estimation.linear import LinearMethod
from eivor.linalg import AugmentedLeastSquares
from eivor.linalg.total_least_squares import ErrorsInColumns

ROWS, LAGS = 90, 4
NOISE = {
    "velocity_z": ev.FractionalNoise(std=0.15, order=-0.4),
    "specific_force_z": ev.FractionalNoise(std=0.2, order=-0.5),
    "input": ev.WhiteNoise(std=0.25),
}
EXACT = 1e-10


@pytest.fixture(scope="module")
def signals():
    """A short record with so much noise that least squares is far from total least squares."""
    rng = np.random.default_rng(11)
    drive = np.convolve(rng.standard_normal(ROWS + 2), [0.6, 1.0, 0.6], mode="valid")
    velocity = np.zeros(ROWS)
    for k in range(1, ROWS):
        velocity[k] = 0.8 * velocity[k - 1] + 0.5 * drive[k - 1]
    channels = {"velocity_z": velocity, "specific_force_z": 1.2 * drive - 0.7 * velocity, "input": drive}
    for name, noise in NOISE.items():
        channels[name] = channels[name] + fractional(noise) @ rng.standard_normal(ROWS)
    return ev.Signals(rate_hz=5.0, channels=channels, noise=NOISE)


def fractional(noise):
    """Matrix that makes the noise out of white: std a_(k - m), a_j = a_(j-1) (j - 1 - alpha) / j."""
    order = getattr(noise, "order", 0.0)
    a = [1.0]
    for j in range(1, ROWS):
        a.append(a[-1] * (j - 1.0 - order) / j)
    return noise.std * np.array([[a[k - m] if m <= k else 0.0 for m in range(ROWS)] for k in range(ROWS)])


def columns(signals, tags, rows):
    """Rows of columns (channel, lag, sign)."""
    return np.array([[sign * signals.channels[name][k - lag] for name, lag, sign in tags] for k in rows])


def shared(left, right, rows):
    """Mean over the rows of the covariance of two sets of columns, out of dense ROWS x ROWS covariances."""
    covariance = {name: (root := fractional(noise)) @ root.T for name, noise in NOISE.items()}
    return np.array(
        [
            [
                0.0
                if item != other
                else sign * its * np.mean([covariance[item][k - lag, k - late] for k in rows])
                for other, late, its in right
            ]
            for item, lag, sign in left
        ]
    )


REGRESSORS = [("velocity_z", 0, -1.0), ("input", 0, 1.0)]
RESPONSE = [("specific_force_z", 0, 1.0)]


def instruments(first):
    return [("input", lag, 1.0) for lag in range(first, LAGS + 1)]


class Dense:
    """X, b of (23) or (29) as means, and S of their columns' errors."""

    def __init__(self, signals, first, *, limited=False):
        right = REGRESSORS + RESPONSE
        rows = range(0 if first is None else LAGS, ROWS)  # from the largest lag on
        both = columns(signals, right, rows)
        if first is None:  # (13): the rows themselves
            self.stacked, self.S = both, shared(right, right, rows)
            return
        psi = columns(signals, instruments(first), rows)
        cross = psi.T @ both / len(both)
        self.stacked = cross - shared(instruments(first), right, rows)
        self.S = np.eye(3)
        if limited:
            weight = np.linalg.inv(psi.T @ psi / len(both))
            self.S = both.T @ both / len(both) - cross.T @ weight @ cross
            self.stacked = scipy.linalg.sqrtm(weight).real @ self.stacked
        self.left_over = len(both) - len(instruments(first))

    @property
    def least(self):
        """Sigma^2, the least generalized eigenvalue of [X b]'[X b] and S: a column may be without error."""
        return 1.0 / scipy.linalg.eigh(self.S, self.stacked.T @ self.stacked, eigvals_only=True)[-1]

    def shifted(self, taken_off=0.0):
        """(X'X - (sigma^2 - taken_off) S) theta = X'b - (sigma^2 - taken_off) s, (15), (26) and (32)."""
        G = self.stacked.T @ self.stacked - (self.least - taken_off) * self.S
        return np.linalg.solve(G[:-1, :-1], G[:-1, -1])

    def eigenvector(self):
        """Theta from the vector of that eigenvalue."""
        d = scipy.linalg.eigh(self.stacked.T @ self.stacked, self.S)[1][:, 0]
        return -d[:-1] / d[-1]

    def augmented(self):
        """Theta of (27) and (33) with all rows; for S = I only."""
        X, b, sigma = self.stacked[:, :-1], self.stacked[:, -1], np.sqrt(self.least)
        full = np.block([[sigma * np.eye(len(b)), X], [X.T, sigma * np.eye(2)]])
        return np.linalg.solve(full, np.append(b, np.zeros(2)))[len(b) :]


#: Of every method that total least squares solves: its first lag (None: no instruments), what is made of it.
FORMS = {
    "total_least_squares": (None, lambda signals: Dense(signals, None).shifted()),
    "extended_iv_tls": (1, lambda signals: Dense(signals, 1).shifted()),
    "generalized_iv_tls": (0, lambda signals: Dense(signals, 0).shifted()),
    "liml": (1, lambda signals: Dense(signals, 1, limited=True).shifted()),
    "generalized_liml": (0, lambda signals: Dense(signals, 0, limited=True).shifted()),
    "fuller": (1, lambda signals: with_fuller(Dense(signals, 1, limited=True))),
    "generalized_fuller": (0, lambda signals: with_fuller(Dense(signals, 0, limited=True))),
}


def with_fuller(dense):
    return dense.shifted(1.0 / dense.left_over)


def problem_of(signals, first):
    """The product's problem on the same rows."""
    lags = () if first is None else ev.lags("input", first, LAGS)
    return ev.VerticalMotion(intercept=False).regression(signals, lags)


def methods_by_name():
    made = {}
    for name in methods.__all__:
        maker = getattr(methods, name)
        if callable(maker) and name.islower() and name not in ("by_name", "regularised"):
            made[name] = maker()
    return made


def test_every_method_that_total_least_squares_solves_has_its_form_here():
    solved = {
        name
        for name, method in methods_by_name().items()
        if isinstance(method, LinearMethod) and isinstance(method.solver, ErrorsInColumns)
    }
    assert solved == set(FORMS)


@pytest.mark.filterwarnings("ignore::eivor.errors.WeakInstrumentsWarning")
@pytest.mark.parametrize("name", FORMS)
def test_the_formula_as_it_stands(signals, name):
    first, wanted = FORMS[name]
    method, problem = methods_by_name()[name], problem_of(signals, first)
    theta = method.solve(problem).solution.theta
    np.testing.assert_allclose(theta, wanted(signals), rtol=EXACT)
    swapped = replace(method, solver=AugmentedLeastSquares()).solve(problem).solution.theta
    assert np.abs(swapped / theta - 1.0).max() > 1e6 * EXACT, "least squares in its place is not noticed"


@pytest.mark.parametrize(("name", "first"), [("extended_iv_tls", 1), ("generalized_iv_tls", 0)])
def test_the_augmented_systems_with_all_their_rows(signals, name, first):
    """(27) is (26), and (33) is (32); and both are the vector of the least singular value."""
    dense = Dense(signals, first)
    np.testing.assert_allclose(dense.augmented(), dense.shifted(), rtol=EXACT)
    np.testing.assert_allclose(dense.eigenvector(), dense.shifted(), rtol=EXACT)
    theta = methods_by_name()[name].solve(problem_of(signals, first)).solution.theta
    np.testing.assert_allclose(theta, dense.augmented(), rtol=EXACT)
