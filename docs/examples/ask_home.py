"""Ask Lookback for the way home, or a route by its number: `python ask_home.py udpin:0.0.0.0:14551 [ROUTE]`."""

import sys

from pymavlink import mavutil

link = mavutil.mavlink_connection(sys.argv[1], source_system=255)
while link.wait_heartbeat().get_srcComponent() != 191:
    pass
link.mav.command_long_send(link.target_system, 191, 31014, 0, 1, 5665, float((*sys.argv, 0)[2]), 0, 0, 0, 0)
while True:
    print(link.recv_match(type=["COMMAND_ACK", "STATUSTEXT"], blocking=True))
