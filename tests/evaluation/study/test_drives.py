"""Drives keep to free space, truths follow them, and a matched filter is consistent along the way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy import stats

from rangefix.arrays import Array
from rangefix.evaluation import streams
from rangefix.evaluation.monte_carlo.simulate import follow
from rangefix.evaluation.study.sections.drives import Drive, random_drive, waypoint_drive
from rangefix.filters import (
    Confined,
    GaussianPrior,
    Odometry,
    Problem,
    RandomWalk,
    Rangefinder,
    Stationary,
    StudentT,
    build,
    in_line_of_sight,
    pose_space,
    position_space,
)
from rangefix.maps import FloorPlan, Hits, RectangularRoom

SPACE = pose_space()
ALPHAS = (0.01, 0.005, 0.02, 0.002)
PLAN = FloorPlan(
    [[0, 0], [10, 0], [10, 8], [0, 8]],
    holes=[[[7, 1], [8, 1], [8, 2], [7, 2]]],
    walls=[[5, 0, 5, 3], [5, 4.2, 5, 8], [0, 4, 3.8, 4], [6.2, 4, 10, 4]],
)


def clearances(states: Array) -> Array:
    return PLAN.ranges(states, np.linspace(0, 2 * np.pi, 720, endpoint=False)).min(-1)


def replayed(drive: Drive) -> Array:
    """The states by the controls alone."""
    states = [drive.states[0]]
    for control in drive.controls:
        states.append(Odometry(SPACE).mean(states[-1], control))
    return np.stack(states)


def test_waypoints_are_met_along_straight_legs() -> None:
    """A square clockwise from the origin: north, east, south; 0.5 m steps, quarter turns in two steps."""
    drive = waypoint_drive([[0, 0], [0, 2], [2, 2], [2, 0]], step=0.5)
    assert len(drive.controls) == 12 + 2
    np.testing.assert_allclose(replayed(drive), drive.states, atol=1e-12)
    np.testing.assert_allclose(drive.states[3], [0, 1.5, 0], atol=1e-12)
    np.testing.assert_allclose(drive.states[4], [0, 2, np.pi / 4], atol=1e-12)
    np.testing.assert_allclose(drive.states[5], [0, 2, np.pi / 2], atol=1e-12)
    np.testing.assert_allclose(drive.states[6], [0.5, 2, np.pi / 2], atol=1e-12)
    np.testing.assert_allclose(drive.states[-1, :2], [2, 0], atol=1e-12)


@pytest.mark.parametrize("step", [0.3, 0.7, 5.0])
@pytest.mark.parametrize("turn", [0.1, 1.0, 4.0])
def test_steps_and_turns_keep_their_limits(step: float, turn: float) -> None:
    points = np.random.default_rng(0).uniform(0, 10, (12, 2))
    drive = waypoint_drive(points, step, turn)
    assert (drive.controls[:, 0] <= step + 1e-12).all()
    assert (np.abs(drive.controls[:, 2]) <= turn + 1e-12).all()
    assert (drive.controls[:, 1] == 0).all()
    away = np.hypot(*(drive.states[:, None, :2] - points).transpose(2, 0, 1)).min(0)
    np.testing.assert_allclose(away, 0, atol=1e-9)  # every waypoint is passed


@pytest.mark.parametrize("seed", range(5))
def test_random_drives_keep_clear_of_walls(seed: int) -> None:
    """200 steps round thin walls, doors and a pillar: 0.8 of the clearance kept, no step through a wall."""
    drive = random_drive(PLAN, 200, 0.2, np.random.default_rng(seed), clearance=0.4)
    assert drive.states.shape == (201, 3)
    assert drive.controls.shape == (200, 3)
    np.testing.assert_allclose(replayed(drive), drive.states, atol=1e-9)
    assert in_line_of_sight(PLAN, drive.states[:-1, :2], drive.states[1:, :2]).all()
    assert clearances(drive.states).min() > 0.8 * 0.4
    np.testing.assert_array_equal(
        random_drive(PLAN, 200, 0.2, np.random.default_rng(seed), clearance=0.4).states, drive.states
    )


def test_random_drives_get_everywhere() -> None:
    """2000 steps visit all four rooms, and start where they are told to."""
    drive = random_drive(PLAN, 2000, 0.3, np.random.default_rng(1), start=[1.0, 1.0])
    assert np.hypot(*(drive.states[0, :2] - 1.0)) < 0.12
    rooms = (drive.states[:, 0] > 5) + 2 * (drive.states[:, 1] > 4)
    assert set(rooms.tolist()) == {0, 1, 2, 3}


@dataclass(frozen=True)
class Tabled:
    """A room with a table in the middle that beams pass over: not free, but no wall."""

    room: RectangularRoom

    @property
    def bounds(self) -> tuple[Array, Array]:
        return self.room.bounds

    @property
    def segments(self) -> Array:
        return self.room.segments

    def ranges(self, poses: Array, bearings: Array) -> Array:
        return self.room.ranges(poses, bearings)

    def cast(self, poses: Array, bearings: Array) -> Hits:
        return self.room.cast(poses, bearings)

    def gradients(self, poses: Array, bearings: Array) -> Array:
        return self.room.gradients(poses, bearings)

    def is_free(self, points: Array) -> np.ndarray:
        return self.room.is_free(points) & (np.abs(np.asarray(points) - 3.0).max(-1) > 0.8)


def test_random_drives_keep_clear_of_what_beams_pass_over() -> None:
    drive = random_drive(Tabled(RectangularRoom(6.0, 6.0)), 500, 0.2, np.random.default_rng(2), clearance=0.3)
    assert np.abs(drive.states[:, :2] - 3.0).max(-1).min() > 0.8 + 0.8 * 0.3 / np.sqrt(2)


def test_truths_stay_in_free_space_and_follow_the_drive() -> None:
    """120 runs of 60 steps, own streams: free, no wall crossed, and as far off as dead reckoning says.

    The first step's covariance is the model's within 5 standard errors: fails for fewer than 1 seed in 10^5.
    """
    drive = random_drive(PLAN, 60, 0.3, np.random.default_rng(3), clearance=0.4)
    motion = Confined(Odometry(SPACE, ALPHAS, floor=[0.01, 0.01, 0.005]), PLAN, SPACE)
    starts = np.tile(drive.states[0], (120, 1))
    truths = follow(motion, starts, drive.controls, streams(4, "motion", range(120)))
    assert truths.shape == (120, 61, 3)
    assert PLAN.is_free(truths[..., :2]).all()
    assert in_line_of_sight(PLAN, truths[:, :-1, :2], truths[:, 1:, :2]).all()
    error = SPACE.difference(truths[:, 1], drive.states[1])
    covariance = motion.noise_covariance(drive.states[0], drive.controls[0])
    stds = np.sqrt(np.diagonal(covariance))
    band = np.sqrt((np.outer(stds, stds) ** 2 + covariance**2) / 120)
    assert (np.abs(error.T @ error / 120 - covariance) < 5 * band).all()


def test_a_run_depends_on_its_stream_alone() -> None:
    """Run 7 alone equals run 7 among 20, bit for bit, and stepping by motion.sample by hand."""
    drive = random_drive(PLAN, 30, 0.3, np.random.default_rng(5))
    motion = Confined(Odometry(SPACE, ALPHAS, floor=0.05), PLAN, SPACE)
    starts = np.tile(drive.states[0], (20, 1))
    among = follow(motion, starts, drive.controls, streams(6, "motion", range(20)))
    alone = follow(motion, starts[:1], drive.controls, streams(6, "motion", [7]))
    np.testing.assert_array_equal(among[7], alone[0])
    (rng,) = streams(6, "motion", [7])
    state = starts[:1]
    for step, control in enumerate(drive.controls, start=1):
        state = motion.sample(state, control, rng)
        np.testing.assert_array_equal(among[7, step], state[0])


def test_controls_by_run() -> None:
    drive = waypoint_drive([[1, 1], [1, 3]], 0.5)
    both = np.stack([drive.controls, 0 * drive.controls])
    truths = follow(Odometry(SPACE), np.tile(drive.states[0], (2, 1)), both, streams(0, "motion", range(2)))
    np.testing.assert_allclose(truths[0], drive.states, atol=1e-12)
    np.testing.assert_allclose(truths[1], np.tile(drive.states[0], (5, 1)))
    still = follow(Stationary(SPACE), truths[:, -1], np.zeros((3, 0)), streams(0, "motion", range(2)))
    assert still.shape == (2, 4, 3)


def test_normalising_each_start_is_right_and_normalising_once_is_not() -> None:
    """A walk of std 0.5 m between walls 2 m apart, begun at 0.3 m, 6 steps, 20 000 truths.

    Chi-square over 20 bins against the law by matrix products on 400 cells: p > 1e-4 where each starting
    state is normalised, as `Confined` does; the walk cut off at the walls and normalised once over all
    states, as by a filter that drops what leaves the room, is refuted with p < 1e-12.
    """
    room, space = RectangularRoom(2.0, 1.0), position_space()
    motion = Confined(RandomWalk(space, [0.5, 0.0]), room, space)
    starts = np.tile([0.3025, 0.5], (20_000, 1))
    rng = np.random.default_rng(9)
    for _ in range(6):
        starts = motion.sample(starts, np.zeros(0), rng)
    counts = np.histogram(starts[:, 0], bins=20, range=(0, 2))[0]
    centres = (np.arange(400) + 0.5) * 0.005
    kernel = stats.norm.pdf(centres[:, None] - centres, scale=0.5)
    pvalues = {}
    for how in ("each start", "once"):
        weights = np.zeros(400)
        weights[60] = 1.0
        moves = kernel / kernel.sum(1, keepdims=True) if how == "each start" else kernel
        for _ in range(6):
            weights = weights @ moves
            weights /= weights.sum()
        pvalues[how] = stats.chisquare(counts, 20_000 * weights.reshape(20, 20).sum(1)).pvalue
    assert pvalues["each start"] > 1e-4
    assert pvalues["once"] < 1e-12


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: waypoint_drive([[0, 0]], 0.5), "two waypoints or more"),
        (lambda: waypoint_drive([[0, 0], [0, 0]], 0.5), "waypoint 2 is where the one before"),
        (lambda: waypoint_drive([[0, 0], [0, 1]], 0.0), "must be positive"),
        (lambda: waypoint_drive([[1, 1], [1, 7]], 0.5, room=PLAN), "way to waypoint 2 is not in free space"),
        (lambda: waypoint_drive([[7.5, 1.5], [9, 1.5]], 0.5, room=PLAN), "way to waypoint 1 is not"),
        (lambda: random_drive(PLAN, 0, 0.1, np.random.default_rng(0)), "must be positive"),
        (
            lambda: random_drive(PLAN, 9, 0.1, np.random.default_rng(0), clearance=5),
            "take a smaller clearance",
        ),
        (lambda: random_drive(PLAN, 9, 0.1, np.random.default_rng(0), clearance=1e-3), "take a larger one"),
        (lambda: random_drive(PLAN, 9, 0.1, np.random.default_rng(0), start=[5, 1]), "does not keep clear"),
    ],
)
def test_bad_drives_are_refused(make: object, match: str) -> None:
    with pytest.raises(ValueError, match=match):
        make()  # type: ignore[operator]


@pytest.mark.study
def test_a_matched_filter_is_consistent_along_a_drive_and_others_are_not() -> None:
    """80 runs of 5 steps among walls, 1500 particles: NEES / n - 1 is zero within 4 standard errors + 5 %.

    The 5 % is for the finite number of particles. A filter with a hundredth of the motion's variance claims
    too little and is found out by 20 of the runs. The matched one fails for fewer than 1 seed in 10^4.
    """
    runs = 80
    drive = random_drive(PLAN, 5, 0.3, np.random.default_rng(3), clearance=0.3)
    sensor = Rangefinder(PLAN, np.linspace(-2, 2, 6), StudentT(0.1, 4.0), SPACE, max_range=4.0)
    prior = GaussianPrior(drive.states[0], np.diag([0.04, 0.04, 0.01]), SPACE, PLAN)
    motion, careless = (
        Confined(Odometry(SPACE, ALPHAS, floor=scale * np.array([0.1, 0.1, 0.05])), PLAN, SPACE)
        for scale in (1.0, 0.1)
    )
    starts = np.concatenate([prior.sample(1, rng) for rng in streams(7, "truth", range(runs))])
    truths = follow(motion, starts, drive.controls, streams(7, "motion", range(runs)))
    noise = streams(7, "measurement", range(runs))
    readings = np.stack([sensor.sample(*each) for each in zip(truths, noise, strict=True)])
    excess = {}
    for name, assumed, judged in (("matched", motion, runs), ("careless", careless, 20)):
        estimator = build("particle", Problem(SPACE, assumed, sensor, prior), particles=1500)
        rngs = streams(7, "estimator", range(judged))
        belief = estimator.init(prior, rngs)
        for step, control in enumerate(drive.controls, start=1):
            reading = readings[:judged, step]
            belief = estimator.update(estimator.predict(belief, control, rngs), reading, rngs)
        estimate = estimator.estimate(belief)
        error = SPACE.difference(truths[:judged, -1], estimate.mean)
        nees = np.einsum("mi,mij,mj->m", error, np.linalg.inv(estimate.covariance), error)
        excess[name] = nees / 3 - 1
    matched = excess["matched"]
    assert abs(matched.mean()) < 4 * matched.std() / np.sqrt(runs) + 0.05
    assert excess["careless"].mean() > 1.0
