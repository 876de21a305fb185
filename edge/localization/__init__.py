"""From what happens on a drive to a position of the vehicle, and whether it may be published.

`events` is what can happen, and `position_estimator` the one door to what follows; a `drive_file` keeps them.
`place_fix` makes positions of matches; `sequence_match` puts matches and structure on the ground, and
`pose_measurement` what one picture says of it; `filter` is the Kalman filter of the `state`, which is all that is
unknown, `measurements` what each kind of measurement says of it, and `hypotheses` one such filter for each thing that
may be wrong; `tracker` follows the vehicle with them, `structure_agreement` says which structure counts, `fused_poses`
hands on keypoint poses, and `gps_monitor` says what follows for GPS; `dead_reckoning` integrates the vehicle's motion,
`gyro_heading` how far a filter has turned its heading, and `odometer_calibration` says what GPS has shown of the
wheels.
`decide`, which is to be read first, says whether a position is published: by its rules, which rest on the
probability of another place and on how far off it may be (`integrity`): by the `evidence` observed, and by dead
reckoning since the last `position_aiding`.
"""

from __future__ import annotations

from edge.journal.records import PlaceFix
from edge.localization.dead_reckoning import MAX_SPEED_MPS, DeadReckoning, Integral, Odometry
from edge.localization.decide import GPS_HEALTHY, NO_PLACES, STANDING, TWO_AUTOPILOTS, NoFix
from edge.localization.events import (
    GPS_SIGMA_M,
    AutopilotState,
    Discontinuity,
    ExternalPosition,
    Fix,
    FixFeedback,
    FixRequest,
    GpsFix,
    GpsState,
    ImageProcessed,
    MapUpdate,
    Moment,
    OdometryUpdate,
    ProtectionLevel,
)
from edge.localization.filter import CORRELATION_M
from edge.localization.fused_poses import HOLE_S
from edge.localization.gps_monitor import GpsVerdict
from edge.localization.gyro_heading import GyroHeading
from edge.localization.integrity import distance_from
from edge.localization.odometer_calibration import AGREE_SIGMAS, MOST_DRIVES, OdometerCalibration, ScaleFactor, learned
from edge.localization.position_estimator import Entry, EstimatorState, PositionEstimator

__all__ = [
    "AGREE_SIGMAS",
    "CORRELATION_M",
    "GPS_HEALTHY",
    "GPS_SIGMA_M",
    "HOLE_S",
    "MAX_SPEED_MPS",
    "MOST_DRIVES",
    "NO_PLACES",
    "STANDING",
    "TWO_AUTOPILOTS",
    "AutopilotState",
    "DeadReckoning",
    "Discontinuity",
    "Entry",
    "EstimatorState",
    "ExternalPosition",
    "Fix",
    "FixFeedback",
    "FixRequest",
    "GpsFix",
    "GpsState",
    "GpsVerdict",
    "GyroHeading",
    "ImageProcessed",
    "Integral",
    "MapUpdate",
    "Moment",
    "NoFix",
    "OdometerCalibration",
    "Odometry",
    "OdometryUpdate",
    "PlaceFix",
    "PositionEstimator",
    "ProtectionLevel",
    "ScaleFactor",
    "distance_from",
    "learned",
]
