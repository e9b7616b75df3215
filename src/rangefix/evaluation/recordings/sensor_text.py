"""A fitted noise as sections of a study file, with what was fitted to and intervals as comments."""

from __future__ import annotations

import numpy as np

from .calibrate import Calibration

DIGITS = 6
AT_BEST_POSES = [
    "# Those err, so each scan was moved to the pose that fits it best. Errors of the map that look like",
    "# another pose are not seen: a scan may be worth less than is said.",
]


def sensor_text(calibration: Calibration, map_name: str, log_name: str) -> str:
    """[sensor] with the errors that readings share, and [assumed.sensor] with readings that weigh less.

    Args:
        calibration: What was fitted.
        map_name, log_name: What it was fitted to, for the comments.

    Returns:
        TOML that stands in a study as it is.
    """
    fitted, sensor = calibration.fitted, calibration.residuals.sensor
    scans, beams = calibration.residuals.readings.shape
    poses = "the given true poses" if calibration.residuals.from_truth else "poses that a filter followed"
    odd = calibration.residuals.warning, calibration.warning, calibration.residuals.reach, calibration.uneven
    lines = [
        *(f"# {text}" for text in odd if text),
        f"# Fitted by rangefix calibrate to {scans} scans of {_plain(log_name)}",
        f"# on the map {_plain(map_name)}, at {poses}.",
        *([] if calibration.residuals.from_truth else AT_BEST_POSES),
        f"# A scan of {beams} beams is worth {calibration.independent_beams:.1f} independent ones.",
        "# Intervals of 95 %:",
        *(
            f"#   {name} {fitted.figures()[name]:.4g}, {low:.4g} to {high:.4g}"
            for name, (low, high) in calibration.intervals.items()
        ),
        "",
        "[sensor]",
        f"bearings_deg = [{', '.join(f'{angle:.6g}' for angle in np.rad2deg(sensor.bearings))}]",
    ]
    if np.isfinite(sensor.max_range):
        lines.append(f"max_range_m = {sensor.max_range:.6g}")
    if sensor.min_range:
        lines.append(f"min_range_m = {sensor.min_range:.6g}")
    for key, value in (("forward_m", sensor.mount.forward), ("left_m", sensor.mount.left)):
        lines += [f"{key} = {value:.6g}"] * bool(value)
    lines += [f"yaw_deg = {np.rad2deg(sensor.mount.yaw):.6g}"] * bool(sensor.mount.yaw)
    errors = fitted.correlated
    shares = [_rounded_down(share) for share in (errors.scan, *(place.share for place in errors.places))]
    places = ", ".join(
        f"{{ share = {share:.{DIGITS}f}, length_m = {place.length:g} }}"
        for share, place in zip(shares[1:], errors.places, strict=True)
    )
    noise = _noise_lines(calibration)
    lines += ["", "[sensor.noise]", *noise]
    lines.append(f"correlation = {{ scan = {shares[0]:.{DIGITS}f}, places = [{places}] }}")
    lines += ["", "[assumed.sensor.noise]", *noise, f"weight = {fitted.weight:.4f}"]
    return "\n".join(lines) + "\n"


def _rounded_down(share: float) -> float:
    """A share as it is written: shares that sum to one must not sum to more."""
    return float(np.floor(share * 10**DIGITS) / 10**DIGITS)


def _noise_lines(calibration: Calibration) -> list[str]:
    fitted = calibration.fitted
    mixture = fitted.mixture
    short, random = round(mixture.short, DIGITS), round(mixture.random, DIGITS)
    return [
        'kind = "beam-mixture"',
        f"hit = {1 - short - random:.6f}",
        f"short = {short:.6f}",
        "max = 0.0",
        f"random = {random:.6f}",
        f"std_m = {mixture.std:.6f}",
        f"rate_per_m = {mixture.rate:.6f}",
        f"max_range_m = {mixture.max_range:.6g}",
        f"bias_m = {fitted.bias:.6f}",
        f"lost = {fitted.law.probability:.6f}",
    ]


def _plain(name: str) -> str:
    """A name that a comment can hold."""
    return "".join(letter if letter.isprintable() else "?" for letter in name)
