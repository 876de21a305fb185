"""What only some vehicles need: each part is opened by the daemon where the config asks for it (`edge.plugin`).

    cameras/    [camera] kind: OAK, network streams, output of a command
    motion/     [motion]: the vehicle's speed from the ground that two pictures show
    layers/     drives over one road: which are searched, and which are deleted
    mapping/    how maps are made; [mapping]: the drive becomes one while it is driven
    recording/  [recording], and `lookback record`
    home/       [home]: any drive of the map as a mission, reversed into the way home or as a route, on request
    ros2/       [ros2]: places, positions and state by DDS; odometry from there
    nmea/       [nmea]: positions as NMEA 0183 for phones, plotters and gpsd
    page/       [page]: the live page, and metrics for Prometheus
    doctor/     `lookback doctor`: what is wrong with config, devices and the vehicle

The front door of each plug-in is its section of the config, which names its class; no more is imported while it is off.
A plug-in imports `edge` and the plug-ins above it. `edge` knows them only as names in tables.
"""
