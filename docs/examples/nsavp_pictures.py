"""NSAVP's left camera as pictures and a CSV file: run in the folder of a sequence, as R0_FA0. Needs h5py."""

from pathlib import Path

import cv2
import h5py
import numpy as np
import pyproj

name = Path.cwd().name
poses = h5py.File(f"{name}_applanix.h5")["pose_base_link"]
images = h5py.File(f"{name}_mono_left.h5")["image_raw"]  # mono8; convert other encodings
at, times = poses["positions"][:], poses["timestamps"][:].astype(float)
stamps = images["timestamps"][:]
x, y, z = (np.interp(stamps.astype(float), times, at[:, axis]) for axis in range(3))
lat, lon, _ = pyproj.Transformer.from_crs(4978, 4979).transform(x, y, z)
folder = Path(f"../{name}_left")
folder.mkdir()
with (folder / "frames.csv").open("w", encoding="utf-8") as csv:
    print("picture,tai_ns,lat,lon", file=csv)
    for number, stamp in enumerate(stamps.tolist()):
        cv2.imwrite(str(folder / f"{number:06}.png"), images["images"][number])
        print(f"{number:06}.png,{stamp},{lat[number]:.8f},{lon[number]:.8f}", file=csv)
