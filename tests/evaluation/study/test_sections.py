"""What studies say of headings, motion, noise, priors and assumptions: built as said, or refused."""

from __future__ import annotations

import re

import numpy as np
import pytest

from rangefix.evaluation import StudyError, parse_study
from rangefix.filters import (
    BeamMixture,
    Confined,
    ConstantVelocity,
    Gaussian,
    GaussianPrior,
    Mixture,
    Odometry,
    Quantised,
    RandomWalk,
    RangeProportional,
    Stationary,
    StudentT,
    Uniform,
    WithHeading,
    WithVelocity,
)

ROOM = '[map]\nkind = "rectangle"\nwidth_m = 4.0\nlength_m = 6.0\n'
SENSOR = "[sensor]\nbearings_deg = [0, 90, 180, 270]\nstd_m = 0.05\n"
UNKNOWN = '[state]\nheading = "unknown"\n'
ODOMETRY = '[motion]\nkind = "odometry"\nsteps = 5\nfloor_m = [0.02, 0.01]\nfloor_deg = 3.0\n'
EKF = '[[estimators]]\nname = "ekf"\n'


def study(*parts: str):
    text = "".join(parts)
    base = (("[map]", ROOM), ("[sensor]", SENSOR), ("[[estimators]]", EKF))
    return parse_study(text + "".join(rest for head, rest in base if head not in text), source="s.toml")


def mistakes(*parts: str) -> list[str]:
    with pytest.raises(StudyError) as caught:
        study(*parts)
    return caught.value.mistakes


def noise(text: str) -> str:
    return f"[sensor]\nbearings_deg = [0, 90, 180, 270]\n[sensor.noise]\n{text}\n"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('kind = "gaussian"\nstd_m = [1, 2, 3, 4]', Gaussian([1, 2, 3, 4])),
        ('kind = "range-proportional"\nstd_m = 0.03\ngrowth = 0.01', RangeProportional(0.03, 0.01)),
        ('kind = "student-t"\nscale_m = 0.05\ndof = 3', StudentT(0.05, 3)),
        ('kind = "student-t"\nscale_m = 0.05\ndof = 3\nstep_m = 0.01', Quantised(StudentT(0.05, 3), 0.01)),
        (
            'kind = "beam-mixture"\nhit = 0.8\nshort = 0.1\nmax = 0.05\nrandom = 0.05\nstd_m = 0.05\n'
            "rate_per_m = 2.0\nmax_range_m = 9.0",
            BeamMixture(0.8, 0.1, 0.05, 0.05, std=0.05, rate=2.0, max_range=9.0),
        ),
    ],
)
def test_noise(text, expected):
    assert study(noise(text)).experiment().truth.sensor.noise == expected


def test_limits_of_the_sensor():
    limited = SENSOR + "min_range_m = 0.2\nmax_range_m = 5.0\nmax_incidence_deg = 80.0\n"
    sensor = study(limited).experiment().truth.sensor
    assert sensor.min_range == 0.2
    assert (sensor.max_range, sensor.max_incidence) == (5.0, pytest.approx(np.deg2rad(80)))
    told = study(limited, "[assumed.sensor]\nmax_range_m = inf\n").experiment().assumed_problem.sensor
    assert (told.max_range, told.max_incidence) == (np.inf, pytest.approx(np.deg2rad(80)))


def test_an_outdated_map():
    """The truth has a cupboard; the filters' map has none, for an outline told anew inherits no holes."""
    outline = "outer_m = [[0, 0], [4, 0], [4, 6], [0, 6]]\n"
    plan = f'[map]\nkind = "floor-plan"\n{outline}holes_m = [[[0.5, 2], [1, 2], [1, 4], [0.5, 4]]]\n'
    experiment = study(plan, SENSOR, f"[assumed.map]\n{outline}").experiment()
    place = np.array([[0.75, 3.0]])
    assert not experiment.truth.sensor.room.is_free(place)[0]
    assert experiment.assumed_problem.sensor.room.is_free(place)[0]
    assert experiment.assumed_problem.prior.log_density(place)[0] > -np.inf
    assert mistakes(SENSOR, "[assumed.map]\nwidth_m = -1\n")[0].count("assumed.map.width_m") == 1


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        (UNKNOWN, Uniform),
        (UNKNOWN + "[prior]\nheading_deg = 40\nheading_std_deg = 5\n", WithHeading),
        (UNKNOWN + '[prior]\nkind = "gaussian"\nmean_m = [2, 3]\nstd_m = 0.5\n', WithHeading),
        (
            UNKNOWN
            + '[prior]\nkind = "gaussian"\nmean_m = [2, 3]\nstd_m = 0.5\n'
            + "heading_deg = 9\nheading_std_deg = 5\n",
            GaussianPrior,
        ),
        ("[state]\nvelocities = true\n[prior]\nvelocity_std_m_per_s = [0.3, 0.2]\n", WithVelocity),
        (
            "[prior]\nkind = 'mixture'\nweights = [1, 3]\n[[prior.parts]]\nkind = 'uniform'\n"
            "[[prior.parts]]\nkind = 'gaussian'\nmean_m = [1, 1]\nstd_m = 0.1\n",
            Mixture,
        ),
    ],
)
def test_priors(text, kind):
    problem = study(text).experiment().truth
    assert isinstance(problem.prior, kind)
    states = problem.prior.sample(500, np.random.default_rng(0))
    assert np.isfinite(problem.prior.log_density(states)).all()
    away = problem.space.difference(states, problem.prior.mean)
    linear = ~problem.space.is_angle
    error = away[:, linear].mean(0) / np.sqrt(np.diagonal(problem.prior.covariance)[linear] / 500)
    assert (np.abs(error) < 5).all()


def test_arcs_run_clockwise():
    """From 350 to 10 deg is 20 deg wide, through north."""
    prior = study(UNKNOWN + "[prior]\nheading_deg = [350, 10]\n").experiment().truth.prior
    states = prior.sample(300, np.random.default_rng(0))
    assert np.abs(np.rad2deg(states[:, 2])).max() < 10
    assert prior.mean[2] == pytest.approx(0, abs=1e-9)


def test_motions():
    assert study("[motion]\nsteps = 3\n").experiment().steps == 4
    assert isinstance(study("[motion]\nsteps = 3\n").experiment().truth.motion, Stationary)
    walk = study(UNKNOWN, '[motion]\nkind = "random-walk"\nsteps = 2\nstd_m = 0.1\nheading_std_deg = 9\n')
    motion = walk.experiment().truth.motion
    assert isinstance(motion, Confined)
    assert isinstance(motion.motion, RandomWalk)
    assert motion.motion.stds == pytest.approx([0.1, 0.1, np.deg2rad(9)])
    free = "[state]\nvelocities = true\n[prior]\nvelocity_std_m_per_s = 0.3\n[motion]\nconfined = false\n"
    speed = study(free, 'kind = "constant-velocity"\nsteps = 2\nstep_s = 0.5\nintensity_m2_per_s3 = 0.01\n')
    assert isinstance(speed.experiment().truth.motion, ConstantVelocity)


def test_a_drive_begins_where_the_prior_is():
    prior = '[prior]\nkind = "gaussian"\nstd_m = 0.1\nheading_std_deg = 5\n'
    described = study(UNKNOWN, ODOMETRY, prior)
    world, made = described.world(), described.experiment()
    assert made.steps == 6
    assert world.drive is not None
    assert made.truth.prior.peak == pytest.approx(world.drive.states[0])
    np.testing.assert_array_equal(made.control_sequence, world.drive.controls)
    again = study(UNKNOWN, ODOMETRY, prior).experiment()
    np.testing.assert_array_equal(made.control_sequence, again.control_sequence)
    other = study(UNKNOWN, ODOMETRY + "drive_seed = 2\n", prior).experiment()
    assert (made.control_sequence != other.control_sequence).any()
    motion = made.truth.motion.motion
    assert isinstance(motion, Odometry)
    assert motion.floors == pytest.approx([0.02, 0.01, np.deg2rad(3)])


def test_ways_can_be_cut_short():
    way = '[motion]\nkind = "odometry"\nwaypoints_m = [[1, 1], [1, 4]]\nstep_m = 0.5\n'
    assert study(UNKNOWN, way).experiment().steps == 7
    assert study(UNKNOWN, way, "steps = 2\n").experiment().steps == 3
    (found,) = mistakes(UNKNOWN, way, "steps = 9\n")
    assert re.match(r"s\.toml:\d+: motion\.steps: the way along waypoints_m has 6 steps", found)


def test_assumptions_inherit_what_is_not_said():
    text = (
        noise('kind = "student-t"\nscale_m = 0.05\ndof = 3')
        + UNKNOWN
        + ODOMETRY
        + '[prior]\nkind = "gaussian"\nstd_m = 0.1\nheading_std_deg = 5\n'
        + "[assumed.sensor]\nstd_m = 0.07\n[assumed.motion]\nfloor_deg = 1.0\nconfined = false\n"
        + "[assumed.prior]\nstd_m = 0.2\n"
    )
    made = study(text).experiment()
    true, told = made.truth, made.assumed_problem
    assert (true.sensor.noise, told.sensor.noise) == (StudentT(0.05, 3), Gaussian(0.07))
    np.testing.assert_array_equal(true.sensor.bearings, told.sensor.bearings)
    assert told.motion.floors == pytest.approx([0.02, 0.01, np.deg2rad(1)])
    assert told.prior.peak == pytest.approx(true.prior.peak)
    assert told.prior.root[0, 0] == pytest.approx(0.2)
    assert study(text.partition("[assumed")[0]).experiment().assumed is None


def test_assumptions_of_another_kind():
    """Another kind takes over what both kinds have, and nothing else."""
    told = (
        study(
            UNKNOWN,
            '[motion]\nkind = "random-walk"\nsteps = 3\nstd_m = 0.1\ntries = 4\n',
            '[assumed.motion]\nkind = "stationary"\n',
            '[prior]\nkind = "gaussian"\nmean_m = [2, 3]\nstd_m = 0.1\nheading_std_deg = 5\n',
            '[assumed.prior]\nkind = "uniform"\n',
        )
        .experiment()
        .assumed_problem
    )
    assert isinstance(told.motion, Stationary)
    assert isinstance(told.prior, WithHeading)
    offset = study("[state]\nheading_deg = 2\n[assumed.state]\nheading_deg = 0\n").experiment()
    assert offset.truth.space.heading == pytest.approx(np.deg2rad(2))
    assert offset.assumed_problem.space.heading == 0.0


def test_a_true_pose_for_all_runs():
    made = study(UNKNOWN, "[truth]\nat_m = [1, 2]\nheading_deg = 400\n").experiment()
    assert np.asarray(made.start) == pytest.approx([1, 2, np.deg2rad(40)])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (UNKNOWN + "heading_deg = 3\n", r"2: state\.heading_deg|state\.heading_deg: is for a known heading"),
        ('[state]\nheading = "maybe"\n', r"state\.heading: must be 'known' or 'unknown'"),
        ("[state]\nheading_deg = [1, 2]\n", r"state\.heading_deg: must be a number.*\[prior\]"),
        ("[state]\nvelocities = 1\n", r"state\.velocities: must be true or false"),
        (
            "[prior]\nheading_deg = [1, 2]\n",
            r'prior\.heading_deg: is for an unknown heading: write heading = "',
        ),
        ("[prior]\nvelocity_std_m_per_s = 1\n", r"prior\.velocity_std_m_per_s: is for velocities"),
        ("[state]\nvelocities = true\n", r"prior\.velocity_std_m_per_s: is missing"),
        (UNKNOWN + "[prior]\nheading_deg = 3\n", r"prior\.heading_deg: as one number needs heading_std_deg"),
        (UNKNOWN + "[prior]\nheading_deg = [3, 3]\n", r"prior\.heading_deg: is empty or more than a turn"),
        (UNKNOWN + "[prior]\nheading_deg = [3, 400]\n", r"prior\.heading_deg: is empty or more than a turn"),
        (UNKNOWN + "[prior]\nheading_deg = [360, 0]\n", r"prior\.heading_deg: is empty or more than a turn"),
        ('[prior]\nkind = "gaussian"\nstd_m = 1\n', r"prior\.mean_m: is missing: for example"),
        ('[prior]\nkind = "gaussian"\nmean_m = [1, 1]\n', r"prior\.std_m: is missing \(standard deviation"),
        (
            '[prior]\nkind = "gausian"\n',
            r"prior\.kind: no kind 'gausian'; there are uniform, gaussian, squared-cosine, mixture",
        ),
        ('[prior]\nkind = "gaussian"\nmean_m = [9, 9]\nstd_m = 0.1\n', r"prior: only 0 of the prior"),
        (
            "[prior]\nkind = 'mixture'\n[[prior.parts]]\nkind = 'box'\n",
            r"prior\.parts\[1\]: no kind 'box'; there",
        ),
        (
            "[prior]\nkind = 'mixture'\n[[prior.parts]]\nkind = 'gaussian'\nstd_m = 1\n",
            r"prior\.parts\[1\]\.mean_m: is missing",
        ),
        (
            "[prior]\nkind = 'mixture'\n[[prior.parts]]\nkind = 'gaussian'\nstd_n = 1\nmean_m = [1, 1]\n",
            r"prior\.parts\[1\]\.std_n: unknown key; did you mean std_m\?",
        ),
        (
            "[prior]\nkind = 'mixture'\nweights = [1, 1]\n[[prior.parts]]\nkind = 'uniform'\n",
            "2 numbers for 1 p",
        ),
        (noise('kind = "student-t"\nscale_m = 0.05'), r"sensor\.noise\.dof: is missing \(degrees of freedom"),
        (
            noise('kind = "student"\nscale_m = 0.05'),
            r"sensor\.noise: no kind 'student'; there are gaussian, range",
        ),
        (noise("scale_m = 0.05"), r"sensor\.noise: needs a kind, one of gaussian"),
        (
            noise('kind = "student-t"\nscale_m = 0.05\ndof = 3\ndofs = 2'),
            r"sensor\.noise\.dofs: .*mean dof\?",
        ),
        (noise('kind = "gaussian"\nstd_m = [1, 2]'), r"sensor.noise.std_m: has 2 numbers for 4 beams"),
        (noise('kind = "gaussian"\nstd_m = [1, -2, 3, 4]'), r"noise\.std_m\[2\]: must be greater than 0"),
        (
            noise(
                'kind = "beam-mixture"\nhit = 0.8\nshort = 0.1\nmax = 0\nrandom = 0\n'
                + "std_m = 1\nmax_range_m = 9"
            ),
            r"sensor\.noise: hit, short, max and random must sum to one, and sum to 0\.9",
        ),
        (SENSOR + "max_range_m = 0\n", r"sensor\.max_range_m: must be greater than 0"),
        (
            SENSOR + "min_range_m = 3\nmax_range_m = 2\n",
            r"sensor\.min_range_m: must be below max_range_m = 2",
        ),
        (SENSOR.replace("0.05", "1e-160"), r"sensor\.std_m: a spread must be from 1e-06 m"),
        (SENSOR + "max_incidence_deg = 91\n", r"sensor\.max_incidence_deg: must be at most 90"),
        (SENSOR + 'noise = { kind = "gaussian", std_m = 1 }\n', r"sensor\.noise: stands instead of std_m"),
        ('[motion]\nkind = "odometry"\nsteps = 3\n', r'motion\.kind: odometry needs .* heading = "unknown"'),
        (UNKNOWN + '[motion]\nkind = "odometry"\n', r"motion\.steps: is missing: for example steps = 50"),
        (UNKNOWN + ODOMETRY + "alphas = [1, 2]\n", r"motion\.alphas: needs at least 4"),
        (UNKNOWN + ODOMETRY + "clearance_m = 3\n", r"motion: no place is 3\.0 m from all walls"),
        (
            UNKNOWN + ODOMETRY + "waypoints_m = [[1, 1], [2, 9]]\n",
            r"motion: the way to waypoint 2 is not in free",
        ),
        (
            UNKNOWN + ODOMETRY + "waypoints_m = [[1, 1], [2, 2]]\nstart_m = [1, 1]\n",
            r"motion\.start_m: is for a",
        ),
        ('[motion]\nkind = "random-walk"\nsteps = 3\n', r"motion\.std_m: is missing"),
        (
            '[motion]\nkind = "random-walk"\nsteps = 3\nstd_m = 1\nheading_std_deg = 1\n',
            r"heading_std_deg: needs",
        ),
        (
            '[motion]\nkind = "constant-velocity"\nsteps = 3\nstep_s = 1\nintensity_m2_per_s3 = 1\n',
            r"motion\.kind: constant velocity needs velocities = true",
        ),
        ("[truth]\nheading_deg = 3\n", "truth: a true heading or velocity needs a place"),
        (
            "[truth]\nat_m = [1, 1]\nheading_deg = 3\n",
            r"truth\.heading_deg: the heading is no part of the state",
        ),
        (
            UNKNOWN + "[truth]\nat_m = [1, 1]\n",
            r"truth\.heading_deg: is missing: the heading is part of the state",
        ),
        (
            UNKNOWN + "[truth]\nat_m = [1, 1]\nheading_deg = 90\n[prior]\nheading_deg = [0, 10]\n",
            r"truth\.at_m: .* gives this state no probability",
        ),
        ("[assumed.sensor]\nstd_m = -1\n", r"assumed\.sensor\.std_m: must be greater than 0"),
        (
            "[assumed.sensor]\nbearings_deg = [1]\n",
            r"sensor: must have as many beams as \[sensor\], 4, not 1",
        ),
        ("[assumed.sensr]\nstd_m = 1\n", r"assumed\.sensr: unknown key; did you mean sensor\?"),
        ("[assumed]\nsensor = 1\n", r"assumed\.sensor: must be a table \[assumed\.sensor\]"),
        ("assumed = 1\n", r"assumed: must be tables"),
        (
            UNKNOWN + ODOMETRY + "[assumed.motion]\nsteps = 3\n",
            r"assumed\.motion\.steps: the drive is that of",
        ),
        (
            UNKNOWN + '[assumed.motion]\nkind = "odometry"\n',
            r"assumed\.motion\.steps: is missing|assumed\.motion\.kind: odometry needs controls",
        ),
        (
            '[assumed.state]\nheading = "unknown"\n',
            r"assumed\.state: must have the same components as \[state\]",
        ),
    ],
)
def test_one_mistake(text, words):
    (found,) = mistakes(text)
    assert re.search(words, found)
    assert re.match(r"s\.toml(:\d+)?: ", found)
    assert "\n" not in found


def test_mistakes_of_the_true_sections_are_told_once():
    """One in [sensor] is not told again for [assumed.sensor], which inherits it."""
    text = "[sensor]\nbearings_deg = []\nmax_range_m = 0\nstd_m = 1\n[assumed.sensor]\nstd_m = -2\n"
    keys = [line.split(": ")[1] for line in mistakes(text)]
    assert keys == ["sensor.bearings_deg", "sensor.max_range_m", "assumed.sensor.std_m"]


def test_many_mistakes_at_once():
    text = (
        noise('kind = "student-t"\ndof = 0')
        + UNKNOWN
        + "[motion]\nkind = 'odometry'\nsteps = 0\nstep_m = 0\n"
    )
    text += "[prior]\nkind = 'gaussian'\n[assumed.prior]\nstd_m = -1\n"
    keys = {line.split(": ")[1] for line in mistakes(text)}
    assert keys == {
        "sensor.noise.scale_m",
        "sensor.noise.dof",
        "motion.steps",
        "motion.step_m",
        "prior.std_m",
        "assumed.prior.std_m",
    }
