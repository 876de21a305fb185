"""`lookback map`: build, extend, inspect, split, keep and sign maps.

`command` builds and extends, `files` does the rest with maps on the disk, `tiles` cuts one into several, and `keys`
makes and uses the keys that sign them.
"""
