"""Ask Lookback for the way home over any link to the vehicle: `python ask_home.py udpin:0.0.0.0:14551`."""

import sys

from pymavlink import mavutil

link = mavutil.mavlink_connection(sys.argv[1], source_system=255)
while link.wait_heartbeat().get_srcComponent() != 191:
    pass
link.mav.command_long_send(link.target_system, 191, 31014, 0, 1, 5665, 0, 0, 0, 0, 0)
while True:
    print(link.recv_match(type=["COMMAND_ACK", "STATUSTEXT"], blocking=True))
