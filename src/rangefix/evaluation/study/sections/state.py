"""The state of a study, and its truths."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from ....arrays import Array, wrap
from ....filters import StateSpace
from .base import Angle, Misfit, Point, Section, refuse


class StateSection(Section):
    """What is estimated: x1 and x2; the heading where it is not known; velocities where asked for."""

    heading: Literal["known", "unknown"] = Field(
        default="known", description='"unknown": it is estimated, from what [prior] says of it'
    )
    heading_deg: Angle = Field(
        default=0.0,
        description='the known heading, clockwise from +x2; an unknown one: heading = "unknown", '
        "and heading_deg in [prior]",
    )
    velocities: bool = Field(default=False, description="whether v1 and v2 are estimated too")

    @model_validator(mode="after")
    def _one_way(self) -> StateSection:
        if self.heading == "unknown" and "heading_deg" in self.model_fields_set:
            raise Misfit(
                "heading_deg", "is for a known heading; what is known of an unknown one stands in [prior]"
            )
        return self

    def build(self) -> StateSpace:
        """The state space."""
        names = ["x1", "x2"]
        names += ["heading"] if self.heading == "unknown" else []
        names += ["v1", "v2"] if self.velocities else []
        known = None if self.heading == "unknown" else float(np.deg2rad(self.heading_deg))
        return StateSpace(tuple(names), heading=known)


class TruthSection(Section):
    """Where the object truly is at first: drawn from the prior for each run, or at one place."""

    draw: Literal["prior"] = Field(default="prior", alias="from")
    at_m: Point | None = None
    heading_deg: Angle | None = None
    velocity_m_per_s: Point | None = None

    @model_validator(mode="after")
    def _one_way(self) -> TruthSection:
        if self.at_m is not None and "draw" in self.model_fields_set:
            raise Misfit("from", "is for truths that are drawn: leave it out, or at_m")
        if self.at_m is None and (self.heading_deg is not None or self.velocity_m_per_s is not None):
            raise ValueError("a true heading or velocity needs a place: give at_m too")
        return self

    def start(self, space: StateSpace) -> Array | None:
        """The true first state, if it is the same for all runs.

        Raises:
            Misfit: If a component of the state is missing here, or the other way round.
        """
        if self.at_m is None:
            return None
        state = dict(zip(("x1", "x2"), self.at_m, strict=True))
        if self.heading_deg is not None:
            state["heading"] = float(wrap(np.deg2rad(self.heading_deg)))
        if self.velocity_m_per_s is not None:
            state |= dict(zip(("v1", "v2"), self.velocity_m_per_s, strict=True))
        misfits = []
        for key, name in (("heading_deg", "heading"), ("velocity_m_per_s", "v1")):
            if name in space.names and name not in state:
                misfits.append(Misfit(key, f"is missing: the {key.partition('_')[0]} is part of the state"))
            if name in state and name not in space.names:
                text = f"the {key.partition('_')[0]} is no part of the state: see [state]"
                misfits.append(Misfit(key, text))
        refuse(misfits)
        return np.array([state[name] for name in space.names])
