"""`lookback map keygen` and `lookback map sign`: so that a vehicle takes only the maps that its owner has made."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge.errors import MapError
from edge.reference_map import open_map_set
from edge.reference_map.signature import make_key, sign_map


def add_actions(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add them to `lookback map`."""
    keygen = actions.add_parser("keygen", help="make a key to sign maps with, and its public half NAME.pub")
    keygen.add_argument("key", type=Path, metavar="NAME")
    keygen.set_defaults(run=_keygen)

    sign = actions.add_parser("sign", help="sign a map, or each of a folder, after checking every byte of it")
    sign.add_argument("map", type=Path, metavar="MAP")
    sign.add_argument("--key", type=Path, required=True, metavar="NAME", help="the secret key of `map keygen`")
    sign.set_defaults(run=_sign)


def _keygen(args: argparse.Namespace) -> int:
    public = make_key(args.key)
    print(f'{args.key}: keep it to yourself; the vehicle gets {public}: [map] require_signature_by = "{public.name}"')
    return 0


def _sign(args: argparse.Namespace) -> int:
    maps = open_map_set(args.map)
    if maps.excluded:
        raise MapError(maps.excluded[0].why)
    for one in maps.maps:
        sign_map(one.path, args.key)
    print(f"{args.map}: signed")
    return 0
