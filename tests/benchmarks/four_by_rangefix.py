"""What four_by_hand.py does, by rangefix; it draws from the beliefs and summarises more beside."""

import numpy as np

from rangefix.evaluation import Experiment, NamedEstimator, comparison_table, run
from rangefix.filters import Gaussian, Problem, Rangefinder, Stationary, Uniform, position_space
from rangefix.maps import RectangularRoom

room, space = RectangularRoom(4.0, 6.0), position_space()
sensor = Rangefinder(room, np.deg2rad([326.3, 0.0, 33.7]), Gaussian(0.05), space)
problem = Problem(space, Stationary(space), sensor, Uniform(room, space))
estimators = {
    "grid": NamedEstimator("point-mass", {"cell": 0.05}),
    "particles": NamedEstimator("particle", {"particles": 2000, "temper": False, "regularise": False}),
    "ekf": NamedEstimator("ekf", {}),
    "ukf": NamedEstimator("ukf", {"alpha": 1.0}),
}
results = run(Experiment(problem, estimators, runs=1000, seed=1), timing=False, progress=False)
print(comparison_table(results))
