"""Lookback: tells an autopilot where it is by recognising places, seen from behind, in other light.

The folders in alphabetical order are the data path; each hands a plain record to the next:

    camera/         -> Frame            image (H, W, 3), stamp_ns, index
    descriptor/     -> (R, D) float32   fc6 of R regions, D = 4096, raw and normalised (NSD)
    reference_map/  -> (2, N) int32     cosine cost of the query to each of N places, in both region orders
    sequence/       -> SequenceMatch    the best line through the last L cost rows, accepted or off the map
    telemetry/      -> the robot        place fixes over MAVLink, and the journal

`recognizer.py` joins the pure stages and is the file to read first; `daemon.py` joins it to the devices.
"""

__version__ = "0.1.0"
