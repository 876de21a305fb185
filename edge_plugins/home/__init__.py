"""The way home: a drive of a reference map, reversed into a mission that an autopilot can follow, and uploaded.

`drive_line`  the positions of one drive of a map, as a line on the ground, and fewer points of it
`passes`      which pass of that drive the vehicle is on
`way_home`    from the vehicle back to the start of that drive, checked and simplified: -> WayHome; and that as items
              of a MAVLink mission, as ArduPilot or PX4 number them
`checks`      whether a vehicle can drive that way: gaps, jumps, turns, loops, length

These are pure. `home_requests` answers requests, which come by MAVLink, by `local_socket` or from the page;
`mission_transfer` uploads the mission, and `replaced_mission` keeps the one before. `plugin` is for the daemon.
"""

from __future__ import annotations

from edge_plugins.home.way_home import MissionItem, Start, WayHome, mission_items, plan_way_home

__all__ = ["MissionItem", "Start", "WayHome", "mission_items", "plan_way_home"]
