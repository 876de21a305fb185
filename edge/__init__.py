"""Lookback: tells an autopilot where it is by recognising places, seen from behind, in other light.

The folders in alphabetical order are the data path; each hands a plain record to the next:

    camera/         -> Frame            image (H, W, 3), stamp_ns, index
    descriptor/     -> (R, D) float32   fc6 of R regions, D = 4096, raw and normalised (NSD)
    reference_map/  -> (2, N) int32     cosine cost of the query to each of N places, in both region orders
    sequence/       -> SequenceMatch    the best line through the last L cost rows, accepted or off the map
    telemetry/      -> the robot        words, positions, journal, live page

The files beside them, by what they are for:

    one frame       recognizer (read it first), place_search, map_part, map_scan, line_ends, tracking, place_fixes
    the daemon      daemon, condition, health, memory, kept_state, live_status, recording, service, stage_times
    commands        map_command (map_files, shrinking, signing_commands), model_command, replay, record, check,
                    completion, doctor (doctor_autopilot, finding)
    below all       errors, config, sampling, traverse, observation
"""

__version__ = "0.1.0"
