"""What a study file says of where the object may be before any measurement."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from ....arrays import Array
from ....filters import (
    GaussianPrior,
    Mixture,
    RangeMap,
    SquaredCosine,
    StateSpace,
    Uniform,
    pose_space,
    position_space,
)
from ....filters.models.product_prior import WithHeading, WithVelocity
from ....filters.problem import SpacedPrior
from ....raster import Raster
from .base import AboveZero, Angle, Misfit, Point, Positive, PositiveAngleSpread, Section, misfits_of, refuse

Pair = Annotated[list[Positive], Field(min_length=2, max_length=2)]
MOST_CELLS = 20_000_000  # to look for the place of a box
LATTICE = 40  # steps along the shorter side of a box that looks for its place


class PriorSection(Section):
    """What all kinds say of an unknown heading and of velocities."""

    heading_deg: Angle | Annotated[list[Angle], Field(min_length=2, max_length=2)] | None = Field(
        default=None,
        description="mean of the heading, with heading_std_deg; or the ends of the arc that it lies in, "
        "clockwise, for example heading_deg = [350, 10]; without it any heading",
    )
    heading_std_deg: PositiveAngleSpread | None = Field(
        default=None, description="standard deviation of the heading about heading_deg"
    )
    velocity_m_per_s: Point | None = Field(default=None, description="mean velocity along x1 and x2")
    velocity_std_m_per_s: Positive | Pair | None = Field(
        default=None, description="standard deviation of the velocities, for example 0.5"
    )

    @model_validator(mode="after")
    def _heading(self) -> PriorSection:
        if isinstance(self.heading_deg, list):
            if self.heading_std_deg is not None:
                raise Misfit("heading_std_deg", "needs one number for heading_deg, not the ends of an arc")
            low, high = self.heading_deg
            if high in (low, low - 360) or abs(high - low) > 360:
                raise Misfit("heading_deg", "is empty or more than a turn: leave it out for any heading")
        elif self.heading_deg is not None and self.heading_std_deg is None:
            raise Misfit(
                "heading_deg",
                "as one number needs heading_std_deg; a heading known for certain stands in [state]",
            )
        return self

    def place(self, room: RangeMap, space: StateSpace, start: Array | None) -> SpacedPrior:
        """The prior of x1 and x2 alone."""
        raise NotImplementedError

    def with_heading(self, room: RangeMap, start: Array | None) -> SpacedPrior:
        """The prior of x1, x2 and an unknown heading that does not depend on them."""
        place = self.place(room, position_space(), start)
        if self.heading_std_deg is None:
            return WithHeading(place, pose_space(), arc=self.arc())
        spread = float(np.deg2rad(self.heading_std_deg))
        return WithHeading(place, pose_space(), mean=self.mean_heading(start), std=spread)

    def build(self, room: RangeMap, space: StateSpace, start: Array | None = None) -> SpacedPrior:
        """The prior on a map.

        Args:
            room: The map.
            space: The state space.
            start: Where a drive begins, x1, x2 (m) and heading (rad), (3,).

        Raises:
            Misfit: If a key does not fit the state space, or one is missing.
            ValueError: If the prior is not sound.
        """
        unknown, moving = "heading" in space.names, "v1" in space.names
        told = [key for key, value in self if value is not None]
        headings = [key for key in told if key.startswith("heading") and not unknown]
        velocities = [key for key in told if key.startswith("velocity") and not moving]
        refuse(
            [
                Misfit(key, 'is for an unknown heading: write heading = "unknown" in [state]')
                for key in headings
            ]
            + [Misfit(key, "is for velocities: write velocities = true in [state]") for key in velocities]
        )
        if unknown:
            prior = self.with_heading(room, start)
        else:
            prior = self.place(room, position_space(space.heading or 0.0), start)
        if not moving:
            return prior
        if self.velocity_std_m_per_s is None:
            raise Misfit("velocity_std_m_per_s", "is missing: for example velocity_std_m_per_s = 0.5")
        return WithVelocity(prior, space, self.velocity_std_m_per_s, self.velocity_m_per_s or (0.0, 0.0))

    def mean_heading(self, start: Array | None) -> float:
        """Mean of a Gaussian heading, rad; a drive's own unless it is given."""
        if isinstance(self.heading_deg, float | int):
            return float(np.deg2rad(self.heading_deg))
        return 0.0 if start is None else float(start[2])

    def arc(self) -> tuple[float, float] | None:
        """Ends of the arc, rad, low < high; None for the whole circle."""
        if not isinstance(self.heading_deg, list):
            return None
        low, high = self.heading_deg
        return float(np.deg2rad(low)), float(np.deg2rad(high if high > low else high + 360.0))


def _refuse_one_corner(lower: list[float] | None, upper: list[float] | None) -> None:
    if (lower is None) != (upper is None):
        raise ValueError("give both corners of the box, lower_m and upper_m, or neither")


class UniformPrior(PriorSection):
    """Uniform over free space: of the whole map, of a box, or of a box of a size where most space is free."""

    alternatives: ClassVar = (frozenset({"lower_m", "upper_m", "size_m"}),)
    kind: Literal["uniform"] = "uniform"
    lower_m: Point | None = Field(default=None, description="lower corner of the box")
    upper_m: Point | None = Field(default=None, description="upper corner of the box")
    size_m: Annotated[list[AboveZero], Field(min_length=2, max_length=2)] | None = Field(
        default=None, description="size of a box where most space is free, for example size_m = [10.0, 10.0]"
    )

    @model_validator(mode="after")
    def _one_way(self) -> UniformPrior:
        _refuse_one_corner(self.lower_m, self.upper_m)
        if self.size_m is not None and self.lower_m is not None:
            raise ValueError("give either the corners lower_m and upper_m, or size_m, not both")
        return self

    def place(self, room: RangeMap, space: StateSpace, start: Array | None) -> Uniform:
        """The prior of x1 and x2 alone."""
        return Uniform(room, space, *self._box(room))

    def with_heading(self, room: RangeMap, start: Array | None) -> SpacedPrior:
        """The prior of x1, x2 and an unknown heading."""
        if self.heading_std_deg is not None:
            return super().with_heading(room, start)
        return Uniform(room, pose_space(), *self._box(room), headings=self.arc())

    def _box(self, room: RangeMap) -> tuple[ArrayLike | None, ArrayLike | None]:
        if self.size_m is not None:
            return box_with_most_free_space(room, np.array(self.size_m))
        return self.lower_m, self.upper_m


class SquaredCosinePrior(PriorSection):
    """Falls smoothly to nothing at the ends of a box of free space: the square of half a cosine wave."""

    alternatives: ClassVar = (frozenset({"lower_m", "upper_m"}),)
    kind: Literal["squared-cosine"]
    lower_m: Point | None = Field(default=None, description="lower corner of the box; the map's unless given")
    upper_m: Point | None = Field(default=None, description="upper corner of the box; the map's unless given")

    @model_validator(mode="after")
    def _both(self) -> SquaredCosinePrior:
        _refuse_one_corner(self.lower_m, self.upper_m)
        return self

    def place(self, room: RangeMap, space: StateSpace, start: Array | None) -> SquaredCosine:
        """The prior of x1 and x2 alone."""
        return SquaredCosine(room, space, self.lower_m, self.upper_m)


class CentredPrior(PriorSection):
    """Gaussian about a place, cut off at walls; about the start of a drive unless the place is given."""

    kind: Literal["gaussian"]
    mean_m: Point | None = Field(
        default=None, description="the place, for example mean_m = [2.0, 3.0]; a drive's start unless given"
    )
    std_m: Positive | Pair = Field(
        description="standard deviation along x1 and x2, for example std_m = 0.5 or [0.5, 0.2]"
    )

    def place(self, room: RangeMap, space: StateSpace, start: Array | None) -> GaussianPrior:
        """The prior of x1 and x2 alone."""
        return GaussianPrior(self._mean(start), np.diag(self._stds() ** 2), space, room)

    def with_heading(self, room: RangeMap, start: Array | None) -> SpacedPrior:
        """The prior of x1, x2 and an unknown heading."""
        if self.heading_std_deg is None:
            return super().with_heading(room, start)
        mean = np.append(self._mean(start), self.mean_heading(start))
        stds = np.append(self._stds(), np.deg2rad(self.heading_std_deg))
        return GaussianPrior(mean, np.diag(stds**2), pose_space(), room)

    def _mean(self, start: Array | None) -> Array:
        if self.mean_m is None and start is None:
            raise Misfit("mean_m", "is missing: for example mean_m = [2.0, 3.0]")
        return np.array(self.mean_m if self.mean_m is not None or start is None else start[:2], dtype=float)

    def _stds(self) -> Array:
        return np.broadcast_to(np.array(self.std_m, dtype=float), (2,))


AnySinglePrior = UniformPrior | CentredPrior | SquaredCosinePrior


class MixturePrior(Section):
    """One of several priors, by chance."""

    alternatives: ClassVar = (frozenset({"parts", "weights"}),)
    kind: Literal["mixture"]
    parts: Annotated[
        list[Annotated[AnySinglePrior, Field(discriminator="kind")]],
        Field(min_length=1),
    ] = Field(description='tables [[prior.parts]], each with, for example, kind = "uniform"')
    weights: list[Positive] | None = Field(
        default=None,
        description="a weight for each part, for example weights = [0.7, 0.3]; equal unless given",
    )

    @model_validator(mode="after")
    def _as_many(self) -> MixturePrior:
        if self.weights is not None and len(self.weights) != len(self.parts):
            raise ValueError(f"weights has {len(self.weights)} numbers for {len(self.parts)} parts")
        return self

    def build(self, room: RangeMap, space: StateSpace, start: Array | None = None) -> Mixture:
        """The prior on a map; a part's mistakes name the part."""
        priors, misfits = [], []
        for place, part in enumerate(self.parts):
            try:
                priors.append(part.build(room, space, start))
            except ValueError as error:
                misfits += misfits_of(error, ("parts", place))
        refuse(misfits)
        return Mixture(priors, self.weights)


AnyPrior = Annotated[AnySinglePrior | MixturePrior, Field(discriminator="kind")]


def box_with_most_free_space(room: RangeMap, size: Array) -> tuple[Array, Array]:
    """Lower and upper corner of the box of a size that holds the most free space; the first of equals."""
    lower, upper = (np.asarray(corner, dtype=float) for corner in room.bounds)
    size = np.minimum(size, upper - lower)
    step = float(size.min()) / LATTICE
    with np.errstate(over="ignore"):  # more than can be counted are too many
        sizes = np.maximum(1, np.floor((upper - lower) / step * (1 + 1e-9)))
        cells = float(sizes.prod())
    if cells > MOST_CELLS:
        raise Misfit(
            "size_m", f"is too small or thin to be looked for in a map of this size: {cells:.0e} cells"
        )
    counts = sizes.astype(int)
    free = room.is_free(Raster(lower, step, tuple(counts.tolist())).centres)
    sums = np.pad(free.astype(np.int64).cumsum(0).cumsum(1), ((1, 0), (1, 0)))
    wide, high = np.clip(np.round(size / step).astype(int), 1, counts)
    inside = sums[wide:, high:] - sums[:-wide, high:] - sums[wide:, :-high] + sums[:-wide, :-high]
    corner = lower + step * np.array(np.unravel_index(int(inside.argmax()), inside.shape))
    return corner, corner + size
