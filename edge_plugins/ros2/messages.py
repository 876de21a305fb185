"""The messages of ROS 2 that Lookback speaks, as DDS has them: XCDR 1, in the order of the .msg files."""

from __future__ import annotations

import re
from functools import cache
from typing import Any

from edge.errors import ConfigError
from edge.extras import install_command

DEFINITIONS = {
    "builtin_interfaces/Time": "int32 sec, uint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp, string frame_id",
    "geometry_msgs/Point": "float64 x, float64 y, float64 z",
    "geometry_msgs/Quaternion": "float64 x, float64 y, float64 z, float64 w",
    "geometry_msgs/Vector3": "float64 x, float64 y, float64 z",
    "geometry_msgs/Pose": "geometry_msgs/Point position, geometry_msgs/Quaternion orientation",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose, float64[36] covariance",
    "geometry_msgs/PoseWithCovarianceStamped": "std_msgs/Header header, geometry_msgs/PoseWithCovariance pose",
    "geometry_msgs/Twist": "geometry_msgs/Vector3 linear, geometry_msgs/Vector3 angular",
    "geometry_msgs/TwistWithCovariance": "geometry_msgs/Twist twist, float64[36] covariance",
    "nav_msgs/Odometry": "std_msgs/Header header, string child_frame_id, geometry_msgs/PoseWithCovariance pose, "
    "geometry_msgs/TwistWithCovariance twist",
    "sensor_msgs/NavSatStatus": "int8 status, uint16 service",
    "sensor_msgs/NavSatFix": "std_msgs/Header header, sensor_msgs/NavSatStatus status, float64 latitude, "
    "float64 longitude, float64 altitude, float64[9] position_covariance, uint8 position_covariance_type",
    "diagnostic_msgs/KeyValue": "string key, string value",
    "diagnostic_msgs/DiagnosticStatus": "byte level, string name, string message, string hardware_id, "
    "diagnostic_msgs/KeyValue[] values",
    "diagnostic_msgs/DiagnosticArray": "std_msgs/Header header, diagnostic_msgs/DiagnosticStatus[] status",
}
"""Each after those that it contains."""
FIELD = re.compile(r"(?P<type>[\w/]+)(?P<many>\[(?P<count>\d*)\])? (?P<name>\w+)")


@cache
def message_types() -> dict[str, Any]:
    """The classes by the names of ROS 2; ConfigError where the package is missing."""
    try:
        from cyclonedds.idl import annotations, make_idl_struct
        from cyclonedds.idl import types as idl_types
    except ModuleNotFoundError:
        raise ConfigError(f"[ros2] domain: needs Cyclone DDS: {install_command('ros2')}") from None
    types: Any = idl_types
    classes: dict[str, Any] = {}

    def type_of(field: re.Match[str]) -> Any:
        kind = field["type"]
        one = str if kind == "string" else classes[kind] if "/" in kind else getattr(types, kind)
        if field["many"] is None:
            return one
        return types.array[one, int(field["count"])] if field["count"] else types.sequence[one]

    for name, fields in DEFINITIONS.items():
        package, kind = name.split("/")
        by_name = {field["name"]: type_of(field) for field in FIELD.finditer(fields)}
        made: Any = make_idl_struct(kind, f"{package}.msg.dds_.{kind}_", by_name)
        classes[name] = annotations.final(annotations.autoid("sequential")(made))
    return classes
