"""Lookback recognizes places that were seen from behind, in other light, and sends an autopilot its position.

A frame goes through these rooms in this order, and none calls back; each hands a plain record to the next:

    feed/           recorded traverses  read, written, sampled
    camera/         -> Frame            image (H, W, 3), stamp_ns, index; one of the cameras plays a feed
    descriptor/     -> (R, D) float32   fc6 of R regions, D = 4096, raw and normalized (NSD)
    reference_map/  -> (2, N) int32     cosine cost of the query to each of N places, in both region orders
    sequence/       -> PlaceMatch       the best line through the last L cost rows, accepted or off the map
    localization/   -> PlaceFix         the vehicle's position along the map's drive, and whether it may be sent
    telemetry/      -> the autopilot    MAVLink 2: positions, lines for people, values to plot
    journal/        what happened, one record per line
    health/         the daemon's state, and systemd
    page/           the live page
    commands/       run, map, replay, record, doctor, ...

The files beside them:

    recognizer      one frame in, one answer out: the file to read first
    daemon          opens the parts that the config names, and runs the loop
    config          the one TOML file
    warm_start      what is kept from one run to the next
    errors          everything that can go wrong, in three kinds
    geodesy         degrees and local meters
    toml_file       a TOML file as a typed record
    atomic_file     a file that is replaced whole
    backoff         pauses that double while attempts fail
"""

__version__ = "0.1.0"
