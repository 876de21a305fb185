"""[motion] in the daemon: the speed by the ground is the odometer where nothing else measures one, or is sent."""

from __future__ import annotations

from edge.camera import Frame
from edge.localization.place_fix import sequence_midpoint
from edge.plugin import Parts, Plugin, UsedFrame
from edge_plugins.motion import MotionConfig
from edge_plugins.motion.camera_motion import CameraMotion
from edge_plugins.motion.height import SequencePosition
from edge_plugins.motion.velocity_sender import VelocitySender


class Motion(Plugin):
    """`CameraMotion` at the daemon's moments."""

    def __init__(self, config: MotionConfig, parts: Parts) -> None:
        self._use, self._parts, link = config.use, parts, parts.autopilot
        link.use_camera_motion(sends=config.use == "send")
        self._sender = VelocitySender(link, lambda: parts.drive.state.heading_error)
        self._motion = CameraMotion(parts.config, parts.record, link.vehicle.velocity.turned_rad)

    def frame(self, frame: Frame) -> None:
        """Measure the speed by the ground that a frame shows, and use it where nothing else measures one."""
        link, use = self._parts.autopilot, self._use
        speed = self._motion.follow(frame.image, frame.stamp_ns, *link.gps_motion())
        if speed is not None and use != "report":
            link.vehicle.velocity.use_speed(speed.stamp_ns, speed.speed_mps, left_mps=-speed.right_mps)
        if speed is not None and use == "send":
            self._sender.send(speed)

    def frame_used(self, used: UsedFrame) -> None:
        """Compare the distance that the camera measures with that between the places which it recognizes."""
        if not self._parts.recognizer.is_in_line:
            return
        match, position = used.match, None
        if match is not None and match.accepted and match.uniqueness >= 1:
            line = sequence_midpoint(match, self._parts.drive.route, self._parts.config.sequence_frames)
            if line is not None:
                along_m = line.along_m if match.direction == "forward" else -line.along_m
                position = SequencePosition(f"{line.segment} {match.direction} {match.order}", along_m, line.back)
        self._motion.height.use_frame(position)
