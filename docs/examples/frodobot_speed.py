"""The odometer of a robot of FrodoBots, beside `connection = "udpin:127.0.0.1:14560"`."""

import json
import time
import urllib.request

from pymavlink import mavutil

robot = mavutil.mavlink_connection("udpout:127.0.0.1:14560", source_system=1, source_component=1)
while True:
    with urllib.request.urlopen("http://localhost:8000/data", timeout=5) as reply:
        data = json.load(reply)
    robot.mav.heartbeat_send(10, 0, 0, 0, 4)  # a rover without an autopilot that Lookback knows
    robot.mav.vfr_hud_send(0, data["speed"], 0, 0, 0, 0)
    time.sleep(0.2)
