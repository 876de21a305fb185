"""Write the positions of an openpilot log as CSV: python openpilot_track.py rlog.zst > fcamera.csv.

Run it where openpilot's own Python packages are installed.
"""

import sys

from openpilot.tools.lib.logreader import LogReader

print("time,lat,lon,alt,heading,speed")
for message in LogReader(sys.argv[1]):
    if message.which() in ("gpsLocation", "gpsLocationExternal"):
        fix = getattr(message, message.which())
        if fix.flags % 2:  # bit 0: it has a fix; hasFix is of newer logs only
            at = fix.latitude, fix.longitude, fix.altitude, fix.bearingDeg, fix.speed
            print(fix.unixTimestampMillis / 1000, *at, sep=",")
