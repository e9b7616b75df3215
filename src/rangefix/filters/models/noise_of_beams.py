"""The noise of some beams of a rangefinder."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np

from ...arrays import IntArray
from ..problem import Noise


def noise_of_beams(noise: Noise, kept: int | IntArray, total: int) -> Any:
    """The noise of one beam, or of several, of a rangefinder with so many; itself if beams are alike.

    Parameters with a number for each beam keep those of these beams. Of a noise that is no dataclass the
    parameters are not known: it is taken to be the same for all beams.

    Args:
        noise: Of all beams.
        kept: Their numbers, from 0: one, or (K,).
        total: How many beams the noise is for.
    """
    if not is_dataclass(noise) or isinstance(noise, type):
        return noise
    own: dict[str, Any] = {}
    for parameter in fields(noise):
        if not parameter.init:
            continue
        value = getattr(noise, parameter.name)
        if is_dataclass(value):
            inner = noise_of_beams(value, kept, total)
            if inner is not value:
                own[parameter.name] = inner
        elif np.shape(value) == (total,) and (total > 1 or np.ndim(kept) == 0):
            own[parameter.name] = np.asarray(value)[kept]
    return replace(noise, **own) if own else noise
