"""The shipped network trained again, or one like it: `lookback dev train`. PyTorch is an extra, `torch`.

images    a folder of pictures for each class, read into one array
views     random views of a picture: crop, mirror, light
alexnet   the network with batch norm; batch norm folded away, and saved for `lookback dev alexnet`
training  loss, schedule, averaged weights, checkpoints
measure   what a trained network is worth on held-out pictures, and the ranges of its layers for int8
command   the options

The network learns to distinguish categories, and by fc6 as NSD normalizes it two views of one picture from others.
"""
