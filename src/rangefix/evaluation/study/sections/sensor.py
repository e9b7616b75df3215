"""What a study file says of the rangefinder: its beams, its limits and how its readings scatter."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from ....arrays import Array
from ....filters import Mount, Noise, Rangefinder, RangeMap, StateSpace, sweep
from ....filters.models.beam_noise import BeamMixture, Quantised
from ....filters.models.correlated import Correlated, PlaceError
from ....filters.models.noise import CumulativeNoise, Gaussian, RangeProportional, StudentT, check_spread
from ....filters.models.wrapped_noise import LARGEST_BIAS_M, Biased, LostBeams, Tempered
from .base import Angle, Misfit, NotNegative, Positive, Section, refuse

MOST_BEAMS = 100_000


def _in_limits(spread: float) -> float:
    check_spread("a spread", spread)
    return spread


Spread = Annotated[float, Field(gt=0), AfterValidator(_in_limits)]
PerBeam = Spread | Annotated[list[Spread], Field(min_length=1)]
Offset = Annotated[float, Field(ge=-100, le=100)]
Share = Annotated[float, Field(ge=0, le=1)]
Correlation = Annotated[float, Field(ge=0, lt=1)]


class PlaceErrorSection(Section):
    """An error of the map: the same whenever a beam meets the same place."""

    share: Share = Field(description="of a reading's variance, for example share = 0.5")
    length_m: Positive = Field(
        description="distance at which its correlation has fallen to 1 / e, for example length_m = 1.0"
    )


class CorrelationSection(Section):
    """Errors that readings share, as shares of a reading's variance; the rest is its own."""

    beams: Share = Field(
        default=0.0, description="share that hangs together along the scan, for example beams = 0.5"
    )
    along: Correlation = Field(
        default=0.0,
        description="correlation of that share between neighbouring beams, for example along = 0.8",
    )
    over_time: Correlation = Field(
        default=0.0,
        description="correlation of that share between consecutive scans, for example over_time = 0.9",
    )
    scan: Share = Field(
        default=0.0, description="share that is one error of a whole scan, for example scan = 0.1"
    )
    places: list[PlaceErrorSection] = Field(
        default_factory=list,
        description="errors of the map, for example places = [{ share = 0.5, length_m = 1.0 }]",
    )

    @model_validator(mode="after")
    def _shares(self) -> CorrelationSection:
        total = self.beams + self.scan + sum(place.share for place in self.places)
        if total > 1 + 1e-9:
            raise ValueError(
                f"the shares beams, scan and of places must sum to at most one, and sum to {total:g}"
            )
        if (self.along or self.over_time) and not self.beams:
            raise Misfit(
                "beams", "is the share that along and over_time are about: give it, for example beams = 0.5"
            )
        return self

    def build(self, noise: CumulativeNoise) -> Correlated:
        """Readings of a noise with these errors."""
        places = tuple(PlaceError(place.share, place.length_m) for place in self.places)
        return Correlated(noise, self.beams, self.along, self.over_time, self.scan, places)


class NoiseSection(Section):
    """How readings scatter; each kind has its own keys.

    Attributes:
        makes: The noise, of the values of the keys of a kind in their order.
    """

    makes: ClassVar[Callable[..., CumulativeNoise]]
    step_m: Positive | None = Field(
        default=None, description="readings are rounded to multiples of it, for example step_m = 0.01"
    )
    bias_m: float = Field(
        default=0.0,
        ge=-LARGEST_BIAS_M,
        le=LARGEST_BIAS_M,
        description="by how much readings are too long, as by thick walls, for example bias_m = 0.04",
    )
    lost: Annotated[float, Field(ge=0, lt=1)] = Field(
        default=0.0,
        description="share of beams that never return, whatever they meet, for example lost = 0.03",
    )
    correlation: CorrelationSection | None = Field(
        default=None, description="errors that readings share, for example correlation = { scan = 0.1 }"
    )
    weight: Annotated[float, Field(gt=0, le=1)] = Field(
        default=1.0,
        description="share of an independent reading that each counts for, for example weight = 0.1",
    )

    def build(self) -> Noise:
        """The noise."""
        own = (value for key, value in self if key != "kind" and key not in NoiseSection.model_fields)
        noise = self.makes(*own)
        noise = Biased(noise, self.bias_m) if self.bias_m else noise
        noise = Quantised(noise, self.step_m) if self.step_m is not None else noise
        noise = LostBeams(noise, self.lost) if self.lost else noise
        noise = self.correlation.build(noise) if self.correlation else noise
        return Tempered(noise, self.weight) if self.weight < 1 else noise


class GaussianNoise(NoiseSection):
    """The same spread at all ranges."""

    makes: ClassVar = Gaussian
    kind: Literal["gaussian"] = "gaussian"
    std_m: PerBeam = Field(description="standard deviation, one or one per beam, for example std_m = 0.05")


class ProportionalNoise(NoiseSection):
    """A spread that grows with the range."""

    makes: ClassVar = RangeProportional
    kind: Literal["range-proportional"]
    std_m: PerBeam = Field(description="standard deviation at range 0, for example std_m = 0.03")
    growth: NotNegative | list[NotNegative] = Field(
        description="its growth in metres per metre of range, for example growth = 0.01"
    )


class StudentNoise(NoiseSection):
    """Now and then far off: Student's t."""

    makes: ClassVar = StudentT
    kind: Literal["student-t"]
    scale_m: PerBeam = Field(description="scale, one or one per beam, for example scale_m = 0.05")
    dof: Positive = Field(description="degrees of freedom: few make heavy tails, for example dof = 3.0")


class MixtureNoise(NoiseSection):
    """Hits, short readings, no returns and random readings; the four shares sum to one."""

    makes: ClassVar = BeamMixture
    kind: Literal["beam-mixture"]
    hit: Share = Field(description="share of readings of the wall, for example hit = 0.85")
    short: Share = Field(description="share of readings of what stands before it, for example short = 0.05")
    max: Share = Field(description="share of beams that do not return, for example max = 0.05")
    random: Share = Field(description="share of readings of anything, for example random = 0.05")
    std_m: Spread = Field(description="standard deviation of hits, for example std_m = 0.05")
    rate_per_m: Positive = Field(
        default=1.0, description="rate of short readings, for example rate_per_m = 1.0"
    )
    max_range_m: Positive = Field(description="longest reading, for example max_range_m = 12.0")

    @model_validator(mode="after")
    def _whole(self) -> MixtureNoise:
        total = self.hit + self.short + self.max + self.random
        if abs(total - 1) > 1e-9:
            raise ValueError(f"hit, short, max and random must sum to one, and sum to {total:g}")
        return self


AnyNoise = Annotated[
    GaussianNoise | ProportionalNoise | StudentNoise | MixtureNoise, Field(discriminator="kind")
]


class SensorSection(Section):
    """A rangefinder: its beams, clockwise from straight ahead, and its noise."""

    alternatives: ClassVar = (frozenset({"std_m", "noise"}), frozenset({"bearings_deg", "resolution_deg"}))
    bearings_deg: Annotated[list[Angle], Field(min_length=1, max_length=MOST_BEAMS)] | None = None
    resolution_deg: Annotated[float, Field(gt=0, le=360)] | None = None
    blind_sector_deg: Annotated[float, Field(ge=0, lt=360)] = 0.0
    min_range_m: NotNegative = 0.0
    max_range_m: Annotated[float, Field(gt=0, allow_inf_nan=True)] = float("inf")
    max_incidence_deg: Annotated[float, Field(gt=0, le=90)] = 90.0
    forward_m: Offset = Field(
        default=0.0, description="how far the laser stands ahead of the point whose position is estimated"
    )
    left_m: Offset = Field(
        default=0.0, description="how far it stands to the left of it; negative = to the right"
    )
    yaw_deg: Annotated[float, Field(ge=-360, le=360)] = Field(
        default=0.0,
        description="how far it is turned to the left (counter-clockwise, as left_m and ROS count)",
    )
    std_m: PerBeam | None = Field(
        default=None,
        description="standard deviation of Gaussian noise, one or one per beam, for example std_m = 0.05",
    )
    noise: AnyNoise | None = Field(
        default=None, description='instead of std_m, for example noise = { kind = "gaussian", std_m = 0.05 }'
    )

    @model_validator(mode="after")
    def _one_way(self) -> SensorSection:
        if (self.bearings_deg is None) == (self.resolution_deg is None):
            raise ValueError("give either bearings_deg, for example [326.3, 0.0, 33.7], or resolution_deg")
        if self.resolution_deg is not None and self.resolution_deg < 360.0 / MOST_BEAMS:
            raise Misfit("resolution_deg", f"makes more than {MOST_BEAMS} beams, got {self.resolution_deg:g}")
        if self.std_m is None and self.noise is None:
            raise Misfit(
                "std_m",
                "is missing (standard deviation of Gaussian noise, for example std_m = 0.05); "
                "or write a table [sensor.noise] for another noise",
            )
        if self.std_m is not None and self.noise is not None:
            raise Misfit("noise", "stands instead of std_m: leave one of them out")
        if self.min_range_m >= self.max_range_m:
            raise Misfit("min_range_m", f"must be below max_range_m = {self.max_range_m:g}")
        beams = len(self.bearings)
        values: list[tuple[str, tuple[str, ...], object]] = [("std_m", (), self.std_m)]
        values += [("noise", (key,), value) for key, value in self.noise or ()]
        refuse(
            [
                Misfit(key, f"has {len(value)} numbers for {beams} beams: give one for each", *further)
                for key, further, value in values
                if isinstance(value, list) and len(value) != beams
            ]
        )
        return self

    @property
    def bearings(self) -> Array:
        """Bearings in rad, (B,)."""
        if self.resolution_deg is None:
            return np.asarray(np.deg2rad(self.bearings_deg or []))
        return sweep(np.deg2rad(self.resolution_deg), np.deg2rad(self.blind_sector_deg))

    def build_noise(self) -> Noise:
        """How readings scatter."""
        return self.noise.build() if self.noise else Gaussian(self.std_m or 0.0)

    def build(self, room: RangeMap, space: StateSpace) -> Rangefinder:
        """The rangefinder in a map."""
        return Rangefinder(
            room,
            self.bearings,
            self.build_noise(),
            space,
            blind_sector=float(np.deg2rad(self.blind_sector_deg)),
            min_range=self.min_range_m,
            max_range=self.max_range_m,
            max_incidence=float(np.deg2rad(self.max_incidence_deg)),
            mount=Mount(self.forward_m, self.left_m, float(np.deg2rad(self.yaw_deg))),
        )
