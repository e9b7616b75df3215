"""Small recordings that tests make, and the real ones beside the checkout."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rangefix.arrays import Array
from rangefix.filters import Gaussian, Mount, Rangefinder, pose_space
from rangefix.maps import FloorPlan

ROOM = FloorPlan([[0, 0], [6, 0], [6, 4], [3, 4], [3, 5], [0, 5]], walls=[[2.0, 0.0, 2.0, 1.5]])
ROOM_TOML = "outer = [[0, 0], [6, 0], [6, 4], [3, 4], [3, 5], [0, 5]]\nwalls = [[2.0, 0.0, 2.0, 1.5]]\n"
ANGLES = np.deg2rad(np.arange(-120.0, 121.0, 6.0))  # counter-clockwise, as ROS counts
MOUNT = Mount(forward=0.2, left=-0.1, yaw=0.3)


def drive(scans: int = 40) -> tuple[Array, Array]:
    """Times and true poses of a robot that goes round in the room."""
    turn = np.linspace(0.0, 1.5 * np.pi, scans)
    x1, x2 = 3.0 + 1.6 * np.sin(turn), 2.6 - 1.0 * np.cos(turn)
    heading = np.arctan2(np.gradient(x1), np.gradient(x2))
    return 100.0 + 0.1 * np.arange(scans), np.column_stack([x1, x2, heading])


def ranges_at(poses: Array, std: float = 0.01, mount: Mount = MOUNT, seed: int = 0) -> Array:
    """What the laser reads there, in the order of ANGLES, (T, B), m."""
    sensor = Rangefinder(ROOM, -ANGLES, Gaussian(max(std, 1e-6)), pose_space(), mount=mount)
    return sensor.sample(poses, np.random.default_rng(seed))


def in_ros(poses: Array) -> Array:
    """The same poses as x, y, yaw, counter-clockwise from +x."""
    return np.column_stack([poses[:, 0], poses[:, 1], 0.5 * np.pi - poses[:, 2]])


class Bag:
    """Writes a bag: ROS 1, or ROS 2 as db3 or mcap."""

    def __init__(self, path: Path, kind: str) -> None:
        rosbags = pytest.importorskip("rosbags.typesys", reason="no rosbags: pip install rangefix[logs]")
        self.is_old = kind == "bag"
        store = rosbags.Stores.ROS1_NOETIC if self.is_old else rosbags.Stores.ROS2_HUMBLE
        self.store = rosbags.get_typestore(store)
        if self.is_old:  # which comes with every bag that has some
            text = "geometry_msgs/TransformStamped[] transforms"
            self.store.register(rosbags.get_types_from_msg(text, "tf2_msgs/msg/TFMessage"))
        if self.is_old:
            from rosbags.rosbag1 import Writer

            self.writer: Any = Writer(path)
        else:
            from rosbags.rosbag2 import StoragePlugin
            from rosbags.rosbag2 import Writer as Writer2

            plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
            self.writer = Writer2(path, version=8, storage_plugin=plugin)
        self.writer.open()
        self.connections: dict[str, Any] = {}

    def header(self, time: float, frame: str) -> Any:
        seconds = round(time * 1e9)
        stamp = self.store.types["builtin_interfaces/msg/Time"](*divmod(seconds, 10**9))
        header = self.store.types["std_msgs/msg/Header"]
        return header(0, stamp, frame) if self.is_old else header(stamp, frame)

    def write(self, topic: str, time: float, message: Any) -> None:
        kind = message.__msgtype__
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        encode = self.store.serialize_ros1 if self.is_old else self.store.serialize_cdr
        self.writer.write(self.connections[topic], round(time * 1e9), encode(message, kind))

    def scan(self, time: float, ranges: Array, recorded: float | None = None, **told: Any) -> None:
        values = {
            "angle_min": float(ANGLES[0]),
            "angle_max": float(ANGLES[-1]),
            "angle_increment": float(ANGLES[1] - ANGLES[0]),
            "time_increment": 0.0,
            "scan_time": 0.0,
            "range_min": 0.05,
            "range_max": 12.0,
        } | told
        frame = values.pop("frame", "laser")
        message = self.store.types["sensor_msgs/msg/LaserScan"](
            self.header(time, frame),
            *values.values(),
            np.asarray(ranges, np.float32),
            np.zeros(0, np.float32),
        )
        self.write("/scan", time if recorded is None else recorded, message)

    def pose(self, pose: Sequence[float]) -> Any:
        types, (x, y, yaw) = self.store.types, (float(value) for value in pose)
        turn = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2))
        return types["geometry_msgs/msg/Pose"](types["geometry_msgs/msg/Point"](x, y, 0.0), turn)

    def odometry(
        self, time: float, pose: Sequence[float], topic: str = "/odom", recorded: float | None = None
    ) -> None:
        types, zero = self.store.types, np.zeros(36)
        still = types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
        twist = types["geometry_msgs/msg/TwistWithCovariance"](
            types["geometry_msgs/msg/Twist"](still, still), zero
        )
        place = types["geometry_msgs/msg/PoseWithCovariance"](self.pose(pose), zero)
        message = types["nav_msgs/msg/Odometry"](self.header(time, "odom"), "base_link", place, twist)
        self.write(topic, time if recorded is None else recorded, message)

    def transform(
        self, time: float, parent: str, child: str, pose: Sequence[float], static: bool, roll: float = 0.0
    ) -> None:
        types, (x, y, yaw) = self.store.types, (float(value) for value in pose)
        sr, cr, sy, cy = np.sin(roll / 2), np.cos(roll / 2), np.sin(yaw / 2), np.cos(yaw / 2)
        turn = types["geometry_msgs/msg/Quaternion"](cy * sr, sy * sr, sy * cr, cy * cr)
        moved = types["geometry_msgs/msg/Transform"](types["geometry_msgs/msg/Vector3"](x, y, 0.3), turn)
        one = types["geometry_msgs/msg/TransformStamped"](self.header(time, parent), child, moved)
        self.write("/tf_static" if static else "/tf", time, types["tf2_msgs/msg/TFMessage"]([one]))

    def close(self) -> None:
        self.writer.close()


@pytest.fixture
def new_bag() -> Callable[[Path, str], Bag]:
    return Bag


def write_carmen(path: Path, times: Array, poses: Array, ranges: Array, kind: str = "FLASER") -> None:
    """A log of CARMEN of scans over 180 deg, 181 beams; the laser where MOUNT says."""
    lines = ["# a comment"]
    laser = in_ros(MOUNT.laser_poses(poses))
    for time, robot, where, scan in zip(times, in_ros(poses), laser, ranges, strict=True):
        places = " ".join(f"{value:.6f}" for value in [*where, *robot])
        readings = f"{len(scan)} " + " ".join(f"{value:.3f}" for value in scan)
        if kind == "FLASER":
            lines.append(f"FLASER {readings} {places} {time:.6f} host {time - times[0]:.6f}")
        else:
            head = f"0 {-np.pi / 2:.7f} {np.pi:.7f} {np.pi / 180:.9f} 30.0 0.01 0"
            lines.append(
                f"ROBOTLASER1 {head} {readings} 0 {places} 0 0 0 0 0 {time:.6f} host {time - times[0]:.6f}"
            )
    path.write_text("\n".join(lines) + "\n")


def data(name: str) -> Path:
    """A real recording; a test that needs it is skipped where it is not there, saying so."""
    root = Path(os.environ.get("RANGEFIX_DATA", Path(__file__).parents[4] / "shared" / "data"))
    path = root / name
    if not path.exists():
        pytest.skip(f"needs {path}")
    return path
