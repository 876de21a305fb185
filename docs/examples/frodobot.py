"""A robot of FrodoBots as a camera: `device = "exec:python3 frodobot.py"`, or `... rear` for the map."""

import base64
import json
import sys
import time
import urllib.request

view = (sys.argv[1:] or ["front"])[0]
newest = 0.0
while True:
    url = f"http://localhost:8000/screenshot?view_types={view}"
    with urllib.request.urlopen(url, timeout=5) as reply:
        answer = json.load(reply)
    if answer["timestamp"] > newest:
        newest = answer["timestamp"]
        sys.stdout.buffer.write(base64.b64decode(answer[f"{view}_video_frame"].rpartition(",")[2]))
        sys.stdout.buffer.flush()
    time.sleep(0.05)
