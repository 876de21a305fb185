"""`lookback dev train`: train AlexNet on labeled images, to weights for `lookback dev alexnet`."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

import msgspec
from tqdm import tqdm

from edge.config import checked_option
from edge.errors import ConfigError
from edge.extras import install_command
from sim.research.training.images import LabeledImages, find_classes, read_images
from sim.research.training.recipe import Recipe

SMALLEST_SIDE_PX = 32


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback dev train`."""
    usual = Recipe()
    parser.description = (
        "Train AlexNet on a folder of images for each class, such as MiniPlaces' images/train, as the"
        " shipped network was trained. Beside WEIGHTS.npz comes WEIGHTS.ranges.json, which"
        " `lookback dev alexnet` takes. A training that was cut off goes on when the same command is given again."
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="folder with a subfolder of images for each class")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="WEIGHTS.npz")
    parser.add_argument("--epochs", type=int, default=usual.epochs, help="default %(default)s")
    parser.add_argument("--batch", type=int, default=usual.batch, help="images per step (default %(default)s)")
    size = "size that images are scaled to (default 128)"
    parser.add_argument("--size", type=int, default=128, metavar="PIXELS", help=size)
    parser.add_argument("--rate", type=float, default=usual.peak_rate, help="peak learning rate (default %(default)s)")
    weight = "weight of the contrastive loss (default %(default)s)"
    parser.add_argument("--contrast", type=float, default=usual.contrast, help=weight)
    share = "fraction of the images held out for validation (default 0.02)"
    parser.add_argument("--hold-out", type=float, default=0.02, metavar="SHARE", help=share)
    parser.add_argument("--seed", type=int, default=usual.seed)
    parser.add_argument("--device", choices=["cpu", "cuda"], help="default: cuda if available")
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    recipe, device = _recipe(args), _device(args.device)
    if args.output.suffix != ".npz":
        raise ConfigError(f"{args.output}: the weights' file must end in .npz")
    if not args.output.absolute().parent.is_dir():
        raise ConfigError(f"{args.output.parent}: no such folder to write the weights to")
    classes = find_classes(args.folder)
    total = sum(map(len, classes.values()))
    images = read_images(classes, args.size, partial(tqdm, desc="pictures", total=total, unit="picture"))
    _train(args.output, *images.split(args.hold_out), recipe, device)
    return 0


def _recipe(args: argparse.Namespace) -> Recipe:
    """The recipe with the options in it; ConfigError names a wrong one."""
    recipe = Recipe()
    for option in ("epochs", "batch", "rate", "contrast", "seed"):
        key = "peak_rate" if option == "rate" else option
        recipe = checked_option(recipe, f"--{option}", **{key: getattr(args, option)})
    if args.size < SMALLEST_SIDE_PX:
        raise ConfigError(f"--size: {args.size} is not {SMALLEST_SIDE_PX} or more")
    if not 0 < args.hold_out <= 0.5:
        raise ConfigError(f"--hold-out: {args.hold_out:g} is not above 0 and up to 0.5")
    return recipe


def _device(asked_for: str | None) -> str:
    try:
        import torch
    except ImportError:
        raise ConfigError(f"training needs PyTorch: {install_command('sim,model,torch')}") from None
    if asked_for == "cuda" and not torch.cuda.is_available():
        raise ConfigError("--device: PyTorch sees no CUDA device here; use cpu")
    return asked_for or ("cuda" if torch.cuda.is_available() else "cpu")


def _train(output: Path, images: LabeledImages, held_out: LabeledImages, recipe: Recipe, device: str) -> None:
    import torch

    from sim.research.training.alexnet import fold, save_weights
    from sim.research.training.measure import layer_ranges, top_shares
    from sim.research.training.training import Training

    training, checkpoint = Training(images, recipe, device), output.with_suffix(".checkpoint")
    if checkpoint.exists():
        training.go_on_from(checkpoint)
        print(f"{checkpoint}: going on after epoch {training.epoch}")
    try:
        while training.epoch < recipe.epochs:
            epoch = f"epoch {training.epoch + 1} of {recipe.epochs}"
            loss = training.run_epoch(partial(tqdm, desc=epoch, unit="step", leave=False))
            print(f"{epoch}: loss {loss:.3f}", flush=True)
            training.save(checkpoint)
    except torch.cuda.OutOfMemoryError:
        raise ConfigError(f"--batch: {recipe.batch} do not fit into the GPU's memory; try half of it") from None
    net = training.averaged()
    first, fifth = top_shares(net, held_out, device)
    print(f"{len(held_out.labels)} held-out pictures: top-1 {100 * first:.1f} %, top-5 {100 * fifth:.1f} %")
    ranges = msgspec.json.encode(layer_ranges(net, held_out, device, recipe.seed))
    output.with_suffix(".ranges.json").write_bytes(msgspec.json.format(ranges))
    save_weights(fold(net), output)
    checkpoint.unlink()
    print(f"{output}: for `lookback dev alexnet`, with --ranges of the file beside it")
