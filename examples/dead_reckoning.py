"""Dead reckoning: believe the motion, ignore the rangefinder. A whole plug-in in one file.

rangefix.filters.build("examples/dead_reckoning.py:DeadReckoning", problem)
"""

from dataclasses import dataclass

from rangefix.filters import Estimate, Problem, check_reading


@dataclass(frozen=True)
class DeadReckoning:
    """Mean and covariance of one run, carried through the motion."""

    problem: Problem

    def init(self, prior, rng):
        return prior.mean, prior.covariance

    def predict(self, belief, control, rng):
        mean, covariance = belief
        motion = self.problem.motion
        slope = motion.jacobian(mean, control)
        covariance = slope @ covariance @ slope.T + motion.noise_covariance(mean, control)
        return self.problem.space.wrap(motion.mean(mean, control)), covariance

    def update(self, belief, measurement, rng):
        check_reading(self.problem.sensor, measurement)  # refuses what is none
        return belief

    def estimate(self, belief):
        return Estimate(*belief)
