"""Bags of ROS 1 and ROS 2 (db3, mcap): laser scans, odometry or tf, and the laser's place by tf."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import Any, NamedTuple

import numpy as np

from ....arrays import Array, wrap
from ..log import UNPLACED, LaserDescription, RecordingError, Scan, beyond, pose_from_ros
from .file_log import EMPTY, FileLog
from .rosbag_file import Messages, Topic, time_of
from .sweeps import onto_beams
from .track import Track
from .transforms import Rigid, Tree, rigid_of

SCANS = ("sensor_msgs/msg/LaserScan", "sensor_msgs/msg/MultiEchoLaserScan")
ODOMETRY = "nav_msgs/msg/Odometry"
POSES = (ODOMETRY, "geometry_msgs/msg/PoseWithCovarianceStamped", "geometry_msgs/msg/PoseStamped")
CLAIMED = POSES[:2]  # with covariances
PLANAR = [0, 1, 5]  # x, y and yaw among x, y, z and the turns about them
TRANSFORMS = "tf2_msgs/msg/TFMessage"
OLD_TRANSFORMS = "tf/msg/tfMessage"
BASES = ("base_footprint", "base_link", "base")
LOOKED_AT = 400  # messages of tf, for the frames that there are
MOST_STEPS_OFF = 1.5  # from the last beam to angle_max: some drivers count one beam more, or less
TILTED = np.cos(np.deg2rad(10.0))
NO_STAMP = "scans without a stamp (the time at which they were recorded is taken)"


class Source(NamedTuple):
    """Where odometry comes from: a topic with poses, or tf from one frame to another."""

    topic: Topic | None
    odom: str = ""
    base: str = ""


@dataclass(frozen=True)
class RosbagLog(FileLog):
    """A bag of ROS 1 (.bag) or ROS 2 (a folder, .db3 or .mcap).

    Attributes:
        path: The file, or the folder.
        options: Which topics and frames are meant, where there are several.
    """

    @cached_property
    def messages(self) -> Messages:
        """The messages of the bag."""
        return Messages(self.path)

    @cached_property
    def _scan_topic(self) -> Topic:
        return self._chosen(self.options.scan_topic, SCANS, "scans", "--scan-topic")

    def _chosen(self, name: str | None, types: tuple[str, ...], what: str, option: str) -> Topic:
        topics = [topic for topic in self.messages.topics if topic.type in types and topic.messages]
        if name is not None:
            for topic in topics:
                if topic.name == name:
                    return topic
        names = ", ".join(topic.name for topic in topics)
        if name is not None or len(topics) > 1:
            wanted = f"no {what} in a topic {name!r}; " if name is not None else ""
            raise RecordingError(
                f"{self.path}: {wanted}{what} are in {names or 'no topic'}: say which ({option})"
            )
        if not topics:
            raise RecordingError(f"{self.path}: no {what}: no topic holds {' or '.join(types)}")
        return topics[0]

    @cached_property
    def _first(self) -> Any:
        """The first scan that has beams, as a message."""
        why = f"{self.path}: no scans in {self._scan_topic.name}"
        for place, (_, message) in enumerate(self.messages.of([self._scan_topic])):
            if not (no_beams := self._no_beams(message)):
                return message
            why = no_beams if place == 0 else why
        raise RecordingError(why)

    def _no_beams(self, message: Any) -> str:
        """Why the beams of a scan are none; "" where they are."""
        topic, count = self._scan_topic.name, len(message.ranges)
        if not count:
            return f"{self.path}: a scan without beams in {topic}"
        first, step = float(message.angle_min), float(message.angle_increment)
        if not (np.isfinite(first) and np.isfinite(step)) or (step == 0 and count > 1):
            told = f"angle_min {first:g}, angle_increment {step:g}"
            return f"{self.path}: angles of a scan in {topic} are not those of beams: {told}"
        return ""

    @cached_property
    def _tree(self) -> Tree:
        """The frames that do not move against each other, and those of the first messages of tf."""
        topics = [topic for topic in self.messages.topics if topic.type in (TRANSFORMS, OLD_TRANSFORMS)]
        fixed = [topic for topic in topics if topic.name.endswith("static")]
        moving = [topic for topic in topics if topic not in fixed]
        tree = Tree()
        for group in (moving, fixed):
            if group:
                for _, message in islice(self.messages.of(group), LOOKED_AT):
                    tree.add(message.transforms)
        return tree

    @cached_property
    def _odometry(self) -> Source | None:
        """Where odometry comes from; None where there is none."""
        name, kinds = self.options.odometry_topic, POSES if self.options.odometry_topic else (ODOMETRY,)
        topics = [topic for topic in self.messages.topics if topic.type in kinds and topic.messages]
        if name != "tf" and (topics or name is not None):
            topic = self._chosen(name, kinds, "poses by odometry", "--odometry-topic")
            for _, message in self.messages.of([topic]):
                frame = self.options.base_frame or message.__dict__.get("child_frame_id", "") or ""
                return Source(topic, base=frame.lstrip("/"))
        base, odom = self._base, self.options.odom_frame or "odom"
        if base and self._tree.path(odom, base) is not None:
            return Source(None, odom, base)
        if name == "tf":
            raise RecordingError(f"{self.path}: tf does not lead from {odom} to {base or 'a base frame'}")
        return None

    @cached_property
    def _base(self) -> str:
        """The frame of the robot's reference point."""
        if self.options.base_frame:
            return self.options.base_frame.lstrip("/")
        return next((frame for frame in BASES if frame in self._tree.frames), "")

    @cached_property
    def _place(self) -> Rigid | None:
        """From the robot's reference point to the laser; None where tf does not tell."""
        laser = self._first.header.frame_id.lstrip("/")
        base = self._odometry.base if self._odometry else ""
        for frame in (base, self._base):
            if frame and laser:
                found = self._tree.path(frame, laser)
                if found is not None:
                    return found
        return None

    def _refuse_unknown_base(self) -> None:
        """Refuse a base frame that the bag does not know.

        Raises:
            RecordingError: With those that it knows.
        """
        if not (name := (self.options.base_frame or "").lstrip("/")):
            return
        known = set(self._tree.frames)
        if (source := self._odometry) is not None and source.topic is not None:
            for _, message in self.messages.of([source.topic]):
                known.add((message.__dict__.get("child_frame_id") or "").lstrip("/"))
                break
        if name not in known:
            frames = ", ".join(sorted(known - {""})) or "none"
            raise RecordingError(f"{self.path}: no frame {name!r} (--base-frame); there are {frames}")

    @cached_property
    def _is_upside_down(self) -> bool:
        return self._place is not None and bool(self._place.rotation[2, 2] < 0)

    def _bearings(self, message: Any) -> Array:
        """Directions of the beams of a scan, clockwise from the laser's forward axis, rad, (B,)."""
        first, step = float(message.angle_min), float(message.angle_increment)
        angles = first + step * np.arange(len(message.ranges))
        return np.asarray(angles if self._is_upside_down else -angles)

    def _other_end(self) -> Iterator[str]:
        """That the first scan's last beam points elsewhere than it says, as where ranges were left out."""
        first, count = self._first, len(self._first.ranges)
        step, end = float(first.angle_increment), float(first.angle_max)
        last = float(first.angle_min) + (count - 1) * step
        off = abs(float(wrap(np.asarray(last - end)))) if np.isfinite(end) else np.inf
        if off > MOST_STEPS_OFF * abs(step):
            last_deg, end_deg, step_deg = np.rad2deg([last, end, step])
            yield (
                f"{count} beams with steps of {step_deg:.4g} deg (angle_increment) end at {last_deg:.1f} "
                f"deg, and angle_max is {end_deg:.1f} deg: the steps are believed"
            )

    @cached_property
    def sensor(self) -> LaserDescription:
        """The laser, as its first scan and tf describe it."""
        self._refuse_unknown_base()
        message, place = self._first, self._place
        low, high = max(float(message.range_min), 0.0), float(message.range_max)
        high = high if high > low else np.inf
        if self.options.no_return_m is not None:
            high = min(high, self.options.no_return_m)
        forward, left, yaw = (0.0, 0.0, 0.0) if place is None else place.planar
        step = abs(float(message.time_increment))
        try:
            laser = LaserDescription(
                self._bearings(message), low, high, forward, left, yaw, step, place is not None
            )
        except RecordingError as error:
            raise RecordingError(f"{self.path}, {self._scan_topic.name}: {error}") from None
        return self.options.placed(laser)

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """What was assumed where the bag says nothing."""
        notes = []
        source = self._odometry
        if source is None:
            notes.append("no odometry: neither a topic of nav_msgs/Odometry nor tf from odom to a base frame")
        else:
            origin = source.topic.name if source.topic else f"tf, {source.odom} to {source.base}"
            notes.append(f"scans from {self._scan_topic.name}, odometry from {origin}")
        if not self.sensor.is_placed:
            notes.append(UNPLACED)
        if self._is_upside_down:
            notes.append("by tf the laser hangs upside down: its beams are counted the other way round")
        if self._place is not None and abs(self._place.rotation[2, 2]) < TILTED:
            notes.append("by tf the laser is tilted by more than 10 deg, which is left out of account")
        notes.extend(self._other_end())
        if not self.sensor.seconds_per_beam and float(self._first.scan_time) > 0:
            notes.append("time_increment is 0: all beams of a scan are taken to be measured at once")
        return tuple(notes)

    def _scans(self, tally: Counter[str]) -> Iterator[Scan]:
        laser, wanted = self.sensor, self.sensor.bearings_rad
        odometry = Track(self.poses(), tally=tally) if self._odometry else None
        duration = laser.seconds_per_beam * (len(wanted) - 1)
        first = self._first
        shape = (len(first.ranges), float(first.angle_min), float(first.angle_increment))
        for recorded, message in self.messages.of([self._scan_topic]):
            if self._no_beams(message):
                tally[EMPTY] += 1
                continue
            stamp = time_of(message.header)
            if stamp == 0:
                tally[NO_STAMP] += 1
                stamp = recorded
            ranges, far = self._readings(message)
            if (len(ranges), float(message.angle_min), float(message.angle_increment)) != shape:
                tally["scans whose beams are not the first scan's (the nearest were taken)"] += 1
                ranges = onto_beams(self._bearings(message), ranges, wanted)
            pose = odometry.at(stamp) if odometry else None
            end = odometry.at(stamp, duration) if odometry and duration else None
            tally["scans without odometry at their time"] += bool(odometry) and pose is None
            yield Scan(stamp, ranges, pose, end, far)

    def _readings(self, message: Any) -> tuple[Array, Array]:
        """Ranges as REP-117 has them, (B,), m; and those that are longer than the laser measures, (K,), m."""
        values = message.ranges
        if self._scan_topic.type == SCANS[1]:
            values = [self._one_echo(message, beam) for beam in range(len(values))]
        ranges = np.asarray(values, dtype=float)
        low, high = self.sensor.range_min_m, self.sensor.range_max_m
        with np.errstate(invalid="ignore"):
            ranges = np.where(np.isfinite(ranges) & ((ranges < low) | (ranges <= 0)), np.nan, ranges)
            return np.where(ranges >= high * (1 - 1e-6), np.inf, ranges), beyond(ranges, high)

    def _one_echo(self, message: Any, beam: int) -> float:
        echoes = message.ranges[beam].echoes
        if not len(echoes):
            return np.nan
        if self.options.echo == "strongest" and beam < len(message.intensities):
            brightness = message.intensities[beam].echoes
            if len(brightness) == len(echoes):
                return float(echoes[int(np.argmax(brightness))])
        return float(echoes[-1 if self.options.echo == "last" else 0])

    def poses(self, topic: str | None = None) -> Iterator[tuple[float, Array]]:
        """Times and poses by odometry; or those of a topic, for example one with the true pose.

        Raises:
            RecordingError: If there are none, or one is not finite.
        """
        source = (
            self._odometry if topic is None else Source(self._chosen(topic, POSES, "poses", "topic:NAME"))
        )
        if source is None:
            raise RecordingError(f"{self.path}: no odometry")
        if source.topic is None:
            yield from self._poses_by_tf(source)
            return
        for recorded, message in self.messages.of([source.topic]):
            pose = message.pose if source.topic.type == POSES[2] else message.pose.pose
            found = rigid_of(pose.position, pose.orientation)
            yield time_of(message.header) or recorded, pose_from_ros(*found.planar)

    def claimed_poses(self, topic: str) -> Iterator[tuple[float, Array, Array]]:
        """Times, poses (3,) and their covariances (3, 3) of a topic, in the conventions of this package.

        Raises:
            RecordingError: If it has none, or one is not finite.
        """
        source = self._chosen(topic, CLAIMED, "poses with covariances", "topic:NAME")
        sign = np.array([1.0, 1.0, -1.0])  # the yaw of ROS grows to the left, the heading to the right
        for recorded, message in self.messages.of([source]):
            pose = message.pose.pose
            planar = rigid_of(pose.position, pose.orientation).planar
            full = np.asarray(message.pose.covariance, dtype=float).reshape(6, 6)
            covariance = full[np.ix_(PLANAR, PLANAR)] * sign[:, None] * sign
            if not np.isfinite(covariance).all():
                raise RecordingError(f"{self.path}: a covariance in {topic} is not finite")
            yield time_of(message.header) or recorded, pose_from_ros(*planar), covariance

    def _poses_by_tf(self, source: Source) -> Iterator[tuple[float, Array]]:
        topics = [topic for topic in self.messages.topics if topic.type in (TRANSFORMS, OLD_TRANSFORMS)]
        tree = self._tree.copy()
        links = tree.links(source.odom, source.base)
        for _, message in self.messages.of([topic for topic in topics if not topic.name.endswith("static")]):
            moved = [each for each in message.transforms if tree.link_of(each) in links]
            if not moved:
                continue
            tree.add(moved)
            found = tree.path(source.odom, source.base)
            assert found is not None
            yield max(time_of(each.header) for each in moved), pose_from_ros(*found.planar)
