"""What an estimator believes of a recording, as files that other software reads: TUM, CSV, bags of ROS."""

from __future__ import annotations

import csv
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import IO, Any

import numpy as np

from ...arrays import Array
from ...filters import StateSpace
from .log import RecordingError, heading_of
from .readers.rosbag_file import MISSING
from .readers.tum import tum_line
from .replay import Believed

BAGS = ("bag", "db3", "mcap")
FRAME = "map"
LAST_S = 2**31 - 1  # of a stamp of ROS
COLUMNS = (
    "scan", "time_s", "x1_m", "x2_m", "heading_deg",
    "cov_x1_x1_m2", "cov_x1_x2_m2", "cov_x1_heading_m_rad", "cov_x2_x2_m2", "cov_x2_heading_m_rad",
    "cov_heading_heading_rad2", "log_evidence", "true_x1_m", "true_x2_m", "true_heading_deg",
    "error_x1_m", "error_x2_m", "error_heading_deg", "nees", "residual_median_m", "seconds",
    "misfit", "misfit_threshold",
)  # fmt: skip


class PoseFiles:
    """The files of one estimator, written as it goes. Errors are truth minus estimate, as in studies.

    Args:
        folder: Where they are written.
        name: How they are called, without suffix.
        space: Of the states.
        bag: Kind of bag besides: "bag" (ROS 1), "db3" or "mcap" (ROS 2); None = none.
    """

    def __init__(self, folder: Path, name: str, space: StateSpace, bag: str | None = None) -> None:
        self._folder, self._name, self._space, self._kind = folder, name, space, bag
        self._stack = ExitStack()
        self._tum: IO[str]
        self._rows: Any
        self._bag: BagWriter | None = None

    def __enter__(self) -> PoseFiles:
        with self._stack:
            open_ = self._stack.enter_context
            self._tum = open_(open(self._folder / f"{self._name}.tum", "w", encoding="utf-8"))
            table = open_(open(self._folder / f"{self._name}.csv", "w", encoding="utf-8", newline=""))
            self._rows = csv.writer(table, lineterminator="\n")
            self._rows.writerow(COLUMNS)
            if self._kind:
                self._bag = BagWriter(self._folder / self._name, self._kind, self._stack)
            self._stack = self._stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def write(self, believed: Believed) -> None:
        """A pose with its covariance."""
        time, mean, covariance = believed.step.time_s, believed.mean, believed.covariance
        self._tum.write(tum_line(time, mean))
        self._rows.writerow(self._row(believed))
        if self._bag is not None:
            self._bag.write(time, mean, covariance)

    def _row(self, believed: Believed) -> list[str]:
        mean, covariance = believed.mean, believed.covariance
        values = [
            mean[0], mean[1], np.rad2deg(mean[2]),
            covariance[0, 0], covariance[0, 1], covariance[0, 2], covariance[1, 1], covariance[1, 2],
            covariance[2, 2], believed.log_evidence,
        ]  # fmt: skip
        values += self._errors(believed)
        seen = believed.residuals[np.isfinite(believed.residuals)]
        values += [np.median(seen) if len(seen) else np.nan, believed.seconds]
        fit = believed.fit
        values += [np.nan, np.nan] if fit is None or not fit.readings else [fit.misfit, fit.threshold]
        when = f"{believed.step.time_s:.9f}"  # seconds of today's clocks have ten digits before the point
        cells = [f"{value:.10g}" if value == value else "" for value in values]
        return [str(believed.step.scan), when, *cells]

    def _errors(self, believed: Believed) -> list[float]:
        """Truth (m, m, deg), error x - x^ (m, m, deg) and NEES, (7,); NaN where the truth is not known."""
        from ..consistency.scores import CorrelationAxes

        if believed.truth is None:
            return [np.nan] * 7
        error = self._space.difference(believed.truth, believed.mean)
        ratio = float(CorrelationAxes.of(believed.covariance).nees(error))
        truth = believed.truth
        return [
            truth[0], truth[1], np.rad2deg(truth[2]), error[0], error[1], np.rad2deg(error[2]), ratio
        ]  # fmt: skip


class BagWriter:
    """PoseWithCovarianceStamped messages of one topic, /NAME, in a bag.

    Args:
        path: Without suffix.
        kind: "bag", "db3" or "mcap".
        stack: What closes it.
    """

    def __init__(self, path: Path, kind: str, stack: ExitStack) -> None:
        try:
            from rosbags.typesys import Stores, get_typestore
        except ModuleNotFoundError:
            raise RecordingError(MISSING) from None
        self._is_old = kind == "bag"
        self._store = get_typestore(Stores.ROS1_NOETIC if self._is_old else Stores.ROS2_HUMBLE)
        self._bag: Any
        if self._is_old:
            from rosbags.rosbag1 import Writer

            self._bag = stack.enter_context(Writer(path.with_name(f"{path.name}.bag")))
        else:
            from rosbags.rosbag2 import StoragePlugin
            from rosbags.rosbag2 import Writer as Writer2

            plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
            folder = path.with_name(f"{path.name}_{kind}")
            self._bag = stack.enter_context(Writer2(folder, version=8, storage_plugin=plugin))
        topic = f"/{path.name.replace('-', '_')}"
        self._type = "geometry_msgs/msg/PoseWithCovarianceStamped"
        self._connection = self._bag.add_connection(topic, self._type, typestore=self._store)
        self._number = 0

    def write(self, time_s: float, pose: Array, covariance: Array) -> None:
        """A pose x1, x2 (m), heading (rad) with its covariance, in the conventions of ROS.

        Raises:
            RecordingError: If no stamp of ROS holds its time.
        """
        if not 0 <= time_s < LAST_S:
            raise RecordingError(
                f"a bag (--bag) has stamps from 0 to {LAST_S} s, and a scan is at {time_s:.10g} s: "
                "are the recording's times in seconds?"
            )
        types = self._store.types
        yaw = heading_of(float(pose[2]))
        nanoseconds = round(time_s * 1e9)
        stamp = types["builtin_interfaces/msg/Time"](*divmod(nanoseconds, 10**9))
        header = types["std_msgs/msg/Header"]
        head = header(self._number, stamp, FRAME) if self._is_old else header(stamp, FRAME)
        point = types["geometry_msgs/msg/Point"](float(pose[0]), float(pose[1]), 0.0)
        turn = types["geometry_msgs/msg/Quaternion"](
            0.0, 0.0, float(np.sin(0.5 * yaw)), float(np.cos(0.5 * yaw))
        )
        body = types["geometry_msgs/msg/PoseWithCovariance"](
            types["geometry_msgs/msg/Pose"](point, turn), in_ros(covariance).ravel()
        )
        message = types[self._type](head, body)
        encode = self._store.serialize_ros1 if self._is_old else self._store.serialize_cdr
        self._bag.write(self._connection, nanoseconds, encode(message, self._type))
        self._number += 1


def in_ros(covariance: Array) -> Array:
    """A covariance of x1, x2, heading as that of x, y, z and turns about them, (3, 3) -> (6, 6).

    The yaw of ROS grows to the left, the heading to the right: their covariances have the other sign.
    """
    sign = np.array([1.0, 1.0, -1.0])
    full = np.zeros((6, 6))
    full[np.ix_([0, 1, 5], [0, 1, 5])] = covariance * sign[:, None] * sign
    return full
