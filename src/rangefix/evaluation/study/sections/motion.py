"""What a study file says of motion: how the object moves, and along which drive."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from ....arrays import Array
from ....filters import Confined, Motion, Odometry, RangeMap, StateSpace
from ....filters.models.motion import ConstantVelocity, RandomWalk, Stationary
from .base import (
    AboveZero,
    AngleSpread,
    Misfit,
    NotNegative,
    Point,
    Positive,
    Section,
    WithExtensions,
    refuse,
)
from .drives import Drive, count_steps, random_drive, waypoint_drive

MOST_STEPS = 100_000
MoreThanNone = Annotated[int, Field(ge=1)]
StepCount = Annotated[int, Field(ge=1, le=MOST_STEPS)]
Steps = Annotated[StepCount, Field(description="moves, a measurement after each, for example steps = 20")]


class MotionSection(Section):
    """How the object moves; one measurement follows each step.

    Attributes:
        driven: Whether controls move it, so that it cannot be assumed where there are none.
    """

    fixed: ClassVar[frozenset[str]] = frozenset({"steps"})
    driven: ClassVar[bool] = False
    kind: str
    steps: int | None = None

    def build(self, room: RangeMap, space: StateSpace) -> Motion:
        """The motion in a map."""
        raise NotImplementedError

    def drive(self, room: RangeMap) -> Drive | None:
        """The drive, where there is one."""
        return None

    def controls(self, drive: Drive | None) -> Array | None:
        """Controls between the measurements, (T - 1, k); None where there is one measurement only."""
        return np.zeros((self.steps, 0)) if self.steps else None


class StationaryMotion(MotionSection):
    """The object stays where it is; `steps` are further measurements from there."""

    kind: Literal["stationary"] = "stationary"
    steps: Annotated[int, Field(ge=0, le=MOST_STEPS)] = 0

    def build(self, room: RangeMap, space: StateSpace) -> Motion:
        """The motion in a map."""
        return Stationary(space)


class WalledMotion(MotionSection):
    """A motion that walls stop, unless told otherwise."""

    confined: bool = Field(default=True, description="whether steps into or through walls are drawn again")
    tries: MoreThanNone = Field(default=10, description="most draws for a step; then the object stays")

    @model_validator(mode="after")
    def _tries_count(self) -> WalledMotion:
        if "tries" in self.model_fields_set and not self.confined:
            raise Misfit("tries", "has no effect with confined = false: no step is drawn again then")
        return self

    def build(self, room: RangeMap, space: StateSpace) -> Motion:
        """The motion in a map."""
        free = self.free(space)
        return Confined(free, room, space, self.tries) if self.confined else free

    def free(self, space: StateSpace) -> Motion:
        """The motion without walls."""
        raise NotImplementedError


class RandomWalkMotion(WalledMotion):
    """Independent Gaussian steps of every component."""

    kind: Literal["random-walk"]
    steps: Steps
    std_m: NotNegative | Annotated[list[NotNegative], Field(min_length=2, max_length=2)] = Field(
        description="standard deviation of a step along x1 and x2, for example std_m = 0.1"
    )
    heading_std_deg: AngleSpread = 0.0
    velocity_std_m_per_s: NotNegative = 0.0

    def free(self, space: StateSpace) -> RandomWalk:
        """The motion without walls."""
        along_x1, along_x2 = np.broadcast_to(self.std_m, (2,)).tolist()
        speed = self.velocity_std_m_per_s
        turn = float(np.deg2rad(self.heading_std_deg))
        stds = {"x1": along_x1, "x2": along_x2, "heading": turn, "v1": speed, "v2": speed}
        fixes = (
            ("heading_std_deg", "heading", 'heading = "unknown"'),
            ("velocity_std_m_per_s", "v1", "velocities = true"),
        )
        refuse(
            [
                Misfit(key, f"needs {fix} in [state]")
                for key, name, fix in fixes
                if stds[name] and name not in space.names
            ]
        )
        return RandomWalk(space, [stds[name] for name in space.names])


class ConstantVelocityMotion(WalledMotion):
    """Velocities that drift under white noise acceleration."""

    kind: Literal["constant-velocity"]
    steps: Steps
    step_s: Positive = Field(description="time between measurements, for example step_s = 0.5")
    intensity_m2_per_s3: NotNegative = Field(
        description="density of the acceleration's noise, for example intensity_m2_per_s3 = 0.01"
    )

    def free(self, space: StateSpace) -> ConstantVelocity:
        """The motion without walls."""
        if "v1" not in space.names:
            raise Misfit("kind", "constant velocity needs velocities = true in [state]")
        return ConstantVelocity(space, self.step_s, self.intensity_m2_per_s3)


class OdometryMotion(WalledMotion):
    """A drive by controls in the body frame, noisy with displacement and turn."""

    fixed: ClassVar[frozenset[str]] = frozenset(
        {"steps", "waypoints_m", "step_m", "turn_deg", "clearance_m", "start_m", "drive_seed"}
    )
    driven: ClassVar[bool] = True
    kind: Literal["odometry"]
    alphas: Annotated[list[NotNegative], Field(min_length=4, max_length=4)] = Field(
        default=[0.0, 0.0, 0.0, 0.0],
        description="a1, a2 (rad^2/m^2), a3, a4 (m^2/rad^2), for example [0.01, 0.002, 0.005, 0.001]",
    )
    floor_m: NotNegative | Annotated[list[NotNegative], Field(min_length=2, max_length=2)] = Field(
        default=0.0, description="noise of every step, forward and right, for example floor_m = 0.01"
    )
    floor_deg: AngleSpread = Field(default=0.0, description="noise of every step's turn")
    waypoints_m: Annotated[list[Point], Field(min_length=2)] | None = Field(
        default=None, description="points to pass, for example [[1, 1], [3, 1], [3, 5]]"
    )
    steps: StepCount | None = Field(
        default=None, description="moves, a measurement after each, for example steps = 50"
    )
    step_m: AboveZero = Field(default=0.3, description="longest step")
    turn_deg: Annotated[float, Field(gt=0, le=180)] = Field(
        default=45.0, description="largest turn in a step"
    )
    clearance_m: Positive = Field(default=0.3, description="distance that a random drive keeps from walls")
    start_m: Point | None = Field(default=None, description="where a random drive begins")
    drive_seed: Annotated[int, Field(ge=0)] = Field(default=1, description="seed of a random drive")

    @model_validator(mode="after")
    def _one_way(self) -> OdometryMotion:
        if self.waypoints_m is None and self.steps is None:
            raise Misfit(
                "steps", "is missing: for example steps = 50, for a random drive; or give waypoints_m"
            )
        random = self.model_fields_set & {"clearance_m", "start_m", "drive_seed"}
        if self.waypoints_m is not None and random:
            raise Misfit(min(random), "is for a random drive: leave it out, or waypoints_m")
        return self

    def free(self, space: StateSpace) -> Odometry:
        """The motion without walls."""
        if "heading" not in space.names:
            raise Misfit("kind", 'odometry needs an unknown heading: write heading = "unknown" in [state]')
        forward, right = np.broadcast_to(self.floor_m, (2,)).tolist()
        a1, a2, a3, a4 = self.alphas
        return Odometry(space, (a1, a2, a3, a4), floor=[forward, right, float(np.deg2rad(self.floor_deg))])

    def drive(self, room: RangeMap) -> Drive:
        """The drive, planned through free space."""
        turn = float(np.deg2rad(self.turn_deg))
        if self.waypoints_m is None:
            assert self.steps is not None
            rng = np.random.default_rng(self.drive_seed)
            return random_drive(
                room, self.steps, self.step_m, rng, self.clearance_m, turn, start=self.start_m
            )
        needed = count_steps(np.array(self.waypoints_m), self.step_m, turn)
        if not needed <= MOST_STEPS:
            key = (
                "turn_deg" if count_steps(np.array(self.waypoints_m), self.step_m) <= MOST_STEPS else "step_m"
            )
            raise Misfit(
                key, f"the way along waypoints_m takes {needed:g} such steps, more than {MOST_STEPS}"
            )
        drive = waypoint_drive(self.waypoints_m, self.step_m, turn, room)
        if self.steps is None:
            return drive
        if self.steps > len(drive.controls):
            raise Misfit(
                "steps", f"the way along waypoints_m has {len(drive.controls)} steps, fewer than that"
            )
        return Drive(drive.states[: self.steps + 1], drive.controls[: self.steps])

    def controls(self, drive: Drive | None) -> Array | None:
        """The drive's controls, (T - 1, 3)."""
        return None if drive is None else drive.controls


Ours = StationaryMotion | RandomWalkMotion | ConstantVelocityMotion | OdometryMotion
AnyMotion = Annotated[Ours, WithExtensions(MotionSection, Ours, "rangefix.motions")]
