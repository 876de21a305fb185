"""A way home or another route as a file for a ground station: QGC WPL 110, QGroundControl plan or GeoJSON."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec

from edge.errors import ConfigError
from edge.files import replacing
from edge_plugins.home import HomeConfig
from edge_plugins.home.replaced_mission import as_waypoints
from edge_plugins.home.route import FRAME_RELATIVE_ALT, MissionItem, RoutePlan, mission_items
from sim.ground_files import GroundLine, as_geojson
from sim.output import refusing

ARDUPILOT, GROUND_ROVER = 3, 10  # MAV_AUTOPILOT, MAV_TYPE


def write_route(path: Path, way: RoutePlan, config: HomeConfig, name: str) -> None:
    """Write the file that its suffix names, whole or not at all; ConfigError for another suffix, or if it cannot be."""
    content = encoder_of(path)(way, config, name)
    with refusing(ConfigError, f"{path}: cannot write it"), replacing(path) as stream:
        stream.write(content)


def encoder_of(path: Path) -> Callable[[RoutePlan, HomeConfig, str], bytes]:
    """What makes the file of that name; ConfigError for a suffix that is no format."""
    encoders = {".waypoints": _waypoints, ".plan": _plan, ".geojson": _geojson}
    if path.suffix not in encoders:
        raise ConfigError(f"{path}: not a name that ends in {', '.join(encoders)}")
    return encoders[path.suffix]


def _waypoints(way: RoutePlan, config: HomeConfig, name: str) -> bytes:
    return as_waypoints(mission_items(way, speed_mps=config.speed_mps, altitude_m=config.altitude_m))


def _plan(way: RoutePlan, config: HomeConfig, name: str) -> bytes:
    items = mission_items(way, speed_mps=config.speed_mps, altitude_m=config.altitude_m, home_first=False)
    home_lat_deg, home_lon_deg = way.positions_deg[-1]
    speed_mps = config.speed_mps or 5.0  # for QGroundControl's estimate of the time only
    speeds = {"cruiseSpeed": speed_mps, "hoverSpeed": speed_mps}
    plan = {
        **{"fileType": "Plan", "version": 1, "groundStation": "QGroundControl"},
        **{"geoFence": {"circles": [], "polygons": [], "version": 2}, "rallyPoints": {"points": [], "version": 2}},
        "mission": {
            **{"version": 2, "firmwareType": ARDUPILOT, "vehicleType": GROUND_ROVER, **speeds},
            "globalPlanAltitudeMode": 1,
            "plannedHomePosition": [home_lat_deg, home_lon_deg, 0.0],
            "items": [_plan_item(number, item) for number, item in enumerate(items, start=1)],
        },
    }
    return msgspec.json.format(msgspec.json.encode(plan), indent=1)


def _plan_item(number: int, item: MissionItem) -> dict[str, Any]:
    """A SimpleItem; null is the autopilot's choice."""
    return {
        "type": "SimpleItem",
        "doJumpId": number,
        "autoContinue": True,
        "command": item.command,
        "frame": item.frame,
        "params": [*item.params, item.lat_deg, item.lon_deg, item.altitude_m],
        **({"Altitude": item.altitude_m, "AltitudeMode": 1} if item.frame == FRAME_RELATIVE_ALT else {}),
    }


def _geojson(way: RoutePlan, config: HomeConfig, name: str) -> bytes:
    """The line and each waypoint, with what the checks found."""
    properties = {
        "name": f"{name}, {way.words}",
        "length_m": round(way.length_m, 1),
        "speed_mps": config.speed_mps or None,
        "findings": [str(finding) for finding in way.findings],
    }
    points = [
        GroundLine("", [at_deg], properties={"waypoint": number, "along_m": round(along_m, 1)})
        for number, (at_deg, along_m) in enumerate(zip(way.positions_deg, way.along_m, strict=True))
    ]
    return as_geojson([GroundLine("", way.positions_deg, properties=properties)], points).encode()
