"""Write the pictures of a ride of FrodoBots-2K, named by their times: python frodobots_pictures.py rear 1001."""

import csv
import sys
from pathlib import Path

import av
import cv2

camera, uid = sys.argv[1:]
Path(camera).mkdir()
(stamps,) = Path().glob(f"{camera}_camera_timestamps_*.csv")
times = [row["timestamp"] for row in csv.DictReader(stamps.read_text(encoding="utf-8").splitlines())]
parts = sorted(map(str, Path("recordings").glob(f"*uid_s_{uid}*video*.ts")))
pictures = (frame for part in parts for frame in av.open(part).decode(video=0))
for time, picture in zip(times, pictures, strict=False):  # the last times may have no picture
    cv2.imwrite(f"{camera}/{time}.jpg", picture.to_ndarray(format="bgr24"))
