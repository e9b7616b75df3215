"""True and claimed deviations and ANEES of four estimators over 1000 runs, by hand in numpy and filterpy."""

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter

RUNS, STD, SIZE = 1000, 0.05, np.array([4.0, 6.0])
ANGLES = np.deg2rad([326.3, 0.0, 33.7])
D = np.stack([np.sin(ANGLES), np.cos(ANGLES)])


def ranges(x):
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = (np.where(D > 0, SIZE[:, None], 0.0) - x[..., None]) / D
    return np.where(D == 0, np.inf, ends).min(-2)


def jacobian(x):
    step = 1e-6 * np.eye(2)
    return np.stack([(ranges(x + s) - ranges(x - s)) / 2e-6 for s in step], axis=-1)


def moments(points, weights):
    mean = weights @ points
    return mean, ((points - mean) * weights[:, None]).T @ (points - mean)


rng = np.random.default_rng(1)
truths = SIZE * rng.random((RUNS, 2))
readings = ranges(truths) + STD * rng.standard_normal((RUNS, 3))
axes = [np.arange(0.025, side, 0.05) for side in SIZE]
cells = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 2)
table, mean0, cov0 = ranges(cells), SIZE / 2, np.diag(SIZE**2 / 12)
points = MerweScaledSigmaPoints(2, alpha=1.0, beta=2.0, kappa=1.0)


def likelihood(expected, reading):
    logs = -0.5 * (((reading - expected) / STD) ** 2).sum(-1)
    weights = np.exp(logs - logs.max())
    return weights / weights.sum()


def grid(reading):
    return moments(cells, likelihood(table, reading))


def particles(reading):
    cloud = SIZE * rng.random((2000, 2))
    return moments(cloud, likelihood(ranges(cloud), reading))


def ekf(reading):
    kf = ExtendedKalmanFilter(2, 3)
    kf.x, kf.P, kf.R = mean0.copy(), cov0.copy(), STD**2 * np.eye(3)
    kf.update(reading, jacobian, ranges)
    return kf.x, kf.P


def ukf(reading):
    kf = UnscentedKalmanFilter(2, 3, 1.0, ranges, lambda x, dt: x, points)
    kf.x, kf.P, kf.R = mean0.copy(), cov0.copy(), STD**2 * np.eye(3)
    kf.sigmas_f = points.sigma_points(kf.x, kf.P)
    kf.update(reading)
    return kf.x, kf.P


for name, estimator in (("grid", grid), ("particles", particles), ("ekf", ekf), ("ukf", ukf)):
    means, covs = map(np.array, zip(*(estimator(reading) for reading in readings), strict=True))
    errors = truths - means
    nees = np.einsum("mi,mi->m", errors, np.linalg.solve(covs, errors[..., None])[..., 0])
    print(name, np.sqrt((errors**2).mean(0)), np.sqrt(np.diagonal(covs.mean(0))), nees.mean() / 2)
