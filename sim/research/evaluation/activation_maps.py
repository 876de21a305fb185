"""Which part of a picture activates a place category (fig. 10).

The paper shows class activation maps [38] of networks with average pooling in place of the fully
connected layers. AlexNet as it is has no such map; its generalization to any layers after the convolutions is Grad-CAM
(Selvaraju et al., ICCV 2017): the channels of the last pooled convolution, each weighted with the mean gradient of the
category's score, and negative values set to 0. For a network with average pooling the two are equal.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.descriptor.model_file import ModelInfo
from edge.descriptor.network import IMAGE, open_session
from edge.descriptor.regions import cut_regions
from sim.model_tools import onnx_graph
from sim.model_tools.weights import FC6, FC7, FC8, Weights

Floats = NDArray[np.float32]

POOLED = "features.10.maxpool"  # pool5: 256 channels of 6 x 6


def pooled_features(weights: Weights, info: ModelInfo, image: NDArray[np.uint8]) -> Floats:
    """Last pooled convolution (256, 6, 6) float32 of a picture (H, W, 3) uint8 BGR, by the float network."""
    import onnx

    model = onnx_graph.build_float(weights, info)
    model.graph.output.append(onnx.helper.make_tensor_value_info(POOLED, onnx.TensorProto.FLOAT, None))
    session = open_session(model.SerializeToString())
    pooled: Floats = session.run([POOLED], {IMAGE: cut_regions(image, "whole", 1.0, info.size)})[0][0]
    return pooled


def scores_and_gradients(weights: Weights, pooled: Floats) -> tuple[Floats, NDArray[np.intp], Floats]:
    """Probabilities (C,), categories by rank (C,), and the gradient of the first three's scores (3, *pooled.shape).

    The score is that before the softmax. The derivative of ReLU at 0 is taken as 0.
    """
    hidden6 = weights[f"{FC6}.weight"] @ pooled.ravel() + weights[f"{FC6}.bias"]
    hidden7 = weights[f"{FC7}.weight"] @ np.maximum(hidden6, 0) + weights[f"{FC7}.bias"]
    scores = weights[f"{FC8}.weight"] @ np.maximum(hidden7, 0) + weights[f"{FC8}.bias"]
    rank = np.argsort(-scores, kind="stable")
    back7 = weights[f"{FC8}.weight"][rank[:3]] * (hidden7 > 0)
    back6 = (back7 @ weights[f"{FC7}.weight"]) * (hidden6 > 0)
    gradients = (back6 @ weights[f"{FC6}.weight"]).reshape(-1, *pooled.shape)
    exponents = np.exp(scores - scores.max())
    return (exponents / exponents.sum()).astype(np.float32), rank, gradients.astype(np.float32)


def activation_map(pooled: Floats, gradient: Floats) -> Floats:
    """Grad-CAM (H, W) in 0..1 of features and gradient (channels, H, W); all 0 where none is positive."""
    weight = gradient.mean(axis=(1, 2))
    speaks = np.maximum(np.tensordot(weight, pooled, axes=1), 0)
    most = float(speaks.max())
    return np.asarray(speaks / most if most > 0 else speaks, dtype=np.float32)


def overlay(image: NDArray[np.uint8], speaks: Floats) -> NDArray[np.uint8]:
    """The picture with the map as a heat map over it."""
    height, width = image.shape[:2]
    large = cv2.resize(speaks, (width, height), interpolation=cv2.INTER_CUBIC).clip(0, 1)
    colors = cv2.applyColorMap(np.rint(large * 255).astype(np.uint8), cv2.COLORMAP_JET)
    return np.asarray(cv2.addWeighted(image, 0.55, colors, 0.45, 0), dtype=np.uint8)
