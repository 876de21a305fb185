"""`lookback calibrate`: measure the camera, its offset, the acceptance threshold and the autopilot's wheels."""

from __future__ import annotations

import argparse
import csv
import io
import os
import tempfile
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path

import msgspec
import numpy as np

from edge.camera.preprocessing import preprocessed_feed
from edge.config import Config, RigConfig, load_config, parse_config
from edge.descriptor.network import Network
from edge.descriptor.open_network import open_network
from edge.errors import ConfigError, LookbackError
from edge.extras import install_command
from edge.feed import Feed
from edge.files import replacing
from edge.reference_map.store import ReferenceMap, open_map
from edge.toml_file import read_text
from edge_plugins.doctor.command import without_log
from sim.calibration.camera import measure_camera
from sim.calibration.offset import (
    FEWEST,
    Offset,
    look_key,
    measure_offsets,
    rig_config,
    rig_key,
    sigma_key,
)
from sim.calibration.offset_samples import OffsetSample, samples_of
from sim.calibration.threshold import DEFAULT, Curve, choose, curve_of_drive
from sim.calibration.wheels import calibrate_wheels
from sim.datasets.found import open_recording
from sim.evaluation.command import add_tolerance_option
from sim.evaluation.replay import load_config_for_map
from sim.output import refusing
from sim.traverse import config_as_mapped

Lines = Mapping[tuple[str, str], float | tuple[float, ...]]
"""Values for the config, by section and key."""
CAMERA, WHEELS = [Path("camera")], [Path("wheels")]
"""The first word, in place of a FEED, without --map."""

WHY_DEFAULT = (
    "lower ones may reach this precision here, but a drive that never leaves the map shows too little of what is"
    " accepted elsewhere"
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback calibrate`."""
    parser.description = (
        "Measure the camera's along-track offset from recorded drives with GPS, and the acceptance threshold for a"
        " precision. `lookback calibrate camera FEED` measures the camera's field of view and lens from a drive with"
        " bends, without a map. `lookback calibrate wheels CONFIG` says how large the autopilot's wheels are by the"
        " drives of `lookback run` beside GPS, and sets it: stop the service first."
    )
    parser.add_argument("feeds", nargs="*", type=Path, metavar="FEED", help="drives along the map, recorded with GPS")
    parser.add_argument("--map", type=Path, help="the map's folder")
    parser.add_argument("--config", type=Path, help="settings of the recognizer, and flip, crop and mask of [camera]")
    parser.add_argument("--precision", type=_share, default=0.99, metavar="P", help='0.99 or "99 %%" (default)')
    add_tolerance_option(parser)
    parser.add_argument("--curve", type=Path, metavar="CSV", help="write precision over threshold to this file")
    parser.add_argument("--write", type=Path, metavar="CONFIG", help="write the result into it; comments are kept")
    parser.add_argument("--upload", action="store_true", help="of wheels: set their radius on the autopilot")
    parser.add_argument("--yes", action="store_true", help="without asking")
    parser.set_defaults(run=_run, error=parser.error)


def _share(text: str) -> float:
    share = float(text.rstrip("% ")) / (100 if text.rstrip().endswith("%") else 1)
    if not 0 < share <= 1:
        raise argparse.ArgumentTypeError(f"{text}: not between 0 and 1, nor up to 100 %")
    return share


def measure_rig(
    reference_map: ReferenceMap, feeds: Sequence[Feed], config: Config | None = None, network: Network | None = None
) -> tuple[list[Offset], list[OffsetSample]]:
    """The offsets of the drives, and the samples they are measured on. FeedError, MapError, ModelError.

    network: instead of the one that the config names.
    """
    config = config or config_as_mapped(reference_map.header)
    network = network or open_network(config.descriptor)
    seen = [one for feed in feeds for one in samples_of(reference_map, feed, config, network)]
    return measure_offsets(seen), seen


def _run(args: argparse.Namespace) -> int:
    # Measuring takes minutes, so it is found out first whether the result can be written.
    if args.write:
        check_writable(args.write)
    if not args.feeds:
        args.error("name a FEED: a drive along the map, recorded with GPS")
    if args.map is None:
        if args.feeds[:1] not in (CAMERA, WHEELS) or len(args.feeds) != 2:
            args.error("--map is required, except as `lookback calibrate camera FEED`, or `wheels CONFIG`")
        return _run_camera(args) if args.feeds[:1] == CAMERA else _run_wheels(args)
    reference_map = open_map(args.map)
    settings = args.config or args.write
    made = reference_map.header
    config = load_config_for_map(settings, made) if settings else config_as_mapped(made)
    offsets, seen = measure_rig(reference_map, [open_recording(path) for path in args.feeds], config)
    off_map = [one.confidence for one in seen if np.isnan(one.ahead_m)]
    _print_offsets(offsets, seen)
    lines = dict(rig_lines(offsets))
    curve = curve_of_drive(seen, _with_known(config.rig, offsets), args.tolerance_m, config.sequence_frames)
    print(f"threshold, from {curve.answers} matches ({curve.stretches} without a shared frame):")
    if not curve.answers:
        raise LookbackError(f"{args.map}: no whole sequence of {config.sequence_frames} places, so nothing is measured")
    chosen = choose(curve, off_map, args.precision)
    threshold = min(float(np.ceil(chosen * 1e6) / 1e6), 1 - 1e-6)
    lines["acceptance", "confidence_from"] = threshold
    _print_curve(curve, threshold)
    if chosen == DEFAULT:
        print(f"the default is kept: {WHY_DEFAULT}")
    if args.curve:
        args.curve.write_text(_curve_as_csv(curve), encoding="utf-8")
    _put(lines, args.write)
    return 0


def _run_camera(args: argparse.Namespace) -> int:
    """Of `lookback calibrate camera FEED`."""
    settings = args.config or args.write
    camera = (load_config(settings) if settings else Config()).camera
    feed = preprocessed_feed(open_recording(args.feeds[1]), camera)
    found = measure_camera(feed)
    spelled = f"{found.fov_deg:.1f} ± {found.fov_sigma_deg:.1f} degrees, k1 {found.k1:+.3f} ± {found.k1_sigma:.3f}"
    print(f"camera of {feed.path}: {spelled}")
    _put({("camera", "fov_deg"): round(found.fov_deg, 1), ("camera", "distortion"): found.distortion}, args.write)
    return 0


def _run_wheels(args: argparse.Namespace) -> int:
    """Of `lookback calibrate wheels CONFIG`."""
    with without_log():
        calibrate_wheels(load_config(args.feeds[1]).telemetry, uploads=args.upload, is_sure=args.yes)
    return 0


def _put(lines: Lines, config: Path | None) -> None:
    """Print the lines, and write them into a config."""
    print(as_toml(lines))
    if config:
        write_lines(config, lines)
        print(f"written to {config}")


def _with_known(rig: RigConfig, offsets: Sequence[Offset]) -> RigConfig:
    """The config's values, replaced by those that were measured."""
    measured = rig_config(offsets)
    return msgspec.structs.replace(rig, **{rig_key(offset): getattr(measured, rig_key(offset)) for offset in offsets})


def rig_lines(offsets: Sequence[Offset]) -> Lines:
    """Values of [rig] that were measured."""
    rig = rig_config(offsets)
    keys = [key for one in offsets for key in (rig_key(one), f"left_{one.direction}_m", sigma_key(one))]
    by_poses = [look_key(one) for one in offsets if not np.isnan(one.pose_m)]
    keys += [*by_poses, "look_sigma_m"] if by_poses else []
    if keys:
        keys += ["sigma_along_m", "sigma_cross_track_m"]
    return {("rig", key): getattr(rig, key) for key in keys}


def _print_offsets(offsets: Sequence[Offset], seen: Sequence[OffsetSample]) -> None:
    accepted = sum(one.accepted for one in seen)
    print(f"offset, from {accepted} accepted matches of {len(seen)}:")
    if not offsets:
        print(f"  none: no direction has {FEWEST} accepted matches on the map's route; drive further, or check the map")
    for offset in offsets:
        ahead = f"{offset.ahead_m:6.1f} ± {offset.ahead_sigma_m:.1f} m ahead"
        side = "left" if offset.lateral_m >= 0 else "right"
        print(
            f"  {offset.direction}, {offset.order:<7}  the place lies {ahead}; remaining error:"
            f" {offset.left_m:.1f} m rms, 95 % within {offset.left_95_m:.1f} m  ({offset.used} matches,"
            f" {offset.outliers} outliers excluded);"
            f" the vehicle {abs(offset.lateral_m):.1f} m {side} of the map's drive"
        )
        if not np.isnan(offset.pose_m):
            print(f"    by keypoint poses the camera is {offset.pose_m:.1f} ± {offset.pose_sigma_m:.1f} m ahead of it")


def _print_curve(curve: Curve, threshold: float) -> None:
    """About 13 points of the curve, and the chosen one."""
    print("  confidence_from  accepted  precision")
    rows = np.unique(np.linspace(0, len(curve.thresholds) - 1, 12).round().astype(int))
    for row in rows:
        print(f"  {curve.thresholds[row]:13.6f}  {curve.accepted[row]:8d}  {curve.precision[row]:9.3f}")
    last = int(np.flatnonzero(curve.thresholds >= threshold)[-1]) if (curve.thresholds >= threshold).any() else 0
    print(f"  {threshold:13.6f}  {curve.accepted[last]:8d}  {curve.precision[last]:9.3f}  chosen")


def _curve_as_csv(curve: Curve) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["confidence_from", "accepted", "precision"])
    for threshold, accepted, precision in zip(curve.thresholds, curve.accepted, curve.precision, strict=True):
        writer.writerow([f"{threshold:.6f}", accepted, f"{precision:.6f}"])
    return text.getvalue()


def as_toml(lines: Lines) -> str:
    """The lines of a config file."""
    sections = dict.fromkeys(section for section, _ in lines)
    return "\n".join(
        "\n".join(
            [f"[{name}]", *(f"{key} = {_toml(value)}" for (section, key), value in lines.items() if section == name)]
        )
        for name in sections
    )


def _toml(value: float | tuple[float, ...]) -> str:
    return f"[{', '.join(map(str, value))}]" if isinstance(value, tuple) else f"{value:g}"


def check_writable(path: Path) -> None:
    """ConfigError unless `write_lines` could write into this config file now."""
    if find_spec("tomlkit") is None:
        raise ConfigError(f"--write needs tomlkit: {install_command('desk')}, or copy the lines yourself")
    load_config(path)
    with refusing(ConfigError, f"{path}: cannot write into its folder"), tempfile.TemporaryFile(dir=path.parent):
        pass


def write_lines(path: Path, lines: Mapping[tuple[str, str], float | str | tuple[float, ...]]) -> None:
    """Write values into a config file in one step; its comments, order and other keys stay. ConfigError."""
    import tomlkit

    document = tomlkit.parse(read_text(path))
    for (section, key), value in lines.items():
        document.setdefault(section, tomlkit.table())[key] = list(value) if isinstance(value, tuple) else value
    new = tomlkit.dumps(document)
    parse_config(new, path)  # a valid config stays valid
    with refusing(ConfigError, f"{path}: cannot write it"), replacing(path) as stream:
        os.fchmod(stream.fileno(), path.stat().st_mode)
        stream.write(new.encode())
