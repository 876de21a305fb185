"""From a picture to what a place means: regions, fc6 of each, and its normalisation over the traverse.

    image (H, W, 3) --regions--> (R, 224, 224, 3) --network--> raw fc6 (R, 4096) --normalize--> NSD (R, 4096)

`model_import` and `quantize` make the network's file at a desk; the vehicle never loads them. A further descriptor
is a class with `describe(images) -> (R, D) float32` that `recognizer.py` can be given in place of `Network`.
"""
